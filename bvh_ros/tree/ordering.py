# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The order in which a batch of rays is cast: neighbours load the same nodes."""

import numpy as np

from .compiling import inlined, lean_kernel
from .machine import stack_array

CELL_BITS = 5  # of the origin on each axis
KEY_BITS = 3 * (CELL_BITS + 1)
DIGIT_BITS = KEY_BITS // 2
DIGITS = 1 << DIGIT_BITS


@inlined
def _ray_key(origins, directions, i, center, per_length):
    """Octant of the direction, then the cell of the origin with the bits of the axes interleaved
    (Morton 1966).
    """
    key = np.int64(0)
    for axis in range(origins.shape[1]):
        place = (origins[i, axis] - center[axis]) * per_length * 0.5 + 0.5
        cell = np.int64(min(max(place, 0.0), 0.999) * (1 << CELL_BITS))
        for bit in range(CELL_BITS):
            key |= ((cell >> bit) & 1) << (3 * bit + axis)
        if directions[i, axis] > 0.0:
            key |= 1 << (3 * CELL_BITS + axis)
    return key


@lean_kernel
def coherent_order(origins, directions, center, per_length, keys, order, spare):
    """Fill `order` so that neighbours visit the same nodes: a stable radix sort by `_ray_key`.
    keys, spare: scratch, n int64.
    """
    starts = stack_array(DIGITS, np.int64)
    count = origins.shape[0]
    for i in range(count):
        keys[i] = _ray_key(origins, directions, i, center, per_length)
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
