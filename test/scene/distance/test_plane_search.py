# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts beside cylinders, feature against feature, decided down to rounding.

A contact is made as `report.error.contacts` does: a point of each shape where a unit vector is an
outward normal, put a gap apart along it. That it is one is then proven in 60 digits for the very
doubles of the shapes: by a plane between the two, or by a point that lies in both.
"""

import itertools
from decimal import Decimal, localcontext
from typing import NamedTuple

import numpy as np
import pytest
from scene import reference
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Scene, ShapeKind, Shapes
from bvh_ros.scene.distance.gap import gap as distance_of
from bvh_ros.scene.distance.narrow_phase import near, near_pairs
from bvh_ros.scene.geometry.canonical import canonicalise
from bvh_ros.scene.geometry.shapes import as_shapes

BOX, SPHERE, CYLINDER, CAPSULE = list(ShapeKind)[:4]
ROUND_FEATURES = [(CYLINDER, 'rim'), (CYLINDER, 'side'), (CYLINDER, 'end')]
FEATURES = [
    *ROUND_FEATURES, (BOX, 'corner'), (BOX, 'edge'), (BOX, 'face'), (SPHERE, 'corner'),
    (CAPSULE, 'corner'), (CAPSULE, 'side'),
]  # fmt: skip
SMALLEST = 2e-14  # of the larger shape: from here on decisions are right


class Contact(NamedTuple):
    shapes: Shapes
    normal: np.ndarray
    """From the first to the second."""
    points: np.ndarray
    """(2, 3): one of each."""


def local_normal(kind, feature, rng):
    """An outward unit normal in the frame of the shape, zero along what is flat or straight."""
    normal = rng.uniform(0.3, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    if feature == 'edge' or feature == 'side':
        normal[0 if feature == 'edge' else 2] = 0.0
    if feature == 'face' or feature == 'end':
        normal[:2] = 0.0
    return normal / np.linalg.norm(normal)


def local_point(kind, half, normal, rng):
    """A point with that normal: anywhere on a face, also in its middle and near its rim."""
    free = rng.choice([0.0, 0.99, rng.random()]) * np.where(rng.random(3) < 0.5, -1.0, 1.0)
    along = np.where(normal == 0.0, free, np.sign(normal))
    if kind == BOX:
        return along * half
    if kind in (SPHERE, CAPSULE):
        return normal * half[0] + along * (half - half[0]) * [0, 0, 1]
    across = normal[:2] if normal[:2].any() else free[:2] * rng.normal(size=2)
    size = abs(free[0]) if not normal[:2].any() else 1.0
    across = across / (np.linalg.norm(across) or 1.0) * size * half[0]
    return np.array([*across, along[2] * half[2]])


def frame(normal, across):
    """Columns: a unit vector across the normal, nearest to a given one, another, the normal."""
    first = across - normal * (normal @ across)
    first /= np.linalg.norm(first)
    return np.column_stack((first, np.cross(normal, first), normal))


def contact(one, other, sizes, gap, straight, rng):
    """The features of two shapes `gap` apart; their axes parallel, as far as that goes, if
    `straight`.
    """
    half = rng.uniform(0.2, 1.0, (2, 3)) * np.array(sizes)[:, None]
    for row, (kind, _) in enumerate((one, other)):
        half[row, 1] = half[row, 0] if kind != BOX else half[row, 1]
        half[row, 2] = half[row, 0] if kind == SPHERE else half[row, 2]
        half[row, 2] += half[row, 0] if kind == CAPSULE else 0.0
    normals = [local_normal(*feature, rng) for feature in (one, other)]
    turn = Rotation.random(random_state=rng)
    normal = turn.apply(normals[0])
    axes = [np.eye(3)[0 if abs(n[2]) == 1.0 else 2] for n in normals] if straight else None
    world = turn.apply(axes[0]) if straight else rng.normal(size=3)
    across = axes[1] if straight else rng.normal(size=3)
    other_turn = Rotation.from_matrix(frame(-normal, world) @ frame(normals[1], across).T)
    points = [
        local_point(f[0], h, n, rng) for f, h, n in zip((one, other), half, normals, strict=True)
    ]
    place = rng.uniform(-1, 1, 3) * max(sizes)
    meet = place + turn.apply(points[0])
    places = [place, meet + gap * normal - other_turn.apply(points[1])]
    kinds = np.array([one[0], other[0]], np.uint8)
    turns = np.array([turn.as_quat(), other_turn.as_quat()])
    shapes = Shapes(kinds, np.array(places), turns, 2 * half)
    shapes.position[1] += (gap - float(between(shapes, normal))) * normal
    made = Contact(shapes, normal, np.array([meet, meet + gap * normal]))
    prove(made, gap)
    return made


def decimals(array):
    return [Decimal(float(number)) for number in array]


def product(one, other):
    return sum(a * b for a, b in zip(one, other, strict=True))


class Exact:
    """A shape in 60 digits."""

    def __init__(self, shapes, row):
        x, y, z, w = decimals(shapes.orientation[row])
        length = product((x, y, z, w), (x, y, z, w)).sqrt()
        x, y, z, w = x / length, y / length, z / length, w / length
        self.axes = (
            (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
            (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
            (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
        )
        self.kind, self.centre = shapes.kind[row], decimals(shapes.position[row])
        self.half = decimals(shapes.size[row] / 2)

    def reach(self, way):
        """How far it reaches along a vector, times the vector's length, from the origin."""
        x, y, z = (abs(product(axis, way)) for axis in self.axes)
        a, b, c = self.half
        if self.kind == BOX:
            along = a * x + b * y + c * z
        elif self.kind == CYLINDER:
            along = a * (x * x + y * y).sqrt() + c * z
        else:
            along = a * product(way, way).sqrt() + (c - a) * z
        return product(self.centre, way) + along

    def holds(self, point):
        away = [p - c for p, c in zip(point, self.centre, strict=True)]
        x, y, z = (abs(product(axis, away)) for axis in self.axes)
        a, b, c = self.half
        if self.kind == BOX:
            return x <= a and y <= b and z <= c
        if self.kind == CYLINDER:
            return x * x + y * y <= a * a and z <= c
        beyond = max(z - (c - a), Decimal(0))
        return x * x + y * y + beyond * beyond <= a * a


def between(shapes, normal):
    """The gap that a plane leaves between two shapes, from the first to the second."""
    with localcontext() as context:
        context.prec = 60
        way = decimals(normal)
        against = [-component for component in way]
        apart = -Exact(shapes, 1).reach(against) - Exact(shapes, 0).reach(way)
        return apart / product(way, way).sqrt()


def prove(made, gap):
    """In 60 digits: a plane leaves the gap, or the middle of the contact lies in both shapes."""
    apart = between(made.shapes, made.normal)
    largest = max(made.shapes.size.max(), np.abs(made.shapes.position).max())
    assert abs(float(apart) - gap) < SMALLEST / 8 * largest
    if gap > 0:
        assert apart > 0
        return
    with localcontext() as context:
        context.prec = 60
        middle = [(a + b) / 2 for a, b in zip(*map(decimals, made.points), strict=True)]
        assert Exact(made.shapes, 0).holds(middle)
        assert Exact(made.shapes, 1).holds(middle)


def contacts(sizes, gap, rng):
    """Every feature of a cylinder against every feature, at random and straight."""
    pairs = itertools.product(ROUND_FEATURES, FEATURES, (False, True))
    return [contact(*pair[:2], sizes, gap, pair[2], rng) for pair in pairs]


def records_of(made):
    parts = zip(*(one.shapes for one in made), strict=True)
    shapes = Shapes(*(np.concatenate(part) for part in list(parts)[:4]))
    return canonicalise(as_shapes(shapes)).records


SIZES = [(1.0, 1.0), (1e-6, 1.0), (1e3, 1e-3), (1e-6, 1e6), (1e6, 1e6)]
GAPS = [1e-2, 1e-5, 1e-8, 1e-11, 1e-13, SMALLEST]


@pytest.mark.parametrize('sign', [-1, 1])
@pytest.mark.parametrize('sizes', SIZES)
def test_every_feature_of_a_cylinder(sizes, sign):
    rng = np.random.default_rng([7, sign + 1])
    wrong = []
    for gap in np.array(GAPS) * max(sizes):
        if gap > min(sizes) / 20:
            continue
        made = [one for _ in range(5) for one in contacts(sizes, sign * gap, rng)]
        records, found = records_of(made), np.empty(len(made), np.bool_)
        pairs = np.arange(2 * len(made)).reshape(-1, 2)
        near_pairs(records, None, pairs, False, found)
        wrong += [(gap, i) for i in np.flatnonzero(found != (sign < 0))]
        near_pairs(records, None, pairs[:, ::-1].copy(), False, found)
        wrong += [(gap, i, 'exchanged') for i in np.flatnonzero(found != (sign < 0))]
    assert not wrong


@pytest.mark.parametrize('tolerance', [1e-7, 0.3, 40.0])
def test_every_feature_of_a_cylinder_with_a_tolerance(tolerance):
    rng = np.random.default_rng(8)
    for beyond in (-1e-13, 1e-13):
        gap = tolerance + beyond * max(tolerance, 1.0)
        made = contacts((1.0, 1.0), gap, rng)
        records = records_of(made)
        for i in range(len(made)):
            found, _ = near(records[2 * i], None, records[2 * i + 1], None, tolerance, False)
            assert found == (beyond < 0), (i, beyond)


@pytest.mark.parametrize('gap', [-1e-3, -1e-12, 1e-12, 1e-9, 1e-6, 1e-3, 1.0, 100.0])
def test_distance_beside_a_cylinder(gap):
    rng = np.random.default_rng(9)
    made = contacts((1.0, 1.0), gap, rng)
    records, points = records_of(made), np.empty((2, 3))
    for i in range(len(made)):
        distance = distance_of(records[2 * i], None, records[2 * i + 1], None, False, points)
        assert distance == pytest.approx(max(gap, 0.0), rel=1e-14, abs=1e-14), i
        assert np.linalg.norm(points[1] - points[0]) == pytest.approx(distance, abs=1e-9), i
        for solid, point in zip(reference.geometry_arrays(made[i].shapes), points, strict=True):
            assert solid.distances(point[None])[0] < 1e-9, i
        apart = points @ made[i].normal - made[i].points @ made[i].normal
        assert gap < 0 or apart == pytest.approx([0, 0], abs=1e-9), i


@pytest.mark.parametrize('gap', [-1e-13, 1e-13, 1e-9])
def test_meshes_beside_a_cylinder(gap):
    rng = np.random.default_rng(10)
    for one, feature in itertools.product(ROUND_FEATURES, ('corner', 'edge', 'face')):
        for straight in (False, True):
            shapes = contact(one, (BOX, feature), (1.0, 1.0), gap, straight, rng).shapes
            scene = Scene()
            mesh = Mesh(reference.box_of_triangles(shapes.size[1]))
            rows = shapes.take([1])
            scene.update(
                'a', ['mesh'], Shapes.of_meshes([mesh], rows.position, rows.orientation), stamp=1
            )
            scene.update('a', ['cylinder'], shapes.take([0]), stamp=1)
            assert len(scene.overlap_pairs()) == (gap < 0)
            assert scene.clearance('mesh').distance == pytest.approx(max(gap, 0.0), abs=1e-14)


@pytest.mark.parametrize(
    ('position', 'size', 'turn', 'away'),
    [
        ((0, 0, 12), (10, 10, 4), (0, 0, 0, 1), (0, 0, 1)),  # on the cap, coaxial
        ((10, 0, 3), (10, 10, 4), (0, 0, 0, 1), (1, 0, 0)),  # side by side
        ((6, 8, 12), (10, 10, 4), (0, 0, 0, 1), (0, 0, 1)),  # rim on rim
        ((0, 10, 0), (10, 10, 4), (0, 1, 0, 1), (0, 1, 0)),  # crossed, side on side
        ((7, 0, 0), (10, 10, 4), (0, 1, 0, 1), (1, 0, 0)),  # an end on the side
        ((7, 4, 13), (10, 10, 4), (0, 1, 0, 1), (1, 0, 0)),  # the rim of an end on the rim
        ((8, 9, 12), (10, 10, 4), None, (0, 0, 1)),  # corner on rim, at (3, 4)
        ((8, 9, 2), (10, 10, 4), None, (0.6, 0.8, 0)),  # edge along the side
    ],
)
def test_exact_contacts(position, size, turn, away):
    """Of a cylinder of radius 5 from z = -10 to 10 in whole numbers; and a little away."""
    kind = np.array([CYLINDER, BOX if turn is None else CYLINDER], np.uint8)
    for gap in (0.0, 1e-12):
        places = np.array([(0, 0, 0), position + gap * np.array(away)])
        turns = np.array([(0, 0, 0, 1), turn or (0, 0, 0, 1)], float)
        sizes = np.array([(10, 10, 20), size], float)
        scene = Scene()
        scene.update('a', ['a', 'b'], Shapes(kind, places, turns, sizes), stamp=1)
        assert len(scene.overlap_pairs()) == (gap == 0.0)
        assert scene.clearance('a').distance == pytest.approx(gap, abs=2e-14)
