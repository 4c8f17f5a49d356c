# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where to split a range of boxes: binned SAH (Wald 2007, "On fast Construction of SAH-based
Bounding Volume Hierarchies"), down to sixteen boxes; for these, the best plane of all.

A split is a guess about future queries and decides no answer, so it works on float32: eight floats
an item,

    -lo x, -lo y, -lo z, node number, hi x, hi y, hi z, 0      in units in which the range's boxes
    fit into [-1, 1],

for which the union of two boxes is one vector maximum. A range that has become small in its units
gets new ones from the nodes.
"""

import math

import numpy as np

from ..jit.compiling import inlined, lean_kernel
from ..jit.float32x8 import (
    NO_COST,
    NUMBER,
    add_to_bins,
    rank_bins,
    rank_planes8,
    rank_planes16,
    rank_subsets,
)
from ..jit.intrinsics import (
    LANES,
    clear8,
    copy8,
    largest8,
    largest_difference8,
    stack_array,
    swap8,
)

BINS = 16  # of an axis; as many boxes or fewer are divided at the centre of each instead
FEW = 5  # boxes at most for which every division is tried

AXES = 3
NODE = 3  # place of the node number, as int32
HI = 4  # place of hi x

SMALL_RANGE = np.float32(2.0**-10)  # of the unit: below, float32 would see too little of the range
COINCIDENT = np.float32(2.0**-20)  # of the range: centres this close cannot be told apart

_ALL_BINS = AXES * BINS
_BIN_FLOATS = AXES * BINS * LANES
_SCALES = 12


@inlined
def levels_needed(count):
    """Height of a balanced tree over `count` leaves: ceil(log2(count))."""
    levels = 0
    while (1 << levels) < count:
        levels += 1
    return levels


@inlined
def _center(items, item, axis):
    """Twice the centre."""
    return items[item * LANES + HI + axis] - items[item * LANES + axis]


@inlined
def _size(items, item):
    start = item * LANES
    return (
        items[start]
        + items[start + HI]
        + items[start + 1]
        + items[start + HI + 1]
        + items[start + 2]
        + items[start + HI + 2]
    )


@inlined
def _key(items, item, axis):
    """What a median is taken of: the centre on an axis, or on axis AXES the size."""
    return _size(items, item) if axis == AXES else _center(items, item, axis)


@lean_kernel
def median_split(items, start, stop, axis):
    """Quickselect (Hoare 1961): returns the middle, with no key on its left above one on its
    right.
    """
    middle = (start + stop) >> 1
    low, high = start, stop - 1
    while low < high:
        pivot = _key(items, (low + high) >> 1, axis)
        i, j = low, high
        while i <= j:
            while _key(items, i, axis) < pivot:
                i += 1
            while _key(items, j, axis) > pivot:
                j -= 1
            if i <= j:
                swap8(items, i * LANES, j * LANES)
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return middle


@inlined
def compute_bounds(items, start, stop, box, centers):
    """Union of the range's boxes and bounds of their centres (twice), both as [-lo, hi]."""
    clear8(box, 0)
    clear8(centers, 0)
    for item in range(start, stop):
        largest8(box, 0, items, item * LANES)
        largest_difference8(centers, 0, items, item * LANES)


@inlined
def longest_edge(box, planar):
    longest = max(box[0] + box[HI], box[1] + box[HI + 1])
    return longest if planar else max(longest, box[2] + box[HI + 2])


@lean_kernel
def rescale_items(nodes, items, numbers, start, stop):
    """Write the range's items again from their nodes, in units in which their union fits into [-1,
    1].
    """
    ndim = nodes[0].lo.shape[0]
    lo, hi = stack_array(AXES, np.float64), stack_array(AXES, np.float64)
    for axis in range(ndim):
        lo[axis], hi[axis] = np.inf, -np.inf
    for item in range(start, stop):
        node = nodes[numbers[item * LANES + NODE]]
        for axis in range(ndim):
            lo[axis] = min(lo[axis], node.lo[axis])
            hi[axis] = max(hi[axis], node.hi[axis])
    center, half = stack_array(AXES, np.float64), 0.0
    for axis in range(ndim):
        center[axis] = lo[axis] * 0.5 + hi[axis] * 0.5
        half = max(half, hi[axis] * 0.5 - lo[axis] * 0.5)
    # A power of two, whose inverse is finite.
    scale = math.ldexp(1.0, min(-math.frexp(half)[1], 1022))
    for item in range(start, stop):
        node = nodes[numbers[item * LANES + NODE]]
        for axis in range(AXES):
            low, high = 0.0, 0.0
            if axis < ndim:
                low = (node.lo[axis] - center[axis]) * scale
                high = (node.hi[axis] - center[axis]) * scale
            items[item * LANES + axis] = -low
            items[item * LANES + HI + axis] = high
        items[item * LANES + HI + AXES] = 0.0


@inlined
def _bin_scales(centers, smallest, scales):
    """How `add_to_bins` finds the bin of a centre; an axis on which the centres spread no more
    than `smallest` has but one.
    """
    for axis in range(AXES):
        extent = centers[axis] + centers[HI + axis]
        scales[axis] = -centers[axis]
        scales[4 + axis] = np.float32(BINS) / extent if extent > smallest else np.float32(0.0)
        scales[8 + axis] = np.float32(BINS - 1)
    scales[3] = scales[7] = scales[11] = np.float32(0.0)


@inlined
def _cheapest_bin(items, start, stop, scales, planar):
    """The bin after which a split is cheapest; the bins of the three axes are numbered in turn."""
    boxes, counts = stack_array(_BIN_FLOATS, np.float32), stack_array(_ALL_BINS, np.int32)
    for b in range(_ALL_BINS):
        counts[b] = 0
        clear8(boxes, b * LANES)
    for item in range(start, stop):
        add_to_bins(boxes, counts, items, item, scales)
    rank = NO_COST
    for axis in range(AXES):
        if scales[4 + axis] > 0.0:
            rank = min(rank, rank_bins(boxes, counts, axis, stop - start, planar))
    return np.int64(rank & NUMBER)


@inlined
def _choose_few(items, start, count, planar):
    """A bit for each of at most sixteen boxes that the cheapest split has on the left."""
    if count <= FEW:
        return np.int64(rank_subsets(items, start, count, planar) & NUMBER)
    planes = stack_array(_ALL_BINS, np.float32)  # through every centre
    for i in range(_ALL_BINS):
        planes[i] = np.float32(np.inf)
    for i in range(count):
        for axis in range(AXES):
            planes[axis * BINS + i] = _center(items, start + i, axis)
    rank = NO_COST
    for axis in range(2 if planar else 3):
        if count <= LANES:
            rank = min(rank, rank_planes8(items, start, count, planes, axis, planar))
        else:
            rank = min(rank, rank_planes16(items, start, count, planes, axis, planar))
    best = np.int64(rank & NUMBER)
    along, plane, chosen = best // BINS, planes[best], np.int64(0)
    for i in range(count):
        chosen |= np.int64(_center(items, start + i, along) <= plane) << i
    return chosen


# A partition copies every item once into the other half of the array: items of the left child from
# its front on, items of the right child from its back. It has no branch: the processor would guess
# that wrong half the time, which costs more than all the rest of a split.


@inlined
def _divide_few(items, start, stop, shift, chosen):
    """Copy the items to `shift` places further; returns where the right ones begin."""
    left, right = np.int64(start + shift), np.int64(stop + shift - 1)
    for item in range(start, stop):
        before = (chosen >> (item - start)) & 1
        copy8(items, (left if before else right) * LANES, items, item * LANES)
        left += before
        right -= 1 - before
    return left


@inlined
def _divide(items, start, stop, shift, scales, last):
    """As `_divide_few`, left the items up to the bin `last`."""
    axis, limit = last // BINS, np.float32(last % BINS + 1)
    origin, per_length = scales[axis], scales[4 + axis]
    left, right = np.int64(start + shift), np.int64(stop + shift - 1)
    for item in range(start, stop):
        before = np.int64((_center(items, item, axis) - origin) * per_length < limit)
        copy8(items, (left if before else right) * LANES, items, item * LANES)
        left += before
        right -= 1 - before
    return left


@inlined
def _halving_axis(centers, smallest):
    """The axis on which the centres spread most; AXES if that is no more than `smallest`."""
    widest, spread = AXES, smallest
    for axis in range(AXES):
        extent = centers[axis] + centers[HI + axis]
        if extent > spread:
            widest, spread = axis, extent
    return widest


@lean_kernel
def binned_sah_split(nodes, items, numbers, start, stop, levels):
    """Divide items[start:stop] into two sides, each no more than fits below `levels` levels;
    return where the range begins now, which may be in the other half of `items`, and its second
    side.
    """
    count = stop - start
    if count == 2:
        return start, start + 1
    planar = nodes[0].lo.shape[0] == 2
    box, centers = stack_array(LANES, np.float32), stack_array(LANES, np.float32)
    compute_bounds(items, start, stop, box, centers)
    if longest_edge(box, planar) < SMALL_RANGE:
        rescale_items(nodes, items, numbers, start, stop)
        compute_bounds(items, start, stop, box, centers)
    smallest = COINCIDENT * longest_edge(box, planar)
    room = items.shape[0] // (2 * LANES)
    shift = room if start < room else -room
    if count <= BINS:
        chosen = _choose_few(items, start, count, planar)
        middle = _divide_few(items, start, stop, shift, chosen)
    else:
        scales = stack_array(_SCALES, np.float32)
        _bin_scales(centers, smallest, scales)
        last = _cheapest_bin(items, start, stop, scales, planar)
        middle = _divide(items, start, stop, shift, scales, last)
    start, stop = start + shift, stop + shift
    if start < middle < stop and max(middle - start, stop - middle) <= 1 << min(levels - 1, 62):
        return start, middle
    return start, median_split(items, start, stop, _halving_axis(centers, smallest))
