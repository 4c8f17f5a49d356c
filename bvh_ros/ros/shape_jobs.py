# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is called for all shapes, see `compile_jobs`: jobs that share most of what they compile.

Each compiles what it can before it needs a scene with shapes in it: how these get there is
compiled in another process meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bvh_ros.ros.job_scenes import ABOUT_Z, CORNERS, FAR, GOAL, RADIUS, START, scenes, with_shapes
from bvh_ros.scene import ShapeKind
from bvh_ros.scene.cast.arguments import Rays
from bvh_ros.scene.cast.batch import first_hits, first_of_one
from bvh_ros.scene.distance.narrow_phase import hull_gap
from bvh_ros.scene.shapes.hull import Hull
from bvh_ros.scene.store import Obstacles
from bvh_ros.tree.compiler import prepare

if TYPE_CHECKING:
    from bvh_ros.ros.compile_jobs import Needs


def calls(needs: Needs) -> Sequence[tuple[str, float, Callable[[Needs], None]]]:
    """Return names, seconds and calls as of `compile_jobs.Job`."""
    meshes = ShapeKind.MESH in needs.kinds and not needs.planar
    return [
        *([('distances of meshes', 5.0, _distances_of_meshes)] if meshes else []),
        ('balls', 10.0, _balls),
        ('overlaps', 6.0, _overlaps),
        ('rays', 4.0, _rays),
        *([('batches of rays at shapes', 4.0, _batches_of_rays)] if needs.batch else []),
    ]


def _distances_of_meshes(_needs: Needs) -> None:
    """The longest part that all share. Begun first, it is there when they come to it."""
    vector = np.zeros(3)
    prepare(hull_gap, Hull(CORNERS, CORNERS[None], 1.0), vector, vector, vector)


def _balls(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.raycast(START, GOAL, RADIUS)
        scene.raycast_all(START, GOAL, RADIUS)


def _overlaps(needs: Needs) -> None:
    """Of a turned box with round corners, a ball, and a box, which is compiled elsewhere."""
    for scene in scenes(needs):
        scene.overlap(START, FAR, ABOUT_Z, RADIUS)
        scene.overlap((3.0,) * 3, (3.0,) * 3, ABOUT_Z, 2.0)
        scene.overlap(START, FAR)


def _rays(needs: Needs) -> None:
    held = _no_shapes(needs)
    ends = np.zeros(3), np.zeros(3)
    first_of_one(held.tree, held.columns, ends, (0.0, np.uint32(1), False))
    scene = with_shapes(needs)
    scene.raycast(START, GOAL)
    scene.raycast_all(START, GOAL)


def _batches_of_rays(needs: Needs) -> None:
    held, row = _no_shapes(needs), np.zeros((1, 3))
    rays = Rays(row, row, np.ones(1), np.ones(1, np.uint32), None, False, False)
    first_hits(held.tree, held.columns, rays)
    with_shapes(needs).raycast_many([START], [GOAL])


def _no_shapes(needs: Needs) -> Obstacles:
    """What would hold shapes: where there are none, a scene asks its tree."""
    return Obstacles(needs.planar, needs.margin, ShapeKind.MESH in needs.kinds, 1)
