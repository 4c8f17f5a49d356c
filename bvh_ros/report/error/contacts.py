# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of shapes of which it is known how far they are apart.

A contact is made: a point of each shape that is farthest along a unit vector n, and against it,
are put `gap` apart along n. So a plane with normal n keeps the shapes exactly so far apart; and
where the gap is negative, the one point lies in the other shape, because at no point of these
shapes the outward normals lean away from the inside.
"""

import numpy as np

from ...scene import ShapeKind, Shapes
from ...scene.geometry.shapes import rotations, unit_quaternions
from ..scenes import Floats

FACING = 3  # one contact of so many is along an axis of the first shape


def random_pairs(count: int, rng: np.random.Generator) -> Shapes:
    """2 * count rows of all kinds of a few decimetres, also thin ones, near each other."""
    rows = 2 * count
    kind = rng.integers(0, 4, rows).astype(np.uint8)
    size = rng.uniform(0.05, 2.0, (rows, 3))
    size[rng.random(rows) < 0.1, 2] = 0.01
    round_one = kind != ShapeKind.BOX
    size[round_one, 1] = size[round_one, 0]
    size[kind == ShapeKind.SPHERE, 2] = size[kind == ShapeKind.SPHERE, 0]
    size[kind == ShapeKind.CAPSULE, 2] += size[kind == ShapeKind.CAPSULE, 0]
    return Shapes(kind, rng.uniform(-1.0, 1.0, (rows, 3)), rng.normal(size=(rows, 4)), size)


def contacts(count: int, gap: float, rng: np.random.Generator) -> Shapes:
    """2 * count rows; rows 2 i and 2 i + 1 are `gap` apart, m (negative: so deep)."""
    shapes = random_pairs(count, rng)
    ways = rng.normal(size=(count, 3))
    facing = np.arange(0, count, FACING)
    axes = rotations(unit_quaternions(shapes.orientation[2 * facing]))
    ways[facing] = axes[np.arange(len(facing)), :, rng.integers(0, 3, len(facing))]
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    even, odd = shapes.take(slice(0, None, 2)), shapes.take(slice(1, None, 2))
    shapes.position[1::2] += farthest(even, ways) - farthest(odd, -ways) + gap * ways
    return shapes


def farthest(shapes: Shapes, ways: Floats) -> Floats:
    """The point (n, 3) of each shape that is farthest along its unit vector."""
    matrices = rotations(unit_quaternions(shapes.orientation))
    local, half = np.einsum('nij,ni->nj', matrices, ways), shapes.size / 2
    place = np.copysign(half, local)
    rows = shapes.kind == ShapeKind.CYLINDER
    across = np.linalg.norm(local[rows, :2], axis=1)
    place[rows, :2] = local[rows, :2] * (half[rows, 0] / np.maximum(across, 1e-300))[:, None]
    rows = (shapes.kind == ShapeKind.SPHERE) | (shapes.kind == ShapeKind.CAPSULE)
    straight = half[rows, 2] - half[rows, 0]
    ends = np.copysign(straight, local[rows, 2])
    place[rows] = local[rows] * half[rows, :1]
    place[rows, 2] += ends
    points: Floats = shapes.position + np.einsum('nij,nj->ni', matrices, place)
    return points
