# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bulk build: as good as a full sweep of all splits, within the height, for any boxes; rebuild and
optimize.
"""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from tree.adversary import SCALES, some_boxes
from tree.reference import Floats

from bvh_ros import DynamicBVH

# ---- against the best split of all (the sweep build of Wald 2007, section 3.2)


def half_areas(lo: Floats, hi: Floats) -> Floats:
    edges = (hi - lo).T
    if len(edges) == 2:
        return edges[0] + edges[1]
    return edges[0] * edges[1] + edges[1] * edges[2] + edges[2] * edges[0]


def full_sweep_cost(lo: Floats, hi: Floats) -> float:
    """Cost of the tree that, at every node, tries every split of the boxes sorted by centre along
    every axis.
    """
    root = half_areas(lo.min(axis=0)[None], hi.max(axis=0)[None])[0]
    total, stack = 0.0, [np.arange(len(lo))]
    while stack:
        rows = stack.pop()
        if len(rows) < 2:
            continue
        total += half_areas(lo[rows].min(axis=0)[None], hi[rows].max(axis=0)[None])[0]
        best = (math.inf, rows, 1)
        for axis in range(lo.shape[1]):
            order = rows[np.argsort(lo[rows, axis] + hi[rows, axis], kind='stable')]
            below = half_areas(np.minimum.accumulate(lo[order]), np.maximum.accumulate(hi[order]))
            back = order[::-1]
            above = half_areas(np.minimum.accumulate(lo[back]), np.maximum.accumulate(hi[back]))[
                ::-1
            ]
            sizes = np.arange(1, len(rows))
            costs = below[:-1] * sizes + above[1:] * sizes[::-1]
            split = int(np.argmin(costs))
            best = min(best, (costs[split], order, split + 1), key=lambda candidate: candidate[0])
        stack += [best[1][: best[2]], best[1][best[2] :]]
    return total / root


def uniform(rng: np.random.Generator, count: int, ndim: int) -> tuple[Floats, Floats]:
    lo = rng.uniform(0, 100, (count, ndim))
    return lo, lo + rng.uniform(0.5, 3, lo.shape)


def clusters(rng: np.random.Generator, count: int, ndim: int) -> tuple[Floats, Floats]:
    lo = rng.uniform(0, 100, (20, ndim))[rng.integers(0, 20, count)] + rng.normal(
        size=(count, ndim)
    )
    return lo, lo + rng.uniform(0.01, 0.3, lo.shape)


def of_many_sizes(rng: np.random.Generator, count: int, ndim: int) -> tuple[Floats, Floats]:
    lo = rng.uniform(0, 100, (count, ndim))
    return lo, lo + 10 ** rng.uniform(-3, 1.3, (count, 1))


def long_and_thin(rng: np.random.Generator, count: int, ndim: int) -> tuple[Floats, Floats]:
    lo, size = rng.uniform(0, 100, (count, ndim)), np.full((count, ndim), 0.1)
    size[np.arange(count), rng.integers(0, ndim, count)] = 20.0
    return lo, lo + size


def cells(rng: np.random.Generator, count: int, ndim: int) -> tuple[Floats, Floats]:
    lo = np.stack(
        np.unravel_index(rng.choice(16**ndim, min(count, 8**ndim * 2), False), [16] * ndim), axis=1
    )
    return lo.astype(float), lo + 1.0


@pytest.mark.parametrize('scene', [uniform, clusters, of_many_sizes, long_and_thin, cells])
@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('count', [10, 100, 2000])
def test_cost_against_a_full_sweep(
    scene: Callable[..., tuple[Floats, Floats]], ndim: int, count: int
) -> None:
    """At most 1.05 of it, in the mean of some scenes."""
    ratios = []
    for seed in range(max(3, 1000 // count)):
        lo, hi = scene(np.random.default_rng(seed), count, ndim)
        ratios.append(DynamicBVH.from_boxes(lo, hi).cost() / full_sweep_cost(lo, hi))
    assert np.mean(ratios) <= 1.05


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('count', [300, 1000, 4000])
def test_cost_of_a_tree_made_one_by_one(count: int, seed: int) -> None:
    lo, hi = uniform(np.random.default_rng(seed), count, 3)
    tree = DynamicBVH(sibling_search='branch_and_bound')
    for row in range(count):
        tree.insert(lo[row], hi[row])
    assert tree.cost() <= 1.15 * DynamicBVH.from_boxes(lo, hi).cost()


# ---- any boxes


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('margin', [0.0, 0.1])
def test_from_boxes(ndim: int, margin: float) -> None:
    for count, scale in itertools.product([0, 1, 2, 3, 5, 17, 300], SCALES):
        check_from_boxes(ndim, margin, count, scale)


def check_from_boxes(ndim: int, margin: float, count: int, scale: float) -> None:
    rng = np.random.default_rng(count)
    lo, hi = some_boxes(rng, count, ndim, scale) if count else (np.empty((0, ndim)),) * 2
    masks = rng.integers(0, 2**32, count, dtype=np.uint32)
    tree = DynamicBVH.from_boxes(lo, hi, mask=masks, margin=margin)
    tree.validate()
    handles = tree.ids()
    assert (len(tree), tree.ndim, tree.margin, len(handles)) == (count, ndim, margin, count)
    assert [side.tolist() for side in tree.boxes(handles)] == [lo.tolist(), hi.tolist()]
    assert np.array_equal(tree.masks(handles), masks)
    if count:
        assert [side.tolist() for side in tree.bounds] == [lo.min(0).tolist(), hi.max(0).tolist()]
        assert math.ceil(math.log2(count)) <= tree.height <= 4 * math.log2(count) + 4


@pytest.mark.parametrize('change', ['rebuild', 'optimize'])
@pytest.mark.parametrize('margin', [0.0, 0.2])
def test_rebuild_and_optimize_keep_all_but_the_cost(change: str, margin: float) -> None:
    """On a tree made bad by moves under refitting, they lower the cost and change nothing else."""
    rng = np.random.default_rng(4)
    for count in (0, 1, 2, 3, 50, 3000):
        lo, hi = uniform(rng, count, 3)
        masks = rng.integers(0, 2**32, count, dtype=np.uint32)
        tree = DynamicBVH(margin=margin)
        handles = np.array(
            [tree.insert(lo[i], hi[i], int(masks[i])) for i in range(count)], np.int64
        )
        before = tree.cost()
        getattr(tree, change)()
        tree.validate()
        assert np.array_equal(tree.ids(), handles)
        assert [side.tolist() for side in tree.boxes(handles)] == [lo.tolist(), hi.tolist()]
        assert np.array_equal(tree.masks(handles), masks)
        assert tree.cost() <= before
        if count == 3000:
            assert tree.cost() < before
            assert tree.cost() <= 1.15 * full_sweep_cost(lo - margin, hi + margin)


def test_rebuilding_twice_is_rebuilding_once() -> None:
    lo, hi = uniform(np.random.default_rng(5), 500, 2)
    tree = DynamicBVH.from_boxes(lo, hi)
    first = tree.cost()
    tree.rebuild()
    assert tree.cost() == first
