# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is called besides, see `compile_jobs`, where a source predicts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from bvh_ros.ros.job_scenes import ABOUT_Z, EDGE, GOAL, MANY, RADIUS, START, scenes
from bvh_ros.scene import Numbered, Scene, Shapes

if TYPE_CHECKING:
    from bvh_ros.ros.compile_jobs import Needs


LATER = 10**10  # ns: by then who moves has come to rest


def _moving_scenes(needs: Needs) -> Iterator[Scene]:
    """Some that hold obstacles, one of which has a velocity."""
    for scene in scenes(needs):
        shape = Shapes.boxes(GOAL, EDGE)
        scene.update('moving', ['one'], shape, stamp=1, velocities=[EDGE])
        yield scene


def other_times(needs: Needs) -> None:
    """Rays, balls and overlaps at a time, and while it passes."""
    for scene in _moving_scenes(needs):
        for radius in (0.0, RADIUS):
            scene.raycast(START, GOAL, radius, at=2, until=3)
            scene.raycast(START, GOAL, radius, at=2, until=LATER)
            scene.raycast_all(START, GOAL, radius, at=2)
        scene.overlap(START, GOAL, ABOUT_Z, RADIUS, at=2)
        if needs.batch:
            scene.raycast_many([START], [GOAL], 1.0, at=2, until=3)
    if needs.batch:
        _rays_among_boxes(needs)


def _rays_among_boxes(needs: Needs) -> None:
    """So many that boxes are swept for them, and for balls, as for rays among other shapes."""
    scene, line = next(scenes(needs)), np.arange(MANY * 3.0).reshape(MANY, 3)
    names = Numbered('box#', np.arange(MANY))
    speeds = np.ones((MANY, 3))
    scene.replace('cloud', '', names, Shapes.boxes(line, EDGE), stamp=1, velocities=speeds)
    for radius in (0.0, RADIUS):
        for until in (3, LATER):
            scene.raycast_many(line, line, 1.0, radius=radius, at=2, until=until)
    scene.raycast_many(line, line, 1.0, at=np.full(MANY, 2), until=until)


def nearest_then(needs: Needs) -> None:
    """What is nearest at a time."""
    for scene in _moving_scenes(needs):
        scene.nearest(START, 2, at=2)


def paths_then(needs: Needs) -> None:
    """How far a shape is at a time."""
    for scene in _moving_scenes(needs):
        shapes = Shapes.boxes([START], EDGE, [ABOUT_Z])
        scene.clearance_many(shapes, signed=True, at=2)
