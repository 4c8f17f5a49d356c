# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The client's ends of the topics of questions and answers in batches, and of `names`."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Path
from numpy.typing import ArrayLike, NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

from bvh_ros.client.asking import Patience, Question
from bvh_ros.client.errors import BvhError
from bvh_ros.ros.conversions.ray_clouds import FREE, UNANSWERED, Rays
from bvh_ros.ros.qos import REPEATED_REPLIES, REQUESTS

# Fast DDS sends a heartbeat with each message of a publisher that keeps only the latest one, so
# what is lost is sent again at once. What the next message has replaced is asked again.
LATEST = QoSProfile(depth=1)
ROW_WORK, POSE_WORK = 1e-5, 1e-4  # seconds that an answer takes a row, and a pose, at most
JITTER = 1_000_000  # ns, of a stamp near the clock
TIME_JITTER = 1_000_000_000  # ns, of a stamp near the times of the rows: clients may share these
LAST_STAMP = 2**31 * 10**9  # ns
NAMES_TYPE = 'diagnostic_msgs/msg/DiagnosticStatus'


class Channel:
    """Sends questions by one topic and gives each cloud of answers to who waits for its stamp.

    Parameters
    ----------
    topics : tuple of two str
        Of questions and of answers.
    read : callable
        Makes answers of a cloud; ValueError if it cannot be read.
    kind : type
        Of the questions' messages.
    """

    def __init__(
        self,
        node: Node,
        topics: tuple[str, str],
        read: Callable[[PointCloud2], Any],
        group: CallbackGroup,
        kind: type = PointCloud2,
    ) -> None:
        self._node = node
        self.topic = topics[0]
        self._read = read
        self.has_answered = False
        self._waiting: dict[tuple[int, int], tuple[Future, int, Question]] = {}
        self._patience = Patience()
        self.nothing = kind
        """Makes a message that asks nothing."""
        self._publisher = node.create_publisher(kind, topics[0], LATEST)
        # A lost message holds up the reliable subscription until a heartbeat, not the other one.
        self.subscriptions = [
            node.create_subscription(
                PointCloud2, topics[1], self._receive, qos, callback_group=group
            )
            for qos in (REQUESTS, REPEATED_REPLIES)
        ]

    def is_found(self) -> bool:
        """Whether the node's ends of both topics are found."""
        return bool(
            self._publisher.get_subscription_count()
            and self.subscriptions[0].get_publisher_count()
        )

    def ask(
        self, asked: Any, frame_id: str, stamp: int | None, executor: Executor | None = None
    ) -> tuple[Future, Question]:
        """Publish a message of questions; return a future of the answers, whose callbacks the
        executor runs, and what asks again.
        """
        asked.header.frame_id = frame_id
        asked.header.stamp = Time(nanoseconds=self.stamp() if stamp is None else stamp).to_msg()
        answer = Future(executor=executor)
        rows = _rows_of(asked)
        work = rows * (POSE_WORK if isinstance(asked, Path) else ROW_WORK)
        question = Question(lambda _: self._publisher.publish(asked), self._patience, work)
        self._waiting[_key(asked)] = answer, rows, question
        question.ask_if_due()
        return answer, question

    def forget(self, answer: Future) -> None:
        """Wait for this answer no longer."""
        for key, (other, *_) in list(self._waiting.items()):
            if other is answer:
                self._waiting.pop(key, None)

    def forget_contact(self) -> None:
        """Make sure of the node again before the next question: it did not answer the last one."""
        self.has_answered = False

    def stamp(self, near: int | None = None) -> int:
        """A stamp (ns) that no other question has, just before `near`, or before now.

        Answers bear the stamp of their question, so it is random: two clients that ask in one
        tick of a simulated clock must tell their answers apart. Rows count seconds from it, as
        doubles, so a stamp near their times keeps their nanoseconds.
        """
        jitter = JITTER if near is None else TIME_JITTER
        latest = self._node.get_clock().now().nanoseconds if near is None else near
        while True:
            stamp = max(latest, jitter) - random.randrange(jitter)
            if divmod(stamp, 1_000_000_000) not in self._waiting:
                return int(stamp)

    def _receive(self, cloud: PointCloud2) -> None:
        waiting = self._waiting.pop(_key(cloud), None)
        if waiting is None:
            return  # another client's, or not the first answer
        answer, count, question = waiting
        question.answered()
        self.has_answered = True
        try:
            hits = self._read(cloud)
        except ValueError as error:
            answer.set_exception(BvhError(f'the reply cannot be read: {error}'))
            return
        rows = len(hits.obstacles)
        if rows != count or (count and (hits.obstacles == UNANSWERED).all()):
            answer.set_exception(
                BvhError(f"'{self.topic}' cannot answer; its log and diagnostics say why")
            )
        else:
            answer.set_result(hits)


class NameChannel:
    """Keeps the newest message of names, and who waits for one that it does not tell."""

    def __init__(self, node: Node, topic: str, group: CallbackGroup) -> None:
        self.known: dict[int, str] = {}
        self.has_told = False
        self._waiting: dict[Future, set[int]] = {}  # other threads add and take away
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.subscription = node.create_subscription(
            DiagnosticStatus, topic, self._receive, latched, callback_group=group
        )

    def ask(self, handles: set[int]) -> Future:
        """Return a future that is done once all of these handles are known."""
        answer = Future()
        self._waiting[answer] = handles
        self._tell()
        return answer

    def forget(self, answer: Future) -> None:
        """Wait for this answer no longer."""
        self._waiting.pop(answer, None)

    def _receive(self, status: DiagnosticStatus) -> None:
        self.has_told = True
        self.known = {int(pair.key): pair.value for pair in status.values}
        self._tell()

    def _tell(self) -> None:
        for answer, handles in [*self._waiting.items()]:
            if handles <= self.known.keys():
                self.forget(answer)
                answer.set_result(None)


def as_rays(
    origins: ArrayLike,
    directions: ArrayLike,
    t_max: ArrayLike,
    mask: ArrayLike,
    radius: ArrayLike | None = None,
) -> Rays:
    """Return n rays; ValueError where the shapes do not fit together."""
    starts, ways = np.asarray(origins), np.asarray(directions)
    if starts.ndim != 2 or starts.shape[1] != 3 or ways.shape != starts.shape:
        raise ValueError(
            f'origins and directions must both have the shape (n, 3), not {starts.shape} '
            f'and {ways.shape}'
        )
    count = len(starts)
    narrow = starts.dtype == ways.dtype == np.float32
    return Rays(
        starts.astype(np.float64),
        ways.astype(np.float64),
        column('t_max', np.asarray(t_max, np.float64), count),
        column('mask', np.asarray(mask, np.uint32), count),
        np.dtype(np.float32 if narrow else np.float64),
        None if radius is None else column('radius', np.asarray(radius, np.float64), count),
    )


def with_times(rays: Rays, at: ArrayLike | None, until: ArrayLike | None, stamp: int) -> Rays:
    """Return rays that begin at `at` and are at t = 1 at `until`, ns; `stamp` is their cloud's.
    ValueError if these are no times.
    """
    if at is None:
        raise ValueError('until needs at')
    count = len(rays.t_max)
    begin = times('at', at, count)
    given = rays._replace(since=since(at, stamp, count))
    if until is None:
        return given
    takes = times('until', until, count) - begin
    if (takes < 0).any():
        raise ValueError(f'until must not be before at: row {int(np.argmax(takes < 0))} is')
    if ((takes > 0) & np.isinf(rays.t_max)).any():
        raise ValueError('t_max must end a ray that takes time')
    durations = np.where(takes > 0, takes / 1e9 * np.where(takes > 0, rays.t_max, 0.0), 0.0)
    return given._replace(durations=durations)


def earliest(at: ArrayLike | None, count: int) -> int | None:
    """Return the first of the times of `count` rows, ns; None where a stamp cannot be near it."""
    if at is None or not count:
        return None
    first = int(times('at', at, count).min())
    return first if 0 <= first < LAST_STAMP else None


def since(at: ArrayLike, stamp: int, count: int) -> NDArray[np.float64]:
    """Return times in ns as s after the stamp of their cloud; ValueError if they are none."""
    return (times('at', at, count) - stamp) / 1e9


def times(name: str, given: ArrayLike, count: int) -> NDArray[np.int64]:
    """Return a time in ns a row; ValueError if they are no integers."""
    values = np.asarray(given)
    if values.dtype.kind != 'i':
        raise ValueError(f'{name} must be integers (ns), not {values.dtype}')
    return column(name, values.astype(np.int64), count)


def as_rows(name: str, values: ArrayLike, count: int | None = None, width: int = 3) -> NDArray:
    """Return rows as float64; ValueError where they have another shape."""
    rows = np.asarray(values, np.float64)
    if count is not None and rows.shape == (width,):
        rows = np.broadcast_to(rows, (count, width))
    if rows.ndim != 2 or rows.shape[1] != width or count not in (None, len(rows)):
        raise ValueError(f'{name} must have the shape ({count or "n"}, {width}), not {rows.shape}')
    return rows


def handles_of(obstacles: Iterable[int]) -> set[int]:
    """Return the different handles of obstacles, without what stands for none."""
    return set(np.unique(np.fromiter(obstacles, np.int64)).tolist()) - {FREE, UNANSWERED}


def tellers_of_names(node: Node, name: str) -> tuple[str, frozenset[bytes]]:
    """Where names are told, and by which publishers; '' and none while nobody does.

    The handles in a view are those of the node, which tells them under its own name only. A node
    that is started again has another publisher.
    """
    for above in (name, name.rpartition('/')[0]):
        told = node.get_publishers_info_by_topic(f'{above}/names') if above else ()
        tellers = [bytes(one.endpoint_gid) for one in told if one.topic_type == NAMES_TYPE]
        if tellers:
            return f'{above}/names', frozenset(tellers)
    return '', frozenset()


def column(name: str, values: NDArray, count: int) -> NDArray:
    """Return a number a row; ValueError where there are others."""
    if values.shape not in ((), (count,)):
        raise ValueError(f'{name} must be one number or have the shape ({count},)')
    return np.broadcast_to(values, (count,))


def _rows_of(asked: Any) -> int:
    """How many questions a message asks."""
    return len(asked.poses) if isinstance(asked, Path) else asked.width


def _key(cloud: Any) -> tuple[int, int]:
    return cloud.header.stamp.sec, cloud.header.stamp.nanosec
