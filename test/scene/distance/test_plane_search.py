# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts beside cylinders, feature against feature, decided down to rounding. `contacts`
measures the truth in 50 digits.
"""

import itertools

import numpy as np
import pytest
from scene.distance.contacts import (
    BOX,
    CAPSULE,
    CYLINDER,
    FEATURES,
    SPHERE,
    Solid,
    answers,
    contact,
    farthest_outside,
    shapes_of,
    touches_within,
)
from scene.reference import refilled, scene_of
from turns import unit_quaternions

from bvh_ros.scene import Shapes

ROUND_FEATURES = [(CYLINDER, feature) for feature in FEATURES[CYLINDER]]
OTHERS = [
    (kind, feature) for kind in (CYLINDER, BOX, SPHERE, CAPSULE) for feature in FEATURES[kind]
]
SMALLEST = 2e-14  # of the larger shape: from here on decisions are right


def beside(one, other, sizes, gap, manner, rng):
    """Two features, (kind, name), of shapes of some sizes `gap` apart; None if that failed."""
    halves = rng.uniform(0.2, 1.0, (2, 3)) * np.array(sizes)[:, None]
    for half, (kind, _) in zip(halves, (one, other), strict=True):
        half[1] = half[1] if kind == BOX else half[0]
        half[2] = half[0] if kind == SPHERE else half[2] + (half[0] if kind == CAPSULE else 0.0)
    bodies = [Solid(kind, half) for (kind, _), half in zip((one, other), halves, strict=True)]
    return contact(bodies, (one[1], other[1]), gap / (2 * halves.max()), 1.0, manner, rng)


def every(sizes, gap, rng):
    """Every feature of a cylinder against every feature, turned anyhow and along each other."""
    pairs = itertools.product(ROUND_FEATURES, OTHERS, ('free', 'parallel'))
    made = [beside(one, other, sizes, gap, manner, rng) for one, other, manner in pairs]
    made = [one for one in made if one]
    assert len(made) > 40
    return made


SIZES = [(1.0, 1.0), (1e-6, 1.0), (1e3, 1e-3), (1e-6, 1e6), (1e6, 1e6)]
GAPS = [1e-2, 1e-5, 1e-8, 1e-11, 1e-13, SMALLEST]


@pytest.mark.parametrize('sign', [-1, 1])
@pytest.mark.parametrize('sizes', SIZES)
def test_every_feature_of_a_cylinder(sizes, sign):
    rng = np.random.default_rng([7, sign + 1])
    for gap in np.array(GAPS) * max(sizes):
        if gap > min(sizes) / 20:
            continue
        for one in every(sizes, sign * gap, rng):
            assert bool(refilled(shapes_of(one)).overlap_pairs()) == (sign < 0), one
            assert touches_within(one, 0.0) == (sign < 0), one


@pytest.mark.parametrize('tolerance', [1e-7, 0.3, 40.0])
def test_every_feature_of_a_cylinder_with_a_tolerance(tolerance):
    rng = np.random.default_rng(8)
    for beyond in (-1e-13, 1e-13):
        for one in every((1.0, 1.0), tolerance + beyond * max(tolerance, 1.0), rng):
            assert touches_within(one, tolerance) == (beyond < 0), one


@pytest.mark.parametrize('gap', [-1e-3, -1e-12, 1e-12, 1e-9, 1e-6, 1e-3, 1.0, 100.0])
def test_distance_beside_a_cylinder(gap):
    for one in every((1.0, 1.0), gap, np.random.default_rng(9)):
        _, found, _ = answers(one)
        assert found.distance == pytest.approx(max(one.gap, 0.0), rel=1e-14, abs=1e-14)
        between = np.linalg.norm(found.other_point - found.point)
        assert between == pytest.approx(found.distance, abs=1e-9)
        assert farthest_outside(one, found) < 1e-9


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
        turns = unit_quaternions(np.array([(0, 0, 0, 1), turn or (0, 0, 0, 1)], float))
        sizes = np.array([(10, 10, 20), size], float)
        scene = scene_of(Shapes(kind, places, turns, sizes), names=['a', 'b'], source='a')
        assert len(scene.overlap_pairs()) == (gap == 0.0)
        assert scene.clearance('a').distance == pytest.approx(gap, abs=2e-14)
