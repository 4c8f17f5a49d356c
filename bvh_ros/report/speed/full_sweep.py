# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The cost of a tree built top down by SAH with every split of every axis tried (Wald 2007).

Slow, and so the yardstick for bulk builds that look at few splits.
"""

import numpy as np

from ...tree.area import half_area
from ...tree.compiling import kernel
from ..scenes import Floats


@kernel
def _areas_from_left(lo, hi, order, areas):
    """Half area of the box around the first k + 1 boxes in order, for each k; return the last."""
    low, high = lo[order[0]].copy(), hi[order[0]].copy()
    for k in range(order.shape[0]):
        low = np.minimum(low, lo[order[k]])
        high = np.maximum(high, hi[order[k]])
        areas[k] = half_area(low, high, 1.0)
    return areas[order.shape[0] - 1]


@kernel
def _best_split(lo, hi, rows, best_order):
    """Place of the cheapest split, the rows sorted for it in `best_order`, and the area of all."""
    count = rows.shape[0]
    left, right = np.empty(count), np.empty(count)
    best_cost, best_place, area = np.inf, 1, 0.0
    for axis in range(lo.shape[1]):
        order = rows[np.argsort(lo[rows, axis] + hi[rows, axis])]
        area = _areas_from_left(lo, hi, order, left)
        _areas_from_left(lo, hi, order[::-1].copy(), right)
        for k in range(1, count):
            cost = left[k - 1] * k + right[count - k - 1] * (count - k)
            if cost < best_cost:
                best_cost, best_place = cost, k
                best_order[:count] = order
    return best_place, area


@kernel
def full_sweep_cost(lo: Floats, hi: Floats) -> float:
    """Sum over the inner nodes of area / area of the root, as `DynamicBVH.cost`."""
    count = lo.shape[0]
    rows, order = np.arange(count), np.empty(count, np.int64)
    stack = [(0, count)]
    total, root_area = 0.0, 0.0
    while len(stack) > 0:
        start, stop = stack.pop()
        if stop - start < 2:
            continue
        place, area = _best_split(lo, hi, rows[start:stop], order)
        rows[start:stop] = order[: stop - start]
        if start == 0 and stop == count:
            root_area = area
        total += area
        stack.append((start, start + place))
        stack.append((start + place, stop))
    return total / root_area
