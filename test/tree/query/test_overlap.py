# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes against boxes: touching counts, flat and point boxes too; comparisons of doubles, so all
of it is exact.
"""

import numpy as np
import pytest
from tree.adversary import SCALES, each_scale, some_boxes
from tree.reference import overlapping_pairs, overlapping_rows

from bvh_ros import ALL, DynamicBVH


@each_scale
@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('margin', [0.0, 0.3])
def test_as_brute_force(ndim: int, scale: float, margin: float) -> None:
    rng = np.random.default_rng([ndim, SCALES.index(scale)])
    lo, hi = some_boxes(rng, 80, ndim, scale)
    low, high = some_boxes(rng, 40, ndim, scale)
    masks = rng.choice([0, 1, 2, 3], 80).astype(np.uint32)
    seen = rng.choice([1, 2, ALL], 40).astype(np.uint32)
    tree = DynamicBVH.from_boxes(lo, hi, mask=masks, margin=margin)
    handles = tree.ids()
    offsets, ids = tree.overlap_many(low, high, seen)
    for query in range(40):
        rows = overlapping_rows(lo, hi, low[query], high[query])
        expected = handles[rows[masks[rows] & seen[query] != 0]].tolist()
        assert ids[offsets[query] : offsets[query + 1]].tolist() == expected
        assert tree.overlap(low[query], high[query], int(seen[query])).tolist() == expected
    for mask in (ALL, 2):
        rows = np.flatnonzero(masks & mask)
        pairs = [
            [handles[rows[a]], handles[rows[b]]] for a, b in overlapping_pairs(lo[rows], hi[rows])
        ]
        assert tree.overlap_pairs(mask).tolist() == pairs


@pytest.mark.parametrize('ndim', [2, 3])
def test_shapes_and_types_where_there_is_nothing(ndim: int) -> None:
    empty, none, one = DynamicBVH(ndim), np.empty((0, ndim)), np.ones((1, ndim))
    for found, shape in ((empty.overlap(*one, *one), (0,)), (empty.overlap_pairs(), (0, 2))):
        assert (found.shape, found.dtype) == (shape, np.int64)
    assert [a.tolist() for a in empty.overlap_many(one, one)] == [[0, 0], []]
    tree = DynamicBVH.from_boxes(one, one)
    assert [a.tolist() for a in tree.overlap_many(none, none, threads=2)] == [[0], []]
    assert tree.overlap_pairs().shape == (0, 2)


def test_all_pairs_of_many_coincident_boxes() -> None:
    """150 boxes at one place make 11,175 pairs: more than any first buffer."""
    tree = DynamicBVH.from_boxes(np.zeros((150, 3)), np.ones((150, 3)))
    handles = tree.ids()
    first, second = np.triu_indices(150, 1)
    assert np.array_equal(
        tree.overlap_pairs(), np.stack([handles[first], handles[second]], axis=1)
    )
    assert np.array_equal(tree.overlap([1, 1, 1], [5, 5, 5]), handles)
    offsets, ids = tree.overlap_many(np.zeros((20, 3)), np.zeros((20, 3)))
    assert np.diff(offsets).tolist() == [150] * 20
    assert np.array_equal(ids, np.tile(handles, 20))
