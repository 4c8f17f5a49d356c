# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The surfaces of obstacles as polygons, and what is seen of them from above."""

from collections.abc import Iterator

import numpy as np

from ..tree.access import CORNERS, SIDES
from .geometry.outline import convex_polygon
from .geometry.shapes import Floats, ShapeKind, Shapes, rotations

AROUND, UP = 24, 12  # faces of a sphere, and of a cylinder's side


def _sphere() -> Floats:
    """Quadrilaterals (n, 4, 3) of a ball of diameter 1."""
    turn = np.linspace(0.0, 2.0 * np.pi, AROUND + 1)
    rise = np.linspace(-0.5 * np.pi, 0.5 * np.pi, UP + 1)
    ring, height = np.cos(rise)[:, None], np.sin(rise)[:, None] + 0.0 * turn
    grid = 0.5 * np.stack((ring * np.cos(turn), ring * np.sin(turn), height), axis=2)
    return _between(grid)


def _cylinder() -> Floats:
    """The same of a cylinder of diameter and height 1; those of a base meet in its middle."""
    turn = np.linspace(0.0, 2.0 * np.pi, AROUND + 1)
    ring = 0.5 * np.array((0.0, 1.0, 1.0, 0.0))[:, None]
    height = np.array((-0.5, -0.5, 0.5, 0.5))[:, None] + 0.0 * turn
    return _between(np.stack((ring * np.cos(turn), ring * np.sin(turn), height), axis=2))


def _between(grid: Floats) -> Floats:
    """Quadrilaterals between the points of a grid, which goes up, and around counter-clockwise."""
    below, above = grid[:-1], grid[1:]
    sides = (below[:, :-1], below[:, 1:], above[:, 1:], above[:, :-1])
    return np.stack(sides, axis=2).reshape(-1, 4, 3)


UNIT = {
    ShapeKind.BOX: (CORNERS - 0.5)[SIDES],
    ShapeKind.SPHERE: _sphere(),
    ShapeKind.CYLINDER: _cylinder(),
}


def surfaces(shapes: Shapes) -> Iterator[Floats]:
    """Yield the polygons of canonical shapes, (m, 4, 3) or (m, 3, 3) for each."""
    turns = rotations(shapes.orientation)
    for row, kind in enumerate(shapes.kind.tolist()):
        local = _local(shapes, row, ShapeKind(kind))
        yield local @ turns[row].T + shapes.position[row]


def _local(shapes: Shapes, row: int, kind: ShapeKind) -> Floats:
    size = shapes.size[row]
    if kind == ShapeKind.MESH and shapes.mesh is not None:
        mesh = shapes.mesh[row]
        corners: Floats = mesh.vertices[mesh.corners]
        return corners
    if kind == ShapeKind.CAPSULE:
        ball = UNIT[ShapeKind.SPHERE] * size[0]
        straight = size[2] - size[0]
        middle = ball.mean(axis=1, keepdims=True)[..., 2:]
        side = UNIT[ShapeKind.CYLINDER][AROUND : 2 * AROUND] * (size[0], size[1], straight)
        return np.concatenate((ball + np.sign(middle) * (0.0, 0.0, 0.5 * straight), side))
    return UNIT[kind] * size


def faces(shapes: Shapes) -> list[Floats]:
    """All the polygons of canonical shapes, one after the other."""
    return [face for surface in surfaces(shapes) for face in surface]


def outlines(shapes: Shapes) -> list[Floats]:
    """The polygon (k, 2) around each shape as seen from above."""
    return [convex_polygon(surface.reshape(-1, 3)[:, :2]) for surface in surfaces(shapes)]
