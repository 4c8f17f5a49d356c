# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The client's end of the topics `rays`, `ray_hits` and `names`."""

from __future__ import annotations

import random
from collections.abc import Iterable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import ArrayLike, NDArray
from rclpy.callback_groups import CallbackGroup
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

from bvh_ros.client.errors import BvhError
from bvh_ros.ros.conversions import ray_clouds
from bvh_ros.ros.conversions.ray_clouds import FREE, UNANSWERED, Rays
from bvh_ros.ros.qos import DEPTH

JITTER = 1_000_000  # ns
NAMES_TYPE = 'diagnostic_msgs/msg/DiagnosticStatus'


class RayChannel:
    """Sends clouds of rays and gives each cloud of hits to who waits for its stamp."""

    def __init__(self, node: Node, name: str, group: CallbackGroup) -> None:
        self._node = node
        self._name = name
        self.has_answered = False
        self._waiting: dict[tuple[int, int], tuple[Future, int]] = {}
        self._publisher = node.create_publisher(PointCloud2, f'{name}/rays', DEPTH)
        self.subscription = node.create_subscription(
            PointCloud2, f'{name}/ray_hits', self._receive, DEPTH, callback_group=group
        )

    def is_found(self) -> bool:
        """Whether the node's ends of both topics are found."""
        return bool(
            self._publisher.get_subscription_count() and self.subscription.get_publisher_count()
        )

    def ask(
        self, rays: Rays, frame_id: str, stamp: int | None, executor: Executor | None = None
    ) -> Future:
        """Publish rays; return a future of their hits, whose callbacks the executor runs."""
        cloud = ray_clouds.rays_cloud(rays)
        cloud.header.frame_id = frame_id
        cloud.header.stamp = Time(nanoseconds=self._stamp() if stamp is None else stamp).to_msg()
        answer = Future(executor=executor)
        self._waiting[_key(cloud)] = answer, cloud.width
        self._publisher.publish(cloud)
        return answer

    def forget(self, answer: Future) -> None:
        """Wait for this answer no longer."""
        for key, (other, _) in list(self._waiting.items()):
            if other is answer:
                self._waiting.pop(key, None)

    def _stamp(self) -> int:
        """Now, or up to a millisecond ago: clients that ask in one tick of a simulated clock must
        not take each other's answers for their own.
        """
        now = self._node.get_clock().now().nanoseconds
        while True:
            stamp = max(now, JITTER) - random.randrange(JITTER)
            if divmod(stamp, 1_000_000_000) not in self._waiting:
                return int(stamp)

    def _receive(self, cloud: PointCloud2) -> None:
        answer, count = self._waiting.pop(_key(cloud), (None, 0))
        if answer is None:
            return  # another client's
        self.has_answered = True
        try:
            hits = ray_clouds.hits(cloud)
        except ValueError as error:
            answer.set_exception(BvhError(f'the reply cannot be read: {error}'))
            return
        if len(hits.t) != count or (count and (hits.obstacles == UNANSWERED).all()):
            answer.set_exception(
                BvhError(f"'{self._name}/rays' cannot answer; its log and diagnostics say why")
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


def as_rays(origins: ArrayLike, directions: ArrayLike, t_max: ArrayLike, mask: ArrayLike) -> Rays:
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
        _column('t_max', np.asarray(t_max, np.float64), count),
        _column('mask', np.asarray(mask, np.uint32), count),
        np.dtype(np.float32 if narrow else np.float64),
    )


def handles_of(obstacles: Iterable[int]) -> set[int]:
    """Return the different handles of obstacles, without what stands for none."""
    return set(np.unique(np.fromiter(obstacles, np.int64)).tolist()) - {FREE, UNANSWERED}


def topic_of_names(node: Node, name: str) -> str:
    """Where names are told, or '' while nobody does.

    The handles in a view are those of the node, which tells them under its own name only.
    """
    for above in (name, name.rpartition('/')[0]):
        told = node.get_publishers_info_by_topic(f'{above}/names') if above else ()
        if any(publisher.topic_type == NAMES_TYPE for publisher in told):
            return f'{above}/names'
    return ''


def _column(name: str, values: NDArray, count: int) -> NDArray:
    if values.shape not in ((), (count,)):
        raise ValueError(f'{name} must be one number or have the shape ({count},)')
    return np.broadcast_to(values, (count,))


def _key(cloud: PointCloud2) -> tuple[int, int]:
    return cloud.header.stamp.sec, cloud.header.stamp.nanosec
