# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts of all kinds of shapes against python-fcl's `collide` and `distance`."""

from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scene import ShapeKind, Shapes
from ...scene.distance.gap import gap as distance_of
from ...scene.distance.narrow_phase import near_pairs
from ...scene.geometry.canonical import canonicalise
from ...scene.geometry.shapes import as_shapes, rotations, unit_quaternions
from ..page import Page
from ..scenes import Floats
from ..tables import Cell, Table
from .contacts import contacts

GAPS = (-1e-2, -1e-4, -1e-6, -1e-8, -1e-10, -1e-13, 1e-13, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
PAIRS, PAIRS_QUICK = 100_000, 120  # of all the gaps together
HEADER = (
    'gap, m', 'pairs', 'touching: bvh_ros wrong', 'python-fcl wrong',
    'distance: bvh_ros, largest error, m', 'python-fcl, largest error, m',
)  # fmt: skip


class Answers(NamedTuple):
    """Of n pairs."""

    touching: NDArray[np.bool_]
    distances: Floats
    """m; 0 where they touch."""


def against_fcl(page: Page, brief: bool) -> None:
    """Contacts, made so that the gap is known."""
    page.add('### Pairs of shapes against python-fcl')
    if find_spec('fcl') is None:
        page.add('Left out: python-fcl is not installed.')
        return
    page.add(
        'Turned boxes, spheres, cylinders and capsules of 0.05 to 2 m, also 1 cm thin ones, put '
        'so that the gap is known; a negative gap is a depth. Touching is asked of both by their '
        '`collide`. python-fcl iterates for all but a few kinds of pairs and ends at about 1e-6 m.'
    )
    rng = np.random.default_rng(31)
    rows: list[list[Cell]] = []
    for gap in GAPS:
        shapes = contacts((PAIRS_QUICK if brief else PAIRS) // len(GAPS), gap, rng)
        both = our_answers(shapes), fcl_answers(shapes)
        wrong = [answers.touching != (gap < 0) for answers in both]
        errors = [np.abs(answers.distances - max(gap, 0.0)).max() for answers in both]
        counts = [int(np.count_nonzero(one)) for one in wrong]
        rows.append([f'{gap:g}', len(wrong[0]), *counts, *map(float, errors)])
    page.table(Table('error_pairs', HEADER, rows))


def our_answers(shapes: Shapes) -> Answers:
    """What the narrow phase and the clearance say of rows 2 i and 2 i + 1."""
    records = canonicalise(as_shapes(shapes)).records
    count = len(records) // 2
    touching, distances, points = np.empty(count, np.bool_), np.empty(count), np.empty((2, 3))
    near_pairs(records, None, np.arange(2 * count).reshape(-1, 2), False, touching)
    for i in range(count):
        distances[i] = distance_of(records[2 * i], None, records[2 * i + 1], None, False, points)
    return Answers(touching, distances)


def fcl_answers(shapes: Shapes) -> Answers:
    """What python-fcl says of them."""
    import fcl

    objects = fcl_objects(shapes)
    pairs = list(zip(objects[::2], objects[1::2], strict=True))
    touching = np.array([fcl.collide(*pair) > 0 for pair in pairs])
    distances = np.array([max(fcl.distance(*pair), 0.0) for pair in pairs])
    return Answers(touching, distances)


def fcl_objects(shapes: Shapes) -> list[Any]:
    """The shapes as python-fcl has them."""
    import fcl

    matrices = rotations(unit_quaternions(shapes.orientation))
    objects = []
    for row, (kind, size) in enumerate(zip(shapes.kind, shapes.size.tolist(), strict=True)):
        if kind == ShapeKind.BOX:
            geometry = fcl.Box(*size)
        elif kind == ShapeKind.SPHERE:
            geometry = fcl.Sphere(size[0] / 2)
        elif kind == ShapeKind.CYLINDER:
            geometry = fcl.Cylinder(size[0] / 2, size[2])
        else:
            geometry = fcl.Capsule(size[0] / 2, size[2] - size[0])
        place = fcl.Transform(matrices[row], shapes.position[row])
        objects.append(fcl.CollisionObject(geometry, place))
    return objects
