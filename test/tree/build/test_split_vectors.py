# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vector operations of a split, against every candidate worked out one by one."""

from collections.abc import Sequence

import numba
import numpy as np
import pytest

from bvh_ros.tree.jit import float32x8 as split_vectors

BINS = 16


@numba.njit
def subsets(items, start, count, planar):
    return split_vectors.rank_subsets(items, start, count, planar)


@numba.njit
def planes8(items, start, count, planes, axis, planar):
    return split_vectors.rank_planes8(items, start, count, planes, axis, planar)


@numba.njit
def planes16(items, start, count, planes, axis, planar):
    return split_vectors.rank_planes16(items, start, count, planes, axis, planar)


@numba.njit
def bins_of(boxes, counts, items, scales, axis, planar):
    for item in range(items.shape[0] // 8):
        split_vectors.add_to_bins(boxes, counts, items, item, scales)
    return split_vectors.rank_bins(boxes, counts, axis, items.shape[0] // 8, planar)


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


def cost(items: np.ndarray, left: np.ndarray, planar: bool) -> float:
    """Area times boxes of both sides; inf if one is empty."""
    if left.all() or not left.any():
        return np.inf
    total = 0.0
    for side in (items[left], items[~left]):
        x, y, z = (side[:, :3].max(axis=0) + side[:, 4:7].max(axis=0)).astype(float)
        total += len(side) * (x + y if planar else x * y + y * z + z * x)
    return total


def check(rank: int, costs: Sequence[float], place: int) -> None:
    """The candidate is one of the cheapest, as far as a rank can tell costs apart."""
    least = min(costs)
    if least == np.inf:
        assert rank >= split_vectors.NO_COST
    else:
        assert rank < split_vectors.NO_COST
        assert costs[place] <= least * (1 + 2.0**-16)


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('count', [3, 4, 5])
def test_subsets(count: int, planar: bool) -> None:
    rng = np.random.default_rng(count)
    for _ in range(200):
        items = some_items(rng, count + 2, planar)  # the first and the last are not asked about
        rank = int(subsets(items.ravel(), 1, count, planar))
        sides = [np.array([s >> i & 1 for i in range(count)], bool) for s in range(2**count)]
        costs = [cost(items[1:-1], side, planar) for side in sides]
        check(rank, costs, rank & int(split_vectors.NUMBER))


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('count', [1, 2, 6, 8, 11, 16])
def test_planes(count: int, planar: bool) -> None:
    rng = np.random.default_rng(count)
    search = planes8 if count <= 8 else planes16
    for axis in [0, 1, 2][: 2 if planar else 3] * 50:
        items = some_items(rng, count + 2, planar)
        centers = (items[:, 4:7] - items[:, :3])[1:-1]
        planes = np.full((3, BINS), np.inf, np.float32)
        planes[:, :count] = centers.T
        rank = int(search(items.ravel(), 1, count, planes.ravel(), axis, planar))
        costs = [cost(items[1:-1], centers[:, axis] <= plane, planar) for plane in planes[axis]]
        check(rank, costs, (rank & int(split_vectors.NUMBER)) - BINS * axis)


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('count', [1, 3, 20, 300])
def test_bins(count: int, planar: bool) -> None:
    rng = np.random.default_rng(count)
    for axis in [0, 1, 2][: 2 if planar else 3] * 20:
        items = some_items(rng, count, planar)
        centers = items[:, 4:7] - items[:, :3]
        scales = np.zeros((3, 4), np.float32)
        scales[0, :3] = centers.min(axis=0)
        extent = np.ptp(centers, axis=0)
        np.divide(BINS, extent, out=scales[1, :3], where=extent > 0)
        scales[2, :3] = BINS - 1
        boxes = np.full(3 * BINS * 8, -np.inf, np.float32)
        counts = np.zeros(3 * BINS, np.int32)
        rank = int(bins_of(boxes, counts, items.ravel(), scales.ravel(), axis, planar))
        place = np.minimum((centers - scales[0, :3]) * scales[1, :3], BINS - 1).astype(int)
        assert counts.tolist() == [
            int((place[:, a] == b).sum()) for a in range(3) for b in range(BINS)
        ]
        costs = [cost(items, place[:, axis] <= b, planar) for b in range(BINS)]
        check(rank, costs, (rank & int(split_vectors.NUMBER)) - BINS * axis)
