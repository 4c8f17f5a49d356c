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
from ..jit.intrinsics import CACHE_LINE, stack_array
from ..nodes import DEEPEST, NONE, ROOT, is_leaf, next_node
from ..rays.slab import DIRECTION, ORIGIN, PAD, TINY, UPPER
from ..store.turns import REFUSED, begin_query, end_query
from .meeting import box_of

WIDER = 2.0**-48
LEAST = 1e-280
# Beyond these a query visits all boxes: t or a time times LEAST would not be negligible.
LONGEST = 1e40
SIDES = 'lo', 'hi', 'lo_rate', 'hi_rate'


@functools.cache
def moving_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a node: bounds at the start of the span, and how fast they move."""
    side = 8 * ndim
    sides = [(name, (np.float64, (ndim,)), k * side) for k, name in enumerate(SIDES)]
    links = [('left', np.int32), ('right', np.int32), ('mask', np.uint32)]
    fields = [*sides, *((*link, 4 * side + 4 * k) for k, link in enumerate(links))]
    names, formats, offsets = zip(*fields, strict=True)
    # Whole cache lines: three quarters of the time of records that lie across one more.
    return np.dtype(
        {'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': 2 * CACHE_LINE}
    )


@inlined
def _ends_of(node, axis, length):
    """What the bounds are at the start and at the stop: (lo, hi, lo, hi)."""
    lo, hi = node.lo[axis], node.hi[axis]
    return lo, hi, lo + node.lo_rate[axis] * length, hi + node.hi_rate[axis] * length


@inlined
def _set_bounds(node, axis, ends, per_second, extent):
    """Write bounds that are `ends`, a sum of absolute values at most `extent`, widened."""
    lo, hi, later_lo, later_hi = ends
    more = extent * WIDER + LEAST
    node.lo[axis], node.lo_rate[axis] = lo - more, (later_lo - lo) * per_second
    node.hi[axis], node.hi_rate[axis] = hi + more, (later_hi - hi) * per_second
    if not (math.isfinite(node.lo[axis]) and math.isfinite(node.lo_rate[axis])):
        node.lo[axis], node.lo_rate[axis] = -np.inf, 0.0
    if not (math.isfinite(node.hi[axis]) and math.isfinite(node.hi_rate[axis])):
        node.hi[axis], node.hi_rate[axis] = np.inf, 0.0


@inlined
def _fit_leaf(node, box, moving):
    lo, hi, velocity, reference = box
    start, stop = moving.start, moving.stop
    for axis in range(lo.shape[0]):
        way, later = velocity[axis] * (start - reference), velocity[axis] * (stop - reference)
        extent = abs(lo[axis]) + abs(hi[axis])
        extent += abs(velocity[axis]) * (abs(start) + abs(stop) + abs(reference))
        ends = lo[axis] + way, hi[axis] + way, lo[axis] + later, hi[axis] + later
        _set_bounds(node, axis, ends, 1.0 / (stop - start), extent)


@inlined
def _fit_inner(node, left, right, length):
    for axis in range(node.lo.shape[0]):
        one, other = _ends_of(left, axis, length), _ends_of(right, axis, length)
        lo, later_lo = min(one[0], other[0]), min(one[2], other[2])
        hi, later_hi = max(one[1], other[1]), max(one[3], other[3])
        extent = abs(lo) + abs(later_lo) + abs(hi) + abs(later_hi)
        _set_bounds(node, axis, (lo, hi, later_lo, later_hi), 1.0 / length, extent)


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
def enter_node(node, course, ahead, limit):
    """Distance at which a course may enter a node's bounds, or inf if it surely misses them or
    enters after `limit`. `ahead` is from the start of the span to that of the course.

    Comparisons with NaN are written such that they bound nothing, nor does a speed beyond the
    doubles.
    """
    ray, pace = course.ray, course.pace
    entry, leave = 0.0, limit
    for axis in range(node.lo.shape[0]):
        below = node.lo[axis] + node.lo_rate[axis] * ahead - ray[UPPER, axis]
        above = node.hi[axis] + node.hi_rate[axis] * ahead - ray[ORIGIN, axis]
        toward = ray[DIRECTION, axis] - node.lo_rate[axis] * pace
        away = ray[DIRECTION, axis] - node.hi_rate[axis] * pace
        if below > 0.0:
            if toward <= 0.0:
                return np.inf
            entry = max(entry, below / toward)
        elif -np.inf < toward < 0.0 and below / toward < leave:
            leave = below / toward
        if above < 0.0:
            if away >= 0.0:
                return np.inf
            entry = max(entry, above / away)
        elif 0.0 < away < np.inf and above / away < leave:
            leave = above / away
    if math.isinf(entry):
        return 0.0
    return entry if entry <= leave * PAD + TINY else np.inf
