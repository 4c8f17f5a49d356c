# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`~/boxes` to `~/box_hits`, `~/points` to `~/nearest_hits`, `~/paths` to `~/path_hits`."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.compile_jobs import BOXES_ASKED, NEAREST_THEN, PATHS_THEN, POINTS
from bvh_ros.ros.conversions import paths, query_clouds, ray_clouds
from bvh_ros.ros.conversions.query_clouds import Boxes, Near, Points, QueryCloud, Touched
from bvh_ros.ros.parts.batch import UNKNOWN_TIME, Batch, moved_back
from bvh_ros.scene import NO_NODE

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rclpy.node import Node

    from bvh_ros.ros.cdr.point_cloud2 import PointCloud
    from bvh_ros.ros.parts.on_demand import OnDemand
    from bvh_ros.ros.parts.timed_batches import Spans
    from bvh_ros.ros.world.frames import Transform
    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import Scene

Told = Near | Touched
LEAST_FIELD = 4  # bytes


class VolumeBatch(Batch):
    """What batches of points and boxes share."""

    question: type = Points
    answer: Any = Near
    needed, needed_then = POINTS, NEAREST_THEN
    least = 3 * LEAST_FIELD  # bytes of a row

    def _reply(self, request: PointCloud) -> Generator[None, None, PointCloud2]:
        self._now()
        self._kernels.require(self.needed)
        transform = self._world.frames.into_node(request.frame_id, request.stamp)
        cloud, stamp = QueryCloud(request, self.question), self._stamp_of(request)
        if cloud.has_times:
            self._kernels.require(self.needed_then)
        told = query_clouds.unanswered(self.answer, len(cloud))

        def answer(piece: slice) -> None:
            rows = cloud.rows(piece.start, piece.stop)
            put(told, piece, *self._answer(rows, piece.start, transform, stamp))

        yield from self._in_pieces(len(cloud), answer)
        return query_clouds.answers_cloud(told, request.height, request.width, cloud.real)

    def _answer(
        self, asked: Any, number: int, transform: Transform | None, stamp: int
    ) -> tuple[NDArray[np.bool_], Told]:
        """Which of some rows are good, and the answers to these; `number` is that of the first
        row, and `stamp` that of the cloud, ns.
        """
        scene, spans = self._now(), None
        if transform is not None:
            with np.errstate(over='ignore', invalid='ignore'):  # what leaves the doubles is bad
                asked = asked.moved(transform)
        bad, reason = query_clouds.fault(asked, number)
        if asked.since is not None:
            spans, unknown = self._spans(asked.since, None, stamp)
            bad, reason = bad | unknown, reason or UNKNOWN_TIME
        good = self._count(bad, reason)
        some = query_clouds.take(asked, good)
        if spans is None:
            found = self._ask(scene, some)
        else:
            found = self._elsewhen(some, spans.take(good))
        return good, found if transform is None else moved_back(transform, found)

    def _elsewhen(self, asked: Any, spans: Spans) -> Told:
        """Ask about other times."""
        from bvh_ros.ros.parts.timed_batches import fill

        told = query_clouds.unanswered(self.answer, len(spans.at))
        return fill(
            *(told, spans),
            lambda scene, rows, at: self._ask(scene, query_clouds.take(asked, rows), at),
        )

    def _ask(self, scene: Scene, asked: Any, at: NDArray[np.int64] | None = None) -> Told:
        """Ask the scene, about now or (n,) times in ns."""
        raise NotImplementedError

    def _refusal(self, request: PointCloud, reason: str) -> PointCloud2:
        height, width = ray_clouds.rows_of(request, self.least)
        self.refused.add(reason, height * width)
        told = query_clouds.unanswered(self.answer, height * width)
        return query_clouds.answers_cloud(told, height, width, np.dtype(np.float32))


class PointBatch(VolumeBatch):
    """Answers points by the obstacles nearest to them."""

    asked, told = 'points', 'nearest_hits'

    def _ask(self, scene: Scene, asked: Points, at: NDArray[np.int64] | None = None) -> Near:
        masks = self._masks(asked.masks)
        handles, distances, points = scene.nearest_many(
            *(asked.places, 1, asked.reaches, masks),
            threads=self._world.settings.threads_for(len(masks)),
            at=at,
        )
        return near(asked.places, points[:, 0], distances[:, 0], handles[:, 0])


class BoxBatch(VolumeBatch):
    """Answers boxes by what touches them."""

    asked, told = 'boxes', 'box_hits'
    question, answer, needed, needed_then = Boxes, Touched, BOXES_ASKED, BOXES_ASKED
    least = 6 * LEAST_FIELD

    def _ask(self, scene: Scene, asked: Boxes, at: NDArray[np.int64] | None = None) -> Touched:
        hits = scene.overlap_many(
            *(asked.places, asked.sizes, asked.turns, asked.tolerances),
            *(
                self._masks(asked.masks),
                'hits',
                self._world.settings.threads_for(len(asked.masks)),
            ),
            at=at,
        )
        return Touched(hits.points, hits.distances, hits.handles, hits.counts.astype(np.uint32))


class PathBatch(Batch):
    """Answers the poses of paths by how far the footprint is from the nearest obstacle there:
    where they touch, minus the depth, and the normal is the shortest way out.

    Parameters
    ----------
    node, world, view, kernels
        As of a `Batch`.
    footprint : sequence of float
        Edge lengths of a box, or the radius of a ball, m; centred on each pose.
    """

    asked, told = 'paths', 'path_hits'
    message = Path

    def __init__(
        self, node: Node, world: World, view: View, kernels: OnDemand, footprint: Sequence[float]
    ) -> None:
        self._footprint = footprint
        super().__init__(node, world, view, kernels)

    def _read(self, serialised: bytes) -> paths.Poses:
        return paths.read(serialised)

    def _reply(self, request: paths.Poses) -> Generator[None, None, PointCloud2]:
        self._now()
        transform = self._world.frames.into_node(request.frame_id, request.stamp)
        told = query_clouds.unanswered(Near, len(request.places))

        def answer(piece: slice) -> None:
            rows = request.rows(piece)
            if transform is not None:
                rows = rows.moved(transform)
            good, found = self._answer(rows, piece.start)
            if transform is not None:
                found = moved_back(transform, found)
            put(told, piece, good, found)

        yield from self._in_pieces(len(request.places), answer)
        return query_clouds.answers_cloud(told, 1, len(request.places), np.dtype(np.float64))

    def _answer(self, rows: paths.Poses, number: int) -> tuple[NDArray[np.bool_], Near]:
        """Which of some poses are good, and the answers to these."""
        times, scene = self._world.times, self._now()
        if times is None or not rows.stamps.any():  # as ever, stamps say nothing
            good = self._count(*rows.fault(number))
            return good, self._ask(scene, rows.rows(good))
        from bvh_ros.ros.parts.timed_batches import fill, spans_between

        self._kernels.require(PATHS_THEN)
        now = self.node.get_clock().now().nanoseconds
        spans, unknown = spans_between(rows.stamps, rows.stamps, times, now)
        timed, (bad, reason) = rows.stamps != 0, rows.fault(number)
        good = self._count(bad | (unknown & timed), reason or UNKNOWN_TIME)
        some, timed = rows.rows(good), timed[good]
        told, later = query_clouds.unanswered(Near, len(timed)), some.rows(timed)
        put(told, slice(None), ~timed, self._ask(scene, some.rows(~timed)))

        def ask(state: Scene, places: Any, at: NDArray[np.int64]) -> Near:
            return self._ask(state, later.rows(places), at)

        found = query_clouds.unanswered(Near, len(later.stamps))
        put(told, slice(None), timed, fill(found, spans.take(good).take(timed), ask))
        return good, told

    def _ask(self, scene: Scene, rows: paths.Poses, at: NDArray[np.int64] | None = None) -> Near:
        shapes = paths.shapes(rows, self._footprint)
        handles, distances, places, points = scene.clearance_many(
            *(shapes, np.inf, self.view.mask, True),
            self._world.settings.threads_for(len(rows.places)),
            at=at,
        )
        return near(places, points, distances, handles)

    def _refusal(self, request: paths.Poses, reason: str) -> PointCloud2:
        count = max(len(request.places), 1)
        self.refused.add(reason, count)
        told = query_clouds.unanswered(Near, count)
        return query_clouds.answers_cloud(told, 1, count, np.dtype(np.float64))


def put(told: Any, piece: slice, good: NDArray[np.bool_], found: Any) -> None:
    """Write the answers to the good rows of a piece."""
    for column, rows in zip(told, found, strict=True):
        column[piece][good] = rows


def near(
    places: NDArray[np.float64],
    points: NDArray[np.float64],
    distances: NDArray[np.float64],
    handles: NDArray[np.uint32],
) -> Near:
    """Return obstacles' points with the directions from there to the places, or out of the
    obstacles where distances are negative.
    """
    normals = np.zeros((len(places), 3))
    apart = (handles != NO_NODE) & (distances != 0.0)
    normals[apart] = (places[apart] - points[apart]) / distances[apart, None]
    return Near(points, distances, normals, handles)
