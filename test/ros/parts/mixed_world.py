# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes and balls in a node and in a scene: what the one answers, the other does."""

from typing import Any

import numpy as np
from ros.messages import marker
from scipy.spatial.transform import Rotation
from turns import unit_quaternions
from visualization_msgs.msg import Marker

from bvh_ros.scene import NodeScene, ShapeKind, Shapes

COUNT = 80
_RNG = np.random.default_rng(17)
CENTRE, SIZE = _RNG.uniform(-6, 6, (COUNT, 3)), _RNG.uniform(0.2, 2.0, (COUNT, 3))
TURN = unit_quaternions(_RNG.normal(size=(COUNT, 4)))
TURN[::2] = 0, 0, 0, 1
SIZE[-10:] = SIZE[-10:, :1]  # the last are balls
KIND = np.where(np.arange(COUNT) < COUNT - 10, ShapeKind.BOX, ShapeKind.SPHERE).astype(np.uint8)
NAMES = [f'a/{i}' for i in range(COUNT)]
PLACE, FACING = np.array((1.0, -2.0, 0.5)), Rotation.from_euler('xyz', (0.3, -0.8, 2.0))
PARAMETERS = {  # a view that shows every other one, and a frame
    'views': ['even'],
    'even.include': NAMES[::2],
    'transforms': ['lidar'],
    'lidar.xyz': PLACE.tolist(),
    'lidar.xyzw': FACING.as_quat().tolist(),
}


SHAPES = Shapes(KIND, CENTRE, TURN, SIZE)


def fill(world: Any) -> None:
    """Publish them, and wait until all are known."""
    kinds = {ShapeKind.BOX: Marker.CUBE, ShapeKind.SPHERE: Marker.SPHERE}
    rows = zip(CENTRE, SIZE, TURN, KIND, strict=True)
    world.show(
        *(
            marker(i, at, size, turn=turn, type=kinds[ShapeKind(kind)])
            for i, (at, size, turn, kind) in enumerate(rows)
        )
    )


def same_scene() -> NodeScene:
    """The same in a scene."""
    scene, even = NodeScene(), 1 + 2 * (np.arange(COUNT) % 2 == 0)
    scene.update('markers', NAMES, SHAPES, stamp=1, categories=even)
    return scene
