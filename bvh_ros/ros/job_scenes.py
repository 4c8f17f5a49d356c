# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Throw-away scenes for the calls of `compile_jobs`, and numbers to ask them about."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bvh_ros import DynamicBVH
from bvh_ros.scene import Mesh, Numbered, Scene, ShapeKind, Shapes

if TYPE_CHECKING:
    from bvh_ros.ros.compile_jobs import Needs

MANY = 4096  # boxes and rays enough that the batch is sorted and cast through a wide snapshot
BOXES = 24  # enough that every branch of building, inserting and rotating runs
EDGE = (0.9, 0.9, 0.9)
ABOUT_Z = (0.0, 0.0, 0.3, 0.9)  # the only way to turn what is seen from above
TURNED = (0.1, 0.2, 0.3, 0.9)
CORNERS = np.vstack((np.zeros(3), np.eye(3)))
TETRAHEDRON = [np.delete(CORNERS, corner, axis=0) for corner in range(4)]  # its faces
# Through boxes, seen from above or not: what writes down a hit is compiled by hitting.
START, GOAL = (0.0, 0.0, 0.0), (60.0, 60.0, 60.0)
FAR = (9.0, 9.0, 9.0)
RADIUS = 0.5
NUMBERS = np.arange(BOXES)
MIDDLE = np.column_stack((NUMBERS, NUMBERS % 5, NUMBERS % 3)).astype(np.float64)


def empty(needs: Needs) -> Scene:
    """One in which who moves comes to rest."""
    meshes = ShapeKind.MESH in needs.kinds
    return Scene(planar=needs.planar, margin=needs.margin, meshes=meshes, max_prediction=1.0)


def replace(scene: Scene, shift: float, numbers: NDArray[np.int64] = NUMBERS) -> None:
    shapes = Shapes.boxes(MIDDLE[numbers] + shift, EDGE)
    scene.replace('cloud', '', Numbered('box#', numbers), shapes, stamp=1)


def with_boxes(needs: Needs) -> Scene:
    scene = empty(needs)
    replace(scene, 0.0)
    return scene


def with_shapes(needs: Needs) -> Scene:
    """Return turned and round shapes among boxes."""
    scene = with_boxes(needs)
    for kind in needs.kinds:
        place = [3.0, 3.5 + kind, 3.0]
        if kind == ShapeKind.MESH:
            shape = Shapes.of_meshes([Mesh(TETRAHEDRON)], place, [TURNED])
        else:
            shape = Shapes.boxes(place, EDGE, [TURNED])
            shape = shape._replace(kind=np.array([kind], dtype=np.uint8))
        scene.update('turned', [f'{kind.name}/0'], shape, stamp=3)
    return scene


def scenes(needs: Needs) -> Iterator[Scene]:
    """The empty one first: while another process compiles how boxes get there, what is asked of it
    can be compiled here.
    """
    yield empty(needs)
    yield with_boxes(needs)
    yield with_shapes(needs)


def use_tree(ndim: int) -> None:
    """What a tree without a scene is asked."""
    tree = DynamicBVH(ndim=ndim)
    low, high = np.zeros(ndim), np.ones(ndim)
    handle = tree.insert(low, high)
    tree.raycast(low - 1.0, high)
    tree.move(handle, low + 1.0, high + 1.0)
    boxes = MIDDLE[:, :ndim]
    handles = tree.insert_many(boxes, boxes + 0.9)
    tree.move_many(handles, boxes + 0.1, boxes + 1.0)
    tree.raycast_all(low, high)
    tree.raycast_many(boxes, boxes)
    tree.overlap(low, high)
    tree.overlap_pairs()
    tree.nearest(low, 2)
    tree.boxcast(low, high, high)
    tree.remove(handle)
    tree.remove_many(handles)
