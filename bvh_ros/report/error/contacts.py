# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of shapes of which it is known how far they are apart.

A contact is made: a point of each shape that is farthest along a unit vector n, and against it,
are put `gap` apart along n. So a plane with normal n keeps the shapes exactly so far apart; and
where the gap is negative, the one point lies in the other shape, because at no point of these
shapes the outward normals lean away from the inside. Of other pairs the gap is measured by the
widest gap between two parallel planes, which needs no simplex and no closed form of a distance.
"""

import numpy as np

from ...scene import ShapeKind, Shapes
from ...scene.shapes import rotations, unit_quaternions
from ..scenes import Floats

FACING = 3  # one contact of so many is along an axis of the first shape
SAMPLES = 20_000
WINDOW = 0.25  # of the search about the best sample, on the plane that touches the sphere there
GRID, ROUNDS = 17, 17  # each round leaves an eighth of the window: 1e-16 in the end


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


def widest_gap(pair: Shapes, rng: np.random.Generator) -> float:
    """Gap of two shapes, m: the widest between parallel planes, one on each.

    Where they are apart it has one maximum over the normals, on any plane through which these
    are drawn: the best sample is bettered by a search in a search. Where they overlap it is minus
    the depth, roughly. Never more than the truth, apart from rounding.
    """
    ways = rng.normal(size=(SAMPLES, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    best = ways[_gaps(pair, ways).argmax()]
    tangents = np.linalg.svd(best[None])[2][1:]
    middle, wide = 0.0, WINDOW
    for _ in range(ROUNDS):
        places = middle + wide * np.linspace(-1.0, 1.0, GRID)
        gaps = _widest_across(pair, best + places[:, None] * tangents[0], tangents[1])
        middle, wide = places[gaps.argmax()], wide * 2 / (GRID - 1)
    return float(gaps.max())


def _widest_across(pair: Shapes, starts: Floats, tangent: Floats) -> Floats:
    """For each of GRID normals the widest gap along `tangent` from there."""
    rows, middle, wide = np.arange(GRID), np.zeros(GRID), WINDOW
    for _ in range(ROUNDS):
        places = middle[:, None] + wide * np.linspace(-1.0, 1.0, GRID)
        ways = (starts[:, None] + places[:, :, None] * tangent).reshape(-1, 3)
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        gaps = _gaps(pair, ways).reshape(GRID, GRID)
        best = gaps.argmax(axis=1)
        middle, wide = places[rows, best], wide * 2 / (GRID - 1)
    widest: Floats = gaps[rows, best]
    return widest


def _gaps(pair: Shapes, ways: Floats) -> Floats:
    """How far planes with these unit normals keep the two apart."""
    gaps: Floats = ways @ (pair.position[1] - pair.position[0])
    matrices = rotations(unit_quaternions(pair.orientation))
    for kind, matrix, size in zip(pair.kind, matrices, pair.size, strict=True):
        gaps -= _reach(kind, size / 2, np.abs(ways @ matrix))
    return gaps


def _reach(kind: int, half: Floats, local: Floats) -> Floats:
    """How far a shape reaches from its centre along unit vectors of its frame, made positive."""
    reach: Floats
    if kind == ShapeKind.BOX:
        reach = local @ half
    elif kind == ShapeKind.CYLINDER:
        reach = np.hypot(local[:, 0], local[:, 1]) * half[0] + local[:, 2] * half[2]
    else:
        reach = half[0] + local[:, 2] * (half[2] - half[0])
    return reach
