# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decisions equal real arithmetic: rays made to be decided wrongly, against exact brute force.

BVH_ROS_LONG_TESTS=1 makes it a million rays instead of some ten thousand.
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from tree.adversary import SCALES, each_ndim, each_scale, rays_at, reaches, some_boxes
from tree.reference import (
    INSIDE,
    ExactHit,
    Floats,
    Ids,
    check_hit,
    effort,
    exact_hits,
    is_within_2_ulp,
    seen,
)

from bvh_ros import ALL, DynamicBVH, RayHit

BOXES = 20
RAYS = 500  # a scene: enough for the batch path
SCENES = effort(1, 130)  # a scale and number of dimensions


class World(NamedTuple):
    lo: Floats
    hi: Floats
    masks: NDArray[np.uint32]
    origins: Floats
    directions: Floats
    t_max: Floats
    query_masks: NDArray[np.uint32]
    hits: list[list[ExactHit]]

    def expected(
        self, ray: int, handles: Ids, limited: bool, skip_inside: bool = False
    ) -> list[ExactHit]:
        if not limited:
            return seen(self.hits[ray], handles, skip_inside=skip_inside)
        visible = self.masks & self.query_masks[ray] != 0
        return seen(self.hits[ray], handles, float(self.t_max[ray]), skip_inside, visible)

    def limits(self, limited: bool) -> dict[str, object]:
        return {'t_max': self.t_max, 'mask': self.query_masks} if limited else {}


def make_world(seed: int, ndim: int, scale: float, boxes: int = BOXES, rays: int = RAYS) -> World:
    rng = np.random.default_rng([seed, ndim, SCALES.index(scale)])
    lo, hi = some_boxes(rng, boxes, ndim, scale)
    origins, directions = rays_at(rng, lo, hi, rays, scale)
    hits = exact_hits(lo, hi, origins, directions)
    masks = rng.choice([1, 2, 3, 0x80000000, 0], boxes).astype(np.uint32)
    query_masks = rng.choice([ALL, 1, 2, 0x80000001], rays).astype(np.uint32)
    return World(lo, hi, masks, origins, directions, reaches(rng, hits), query_masks, hits)


def check_every_hit(
    tree: DynamicBVH, handles: Ids, world: World, limited: bool, skip_inside: bool
) -> None:
    offsets, ids, ts = tree.raycast_all_many(
        world.origins, world.directions, skip_inside=skip_inside, **world.limits(limited)
    )
    for ray in range(len(world.origins)):
        expected = world.expected(ray, handles, limited, skip_inside)
        part = slice(offsets[ray], offsets[ray + 1])
        assert ids[part].tolist() == [handles[hit.row] for hit in expected], ray
        assert ts[part].tolist() == sorted(ts[part].tolist())
        for t, hit in zip(ts[part].tolist(), expected, strict=True):
            assert is_within_2_ulp(t, hit.t), (ray, t, hit)


def check_first_hit(
    tree: DynamicBVH,
    handles: Ids,
    world: World,
    limited: bool,
    skip_inside: bool = False,
    threads: int = 1,
) -> None:
    limits = world.limits(limited)
    ids, ts, normals = tree.raycast_many(
        world.origins, world.directions, skip_inside=skip_inside, threads=threads, **limits
    )
    occluded = tree.occluded_many(
        world.origins, world.directions, skip_inside=skip_inside, threads=threads, **limits
    )
    for ray in range(len(world.origins)):
        expected = world.expected(ray, handles, limited, skip_inside)
        assert occluded[ray] == bool(expected), ray
        if not expected:
            assert (ids[ray], ts[ray], *normals[ray]) == (-1, math.inf, *np.zeros(tree.ndim)), ray
            continue
        first = expected[0]
        assert ids[ray] == handles[first.row], ray
        assert is_within_2_ulp(ts[ray], first.t), (ray, ts[ray], first)
        normal = np.zeros(tree.ndim)
        if first.axis != INSIDE:
            normal[first.axis] = -np.sign(world.directions[ray, first.axis])
        assert normals[ray].tolist() == normal.tolist(), ray


@each_scale
@each_ndim
def test_batches_decide_exactly(ndim: int, scale: float) -> None:
    for seed in range(SCENES):
        world = make_world(seed, ndim, scale)
        tree = DynamicBVH.from_boxes(world.lo, world.hi, mask=world.masks)
        handles = tree.ids()
        tree.set_masks(handles, 1)
        for skip_inside in (False, True):
            check_every_hit(tree, handles, world, False, skip_inside)
            check_first_hit(tree, handles, world, False, skip_inside)
        tree.set_masks(handles, world.masks)
        for skip_inside in (False, True):
            check_every_hit(tree, handles, world, True, skip_inside)
            check_first_hit(tree, handles, world, True, skip_inside)
        check_first_hit(tree, handles, world, True, threads=2)


def check_ray_hit(
    hit: RayHit, exact: ExactHit, world: World, origin: Floats, direction: Floats
) -> None:
    check_hit(hit, exact, world.lo[exact.row], world.hi[exact.row], (origin, origin, direction))
    if exact.axis == INSIDE:
        assert hit.point.tolist() == origin.tolist()


@each_scale
@each_ndim
def test_scalar_calls_decide_exactly(ndim: int, scale: float) -> None:
    world = make_world(1000, ndim, scale, rays=150)
    tree = DynamicBVH.from_boxes(world.lo, world.hi, mask=world.masks)
    handles = tree.ids()
    for row, ray in enumerate(zip(world.origins, world.directions, strict=True)):
        limits = {'t_max': float(world.t_max[row]), 'mask': int(world.query_masks[row])}
        expected = world.expected(row, handles, True)
        hits = tree.raycast_all(*ray, **limits)
        assert [hit.id for hit in hits] == [handles[hit.row] for hit in expected]
        assert [hit.t for hit in hits] == sorted(hit.t for hit in hits)
        for hit, exact in zip(hits, expected, strict=True):
            check_ray_hit(hit, exact, world, *ray)
        first = tree.raycast(*ray, **limits)
        assert (first is not None) == bool(expected) == tree.occluded(*ray, **limits)
        if first is not None:
            assert first.id == handles[expected[0].row]
            check_ray_hit(first, expected[0], world, *ray)


VARIANTS = {
    'margin': {'margin': 0.25},
    'margin far beyond the scene': {'margin': 1e300},
    'branch and bound': {'sibling_search': 'branch_and_bound'},
    'both': {'margin': 1e-3, 'sibling_search': 'branch_and_bound'},
}


@each_scale
@each_ndim
def test_answers_do_not_depend_on_the_tree(ndim: int, scale: float) -> None:
    """Margins, searches, order of insertion, rebuilding: the same hits in the same order."""
    world = make_world(2000, ndim, scale, rays=80)
    orders = [
        np.arange(BOXES),
        np.arange(BOXES)[::-1],
        np.random.default_rng(1).permutation(BOXES),
    ]
    for options in VARIANTS.values():
        for order in orders:
            tree = DynamicBVH(ndim, **options)
            handles = np.empty(BOXES, np.int64)
            for row in order:
                handles[row] = tree.insert(world.lo[row], world.hi[row], int(world.masks[row]))
            check_every_hit(tree, handles, world, True, False)
            check_first_hit(tree, handles, world, True)
        tree.rebuild()
        check_every_hit(tree, handles, world, True, False)
        check_first_hit(tree, handles, world, True)


@each_scale
@each_ndim
def test_a_larger_tree_decides_exactly(ndim: int, scale: float) -> None:
    """Deep enough that inner nodes have to prune, and must not prune a hit."""
    world = make_world(3000, ndim, scale, boxes=200, rays=50)
    tree = DynamicBVH.from_boxes(world.lo, world.hi, mask=world.masks)
    check_every_hit(tree, tree.ids(), world, True, False)
    check_first_hit(tree, tree.ids(), world, True)


def test_the_rays_are_adversarial() -> None:
    """Plain float64 decides many of these rays wrongly; else the tests above show nothing."""
    world = make_world(0, 3, 1.0)
    wrong = 0
    with np.errstate(all='ignore'):
        for ray, (origin, direction) in enumerate(
            zip(world.origins, world.directions, strict=True)
        ):
            at_lo, at_hi = (world.lo - origin) / direction, (world.hi - origin) / direction
            entry = np.maximum(np.minimum(at_lo, at_hi).max(axis=1), 0.0)
            plain = np.flatnonzero(entry <= np.maximum(at_lo, at_hi).min(axis=1))
            wrong += set(plain.tolist()) != {hit.row for hit in world.hits[ray]}
    assert wrong > RAYS / 10


def test_ties_of_exact_distances_only() -> None:
    """Two entries that round to one double are still in their exact order, whichever was inserted
    first.
    """
    ray = (
        [0.0, 0.0],
        [3.0, math.nextafter(3.0, 4.0)],
    )  # entered at x = 1 at 1/3, at y = 1 a hair earlier
    assert 1.0 / ray[1][0] == pytest.approx(1.0 / ray[1][1], rel=1e-15)
    for x_first in (True, False):
        tree = DynamicBVH(2)
        boxes = [([1.0, 0.0], [2.0, 2.0]), ([0.0, 1.0], [2.0, 2.0])]
        x_box, y_box = (
            [tree.insert(*box) for box in boxes]
            if x_first
            else [tree.insert(*box) for box in boxes[::-1]][::-1]
        )
        assert [hit.id for hit in tree.raycast_all(*ray)] == [y_box, x_box]
        assert tree.raycast(*ray).id == y_box
