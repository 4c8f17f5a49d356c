# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The order in which a dense batch of points is asked: neighbours load the same nodes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import Floats
from ..compiler import inlined, lean_kernel, stack_array
from ..nodes import ROOT

CELL_BITS = 5  # of a point on each axis
DIGIT_BITS = 8  # two digits hold a key of 3 * CELL_BITS
DIGITS = 1 << DIGIT_BITS


@inlined
def _cell(points, i, center, per_length):
    """The cell of a point, with the bits of the axes interleaved (Morton 1966)."""
    key = np.int64(0)
    for axis in range(points.shape[1]):
        place = (points[i, axis] - center[axis]) * per_length * 0.5 + 0.5
        cell = np.int64(min(max(place, 0.0), 0.999) * (1 << CELL_BITS))
        for bit in range(CELL_BITS):
            key |= ((cell >> bit) & 1) << (3 * bit + axis)
    return key


@lean_kernel
def neighbour_order(points, lo, hi, keys, order, spare):
    """Fill `order`, (n,) int64, with the rows of `points`, (n, ndim), so that consecutive rows are
    near each other: sorted by the cells of a grid over the intersection of the points' bounds and
    the box from `lo` to `hi`. keys, spare: scratch, (n,) int64.
    """
    center, half = stack_array(3, np.float64), 1e-300
    for axis in range(points.shape[1]):
        least, largest = np.inf, -np.inf
        for i in range(points.shape[0]):
            least, largest = min(least, points[i, axis]), max(largest, points[i, axis])
        least, largest = max(least, lo[axis]), min(largest, hi[axis])
        center[axis] = least * 0.5 + largest * 0.5
        half = max(half, largest * 0.5 - least * 0.5)
    for i in range(points.shape[0]):
        keys[i] = _cell(points, i, center, 1.0 / half)
    _sort(keys, order, spare)


@lean_kernel
def _sort(keys, order, spare):
    """Fill `order` with the rows by ascending key: a stable radix sort in two passes."""
    starts = stack_array(DIGITS, np.int64)
    count = keys.shape[0]
    for i in range(count):
        order[i] = i
    for shift in (0, DIGIT_BITS):
        before, after = (order, spare) if shift == 0 else (spare, order)
        for digit in range(DIGITS):
            starts[digit] = 0
        for i in range(count):
            starts[(keys[i] >> shift) & (DIGITS - 1)] += 1
        total = 0
        for digit in range(DIGITS):
            starts[digit], total = total, total + starts[digit]
        for i in before:
            digit = (keys[i] >> shift) & (DIGITS - 1)
            after[starts[digit]] = i
            starts[digit] += 1


def order_of(tree: Any, points: Floats) -> NDArray[np.int64]:
    """The order in which points, finite and of shape (n, ndim), are asked; as they stand where the
    tree is empty.
    """
    arrays = tree.view().tree
    keys, order, spare = np.empty((3, len(points)), np.int64)
    root = arrays.state.item(ROOT)
    if root < 0:
        return order[:0]
    bounds = arrays.nodes[root]
    neighbour_order(points, bounds['lo'], bounds['hi'], keys, order, spare)
    return order
