# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts of all kinds of shapes against python-fcl: pairs whose distance is known."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scene import ShapeKind, Shapes
from ...scene.distance.narrow_phase import gap_convex, near_pairs
from ...scene.shapes.shape import as_shapes, canonicalise, rotations, unit_quaternions
from ..libraries import FCL, collision_objects
from ..page import Cell, Page
from ..scenes import Floats, units

# ---- Pairs of shapes at a known distance


FACING = 3  # one contact of so many is along an axis of the first shape


def random_pairs(count: int, rng: np.random.Generator) -> Shapes:
    """2 * count rows of all kinds of a few decimetres, also thin ones, near each other."""
    rows = 2 * count
    kind = rng.integers(0, 4, rows).astype(np.uint8)
    size = rng.uniform(0.05, 2.0, (rows, 3))
    size[rng.random(rows) < 0.1, 2] = 0.01
    is_round = kind != ShapeKind.BOX
    size[is_round, 1] = size[is_round, 0]
    size[kind == ShapeKind.SPHERE, 2] = size[kind == ShapeKind.SPHERE, 0]
    size[kind == ShapeKind.CAPSULE, 2] += size[kind == ShapeKind.CAPSULE, 0]
    return Shapes(
        kind, rng.uniform(-1.0, 1.0, (rows, 3)), unit_quaternions(rng.normal(size=(rows, 4))), size
    )


def contacts(count: int, gap: float, rng: np.random.Generator) -> Shapes:
    """2 * count rows; rows 2 i and 2 i + 1 are `gap` apart, m (negative: so deep)."""
    shapes = random_pairs(count, rng)
    normals = rng.normal(size=(count, 3))
    facing = np.arange(0, count, FACING)
    axes = rotations(unit_quaternions(shapes.orientation[2 * facing]))
    normals[facing] = axes[np.arange(len(facing)), :, rng.integers(0, 3, len(facing))]
    normals = units(normals)
    even, odd = shapes.take(slice(0, None, 2)), shapes.take(slice(1, None, 2))
    shapes.position[1::2] += farthest(even, normals) - farthest(odd, -normals) + gap * normals
    return shapes


def farthest(shapes: Shapes, directions: Floats) -> Floats:
    """The point (n, 3) of each shape that is farthest along its unit vector."""
    matrices = rotations(unit_quaternions(shapes.orientation))
    local, half = np.einsum('nij,ni->nj', matrices, directions), shapes.size / 2
    place = np.copysign(half, local)
    rows = shapes.kind == ShapeKind.CYLINDER
    across = np.linalg.norm(local[rows, :2], axis=1)
    place[rows, :2] = local[rows, :2] * (half[rows, 0] / np.maximum(across, 1e-300))[:, None]
    rows = (shapes.kind == ShapeKind.SPHERE) | (shapes.kind == ShapeKind.CAPSULE)
    place[rows] = local[rows] * half[rows, :1]
    place[rows, 2] += np.copysign(half[rows, 2] - half[rows, 0], local[rows, 2])
    points: Floats = shapes.position + np.einsum('nij,nj->ni', matrices, place)
    return points


# ---- The same pairs by this package and by python-fcl


GAPS = (-1e-2, -1e-4, -1e-6, -1e-8, -1e-10, -1e-13, 1e-13, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
PAIRS, PAIRS_QUICK = 100_000, 120  # of all the gaps together
HEADER = (
    'gap, m', 'pairs', 'touching: bvh_ros wrong', 'python-fcl wrong',
    'distance: bvh_ros, largest error, m', 'python-fcl, largest error, m',
)  # fmt: skip


class Answers(NamedTuple):
    """Of n pairs."""

    touching: NDArray[np.bool_]
    distances: Floats  # m; 0 where they touch


def against_fcl(page: Page, brief: bool) -> None:
    """Turned boxes, spheres, cylinders and capsules of 0.05 to 2 m, also 1 cm thin ones, put so
    that the gap is known; a negative gap is a depth. Touching is what `collide` of python-fcl
    says. It iterates for all but a few kinds of pairs and ends at about 1e-6 m.
    """
    if not FCL.installed():
        page.add('Left out: python-fcl is not installed.')
        return
    rng = np.random.default_rng(31)
    rows: list[list[Cell]] = []
    for gap in GAPS:
        shapes = contacts((PAIRS_QUICK if brief else PAIRS) // len(GAPS), gap, rng)
        both = our_answers(shapes), fcl_answers(shapes)
        wrong = [int(np.count_nonzero(one.touching != (gap < 0))) for one in both]
        errors = [float(np.abs(one.distances - max(gap, 0.0)).max()) for one in both]
        rows.append([f'{gap:g}', len(both[0].touching), *wrong, *errors])
    page.table('error_pairs', HEADER, rows)


def our_answers(shapes: Shapes) -> Answers:
    """What the narrow phase and the clearance say of rows 2 i and 2 i + 1."""
    records = canonicalise(as_shapes(shapes)).records
    count = len(records) // 2
    touching, distances, points = np.empty(count, np.bool_), np.empty(count), np.empty((2, 3))
    near_pairs(records, None, np.arange(2 * count).reshape(-1, 2), False, touching)
    for i in range(count):
        distances[i] = gap_convex(records[2 * i], None, records[2 * i + 1], None, False, points)
    return Answers(touching, distances)


def fcl_answers(shapes: Shapes) -> Answers:
    """What python-fcl says of them."""
    import fcl

    forms = {
        ShapeKind.BOX: lambda x, y, z: fcl.Box(x, y, z),
        ShapeKind.SPHERE: lambda x, y, z: fcl.Sphere(x / 2),
        ShapeKind.CYLINDER: lambda x, y, z: fcl.Cylinder(x / 2, z),
        ShapeKind.CAPSULE: lambda x, y, z: fcl.Capsule(x / 2, z - x),
    }
    made = [
        forms[ShapeKind(kind)](*size)
        for kind, size in zip(shapes.kind, shapes.size.tolist(), strict=True)
    ]
    turns = rotations(unit_quaternions(shapes.orientation))
    objects = collision_objects('fcl', made, turns, shapes.position)
    pairs = list(zip(objects[::2], objects[1::2], strict=True))
    touching = np.array([fcl.collide(*pair) > 0 for pair in pairs])
    distances = np.array([max(fcl.distance(*pair), 0.0) for pair in pairs])
    return Answers(touching, distances)
