# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A box swept along a way: decided as real arithmetic decides, at every scale."""

import numpy as np
import pytest
from tree.adversary import SCALES, Rng, coordinates, each_scale, nudge, rays_at, some_boxes
from tree.reference import INSIDE, LARGEST, Floats, check_hit, effort, exact_sweeps, seen

from bvh_ros import ALL, DynamicBVH


def sweeps_at(
    rng: Rng, lo: Floats, hi: Floats, count: int, scale: float
) -> tuple[Floats, Floats, Floats]:
    """Boxes of which a corner, or a side on some axes, flies at corners, edges and faces."""
    corner, way = rays_at(rng, lo, hi, count, scale)
    size = np.abs(coordinates(rng, corner.shape, scale))
    size = np.where(rng.random(corner.shape) < 0.2, 0.0, size)
    leading = rng.random(corner.shape) < 0.7
    back = np.where(leading == (way > 0.0), -1.0, 1.0)
    with np.errstate(over='ignore'):
        other = np.clip(corner + back * size, -LARGEST, LARGEST)
    corner = nudge(rng, corner, 0.05)
    return np.minimum(corner, other), np.maximum(corner, other), way


@each_scale
@pytest.mark.parametrize('ndim', [2, 3], ids=['2D', '3D'])
def test_sweeps_are_decided_exactly(ndim: int, scale: float) -> None:
    """Whatever the tree: built at once, with a margin, inserted backwards; and with masks."""
    rng = np.random.default_rng([11, ndim, SCALES.index(scale)])
    lo, hi = some_boxes(rng, 20, ndim, scale)
    low, high, ways = sweeps_at(rng, lo, hi, effort(300, 20_000), scale)
    masks = rng.choice([1, 2, 3], 20).astype(np.uint32)
    plain, fat = DynamicBVH.from_boxes(lo, hi, mask=masks), DynamicBVH(ndim, margin=0.25)
    backwards = np.array(
        [fat.insert(*box) for box in zip(lo[::-1], hi[::-1], masks[::-1], strict=True)]
    )[::-1]
    entered = set()
    for i, hits in enumerate(exact_sweeps(lo, hi, low, high, ways)):
        for tree, handles in ((plain, plain.ids()), (fat, backwards)):
            for mask in (ALL, 2):
                expected = seen(hits, handles, visible=masks & mask != 0)
                hit = tree.boxcast(low[i], high[i], ways[i], mask)
                assert (hit is None) == (not expected), i
                if hit is not None:
                    row = expected[0].row
                    assert hit.id == handles[row], i
                    check_hit(hit, expected[0], lo[row], hi[row], (low[i], high[i], ways[i]))
                    entered.add(expected[0].axis)
    assert entered == {INSIDE, *range(ndim)}


def test_it_counts_as_a_ray() -> None:
    tree = DynamicBVH.from_boxes([[1 / 3, 1 / 3]], [[1, 1]])
    tree.boxcast([0, 0], [0, 0], [1, 1])
    assert (tree.stats()['rays'], tree.stats()['rays_decided_exactly']) == (1, 1)


def test_an_empty_tree_is_free() -> None:
    assert DynamicBVH(3).boxcast([0, 0, 0], [1, 1, 1], [1, 1, 1]) is None
