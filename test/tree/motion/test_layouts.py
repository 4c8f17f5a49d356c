# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bounds and sweeps of nodes that are laid out for the times that are asked for: answers stay what
they were, and nodes are small again.
"""

import math

import numpy as np
import pytest
from tree.motion.exact import meetings
from tree.motion.test_moving_boxes import check_first, tree_of
from tree.motion.worlds import worlds
from tree.reference import LARGEST, effort

from bvh_ros import DynamicBVH
from bvh_ros.tree.motion import state as motion


@pytest.fixture
def laid_out_at_once(monkeypatch):
    """Nodes are laid out for the first times that are asked for; how often."""
    monkeypatch.setattr(motion, 'PARTED', -math.inf)
    monkeypatch.setattr(motion, 'asks_for', lambda boxes, grown: 1)
    monkeypatch.setattr(motion, 'LAYOUT_RAYS_PER_BOX', 0.0)
    calls = []
    lay_out = motion.lay_out

    def counted(*args):
        calls.append(args)
        return lay_out(*args)

    monkeypatch.setattr(motion, 'lay_out', counted)
    return calls


def test_first_hits_are_those_of_exact_arithmetic(laid_out_at_once):
    for number, (world, course, rng) in enumerate(worlds(11, effort(150, 5000))):
        tree = tree_of(world, margin=0.1 if number % 5 == 0 else 0.0)
        course = course._replace(high=course.low)
        every = [hit.t for hit in meetings(world, course) if hit.t <= LARGEST]
        limit = float(rng.choice(every)) if every and number % 3 else math.inf
        check_first(tree, world, course, limit)
        if number % 2:  # boxes that are put in and taken out in between
            tree.remove(tree.insert(world.lo[0], world.hi[0]))
            check_first(tree, world, course._replace(pace=0.0), limit)
    assert len(laid_out_at_once) > effort(60, 2000)


def test_what_is_near_is_what_it_was(laid_out_at_once, monkeypatch):
    laid = 0
    for number, (world, course, rng) in enumerate(worlds(12, effort(100, 3000))):
        points = rng.choice(np.concatenate((world.lo, world.hi)), 40)
        at = course.at + rng.choice([0.0, 1.0], 40) if number % 2 else course.at
        answers = []
        for parted in (-math.inf, math.inf):
            monkeypatch.setattr(motion, 'PARTED', parted)
            tree = tree_of(world, margin=0.1 if number % 5 == 0 else 0.0)
            near = tree.nearest_many(points, 3, at=at)
            touched = tree.overlap_many(points, points + 1.0, at=at)
            one = tree.nearest(points[0], 3, at=course.at)
            answers.append([*near, *touched, *one, tree.overlap(*course[:2], at=course.at)])
            laid += tree.motion.bounds is not tree.motion.moving
        for mine, its in zip(*answers, strict=True):
            assert np.array_equal(mine, its)
    assert laid > effort(50, 1500)


def fast_world(rng, ndim):
    """Boxes at whole places and speeds of tens of metres a second: sums are exact in doubles."""
    lo = rng.integers(0, 160, (2000, ndim)).astype(float)
    return lo, lo + 1.0, rng.integers(-40, 41, lo.shape).astype(float)


@pytest.mark.parametrize('ndim', [2, 3])
def test_many_questions_about_fast_boxes(ndim):
    rng = np.random.default_rng(ndim)
    lo, hi, velocities = fast_world(rng, ndim)
    masks = rng.integers(1, 4, len(lo))
    tree = DynamicBVH.from_boxes(lo, hi, mask=masks)
    ids = tree.ids()
    tree.set_velocities(ids, velocities)
    live = np.ones(len(lo), bool)
    for at in (1.0, 0.0, 0.5):
        gone = rng.choice(np.flatnonzero(live), 3)
        live[gone] = False
        tree.remove_many(np.unique(ids[gone]))
        low = lo + velocities * at
        points = rng.integers(-40, 200, (400, ndim)).astype(float)
        for point in points:
            near = (low <= point + 4).all(axis=1) & (low + 1 >= point - 4).all(axis=1) & live
            assert tree.overlap(point - 4, point + 4, at=at).tolist() == ids[near].tolist()
        apart = np.maximum(np.maximum(low - points[:, None], points[:, None] - low - 1.0), 0.0)
        apart = np.sqrt((apart**2).sum(axis=2))
        apart[:, ~live | (masks == 2)] = np.inf
        found, distances = tree.nearest_many(points, mask=1, at=at)
        assert (apart.min(axis=1) == distances[:, 0]).all()
        assert (ids[apart.argmin(axis=1)] == found[:, 0]).all()
        assert (tree.motion.bounds is not tree.motion.moving) == (at != 0.0)


@pytest.mark.parametrize('ndim', [2, 3])
def test_many_rays_at_a_time_among_fast_boxes(ndim):
    rng = np.random.default_rng(ndim)
    lo, hi, velocities = fast_world(rng, ndim)
    tree = DynamicBVH.from_boxes(lo, hi, mask=rng.integers(1, 4, len(lo)))
    tree.set_velocities(tree.ids(), velocities, reference=-1.0)
    there = DynamicBVH.from_boxes(lo + 2.0 * velocities, hi + 2.0 * velocities)
    assert (there.ids() == tree.ids()).all()
    origins = rng.integers(-80, 240, (4000, ndim)).astype(float)
    directions = rng.normal(size=origins.shape)
    for _ in range(6):
        hits = tree.raycast_many(origins, directions, 30.0, mask=0xFFFFFFFF, at=1.0)
        exact = there.raycast_many(origins, directions, 30.0, mask=0xFFFFFFFF)
        assert (hits.ids == exact.ids).all()
        assert (hits.t == exact.t).all()
    sweep = tree.motion.swept_for(tree, tree.view(), len(origins), (1.0, 1.0))
    own = tree.snapshot_for(len(origins), tree.view())
    assert not np.array_equal(sweep.snapshot.children, own.children)
