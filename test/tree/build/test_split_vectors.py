# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vector operations of a split, against every candidate worked out one by one."""

from collections.abc import Sequence

import numba
import numpy as np
import pytest

from bvh_ros.tree.build import binning
from bvh_ros.tree.nodes import node_dtype
from bvh_ros.tree.simd import float32x8 as split_vectors

BINS = 16


@numba.njit
def paired(items, start, count, other, other_count, planar, pairs):
    split_vectors.pair_up(items, start, count, other, other_count, planar, pairs)


@numba.njit
def bins_of(bins, items, scales, first, axis, planar):
    for item in range(items.shape[0] // 8):
        split_vectors.add_to_bins(bins[8 * first :], items, item, scales)
    return split_vectors.rank_bins(bins, first, axis, items.shape[0] // 8, planar)


@numba.njit
def dealt(items, test, axis, binned, bins, plan):
    """The second half of the items to both ends of the first; where the right ones begin."""
    count = items.shape[0] // 16
    left, right, places = 0, count - 1, np.zeros(4, np.int32)
    for item in range(count, 2 * count):
        before = split_vectors.deal_item(
            items, item, left, right, test, axis, binned, plan, places, 0
        )
        if binned:
            split_vectors.add_dealt(bins, items, item, places, 0)
        left += before
        right -= 1 - before
    return left


@numba.njit
def sides(bins, first, last, unions):
    split_vectors.join_sides(bins, first, last, unions)


def some_items(rng: np.random.Generator, count: int, planar: bool) -> np.ndarray:
    """Items as `binning` describes them, in units of steps that float32 holds exactly; some
    coincide.
    """
    lo = rng.integers(-64, 32, (count, 3)) / 64.0
    hi = lo + rng.integers(0, 32, (count, 3)) / 64.0
    twin = rng.integers(0, count)
    lo[0], hi[0] = lo[twin], hi[twin]
    if planar:
        lo[:, 2] = hi[:, 2] = 0.0
    items = np.zeros((count, 8), np.float32)
    items[:, :3], items[:, 4:7] = -lo, hi
    items[:, 3].view(np.int32)[:] = rng.integers(0, 2**27, count)
    return items


def area(items: np.ndarray, planar: bool) -> float:
    """Of the union, half of it."""
    x, y, z = (items[:, :3].max(axis=0) + items[:, 4:7].max(axis=0)).astype(float)
    return x + y if planar else x * y + y * z + z * x


def cost(items: np.ndarray, left: np.ndarray, planar: bool) -> float:
    """Area times boxes of both sides; inf if one is empty."""
    if left.all() or not left.any():
        return np.inf
    return sum(len(side) * area(side, planar) for side in (items[left], items[~left]))


def check(rank: int, costs: Sequence[float], place: int) -> None:
    """The candidate is one of the cheapest, as far as a rank can tell costs apart."""
    least = min(costs)
    if least == np.inf:
        assert rank >= split_vectors.NO_COST
    else:
        assert rank < split_vectors.NO_COST
        assert costs[place] <= least * (1 + 2.0**-16)


def union(boxes: np.ndarray) -> np.ndarray:
    return boxes[:, [0, 1, 2, 4, 5, 6]].max(axis=0)


def check_pairs(items: np.ndarray, planar: bool, pairs: list[int]) -> None:
    """Each time one of the closest pairs of what is left, and every box once."""
    clusters = {i: [i] for i in range(len(items))}
    for pair in pairs:
        older, younger = pair % 8, pair // 8
        costs = {
            (a, b): area(items[clusters[a] + clusters[b]], planar)
            for a in clusters
            for b in clusters
            if a != b
        }
        assert costs[older, younger] <= min(costs.values()) * (1 + 2.0**-13)
        clusters[older] += clusters.pop(younger)
    assert [sorted(one) for one in clusters.values()] == [list(range(len(items)))]


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('count', [1, 2, 3, 4, 5, 6, 7, 8])
@pytest.mark.parametrize('other', [1, 2, 5, 8])
def test_pairs(count: int, other: int, planar: bool) -> None:
    """Of two groups, each by itself; the boxes stay as they are."""
    rng = np.random.default_rng(8 * count + other)
    for _ in range(50):
        items = some_items(rng, 18, planar)  # some beside those of the groups
        kept, pairs = items.copy(), np.full(16, -1, np.int32)
        paired(items.ravel(), 1, count, 1 + count, other, planar, pairs)
        check_pairs(items[1 : 1 + count], planar, pairs[: count - 1].tolist())
        check_pairs(items[1 + count :][:other], planar, pairs[8:][: other - 1].tolist())
        assert np.array_equal(items.view(np.int32), kept.view(np.int32))


def test_pairs_of_equal_boxes_make_no_list() -> None:
    """Those that were joined first come first."""
    items, pairs = np.ones((8, 8), np.float32), np.empty(16, np.int32)
    paired(items.ravel(), 0, 8, 0, 8, False, pairs)
    depth = [0] * 8
    for pair in pairs[:7].tolist():
        depth[pair % 8] = max(depth[pair % 8], depth[pair // 8]) + 1
    assert depth[pairs[6] % 8] == 3


@numba.njit
def written(nodes, items, numbers, start, stop):
    return binning.rescale_items(nodes, items, numbers, start, stop)


@pytest.mark.parametrize('ndim', [2, 3])
def test_items_of_nodes(ndim: int) -> None:
    """Each box in units in which all of them fit into [-1, 1], with the number of its node."""
    rng = np.random.default_rng(ndim)
    nodes, items = np.zeros(50, node_dtype(ndim)), np.ones(400, np.float32)
    nodes['lo'] = rng.normal(size=(50, ndim)) * 1e3
    nodes['hi'] = nodes['lo'] + rng.exponential(size=(50, ndim))
    rows, chosen = items.reshape(50, 8), rng.permutation(50)
    rows[:, 3].view(np.int32)[:] = chosen
    half = written(nodes, items, items.view(np.int32), 10, 40)
    lo, hi = nodes['lo'][chosen[10:40]], nodes['hi'][chosen[10:40]]
    center = lo.min(axis=0) * 0.5 + hi.max(axis=0) * 0.5
    assert half == (hi.max(axis=0) * 0.5 - lo.min(axis=0) * 0.5).max()
    unit = 2.0 ** -np.ceil(np.log2(half))
    assert (rows[10:40, :ndim] == (-(lo - center) * unit).astype(np.float32)).all()
    assert (rows[10:40, 4 : 4 + ndim] == ((hi - center) * unit).astype(np.float32)).all()
    assert (rows[10:40, ndim:3] == 0.0).all()
    assert (rows[10:40, 4 + ndim :] == 0.0).all()
    assert (rows[:, 3].view(np.int32) == chosen).all()
    others = np.delete(rows, np.r_[10:40], axis=0)
    assert (np.delete(others, 3, axis=1) == 1.0).all()


def some_scales(items: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How items are binned, as `add_to_bins` takes it, and their bins, (n, 3)."""
    centers = items[:, 4:7] - items[:, :3]
    scales = np.zeros((3, 4), np.float32)
    scales[0, :3] = centers.min(axis=0)
    extent = np.ptp(centers, axis=0)
    np.divide(BINS, extent, out=scales[1, :3], where=extent > 0)
    return scales, np.minimum((centers - scales[0, :3]) * scales[1, :3], BINS - 1).astype(int)


def check_bins(bins: np.ndarray, items: np.ndarray, place: np.ndarray) -> None:
    """The bins of three axes, (48, 8), hold the unions of what is in them and how many that is."""
    for axis in range(3):
        for b in range(BINS):
            here = place[:, axis] == b
            found = bins[axis * BINS + b]
            if here.any():
                assert found[7] == here.sum()
                assert np.array_equal(union(found[None]), union(items[here]))
            else:
                assert (found == -np.inf).all()


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('count', [1, 3, 20, 300])
def test_bins(count: int, planar: bool) -> None:
    rng = np.random.default_rng(count)
    for axis in [0, 1, 2][: 2 if planar else 3] * 20:
        items = some_items(rng, count, planar)
        scales, place = some_scales(items)
        first = int(rng.integers(0, 2)) * 3 * BINS
        bins = np.full((6 * BINS, 8), -np.inf, np.float32)
        rank = int(bins_of(bins.ravel(), items.ravel(), scales.ravel(), first, axis, planar))
        check_bins(bins[first : first + 3 * BINS], items, place)
        costs = [cost(items, place[:, axis] <= b, planar) for b in range(BINS)]
        check(rank, costs, (rank & int(split_vectors.NUMBER)) - BINS * axis)
        for last in range(BINS - 1):
            unions = np.empty((2, 8), np.float32)
            sides(bins.ravel(), first + axis * BINS, last, unions.ravel())
            left = place[:, axis] <= last
            for found, there in zip(unions, (left, ~left), strict=True):
                if there.any():
                    assert np.array_equal(union(found[None]), union(items[there]))


@pytest.mark.parametrize('binned', [False, True])
@pytest.mark.parametrize('count', [1, 3, 20, 300])
def test_dealing(count: int, binned: bool) -> None:
    """Each item goes to its side, and to the bins of that."""
    rng = np.random.default_rng(count)
    for axis in [0, 1, 2] * 20:
        items = some_items(rng, count, False)
        scales, place = some_scales(items)
        limit = int(rng.integers(1, BINS))
        test = np.stack([np.zeros(4), np.zeros(4), np.full(4, -1.0)]).astype(np.float32)
        test[:, axis] = scales[0, axis], scales[1, axis], limit
        left = place[:, axis] < limit
        parts = [some_scales(items[one] if one.any() else items) for one in (left, ~left)]
        both = np.concatenate([np.zeros_like(items), items])
        bins = np.full((6 * BINS, 8), -np.inf, np.float32)
        own = np.concatenate([scales.ravel(), *(part[0].ravel() for part in parts)])
        middle = dealt(both.ravel(), test.ravel(), axis, binned, bins.ravel(), own)
        assert middle == left.sum()
        there = np.concatenate([items[left], items[~left][::-1]])
        assert np.array_equal(both[:count].view(np.int32), there.view(np.int32))
        for side, one in enumerate((left, ~left)):
            if binned and one.any():
                check_bins(bins[48 * side : 48 * side + 48], items[one], parts[side][1])
            else:
                assert (bins[48 * side : 48 * side + 48] == -np.inf).all()
