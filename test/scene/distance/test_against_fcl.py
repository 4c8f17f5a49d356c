# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of all kinds against python-fcl, and both against contacts whose gap is known.

How contacts are made says `bvh_ros.report.error.contacts`. 10^5 pairs with BVH_ROS_LONG_TESTS=1.
"""

import os

import fcl
import numpy as np
import pytest
from scene.distance.widest_gap import widest_gap
from scene.reference import random_shapes

from bvh_ros.report.error.pairs import contacts, fcl_objects
from bvh_ros.scene.distance.narrow_phase import near_pairs
from bvh_ros.scene.shapes.shape import as_shapes, canonicalise

LONG = os.environ.get('BVH_ROS_LONG_TESTS') == '1'
PAIRS = 50_000 if LONG else 1_500
GAPS = [-1e-2, -1e-4, -1e-7, -1e-10, -1e-13, 1e-13, 1e-10, 1e-6, 1e-4, 1e-2]


def decide(shapes):
    """Whether rows 2 i and 2 i + 1 touch, for all i."""
    records = canonicalise(as_shapes(shapes)).records
    found = np.empty(len(records) // 2, np.bool_)
    pairs = np.arange(len(records)).reshape(-1, 2)
    near_pairs(records, None, pairs, False, found)
    return found


def test_random_pairs_touch_as_python_fcl_says():
    rng = np.random.default_rng(21)
    shapes = random_shapes(rng, 2 * PAIRS, reach=1.0)
    mine, objects = decide(shapes), fcl_objects(shapes)
    differ = 0
    for i, touching in enumerate(mine):
        one, other = objects[2 * i : 2 * i + 2]
        if touching != (fcl.collide(one, other) > 0):
            differ += 1
            # python-fcl iterates to about 1e-6, and less well round rims.
            assert abs(fcl.distance(one, other)) < 1e-3, (shapes.kind[2 * i : 2 * i + 2], i)
    assert 0.2 < mine.mean() < 0.9
    assert differ <= 3 + PAIRS // 1000


@pytest.mark.parametrize('gap', GAPS)
def test_contacts_with_a_known_gap(gap):
    shapes = contacts(PAIRS // len(GAPS), gap, np.random.default_rng(22))
    mine = decide(shapes)
    assert not (mine != (gap < 0)).any()
    if abs(gap) > 1e-3:
        objects = fcl_objects(shapes)
        pairs = zip(objects[::2], objects[1::2], strict=True)
        theirs = [fcl.collide(*pair) > 0 for pair in pairs]
        assert np.mean(np.array(theirs) == mine) > 0.99


@pytest.mark.parametrize('gap', [1e-5, 1e-3, 0.5])
def test_the_widest_gap_between_planes_is_the_gap_of_a_contact(gap):
    rng = np.random.default_rng(23)
    shapes = contacts(20, gap, rng)
    for i in range(20):
        measured = widest_gap(shapes.take(slice(2 * i, 2 * i + 2)), rng)
        assert gap - 1e-7 <= measured <= gap + 1e-14
