# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Embree 4, through embreex: a very fast ray caster. It knows triangles, so a box is twelve."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scenes import Boxes
from ..timing import Job
from .base import Library, Work

# Corner k of a box takes x, y, z from its upper end where bit 0, 1, 2 of k is set.
UPPER = np.array([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)], bool)
SIDES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
FACES = np.array([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))], np.int32)


Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]


def triangles(boxes: Boxes) -> Mesh:
    """Corners (8 n, 3) and the twelve triangles of every box (12 n, 3)."""
    corners = np.where(UPPER, boxes.hi[:, None], boxes.lo[:, None]).astype(np.float32)
    faces = FACES + 8 * np.arange(len(boxes.lo), dtype=np.int32)[:, None, None]
    return corners.reshape(-1, 3), faces.reshape(-1, 3)


class Embree(Library):
    """Embree's static scene; what moves is built anew, for embreex gives no update."""

    name = 'Embree 4'
    module = 'embreex'
    note = (
        'through embreex, 12 indexed triangles a box, float32, the query that returns the '
        'triangle alone; not the robust mode, which is slower'
    )

    def scene(self, mesh: Mesh) -> Any:
        """A static scene of these triangles."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scene = EmbreeScene()
        TriangleMesh(scene, *mesh)
        return scene

    def cast(self, work: Work) -> Job:
        """First hits."""
        scene = self.scene(triangles(work.boxes))
        rays = [np.ascontiguousarray(part, np.float32) for part in work.rays]
        return Job(lambda: scene.run(*rays), len(rays[0]), _hits)

    def frame(self, work: Work) -> Job:
        """Build with all boxes moved, then cast. Making the triangles is not counted."""
        meshes = [triangles(state) for state in work.states]
        rays = [np.ascontiguousarray(part, np.float32) for part in work.rays]
        turn = iter(range(1 << 62))
        return Job(lambda: self.scene(meshes[1 - next(turn) % 2]).run(*rays), 1, _hits)

    def build(self, work: Work) -> Job:
        """Build; Embree does when the first ray comes. Making the triangles is not counted."""
        mesh = triangles(work.boxes)
        ray = np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)
        return Job(lambda: self.scene(mesh).run(*ray), len(work.boxes.lo))


def _hits(triangle: NDArray[np.int32]) -> int:
    return int(np.count_nonzero(triangle >= 0))
