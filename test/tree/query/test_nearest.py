# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The nearest boxes: distances, order, ties, limits. For accuracy see test_numerics."""

import math

import numpy as np
import pytest
from tree.adversary import SCALES, coordinates, each_scale, some_boxes

from bvh_ros import ALL, DynamicBVH


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('margin', [0.0, 0.4])
@pytest.mark.parametrize('k', [1, 2, 7, 300])
def test_as_brute_force(ndim: int, margin: float, k: int) -> None:
    """Lattice boxes, so that many are equally far: those of smaller handles come first."""
    rng = np.random.default_rng(k)
    lo = rng.integers(-5, 6, (200, ndim)).astype(float)
    hi = lo + rng.integers(0, 3, lo.shape)
    masks = rng.integers(0, 4, 200).astype(np.uint32)
    tree = DynamicBVH.from_boxes(lo, hi, mask=masks, margin=margin)
    handles = tree.ids()
    points = rng.integers(-8, 9, (50, ndim)).astype(float)
    reaches = rng.choice([0.0, 1.0, 2.0, 5.0, math.inf], 50)
    seen = rng.choice([0, 1, 2, ALL], 50).astype(np.uint32)
    ids, distances = tree.nearest_many(points, k, reaches, seen)
    assert ids.shape == distances.shape == (50, k)
    for row in range(50):
        # Squares of whole numbers are exact, and so are their comparisons.
        squares = (np.maximum(np.maximum(lo - points[row], points[row] - hi), 0.0) ** 2).sum(
            axis=1
        )
        kept = np.flatnonzero((squares <= reaches[row] ** 2) & (masks & seen[row] != 0))
        order = kept[np.lexsort((handles[kept], squares[kept]))][:k]
        padding = k - len(order)
        assert ids[row].tolist() == handles[order].tolist() + [-1] * padding
        assert distances[row].tolist() == np.sqrt(squares[order]).tolist() + [math.inf] * padding
        alone = tree.nearest(points[row], k, float(reaches[row]), int(seen[row]))
        assert alone[0].tolist() == handles[order].tolist()
        assert alone[1].tolist() == np.sqrt(squares[order]).tolist()


@pytest.mark.parametrize('ndim', [2, 3])
@each_scale
@pytest.mark.parametrize('k', [1, 3, 90])
def test_a_dense_batch_is_answered_as_point_by_point(ndim: int, scale: float, k: int) -> None:
    """Batches go down the tree eight points at a time, single points do not; 77 is no multiple of
    eight, and some points are outside, far away, masked off or within reach of nothing.
    """
    rng = np.random.default_rng([ndim, SCALES.index(scale), k])
    lo, hi = some_boxes(rng, 80, ndim, scale)
    masks = rng.choice([0, 1, 2, 3], 80).astype(np.uint32)
    tree = DynamicBVH.from_boxes(lo, hi, mask=masks)
    points = np.concatenate(
        [some_boxes(rng, 70, ndim, scale)[1], coordinates(rng, (7, ndim), 1.0)]
    )
    points[rng.choice(77, 5)] *= 0.0
    reaches = rng.choice([0.0, float(np.median(abs(points))), math.inf], 77)
    seen = rng.choice([0, 1, 2, ALL], 77, p=[0.1, 0.2, 0.2, 0.5]).astype(np.uint32)
    ids, distances = tree.nearest_many(points, k, reaches, seen)
    for row in range(77):
        alone = tree.nearest(points[row], k, float(reaches[row]), int(seen[row]))
        found = int(np.count_nonzero(ids[row] >= 0))
        assert [ids[row, :found].tolist(), distances[row, :found].tolist()] == [
            a.tolist() for a in alone
        ]
        assert (distances[row, found:] == math.inf).all()


def test_max_distance_at_the_box_counts() -> None:
    tree = DynamicBVH(2)
    handle = tree.insert([3, 4], [9, 9])
    assert tree.nearest([0, 0], max_distance=5.0)[0].tolist() == [handle]
    assert tree.nearest([0, 0], max_distance=math.nextafter(5.0, 0.0))[0].tolist() == []
    assert tree.nearest([3, 4], max_distance=0.0)[0].tolist() == [handle]
    assert tree.nearest([3, math.nextafter(4, 0)], max_distance=0.0)[0].tolist() == []


def test_nothing_near() -> None:
    empty = DynamicBVH()
    assert [a.tolist() for a in empty.nearest([0, 0, 0], 3)] == [[], []]
    nothing = [[[-1, -1]], [[math.inf] * 2]]
    assert [a.tolist() for a in empty.nearest_many([[0, 0, 0]], 2)] == nothing
    ids, distances = empty.nearest_many(np.empty((0, 3)), 4)
    assert (ids.shape, distances.shape) == ((0, 4), (0, 4))
    assert (ids.dtype, distances.dtype) == (np.int64, np.float64)
