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

import numpy as np

from .compiling import inlined, lean_kernel
from .machine import LANES, clear8, copy8, largest8, largest_difference8, stack_array, swap8

BINS = 32
FEW = 5  # boxes of a range for which the other axes than the widest are not worth trying
AXES = 3
NODE = 3  # place of the node number, as int32
HI = 4  # place of hi x

SMALL_RANGE = np.float32(2.0**-10)  # of the unit: below, float32 would see too little of the range
COINCIDENT = np.float32(2.0**-20)  # of the range: centres this close cannot be told apart

_ALL_BINS = AXES * BINS * LANES
_COUNTS = AXES * BINS


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
def halve(items, start, stop, axis):
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
def _area(boxes, at, planar):
    x = boxes[at] + boxes[at + HI]
    y = boxes[at + 1] + boxes[at + HI + 1]
    if planar:
        return x + y
    z = boxes[at + 2] + boxes[at + HI + 2]
    return x * y + (x + y) * z


@inlined
def _bin_of(items, item, axis, origin, per_length, last):
    return min(np.int64((_center(items, item, axis) - origin) * per_length), last)


@inlined
def _fill_bins(items, start, stop, axis, origin, per_length, bins, boxes, counts):
    first = axis * BINS
    for b in range(first, first + bins):
        counts[b] = 0
        clear8(boxes, b * LANES)
    for item in range(start, stop):
        b = first + _bin_of(items, item, axis, origin, per_length, bins - 1)
        counts[b] += 1
        largest8(boxes, b * LANES, items, item * LANES)


@inlined
def _cheapest_split(axis, bins, boxes, counts, box, right, planar):
    """The bin before which a split has the least sum of area times count, as (cost, bin); `box`
    and `right` are scratch.
    """
    first = axis * BINS
    clear8(box, 0)
    count = 0
    for b in range(bins - 1, 0, -1):
        largest8(box, 0, boxes, (first + b) * LANES)
        count += counts[first + b]
        right[b] = _area(box, 0, planar) * np.float32(count) if count > 0 else np.float32(np.inf)
    clear8(box, 0)
    count = 0
    best_cost, best = np.float32(np.inf), 0
    for b in range(1, bins):
        largest8(box, 0, boxes, (first + b - 1) * LANES)
        count += counts[first + b - 1]
        if count > 0:
            cost = _area(box, 0, planar) * np.float32(count) + right[b]
            if cost < best_cost:
                best_cost, best = cost, b
    return best_cost, best


@inlined
def _divide(items, spare, start, stop, axis, origin, per_length, last, split):
    """Move the items of the bins before `split` to the front; returns where the others begin.

    Every item is copied both ways and one of the two places moves on: no branch that the processor
    would guess wrong half the time, which costs more than all the rest of a split.
    """
    left, right = np.int64(start), np.int64(0)
    for item in range(start, stop):
        before = np.int64(_bin_of(items, item, axis, origin, per_length, last) < split)
        copy8(spare, right * LANES, items, item * LANES)
        copy8(items, left * LANES, items, item * LANES)
        left += before
        right += 1 - before
    for i in range(right):
        copy8(items, (left + i) * LANES, spare, i * LANES)
    return left


@inlined
def measure(items, start, stop, box, centers):
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
def renew_units(nodes, items, numbers, start, stop):
    """Write the range's items again from their nodes, in units in which their union fits into [-1,
    1].
    """
    ndim = nodes[0].lo.shape[0]
    center, half = stack_array(AXES, np.float64), 0.0
    for axis in range(ndim):
        lo, hi = np.inf, -np.inf
        for item in range(start, stop):
            node = nodes[numbers[item * LANES + NODE]]
            lo, hi = min(lo, node.lo[axis]), max(hi, node.hi[axis])
        center[axis] = lo * 0.5 + hi * 0.5
        half = max(half, hi * 0.5 - lo * 0.5)
    for item in range(start, stop):
        node = nodes[numbers[item * LANES + NODE]]
        for axis in range(AXES):
            low, high = 0.0, 0.0
            if axis < ndim and half > 0.0:
                low, high = (
                    (node.lo[axis] - center[axis]) / half,
                    (node.hi[axis] - center[axis]) / half,
                )
            items[item * LANES + axis] = -low
            items[item * LANES + HI + axis] = high
        items[item * LANES + HI + AXES] = 0.0


@inlined
def _pair_area(items, a, b, box, planar):
    clear8(box, 0)
    largest8(box, 0, items, a * LANES)
    largest8(box, 0, items, b * LANES)
    return _area(box, 0, planar)


@inlined
def _split_three(items, start, planar):
    """Leave together, in front, the two of three boxes whose union is the smallest."""
    box = stack_array(LANES, np.float32)
    alone, least = start + 2, _pair_area(items, start, start + 1, box, planar)
    for single in (start, start + 1):
        area = _pair_area(items, start + 2, 2 * start + 1 - single, box, planar)
        if area < least:
            alone, least = single, area
    swap8(items, alone * LANES, (start + 2) * LANES)
    return start + 2


@lean_kernel
def split_range(nodes, items, spare, numbers, start, stop, levels):
    """Reorder items[start:stop] into two sides, each no more than fits below `levels` levels;
    return where the second begins.
    """
    count = stop - start
    if count == 2:
        return start + 1
    planar = nodes[0].lo.shape[0] == 2
    if count == 3 and levels > 1:
        return _split_three(items, start, planar)
    box, centers = stack_array(LANES, np.float32), stack_array(LANES, np.float32)
    measure(items, start, stop, box, centers)
    if longest_edge(box, planar) < SMALL_RANGE:
        renew_units(nodes, items, numbers, start, stop)
        measure(items, start, stop, box, centers)
    widest, spread = 0, np.float32(-1.0)
    for axis in range(2 if planar else 3):
        if centers[axis] + centers[HI + axis] > spread:
            widest, spread = axis, centers[axis] + centers[HI + axis]
    if spread <= COINCIDENT * longest_edge(box, planar):
        return halve(items, start, stop, AXES)
    boxes, counts = stack_array(_ALL_BINS, np.float32), stack_array(_COUNTS, np.int32)
    right = stack_array(BINS, np.float32)
    bins = BINS if count > 200 else 16 if count > 24 else 8 if count > 5 else 4
    best_cost, best_axis, best_bin = np.float32(np.inf), 0, 0
    for axis in range(2 if planar else 3):
        extent = centers[axis] + centers[HI + axis]
        if extent > COINCIDENT * spread and (axis == widest or count > FEW):
            _fill_bins(
                items,
                start,
                stop,
                axis,
                -centers[axis],
                np.float32(bins) / extent,
                bins,
                boxes,
                counts,
            )
            cost, split = _cheapest_split(axis, bins, boxes, counts, box, right, planar)
            if cost < best_cost:
                best_cost, best_axis, best_bin = cost, axis, split
    if best_cost < np.inf:
        per_length = np.float32(bins) / (centers[best_axis] + centers[HI + best_axis])
        middle = _divide(
            items,
            spare,
            start,
            stop,
            best_axis,
            -centers[best_axis],
            per_length,
            bins - 1,
            best_bin,
        )
        if start < middle < stop and max(middle - start, stop - middle) <= 1 << min(
            levels - 1, 62
        ):
            return middle
    return halve(items, start, stop, widest)
