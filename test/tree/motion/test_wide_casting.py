# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays among boxes that move, through a snapshot that is swept."""

import math

import numpy as np
import pytest
from tree.motion.checking import check_rows, one_by_one, tree_of
from tree.motion.exact import Course, World, meetings_until
from tree.motion.worlds import Random, stopping
from tree.reference import effort, seen

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import OpenTree

pytestmark = pytest.mark.slow  # kernels of its own
RAYS = 64  # as many are worth a snapshot of few boxes


def is_swept(tree: OpenTree) -> bool:
    return tree.motion.sweep is not None


@pytest.mark.parametrize('stops', [False, True])
def test_rows_are_those_of_exact_arithmetic(stops: bool):
    """Rays beside one that is hard to decide about, each with a limit and a mask of its own; among
    boxes that go on for ever, or stop.
    """
    swept = 0
    for number, (world, course, left, rng) in enumerate(stopping(6, effort(60, 6000))):
        left = left if stops else math.inf
        tree = tree_of(world, 0.1 if number % 7 == 0 else 0.0, left)
        ndim = world.lo.shape[1]
        ids, masks = tree.ids(), rng.integers(1, 8, RAYS).astype(np.uint32)
        box_masks = rng.integers(1, 8, len(ids)).astype(np.uint32)
        tree.set_masks(ids, box_masks)
        origins = np.repeat(course.low[None], RAYS, axis=0)
        ways = np.repeat(course.direction[None], RAYS, axis=0)
        origins[1:32] *= rng.choice([1.0, 1.0 + 2.0**-52, 1.5, -1.0], (31, ndim))
        ways[16:48] *= rng.choice([1.0, -1.0, 0.0, 0.5], (32, ndim))
        limits = rng.choice([1.0, 0.0, 0.5, 2.0], RAYS)
        paces = course.pace * rng.choice([1.0, 0.0, 0.5], RAYS)
        every = [
            meetings_until(world, Course(o, o, w, course.at, float(p)), left)
            for o, w, p in zip(origins, ways, paces, strict=True)
        ]
        for row, hits in enumerate(every):  # contact exactly at the end
            ends = [float(hit.t) for hit in hits if 0 < hit.t < 1e300]
            if ends and row % 2:
                limits[row] = ends[row % len(ends)]
        for skip in (False, True):
            asked = origins, ways, limits, masks, skip
            hits = tree.raycast_many(*asked, threads=1 + number % 2, at=course.at, pace=paces)
            met = tree.occluded_many(*asked, at=course.at, pace=paces)
            visible = box_masks & masks[:, None] != 0
            check_rows(
                tree,
                hits,
                met,
                [
                    seen(exact, ids, float(limits[row]), skip, visible[row])
                    for row, exact in enumerate(every)
                ],
            )
        swept += is_swept(tree)
    assert swept >= 20


def crowd(rng: Random, count: int, speed: float) -> World:
    lo = rng.uniform(0, 40, (count, 2))
    velocities = speed * rng.normal(size=lo.shape)
    return World(lo, lo + rng.uniform(0, 1, lo.shape), velocities, rng.uniform(-1, 1, count))


def test_bounds_follow_the_tree_and_the_times():
    """One tree that changes, in small batches and large ones, against single rays."""
    rng = np.random.default_rng(7)
    world = crowd(rng, 300, 1.5)
    tree, swept = tree_of(world), []
    origins, ways = rng.uniform(0, 40, (200, 2)), rng.normal(0, 8, (200, 2))
    origins[:3], ways[3:6], ways[6:9] = 1e6, 0.0, 1e-250  # which are not suited
    for turn in range(16):
        for times in (
            {'at': 0.1 * turn, 'pace': 1.0},
            {'at': 3.0},
            {'at': -1e3},
            {'at': 0.0, 'pace': 1e9},
        ):
            hits = tree.raycast_many(origins, ways, 1.0, **times)
            found = list(zip(hits.ids.tolist(), hits.t.tolist(), strict=True))
            assert found == one_by_one(tree, origins, ways, times)
            swept.append(is_swept(tree))
        ids = tree.ids()
        some = rng.choice(ids, 40, replace=False)
        if turn % 4 == 0:
            tree.set_velocities(some, rng.normal(size=(40, 2)), 0.1 * turn)
        elif turn % 4 == 1:
            lo = rng.uniform(0, 40, (3, 2))
            tree.move_many(some[:3], lo, lo + 1)
        elif turn % 4 == 2:
            tree.remove_many(some[:5])
            tree.insert_many(np.full((2, 2), 20.0 + turn), np.full((2, 2), 21.0 + turn))
    assert 16 <= sum(swept) < len(swept)


def test_what_cannot_be_swept_is_asked_one_by_one():
    """Boxes that go beyond all bounds, rays without an end, and rows that are no rays."""
    rng = np.random.default_rng(8)
    origins, ways = rng.uniform(0, 40, (200, 2)), rng.normal(0, 8, (200, 2))
    for speed in (1e250, 1e9, 1e-250):
        tree = tree_of(crowd(rng, 80, speed))
        for _ in range(3):
            hits = tree.raycast_many(origins, ways, 1.0, pace=1.0)
        expected = one_by_one(tree, origins, ways, {'pace': 1.0})
        assert list(zip(hits.ids.tolist(), hits.t.tolist(), strict=True)) == expected
        assert is_swept(tree) == (speed < 1)
    endless = tree.raycast_many(origins, ways, pace=1.0)
    assert endless.ids.tolist() == [
        hit.id if (hit := tree.raycast(o, w, pace=1.0)) else -1
        for o, w in zip(origins, ways, strict=True)
    ]
    ways[7, 1] = np.nan
    with pytest.raises(ValueError, match='directions must be finite: row 7'):
        tree.raycast_many(origins, ways, 1.0, pace=1.0)
    assert len(tree.raycast_many(origins[:0], ways[:0], 1.0, pace=1.0).ids) == 0


@pytest.mark.parametrize('ndim', [2, 3])
def test_few_rays_are_those_one_by_one(ndim: int):
    """Batches too small for lists, whose rays graze corners of boxes that tie, with one limit for
    all or each with its own, as the times.
    """
    rng, count = np.random.default_rng(ndim), 1600
    lo = rng.integers(-12, 12, (count, ndim)).astype(np.float64)
    box_masks = rng.integers(1, 8, count).astype(np.uint32)
    tree = DynamicBVH.from_boxes(lo, lo + rng.integers(0, 3, lo.shape), mask=box_masks)
    tree.set_velocities(tree.ids(), rng.integers(-2, 3, lo.shape))
    many = rng.integers(-13, 13, (2, 500, ndim)).astype(np.float64)
    for _ in range(3):
        tree.raycast_many(*many, 1.0, pace=1.0)
    hit = 0
    for number, size in enumerate((1, 7, 8, 9, 40, 71) * 2):
        origins, ways = rng.integers(-13, 13, (2, size, ndim)).astype(np.float64)
        if number % 2:
            origins[0], ways[-1], ways[size // 2] = 1e6, 0.0, 1e-250  # not all are suited
        masks = rng.integers(1, 8, size).astype(np.uint32)
        limits = rng.choice([0.0, 0.5, 1.0], size) if number % 4 > 1 else np.ones(1)
        own = {'at': rng.choice([0.0, 0.5], size), 'pace': rng.choice([0.0, 0.5], size)}
        for times in ({'pace': 1.0}, {'at': 0.5}, {'at': 1.0, 'pace': -1.0}, {'at': 3.0}, own):
            limit = limits if len(limits) == size else 1.0
            asked = origins, ways, limit, masks, number % 3 == 0
            hits = tree.raycast_many(*asked, **times)
            met = tree.occluded_many(*asked, **times)
            for row in range(size):
                end = limits.item(row if len(limits) == size else 0)
                asked_one = origins[row], ways[row], end, int(masks[row]), asked[4]
                when = {name: float(np.broadcast_to(x, size)[row]) for name, x in times.items()}
                one = tree.raycast(*asked_one, **when)
                assert met[row] == (one is not None)
                assert hits.ids[row] == (-1 if one is None else one.id)
                assert hits.t[row] == (math.inf if one is None else one.t)
                assert hits.normals[row].tolist() == (
                    [0.0] * ndim if one is None else one.normal.tolist()
                )
                hit += one is not None
    assert 200 < hit < 1500
