# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where to split a range of boxes: binned SAH (Wald 2007, "On fast Construction of SAH-based
Bounding Volume Hierarchies").

A split is a guess about future queries and decides no answer, so it works on float32: eight floats
an item,

    -lo x, -lo y, -lo z, node number, hi x, hi y, hi z, 0      in units in which the range's boxes
    fit into [-1, 1],

for which the union of two boxes is one vector maximum. A range that has become small in its units
gets new ones from the nodes.
"""

import math

import numpy as np

from ..compiler import (
    LANES,
    clear8,
    inlined,
    largest8,
    largest_difference8,
    lean_kernel,
    stack_array,
    swap8,
)
from ..simd.float32x8 import (
    NO_COST,
    NUMBER,
    add_dealt,
    add_to_bins,
    deal_item,
    join_sides,
    rank_bins,
)

BINS = 16  # of an axis

AXES = 3
NODE = 3  # place of the node number, as int32
HI = 4  # place of hi x
COUNT = 7  # place of a zero; in a bin, of how many boxes it holds

SMALL_RANGE = np.float32(2.0**-10)  # of the unit: below, float32 would see too little of the range
COINCIDENT = np.float32(2.0**-20)  # of the range: centres this close count as one

_ALL_BINS = AXES * BINS
ALL_BINS = 2 * _ALL_BINS  # of both sides
BIN_FLOATS = ALL_BINS * LANES

# A plan says how a range is binned: of the range itself and of both sides of its split, on each
# axis, the least of twice the centres, bins for a unit of these, and how wide a bin is; for each
# four places.
_SLOPE, _WIDTH, PART = 4, 8, 12
_LIMIT = 8  # in the place of a width: the first bin on the right, see `deal_item`
PLAN = 40  # floats
NO_SPLIT = -1
_SIDES = 2 * LANES
_BLOCK = 32  # items that are dealt before they are binned, see `divide`
_BLOCK_PLACES = 4 * _BLOCK


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


@lean_kernel
def compute_bounds(items, start, stop, box, centers):
    """Union of the range's boxes and bounds of their centres (twice), both as [-lo, hi]."""
    clear8(box, 0)
    clear8(centers, 0)
    for item in range(start, stop):
        largest8(box, 0, items, item * LANES)
        largest_difference8(centers, 0, items, item * LANES)


@inlined
def longest_edge(box):
    return max(max(box[0] + box[HI], box[1] + box[HI + 1]), box[2] + box[HI + 2])


@lean_kernel
def rescale_items(nodes, items, numbers, start, stop):
    """Write the range's items again from their nodes, in units in which their union fits into [-1,
    1]; returns half the longest edge of that.
    """
    ndim = nodes[0].lo.shape[0]
    lo, hi = stack_array(AXES, np.float64), stack_array(AXES, np.float64)
    lo[:], hi[:] = np.inf, -np.inf
    for item in range(start, stop):
        here = nodes[numbers[item * LANES + NODE]]
        for axis in range(ndim):
            lo[axis], hi[axis] = min(lo[axis], here.lo[axis]), max(hi[axis], here.hi[axis])
    center, half = stack_array(AXES, np.float64), 0.0
    for axis in range(ndim):
        center[axis] = lo[axis] * 0.5 + hi[axis] * 0.5
        half = max(half, hi[axis] * 0.5 - lo[axis] * 0.5)
    # A power of two, whose inverse is finite.
    scale = math.ldexp(1.0, min(-math.frexp(half)[1], 1022))
    for item in range(start, stop):
        first = item * LANES
        here = nodes[numbers[first + NODE]]
        for axis in range(AXES):
            items[first + axis] = items[first + HI + axis] = np.float32(0.0)
        items[first + COUNT] = np.float32(0.0)
        for axis in range(ndim):
            items[first + axis] = np.float32((here.lo[axis] - center[axis]) * -scale)
            items[first + HI + axis] = np.float32((here.hi[axis] - center[axis]) * scale)
    return half


@inlined
def _plan_axis(plan, part, low, high, smallest):
    """Bins between these; one where that is no more than `smallest`."""
    extent = high - low
    spread = extent > smallest
    plan[part] = low
    plan[part + _SLOPE] = np.float32(BINS) / extent if spread else np.float32(0.0)
    plan[part + _WIDTH] = extent * np.float32(1.0 / BINS)


@inlined
def plan_range(plan, box, centers):
    """How a range is binned, from its bounds."""
    smallest = COINCIDENT * longest_edge(box)
    for axis in range(AXES):
        _plan_axis(plan, axis, -centers[axis], centers[HI + axis], smallest)
    plan[3] = plan[_SLOPE + 3] = np.float32(0.0)


@inlined
def _plan_side(plan, own, side, unions, last):
    """How a side of a split is binned: between the ends of the range, or the split, as far as the
    side's box reaches. That is known before the side's centres are looked at. Returns whether the
    side may be too small for its units.
    """
    part, box, longest = own + PART * (side + 1), LANES * side, np.float32(0.0)
    for axis in range(AXES):
        longest = max(longest, unions[box + axis] + unions[box + HI + axis])
    smallest = COINCIDENT * longest
    split = np.float32(last % BINS + 1)
    for axis in range(AXES):
        origin, width = plan[own + axis], plan[own + _WIDTH + axis]
        along = axis == last // BINS
        begin = split if along and side == 1 else np.float32(0.0)
        stop = split if along and side == 0 else np.float32(BINS)
        low = max(origin + begin * width, np.float32(-2.0) * unions[box + axis])
        high = min(origin + stop * width, np.float32(2.0) * unions[box + HI + axis])
        _plan_axis(plan, part + axis, low, high, smallest)
    plan[part + 3] = plan[part + _SLOPE + 3] = np.float32(0.0)
    return np.int64(longest < SMALL_RANGE)


@inlined
def clear_bins(bins):
    for b in range(ALL_BINS):
        clear8(bins, b * LANES)


@inlined
def fill_bins(bins, items, start, stop, plan):
    """Bin a range as the first of two sides."""
    clear_bins(bins)
    for item in range(start, stop):
        add_to_bins(bins, items, item, plan)


@lean_kernel
def choose_split(bins, side, plan, own, total, planar):
    """Of a range that is binned as this side: the bin after which a split is cheapest, the bins of
    the three axes numbered in turn, or NO_SPLIT; and a bit for each side, left and right, that may
    be too small for its units. Its plan begins at plan[own]: plans the sides.
    """
    first, rank = side * _ALL_BINS, NO_COST
    for axis in range(AXES):
        if plan[own + _SLOPE + axis] > 0.0:
            rank = min(rank, rank_bins(bins, first, axis, total, planar))
    if rank >= NO_COST:
        return np.int64(NO_SPLIT), np.int64(3)
    last, unions = np.int64(rank & NUMBER), stack_array(_SIDES, np.float32)
    join_sides(bins, first + last // BINS * BINS, last % BINS, unions)
    small = _plan_side(plan, own, 0, unions, last)
    return last, small | _plan_side(plan, own, 1, unions, last) << 1


@inlined
def divide(items, start, stop, shift, plan, last, binned, bins):
    """Copy every item once, to `shift` places further: those up to the bin `last` from the front
    on, the others from the back; and if `binned` add both sides to `bins`. Returns where the
    right ones begin.

    No branch: the processor would guess that wrong half the time, which costs more than all the
    rest of a split. Nor is an item binned at once: while it is still being worked out where the
    last one goes, the processor guesses whether the next one needs what is written there.
    """
    test, along = stack_array(PART, np.float32), last // BINS
    for axis in range(4):
        test[axis] = test[_SLOPE + axis] = np.float32(0.0)
        test[_LIMIT + axis] = np.float32(-1.0)
    test[along], test[_SLOPE + along] = plan[along], plan[_SLOPE + along]
    test[_LIMIT + along] = np.float32(last % BINS + 1)
    left, right = np.int64(start + shift), np.int64(stop + shift - 1)
    places = stack_array(_BLOCK_PLACES, np.int32)
    for first in range(start, stop, _BLOCK):
        end = min(first + _BLOCK, stop)
        for item in range(first, end):
            at = 4 * (item - first)
            before = deal_item(items, item, left, right, test, along, binned, plan, places, at)
            left += before
            right -= 1 - before
        if binned:
            for item in range(first, end):
                add_dealt(bins, items, item, places, 4 * (item - first))
    return left


@lean_kernel
def halve(items, start, stop):
    """Divide at the median of the axis on which the centres spread most, or of the size if that is
    hardly anything; returns where the right ones begin.
    """
    box, centers = stack_array(LANES, np.float32), stack_array(LANES, np.float32)
    compute_bounds(items, start, stop, box, centers)
    widest, spread = AXES, COINCIDENT * longest_edge(box)
    for axis in range(AXES):
        extent = centers[axis] + centers[HI + axis]
        if extent > spread:
            widest, spread = axis, extent
    return median_split(items, start, stop, widest)
