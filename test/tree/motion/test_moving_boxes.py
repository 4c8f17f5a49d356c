# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays, sweeps, overlaps and distances among boxes that move, against exact rationals."""

import math
from fractions import Fraction

import numpy as np
import pytest
from tree.motion.checking import check_course, check_hit, tree_of
from tree.motion.exact import Course, World, meetings, meetings_until, squared_distances
from tree.motion.worlds import stopping, worlds
from tree.reference import LARGEST, effort, is_distance, seen

from bvh_ros import DynamicBVH


def test_first_hits_are_those_of_exact_arithmetic():
    checked = 0
    for number, (world, course, rng) in enumerate(worlds(1, effort(300, 20_000))):
        tree = tree_of(world, margin=0.1 if number % 5 == 0 else 0.0)
        course = course.as_ray()
        exact = meetings(world, course)
        every = [hit.t for hit in exact if hit.t <= LARGEST]
        # Contact exactly at the end, and just before it.
        limit = float(rng.choice(every)) if every and number % 3 else math.inf
        for end in {limit, math.nextafter(limit, 0.0), 1.0}:
            checked += check_course(tree, exact, course, end)
    assert checked >= effort(10_000, 1_000_000)


def test_swept_boxes_meet_what_exact_arithmetic_says():
    for world, course, _ in worlds(2, effort(150, 5000)):
        tree = tree_of(world)
        hit = tree.boxcast(*course[:3], at=course.at, pace=course.pace)
        check_hit(tree, hit, seen(meetings(world, course), tree.ids(), 1.0))


@pytest.mark.parametrize('left', ['at rest', 'for ever', 'stopping'])
def test_overlaps_and_nearest(left):
    """Of boxes at rest, of boxes that go on for ever, and of boxes that stop."""
    for world, course, until, _ in stopping(3, effort(150, 5000)):
        until = until if left == 'stopping' else math.inf
        still = Course(*course[:2], 0 * course.low, course.at, 0.0)
        if left == 'at rest':
            world = World(*world[:2], 0 * world.velocities, world.references)
            tree = DynamicBVH.from_boxes(world.lo, world.hi)
        else:
            tree = tree_of(world, left=until)
        ids = tree.ids().tolist()
        touching = sorted(ids[hit.row] for hit in meetings_until(world, still, until))
        assert tree.overlap(course.low, course.high, at=course.at).tolist() == touching
        lo, hi = [course.low] * 3, [course.high] * 3
        offsets, found = tree.overlap_many(lo, hi, at=[course.at] * 3, threads=2)
        assert found.tolist() == touching * 3
        assert offsets.tolist() == [len(touching) * i for i in range(4)]
        squares = [  # each at its own time
            squared_distances(World(*(x[i : i + 1] for x in world)), *course[:2], at)[0]
            for i, at in enumerate(np.minimum(course.at, world.references + until).tolist())
        ]
        check_nearest(tree, course, squares)


def check_nearest(tree: DynamicBVH, course: Course, squares: list[Fraction]) -> None:
    """Check the boxes nearest to where a course starts; squares of exact distances by row."""
    ids, at = tree.ids().tolist(), course.at
    near, gaps = tree.nearest(np.array(course[:2]), k=len(ids), at=at)
    assert sorted(near.tolist()) == ids
    for handle, gap in zip(near.tolist(), gaps.tolist(), strict=True):
        assert is_distance(gap, squares[ids.index(handle)], 4)
    in_order = sorted(zip(gaps.tolist(), near.tolist(), strict=True))
    assert near.tolist() == [handle for _, handle in in_order]
    first, gap = tree.nearest(np.array(course[:2]), at=at)
    assert (first[0], gap[0]) == (near[0], gaps[0])
    if (course.low == course.high).all():
        many = tree.nearest_many([course.low] * 2, k=3, at=at)
        assert many[0][1].tolist() == near[:3].tolist()
        assert many[1][1].tolist() == gaps[:3].tolist()


def test_nearest_at_a_time_to_many_points_is_that_of_each():
    for number, (world, course, rng) in enumerate(worlds(5, effort(60, 2000))):
        tree, count = tree_of(world, margin=0.1 if number % 5 == 0 else 0.0), 100
        points = np.concatenate((world.lo, world.hi, [course.low]))
        points = points[rng.integers(len(points), size=count)]
        at = course.at + rng.integers(-1, 2, count) if number % 2 else course.at
        if number % 7 == 0:
            at = np.where(rng.random(count) < 0.1, 1e50, at)  # when no bounds hold
        reaches = rng.choice([np.inf, 1.0, 0.0], count) * max(np.abs(points).max(), 1e-300)
        near, gaps = tree.nearest_many(points, 3, reaches, at=at)
        for row, time in enumerate(np.broadcast_to(at, count).tolist()):
            ids, distances = tree.nearest(points[row], 3, float(reaches[row]), at=time)
            assert near[row, : len(ids)].tolist() == ids.tolist()
            assert gaps[row, : len(ids)].tolist() == distances.tolist()
            assert (near[row, len(ids) :] == -1).all()


def test_a_relative_speed_beyond_the_doubles_prunes_nothing():
    tree = DynamicBVH(2)
    ids = tree.insert_many([[-3e307, 1], [-3e307, 500]], [[-2e307, 2], [-2e307, 501]])
    tree.set_velocities(ids, [[1e308, 0]] * 2)
    hit = tree.raycast([0, 0], [-1.5e308, 20], 1.0, pace=1.0)
    assert hit is not None
    assert (hit.id, hit.t) == (ids[0], 0.08)


def test_a_subtree_that_no_mask_sees_is_no_wide_node():
    """Whole subtrees of mask 0 among boxes that move: their lanes hold nothing, not what was in
    memory before.
    """
    rng = np.random.default_rng(5)
    lo = rng.uniform(-50.0, 50.0, (4000, 3))
    tree = DynamicBVH.from_boxes(lo, lo + 1.0, mask=(lo[:, 0] > 0.0).astype(np.uint32))
    ids = tree.ids()
    tree.set_velocities(ids[:1], [[0.5, 0.0, 0.0]])
    origins, directions = rng.uniform(-60.0, 60.0, (3000, 3)), rng.normal(size=(3000, 3))
    many = tree.raycast_many(origins, directions, 100.0, at=0.25)
    moved = np.zeros_like(lo)
    moved[0, 0] = 0.125
    still = DynamicBVH.from_boxes(lo + moved, lo + moved + 1.0, mask=tree.masks(ids))
    expected = still.raycast_many(origins, directions, 100.0)
    assert len(set(many.ids.tolist())) > 100
    assert many.ids.tolist() == expected.ids.tolist()
