# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many questions in one message, answered row for row: `~/rays` to `~/ray_hits`."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.cdr import point_cloud2 as decoder
from bvh_ros.ros.cdr.point_cloud2 import PointCloud
from bvh_ros.ros.compile_jobs import BALLS
from bvh_ros.ros.conversions import ray_clouds
from bvh_ros.ros.conversions.ray_clouds import Hits, RayCloud, Rays
from bvh_ros.ros.parts.part import NodePart
from bvh_ros.ros.parts.refusals import Refused, explain
from bvh_ros.ros.parts.timings import Timings
from bvh_ros.ros.qos import DEPTH, Delivery
from bvh_ros.ros.sources.subscribing import FollowingSubscription

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rclpy.node import Node

    from bvh_ros.ros.parts.on_demand import OnDemand
    from bvh_ros.ros.parts.query_drawing import QueryDrawing
    from bvh_ros.ros.parts.timed_batches import Spans
    from bvh_ros.ros.world.frames import Transform
    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import Scene

QOS_PERIOD = 1.0  # seconds
FIRST_PIECE, LEAST_PIECE, LARGEST_PIECE = 256, 32, 8192  # rows
PIECE_TIME = 0.005  # seconds
# What a batch of so many rows needs of so many obstacles takes longer than a turn.
MANY_ROWS, MANY_OBSTACLES = 1024, 30_000
TURN = 0.01  # seconds after which others get a turn
DONE = object()
UNKNOWN_TIME = 'its time is not known, see history and max_prediction'


class Batch(NodePart):
    """Answers each message of questions by a cloud of answers, in the request's frame.

    A row that cannot be answered (NaN, infinite, negative), and each row of a message that cannot
    be answered (wrong fields, unknown frame, a required source missing), has the obstacle
    0xFFFFFFFE and NaN. A cloud whose size cannot be believed gets one such row.

    A cloud of very many rows is answered piece by piece, and others have their turns in between:
    each row meets the world as it is then. The replies come in the order of the requests.

    Parameters
    ----------
    world : World
        Asked before each answer whether it is complete.
    view : View
        What is seen, of that what each row's mask asks for, and the name of the topics.
    kernels : OnDemand
        What is compiled when somebody asks.
    """

    asked, told = 'rays', 'ray_hits'
    message: type = PointCloud2

    def __init__(self, node: Node, world: World, view: View, kernels: OnDemand) -> None:
        super().__init__(node)
        self.view = view
        self.refused = Refused(node.get_logger(), view.topic(self.asked))
        self.what = f'{self.asked} of {view.name}' if view.name else self.asked
        self.answered = 0  # rows
        self.timings = Timings()
        self._world = world
        self._kernels = kernels
        self._rows = FIRST_PIECE  # of the next piece
        # Questions that wait, the first begun: their bytes, and what answers them.
        self._work: deque[tuple[bytes, Iterator[None]]] = deque()
        self._turn = node.create_guard_condition(self._go_on)
        self._close += [partial(node.destroy_guard_condition, self._turn), self._work.clear]
        self._publisher = self.publisher(PointCloud2, view.topic(self.told), DEPTH)
        delivery = Delivery(ordered=False, raw=True)
        subscription = FollowingSubscription(
            node, self.message, view.topic(self.asked), self.receive, delivery
        )
        self._close.append(subscription.destroy)
        self.every(QOS_PERIOD, subscription.check)

    def receive(self, messages: Sequence[bytes]) -> None:
        """Begin to answer one cloud, unless it repeats a question that still waits."""
        (serialised,) = messages
        if any(serialised == waiting for waiting, _ in self._work):
            return
        try:
            request = self._read(serialised)
        except ValueError as error:  # from whom, and what was asked, is not known
            self.refused.add(str(error))
            return
        self._work.append((serialised, self._answering(request)))
        while len(self._work) > DEPTH:
            for _ in self._work.popleft()[1]:
                pass
        self._go_on()

    def _go_on(self) -> None:
        """Answer for a while, and go on after others had their turn."""
        began = time.perf_counter()
        try:
            while self._work and time.perf_counter() - began < TURN:
                if next(self._work[0][1], DONE) is DONE:
                    self._work.popleft()
        finally:
            if self._work:
                self._turn.trigger()

    def finish(self) -> None:
        """Answer until nothing reads the scene in the helper thread any more."""
        while self._work and self._world.changes.owner is self:
            next(self._work[0][1])

    def _answering(self, request: PointCloud) -> Iterator[None]:
        """Answer one cloud, with pauses."""
        began = time.perf_counter_ns()
        try:
            reply = yield from self._reply(request)
            self._publish(reply, request)
            self.timings.add(began)
            return
        except ValueError as error:
            reason = str(error)
        except Exception as error:  # whatever went wrong, the way must not look free
            reason = explain(error)
        # Not earlier: an error holds in memory whatever its function was working on.
        self._publish(self._refusal(request, reason), request)
        self.timings.add(began)

    def _publish(self, reply: PointCloud2, request: PointCloud) -> None:
        seconds, rest = divmod(request.stamp, 1_000_000_000)
        reply.header.stamp.sec, reply.header.stamp.nanosec = seconds, rest
        reply.header.frame_id = request.frame_id
        self._publisher.publish(reply)

    def _read(self, serialised: bytes) -> Any:
        """Read a message; ValueError if it is none."""
        return decoder.read(serialised)

    def _reply(self, request: Any) -> Generator[None, None, PointCloud2]:
        """Make the cloud of answers, with pauses; ValueError if there can be none."""
        raise NotImplementedError

    def _refusal(self, request: Any, reason: str) -> PointCloud2:
        """Make the cloud that says that nothing is answered."""
        raise NotImplementedError

    def _in_pieces(self, count: int, answer: Callable[[slice], None]) -> Iterator[None]:
        """Answer `count` rows, piece by piece with pauses; a piece takes about PIECE_TIME."""
        changes, begin = self._world.changes, 0
        if count >= MANY_ROWS and len(changes.visible) >= MANY_OBSTACLES:
            yield from changes.read(self, partial(changes.visible.prepare_batch, count))
        while begin < count:
            if begin:
                yield
            began = time.perf_counter()
            end = min(begin + self._rows, count)
            answer(slice(begin, end))
            took = max(time.perf_counter() - began, 1e-6)
            rows = int((end - begin) * min(PIECE_TIME / took, 4.0))
            if rows < self._rows or end - begin == self._rows:
                self._rows = min(max(rows, LEAST_PIECE), LARGEST_PIECE)
            begin = end

    def _now(self) -> Scene:
        return self._world.at(self.node.get_clock().now().nanoseconds)

    def _stamp_of(self, request: Any) -> int:
        """When a cloud was stamped, ns; now, if it was not."""
        return request.stamp or self.node.get_clock().now().nanoseconds

    def _spans(
        self, since: NDArray[np.float64], durations: NDArray[np.float64] | None, stamp: int
    ) -> tuple[Spans, NDArray[np.bool_]]:
        """When rows begin and end, and which of them cannot be answered."""
        from bvh_ros.ros.parts.timed_batches import spans_of

        if self._world.times is None:
            raise ValueError(
                't0 and duration have no meaning: no source predicts, and there is no history'
            )
        now = self.node.get_clock().now().nanoseconds
        return spans_of(since, durations, stamp, self._world.times, now)

    def _masks(self, masks: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """What of these masks this view shows."""
        return masks & np.uint32(self.view.mask)

    def _count(self, bad: NDArray[np.bool_], reason: str) -> NDArray[np.bool_]:
        """Count rows that are answered, and not; return which are."""
        refused = int(np.count_nonzero(bad))
        self.answered += len(bad) - refused
        if refused:
            self.refused.add(reason, refused)
        return ~bad


class RayBatch(Batch):
    """Answers rays by hits.

    Parameters
    ----------
    node, world, view, kernels
        As of a `Batch`.
    drawing : QueryDrawing
        Is told of rays and hits while somebody looks.
    """

    def __init__(
        self, node: Node, world: World, view: View, kernels: OnDemand, drawing: QueryDrawing
    ) -> None:
        super().__init__(node, world, view, kernels)
        self._drawing = drawing

    def _reply(self, request: PointCloud) -> Generator[None, None, PointCloud2]:
        self._now()
        transform = self._world.frames.into_node(request.frame_id, request.stamp)
        cloud = RayCloud(request)
        if cloud.has_radii and not cloud.has_times:
            self._kernels.require(BALLS)
        stamp = self._stamp_of(request)
        table = ray_clouds.hits_table(len(cloud), cloud.real)

        def answer(piece: slice) -> None:
            rays = cloud.rows(piece.start, piece.stop)
            hits = self._answer(rays, piece.start, transform, stamp)
            ray_clouds.write_hits(table[piece], hits)

        yield from self._in_pieces(len(cloud), answer)
        return ray_clouds.table_cloud(table, request.height, request.width, table['t'])

    def _answer(self, rays: Rays, number: int, transform: Transform | None, stamp: int) -> Hits:
        """Hits of some rays, the first of which has this number; `stamp` is their cloud's, ns."""
        scene = self._now()
        if transform is not None:
            rays = moved(transform, rays)
        bad, reason = rays.fault(number)
        if rays.since is None:
            spans = None
        else:
            spans, unknown = self._spans(rays.since, rays.durations, stamp)
            reason = reason or UNKNOWN_TIME
            bad = bad | unknown
        good = self._count(bad, reason)
        if good.all():
            hits = self._cast(scene, rays, spans)
        else:
            some = None if spans is None else spans.take(good)
            hits = self._cast(scene, rays.take(good), some)
            hits = Hits.unanswered(len(good)).put(good, hits)
        if self._drawing.is_watched:
            self._drawing.add_rays(rays, hits)
        return hits if transform is None else moved_back(transform, hits)

    def _cast(self, scene: Scene, rays: Rays, spans: Spans | None) -> Hits:
        masks = self._masks(rays.masks)
        if spans is not None:
            from bvh_ros.ros.parts.timed_batches import cast

            threads = self._world.settings.threads_for(len(masks))
            return cast(rays, masks, self.view.skip_inside, threads, spans)
        return Hits(
            *scene.raycast_many(
                *(rays.origins, rays.directions, rays.t_max, masks, self.view.skip_inside),
                radius=rays.radii,
                threads=self._world.settings.threads_for(len(masks)),
            )
        )

    def _refusal(self, request: PointCloud, reason: str) -> PointCloud2:
        height, width = ray_clouds.rows_of(request, ray_clouds.LEAST_RAY)
        self.refused.add(reason, height * width)
        return ray_clouds.hits_cloud(
            Hits.unanswered(height * width), height, width, np.dtype(np.float32)
        )


def moved(transform: Transform, rays: Rays) -> Rays:
    """Return rays in the node's frame; lengths, and with them t, are the same there."""
    with np.errstate(over='ignore', invalid='ignore'):  # rows that leave the doubles are refused
        return rays._replace(
            origins=transform.points(rays.origins), directions=transform.vectors(rays.directions)
        )


def moved_back(transform: Transform, told: Any) -> Any:
    """Return answers in the frame that the questions came from."""
    back = transform.inverse()
    with np.errstate(over='ignore', invalid='ignore'):
        told = told._replace(points=back.points(told.points))
        if 'normals' in told._fields:
            told = told._replace(normals=back.vectors(told.normals))
    return told
