# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`~/queries`: the last questions and what they met, while somebody looks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.cdr.drawing import Drawing, marker_array
from bvh_ros.ros.conversions import outlines, rotations
from bvh_ros.ros.conversions.ray_clouds import FREE, UNANSWERED, Floats
from bvh_ros.ros.parts.watched import OnDemandPublisher

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.config.part_settings import DrawSettings
    from bvh_ros.ros.conversions.plans import Query
    from bvh_ros.ros.conversions.ray_clouds import Hits, Rays
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import SceneHit

LINE, SPOT = 0.01, 0.08  # m: width of a line, diameter of a hit
FREE_WAY = (0.0, 0.62, 0.45, 1.0)
BLOCKED_WAY = (0.84, 0.37, 0.0, 1.0)
EMPTY_WORLD = 10.0  # m that a ray without end is drawn long where there is nothing


class QueryDrawing(OnDemandPublisher):
    """Keeps the last lines and hits, up to a limit; green is free, red is not.

    A ray ends where it hits, and one without end some way behind the world. A box that was asked
    about is drawn by its edges.
    """

    def __init__(self, node: Node, world: World, settings: DrawSettings) -> None:
        super().__init__(node, MarkerArray, '~/queries')
        self._world = world
        self._limit = settings.limit
        self._new = False
        self._lines = np.empty((0, 2, 3))
        self._blocked = np.empty(0, bool)
        self._spots = np.empty((0, 3))

    def add_rays(self, rays: Rays, hits: Hits) -> None:
        """Remember rays in the node's frame; those without an answer are left out."""
        rows = np.flatnonzero(hits.obstacles != UNANSWERED)[-self._limit :]
        origins, directions = rays.origins[rows], rays.directions[rows]
        blocked = hits.obstacles[rows] != FREE
        lengths = np.linalg.norm(directions, axis=1)
        with np.errstate(divide='ignore'):
            beyond = self._beyond_the_world(origins) / lengths
        t = np.where(blocked, hits.t[rows], np.minimum(rays.t_max[rows], beyond))
        t[lengths == 0.0] = 0.0
        ends = origins + t[:, None] * directions
        self._remember(np.stack((origins, ends), axis=1), blocked, hits.points[rows][blocked])

    def add_query(self, query: Query, hits: Sequence[SceneHit], *, is_box: bool) -> None:
        """Remember what a service was asked and answered."""
        spots = np.array([hit.point for hit in hits]).reshape(-1, 3)
        start, goal = np.array(query.start), np.array(query.goal)
        lines = np.stack((start, goal))[None]
        if is_box:
            turn = rotations.normalised(query.orientation)
            half = rotations.rotate(turn * (-1.0, -1.0, -1.0, 1.0), (goal - start) * 0.5)
            half = np.abs(half)[None] + query.tolerance
            ends = outlines.edges(-half, half)
            lines = (start + goal) * 0.5 + rotations.rotate(turn, ends)
        self._remember(lines, np.full(len(lines), bool(hits)), spots)

    def message(self) -> bytes | None:
        """Return the serialised MarkerArray, or None if nothing was asked since the last."""
        if not self._new:
            return None
        self._new = False
        colours = np.where(self._blocked[:, None], BLOCKED_WAY, FREE_WAY).astype(np.float32)
        drawings = [
            Drawing(
                Marker.LINE_LIST, (LINE, 0.0, 0.0), namespace='rays',
                points=self._lines.reshape(-1, 3), colours=np.repeat(colours, 2, axis=0),
            ),
            Drawing(
                Marker.SPHERE_LIST, (SPOT, SPOT, SPOT), BLOCKED_WAY, 'hits', points=self._spots
            ),
        ]  # fmt: skip
        frames, clock = self._world.frames, self.node.get_clock()
        return marker_array(drawings, frames.frame_id, clock.now().nanoseconds)

    def _remember(self, lines: Floats, blocked: NDArray[np.bool_], spots: Floats) -> None:
        drawable = np.isfinite(lines).all(axis=(1, 2))
        self._lines = np.concatenate((self._lines, lines[drawable]))[-self._limit :]
        self._blocked = np.concatenate((self._blocked, blocked[drawable]))[-self._limit :]
        self._spots = np.concatenate((self._spots, spots))[-self._limit :]
        self._new = True

    def _beyond_the_world(self, origins: Floats) -> Floats:
        """Return how long a ray from each place has to be to end behind all obstacles."""
        bounds = self._world.scene.bounds
        if bounds is None:
            return np.full(len(origins), EMPTY_WORLD)
        lo, hi = bounds
        from_middle = origins[:, : len(lo)] - (lo + hi) * 0.5
        lengths: Floats = np.linalg.norm(from_middle, axis=1) + np.linalg.norm(hi - lo)
        return lengths
