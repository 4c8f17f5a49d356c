# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree's cost, against numpy over the tree's own nodes and against rational arithmetic; at
every scale of doubles.
"""

import numpy as np
import pytest
from tree.adversary import SCALES, some_boxes
from tree.reference import LARGEST, SMALLEST, half_area

from bvh_ros import DynamicBVH


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('scale', SCALES)
def test_cost_is_the_sum_of_areas_over_that_of_the_root(ndim: int, scale: float) -> None:
    lo, hi = some_boxes(np.random.default_rng(3), 60, ndim, scale)
    for tree in (DynamicBVH.from_boxes(lo, hi), DynamicBVH(ndim)):
        if not len(tree):
            for row in range(60):
                tree.insert(lo[row], hi[row])
        every = [*map(half_area, *tree.levels(0, 99, 999)[:2])]
        leaves = [*map(half_area, lo, hi)]
        assert len(every) == 59 + len(leaves)
        inner = (sum(every) - sum(leaves)) / every[0]
        assert tree.cost() == pytest.approx(float(inner), rel=1e-12)


# boxes -> cost, worked out by hand
COSTS = {
    'none': ([], 0.0),
    'one': ([([0, 0, 0], [1, 1, 1])], 0.0),
    'two coincident points: a root of area zero': ([([1, 1, 1], [1, 1, 1])] * 2, 1.0),
    'five coincident points': ([([1, 1, 1], [1, 1, 1])] * 5, 4.0),
    'a line of points has no area': ([([k, 0, 0], [k, 0, 0]) for k in range(7)], 6.0),
    'a line of points in 2D has a perimeter': (
        [([0, 0], [0, 0]), ([1, 0], [1, 0]), ([4, 0], [4, 0])],
        1.25,
    ),
    'all of the doubles': ([([-LARGEST] * 3, [LARGEST] * 3)] * 3, 2.0),
    'the smallest': ([([0, 0, 0], [SMALLEST] * 3)] * 3, 2.0),
}


@pytest.mark.parametrize(('boxes', 'cost'), COSTS.values(), ids=COSTS.keys())
@pytest.mark.parametrize('one_by_one', [True, False])
def test_costs_by_hand(
    boxes: list[tuple[list[float], list[float]]], cost: float, one_by_one: bool
) -> None:
    tree = DynamicBVH(len(boxes[0][0]) if boxes else 3)
    if one_by_one:
        for lo, hi in boxes:
            tree.insert(lo, hi)
    elif boxes:
        tree.insert_many([lo for lo, _ in boxes], [hi for _, hi in boxes])
    assert tree.cost() == pytest.approx(cost, rel=1e-14)


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('exponent', [-1000, -700, -531, 0, 500, 700, 1000])
def test_the_unit_of_length_does_not_matter(ndim: int, exponent: int) -> None:
    """A scene times a power of two gives the same tree, with the same cost to the last bit,
    however it was made.
    """
    rng = np.random.default_rng(4)
    lo = rng.integers(0, 1000, (200, ndim)) / 64.0
    hi = lo + rng.integers(1, 100, lo.shape) / 64.0
    unit = 2.0**exponent
    costs = []
    for length in (1.0, unit):
        built = DynamicBVH.from_boxes(lo * length, hi * length)
        grown = DynamicBVH(ndim)
        for row in range(200):
            grown.insert(lo[row] * length, hi[row] * length)
        before = grown.cost()
        grown.move_many(grown.ids()[:9], lo[50:59] * length, hi[50:59] * length)
        grown.remove_many(grown.ids()[100:120])
        costs.append((built.cost(), before, grown.cost(), built.height, grown.height))
    assert costs[0] == costs[1]
    assert np.isfinite(costs[1]).all()
    assert min(costs[1]) > 1.0
