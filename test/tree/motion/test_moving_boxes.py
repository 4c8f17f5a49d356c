# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays, sweeps, overlaps and distances among boxes that move, against exact rationals."""

import math
from fractions import Fraction

import numpy as np
import pytest
from tree.motion.exact import Course, World, meetings, meetings_until, squared_distances
from tree.motion.worlds import stopping, worlds
from tree.reference import INSIDE, LARGEST, effort, is_within_2_ulp, seen

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import OpenTree
from bvh_ros.tree.motion.queries import MotionQueries


def tree_of(world: World, margin: float = 0.0, left: float = math.inf) -> OpenTree:
    tree = OpenTree.from_boxes(world.lo, world.hi, margin=margin)
    tree._motion = MotionQueries(tree.ndim, tree._tree_of_boxes, left=left)
    moving = world.velocities.any(axis=1)
    ids = tree.ids()[moving]
    tree.set_velocities(ids, world.velocities[moving], world.references[moving])
    return tree


def normal_of(face: int, ndim: int) -> list[float]:
    normal = [0.0] * ndim
    if face != INSIDE:
        normal[face >> 1] = 1.0 if face & 1 else -1.0
    return normal


def check_first(tree: DynamicBVH, world: World, course: Course, limit: float) -> int:
    """Check what a course meets first, if it is a ray; return how many boxes that decided."""
    times, ids, ndim = {'at': course.at, 'pace': course.pace}, tree.ids(), tree.ndim
    ray = course.low, course.direction
    every = meetings(world, course)
    for skip in (False, True):
        hits = seen(every, ids, limit, skip)
        hit = tree.raycast(*ray, limit, skip_inside=skip, **times)
        assert tree.occluded(*ray, limit, skip_inside=skip, **times) == bool(hits)
        assert (hit is None) == (not hits)
        if hit is not None:
            assert hit.id == ids[hits[0].row]
            assert is_within_2_ulp(hit.t, hits[0].t), (hit.t, float(hits[0].t))
            assert hit.normal.tolist() == normal_of(hits[0].axis, ndim)
        _, found, ts = tree.raycast_all_many([ray[0]], [ray[1]], limit, skip_inside=skip, **times)
        assert found.tolist() == [ids[exact.row] for exact in hits]
        assert all(is_within_2_ulp(t, e.t) for t, e in zip(ts.tolist(), hits, strict=True))
        assert (np.diff(ts[np.isfinite(ts)]) >= 0).all()
        many = tree.raycast_many([ray[0]] * 2, [ray[1]] * 2, limit, skip_inside=skip, **times)
        assert many.ids.tolist() == [ids[hits[0].row] if hits else -1] * 2
        if hits:
            assert many.t[1] == hit.t
            assert many.normals[1].tolist() == hit.normal.tolist()
    return 2 * len(world.lo)


def test_first_hits_are_those_of_exact_arithmetic():
    checked = 0
    for number, (world, course, rng) in enumerate(worlds(1, effort(300, 20_000))):
        tree = tree_of(world, margin=0.1 if number % 5 == 0 else 0.0)
        course = course._replace(high=course.low)
        every = [hit.t for hit in meetings(world, course) if hit.t <= LARGEST]
        # Contact exactly at the end, and just before it.
        limit = float(rng.choice(every)) if every and number % 3 else math.inf
        for end in {limit, math.nextafter(limit, 0.0), 1.0}:
            checked += check_first(tree, world, course, end)
    assert checked >= effort(10_000, 1_000_000)


def test_swept_boxes_meet_what_exact_arithmetic_says():
    for world, course, _ in worlds(2, effort(150, 5000)):
        tree = tree_of(world)
        ids = tree.ids()
        hits = seen(meetings(world, course), ids, 1.0)
        hit = tree.boxcast(*course[:3], at=course.at, pace=course.pace)
        assert (hit.id if hit else -1) == (ids[hits[0].row] if hits else -1)
        if hit is not None:
            assert is_within_2_ulp(hit.t, hits[0].t)
            assert hit.normal.tolist() == normal_of(hits[0].axis, tree.ndim)


@pytest.mark.parametrize('left', ['at rest', 'for ever', 'stopping'])
def test_overlaps_and_nearest(left):
    """Of boxes at rest, of boxes that go on for ever, and of boxes that stop."""
    for world, course, until, _ in stopping(3, effort(150, 5000)):
        until = until if left == 'stopping' else math.inf
        still = course._replace(direction=0 * course.low, pace=0.0)
        if left == 'at rest':
            world = world._replace(velocities=0 * world.velocities)
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
        square = squares[ids.index(handle)]
        if math.isfinite(gap):
            slack = Fraction(gap) * Fraction(2) ** -51 + Fraction(2, 10**322)
            assert (Fraction(gap) - slack) ** 2 <= square or Fraction(gap) <= slack
            assert square <= (Fraction(gap) + slack) ** 2
        else:
            assert square * (1 + Fraction(2) ** -50) >= Fraction(LARGEST) ** 2
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
