# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bounds of nodes over a span of time, as motion blur has them: linear from its start to its stop.

The lower side of a node is the least of those of its boxes. Each is linear in time, so their least
is concave: between two times it is never below the line through what it is at both; the upper
side is never above (Grünschloß et al. 2011, "MSBVH"). At both ends the bounds are tight, and in
between loose by no more than a quarter of how far the boxes of a node part in that time.

The bounds only prune: `meeting` decides. They are widened by 2**-48 of what they are at either
end, many times all that a query loses by rounding within the span, and by `LEAST`, as products
may underflow. A bound that is not finite is none.
"""

import functools
import math
from typing import Any

import numpy as np

from ..jit.compiling import inlined, lean_kernel
from ..jit.float64x8 import EIGHT
from ..jit.intrinsics import CACHE_LINE, stack_array
from ..jit.moving_sides import enter_sides
from ..nodes import DEEPEST, NONE, ROOT, is_leaf, next_node
from ..rays.slab import PAD, TINY
from ..store.turns import REFUSED, begin_query, end_query
from .meeting import box_of

WIDER = 2.0**-48
LEAST = 1e-280
# Beyond these a query visits all boxes: t or a time times LEAST would not be negligible.
LONGEST = 1e40
FRONTS = 2 * EIGHT


@functools.cache
def moving_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a node: bounds at the start of the span, and how fast they move; the upper ones
    with the other sign, see `moving_sides`. Of a leaf no side is further out than `loose` at any
    time of the span; NaN where a bound is none.
    """
    links = [('left', np.int32), ('right', np.int32), ('mask', np.uint32)]
    sides: Any = np.float64, (2 * ndim,)
    fields = [('sides', sides, 0), ('rates', sides, CACHE_LINE)]
    fields += [(*link, 16 * ndim + 4 * k) for k, link in enumerate(links)]
    fields += [('loose', np.float64, CACHE_LINE + 16 * ndim)]
    names, formats, offsets = zip(*fields, strict=True)
    # Whole cache lines: three quarters of the time of records that lie across one more.
    return np.dtype(
        {'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': 2 * CACHE_LINE}
    )


@inlined
def _set_side(node, lane, first, last, per_second, extent):
    """Write a side that is there at the start and at the stop, widened; `extent` a sum of absolute
    values that none of its terms exceeds.
    """
    rate = (last - first) * per_second
    node.sides[lane], node.rates[lane] = first - extent * WIDER - LEAST, rate
    if not (math.isfinite(node.sides[lane]) and math.isfinite(node.rates[lane])):
        node.sides[lane], node.rates[lane] = -np.inf, 0.0
        node.loose = np.nan


@inlined
def _fit_leaf(node, box, moving):
    lo, hi, velocity, reference = box
    start, stop, ndim = moving.start, moving.stop, lo.shape[0]
    node.loose = 0.0
    for axis in range(ndim):
        way, later = velocity[axis] * (start - reference), velocity[axis] * (stop - reference)
        extent = abs(lo[axis]) + abs(hi[axis])
        extent += abs(velocity[axis]) * (abs(start) + abs(stop) + abs(reference))
        lower, per_second = (lo[axis] + way, lo[axis] + later), 1.0 / (stop - start)
        _set_side(node, axis, lower[0], lower[1], per_second, extent)
        upper = -(hi[axis] + way), -(hi[axis] + later)
        _set_side(node, ndim + axis, upper[0], upper[1], per_second, extent)
        # As much as it is widened by is lost by rounding at most, and once more by who asks.
        node.loose += 3.0 * (extent * WIDER + LEAST)


@inlined
def _fit_inner(node, left, right, length):
    ends, ndim = stack_array((2, 6), np.float64), node.sides.shape[0] // 2
    for lane in range(2 * ndim):
        ends[0, lane] = min(left.sides[lane], right.sides[lane])
        later = left.sides[lane] + left.rates[lane] * length
        ends[1, lane] = min(later, right.sides[lane] + right.rates[lane] * length)
    for lane in range(2 * ndim):
        extent, other = 0.0, lane + ndim if lane < ndim else lane - ndim
        for row in range(2):
            extent += abs(ends[row, lane]) + abs(ends[row, other])
        _set_side(node, lane, ends[0, lane], ends[1, lane], 1.0 / length, extent)


@lean_kernel
def fit_nodes(tree, moving, order):
    """Fill moving.nodes, (2 capacity,) of `moving_dtype`, over the span; `order`, (2 capacity,)
    int64, is scratch. Returns 0, or REFUSED if the tree is of another version.
    """
    nodes, fitted, root = tree.nodes, moving.nodes, tree.state[ROOT]
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    stack, top, node, count = stack_array(DEEPEST, np.int64), 0, np.int64(root), 0
    while node != NONE:
        order[count] = node
        count += 1
        node, top = next_node(nodes, node, not is_leaf(node), stack, top)
    length = moving.stop - moving.start
    for i in range(count - 1, -1, -1):
        node = order[i]
        here, there = fitted[node], nodes[node]
        here.mask = there.mask
        if is_leaf(node):
            _fit_leaf(here, box_of(tree, moving, node >> 1), moving)
        else:
            here.left, here.right = there.left, there.right
            _fit_inner(here, fitted[there.left], fitted[there.right], length)
    end_query(tree.state)
    return np.int64(0)


@inlined
def covers(moving, at, pace, t_max):
    """Whether the bounds hold for a course: 1; 0 if not, but they could be fitted; -1 if not at
    all.
    """
    last = at if pace == 0.0 else at + t_max * pace
    if not (abs(at) < LONGEST and abs(last) < LONGEST and (pace == 0.0 or t_max < LONGEST)):
        return -1
    within = moving.start <= min(at, last) and max(at, last) <= moving.stop
    return 1 if within else 0


@inlined
def set_fronts(fronts, moving, lo, hi, direction):
    """Write what `moving_sides` asks for, (FRONTS,), of a box that goes somewhere."""
    ndim = moving.kept[0].velocity.shape[0]
    fronts[:EIGHT], fronts[EIGHT:] = np.inf, 0.0
    for axis in range(ndim):
        fronts[axis], fronts[ndim + axis] = hi[axis], -lo[axis]
        fronts[EIGHT + axis], fronts[EIGHT + ndim + axis] = direction[axis], -direction[axis]


@inlined
def enter_node(nodes, node, fronts, ahead, pace, limit):
    """Distance at which a course may enter a node's bounds, or inf if it surely misses them or
    enters after `limit`. `ahead` is from the start of the span to that of the course.

    What is not a number bounds nothing, nor does a speed beyond the doubles.
    """
    missed, entry, leave = enter_sides(nodes, node, fronts, ahead, pace)
    if missed:
        return np.inf
    if not entry < np.inf:
        return 0.0
    return entry if entry <= min(leave, limit) * PAD + TINY else np.inf
