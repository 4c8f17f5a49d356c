# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Made-up worlds of four robots, as large as the recorded ones that they stand for."""

import numpy as np

from ...scene import ShapeKind, Shapes


def aisles() -> Shapes:
    """A warehouse seen by a planner: 40 rows of shelves from cells of half a metre, 2 m high."""
    row, cell = (number.ravel() for number in np.mgrid[:40, :90])
    aside = cell % 30 < 27  # cross aisles
    place = np.column_stack((cell * 0.5, row * 3.0, np.ones(len(row))))[aside]
    return Shapes.boxes(place, [0.5, 0.5, 2.0])


def cans() -> Shapes:
    """A shelf of six boards, and on each turned boxes and standing cans."""
    rng = np.random.default_rng(3)
    boards = Shapes.boxes([(0.6, 0.0, 0.3 * level) for level in range(6)], [0.4, 1.2, 0.02])
    count = 36
    place = np.column_stack(
        (
            rng.uniform(0.45, 0.75, count),
            np.tile(np.linspace(-0.5, 0.5, 6), 6),
            np.repeat(np.arange(6), 6) * 0.3 + 0.07,
        )
    )
    half = rng.uniform(-1.5, 1.5, count) / 2
    turns = np.column_stack((np.zeros((count, 2)), np.sin(half), np.cos(half)))
    kinds = np.where(np.arange(count) % 2, ShapeKind.BOX, ShapeKind.CYLINDER)
    size = np.broadcast_to([0.07, 0.07, 0.12], (count, 3))
    return Shapes(
        np.concatenate((boards.kind, kinds.astype(np.uint8))),
        np.concatenate((boards.position, place)),
        np.concatenate((boards.orientation, turns)),
        np.concatenate((boards.size, size)),
    )


def lanes() -> Shapes:
    """Five lanes of a motorway with a car every 25 m or so, turned by a few degrees."""
    rng = np.random.default_rng(4)
    count = 100
    place = np.column_stack(
        (
            np.repeat(np.arange(20), 5) * 25.0 + rng.uniform(-8, 8, count),
            np.tile(np.arange(5) * 3.6, 20),
            np.full(count, 0.75),
        )
    )
    half = rng.normal(0.0, 0.02, count)
    turns = np.column_stack((np.zeros((count, 2)), np.sin(half), np.cos(half)))
    return Shapes.boxes(place, [4.6, 1.9, 1.5], turns)


def rooms() -> Shapes:
    """Walls and floors of a building as voxels of 0.2 m: 8 x 3 rooms of 5 m."""
    x, y, z = (number.ravel() for number in np.mgrid[:200, :75, :15])
    wall = (x % 25 == 0) | (y % 25 == 0) | (z == 0)
    door = (x % 25 > 10) & (x % 25 < 16) & (z < 10) | (y % 25 > 10) & (y % 25 < 16) & (z < 10)
    kept = wall & ~(door & (z > 0))
    return Shapes.boxes(np.column_stack((x, y, z))[kept] * 0.2, [0.2, 0.2, 0.2])
