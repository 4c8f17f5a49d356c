# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes that stop some time after they were told to go, against exact rationals."""

import math

import numpy as np
import pytest
from tree.motion.checking import check_course, tree_of
from tree.motion.exact import World, meetings_until
from tree.motion.worlds import stopping
from tree.reference import LARGEST, effort, is_within_2_ulp, seen

pytestmark = pytest.mark.slow  # kernels of its own


def test_courses():
    checked = 0
    for number, (world, course, left, rng) in enumerate(stopping(11, effort(400, 20_000))):
        tree = tree_of(world, 0.1 if number % 5 == 0 else 0.0, left)
        course, ids = course.as_ray(), tree.ids()
        exact, when = meetings_until(world, course, left), {'at': course.at, 'pace': course.pace}
        ends = [float(hit.t) for hit in exact if hit.t <= LARGEST]
        for limit in {1.0, float(rng.choice([*ends, 2.0])), math.inf}:
            checked += check_course(tree, exact, course, limit)
            every = tree.raycast_all(course.low, course.direction, limit, **when)
            right = seen(exact, ids, limit)
            assert [hit.id for hit in every] == [ids[hit.row] for hit in right]
            assert all(is_within_2_ulp(h.t, e.t) for h, e in zip(every, right, strict=True))
    assert checked > 5000


@pytest.mark.parametrize(('apart', 'drift'), [(0.0, 0.0), (0.3, 0.0), (0.3, 12.0)])
def test_many_among_many(apart: float, drift: float):
    """What is swept for large batches, and nodes that are laid out for a later time: as a tree
    says, one by one, that knows neither.
    """
    rng = np.random.default_rng(14)
    lo, velocities = rng.uniform(0, 30, (400, 2)), 6.0 * rng.normal(size=(400, 2))
    velocities[:, 0] += drift
    velocities[::7] = 0.0
    world = World(lo, lo + rng.uniform(0, 1, lo.shape), velocities, apart * rng.random(400))
    one, many = tree_of(world, 0.0, 0.9), tree_of(world, 0.0, 0.9)
    origins, ways = rng.uniform(0, 30, (2000, 2)), rng.normal(0, 4, (2000, 2))
    for at, pace in ((0.0, 1.0), (0.5, 1.0), (0.2, 0.4), (0.9, 0.0), (1.2, 0.0), (1.5, 3.0)):
        for part in (slice(0, 16), slice(0, 2000)):
            for _ in range(3):
                hits = many.raycast_many(origins[part], ways[part], 1.0, at=at, pace=pace)
        for row in range(0, 2000, 10):
            hit = one.raycast(origins[row], ways[row], 1.0, at=at, pace=pace)
            assert (hits.ids[row], hits.t[row]) == ((hit.id, hit.t) if hit else (-1, np.inf))
        offsets, found = many.overlap_many(origins, origins + 1.0, at=at)
        near, gaps = many.nearest_many(origins, 2, at=at)
        for row in range(0, 2000, 10):
            touched = one.overlap(origins[row], origins[row] + 1.0, at=at).tolist()
            assert found[offsets[row] : offsets[row + 1]].tolist() == touched
            closest, distances = one.nearest(origins[row], 2, at=at)
            assert near[row].tolist() == closest.tolist()
            assert gaps[row].tolist() == distances.tolist()
