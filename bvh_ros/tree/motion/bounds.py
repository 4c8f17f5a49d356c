# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bounds of nodes over a span of time, as motion blur has them: linear from its start to its stop.

The lower side of a node is the least of those of its boxes. Each is linear in time, so their least
is concave: between two times it is never below the line through what it is at both; the upper
side is never above (Grünschloß et al. 2011, "MSBVH"). At both ends the bounds are tight, and in
between loose by no more than a quarter of how far the boxes of a node part in that time.

Nodes are those of the tree: their boxes lie close together at their reference times. Where boxes
have moved far apart by the times of many queries, another `Layout` of nodes takes its place.

The bounds only prune: `exact_contact` decides. They are widened by 2**-48 of what they are at
either end, many times all that a query loses by rounding within the span, by how far they go in
2**-50 of its times, as those of a query are rounded, too, and by `LEAST`, as products may
underflow. A bound that is not finite is none.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..area import half_area, node_area
from ..compiler import CACHE_LINE, inlined, lean_kernel, prefetch, stack_array
from ..nodes import DEEPEST, NONE, QUERIES_LEFT, ROOT, is_leaf, next_node
from ..query.slab import PAD, TINY
from ..simd.moving_sides import HALF, enter_sides
from ..store.turns import NOT_FINITE, REFUSED, begin_query, end_query
from .exact_contact import Moving, box_of, velocity_records

WIDER = 2.0**-48
LEAST = 1e-280
# Beyond these a query visits all boxes: t or a time times LEAST would not be negligible.
LONGEST = 1e40
OUTSIDE = -4  # why a query did nothing: bounds are to be fitted, or looked at, first
ROWS = 8  # of a batch take as long as one question
# Sentinels of state[QUERIES_LEFT]: counter off; bounds just checked (then LOOKED less the rest).
EVER_SO_MANY, LOOKED = -1, -2
AT_REST, AT_START, AT_STOP = range(3)  # sums of half areas of inner nodes


class Layout(NamedTuple):
    """Which boxes lie in which node, if not as in the tree."""

    nodes: NDArray[Any]
    """Of another tree of these boxes."""
    root: int
    slots: NDArray[np.int64]
    """Their slots in the tree, by slot there; empty for the layout of the tree."""


@functools.cache
def moving_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a node: bounds at the start of the span, and how fast they move; the upper ones
    with the other sign, see `moving_sides`. Of a leaf no side is further out than `loose` at any
    time of the span; NaN where a bound is none.
    """
    # Vectors of two or four lanes, and what stands beside them in lanes that have no axis. Whole
    # cache lines: three quarters of the time of records that lie across one more.
    sides: Any = np.float64, (ndim,)
    fields: dict[str, tuple[Any, int]] = {
        'lower': (sides, 0),
        'upper': (sides, 32),
        'lower_rates': (sides, CACHE_LINE),
        'upper_rates': (sides, CACHE_LINE + 32),
        'left': (np.int32, 24),
        'right': (np.int32, 28),
        'mask': (np.uint32, 56),
        'loose': (np.float64, CACHE_LINE + 24),
    }
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype(
        {'names': [*fields], 'formats': formats, 'offsets': offsets, 'itemsize': 2 * CACHE_LINE}
    )


@inlined
def _set_side(sides, rates, axis, first, last, per_second, extent):
    """Write a side that is there at the start and at the stop, widened; `extent` a sum of absolute
    values that none of its terms exceeds. Returns whether it is a bound.
    """
    rate = (last - first) * per_second
    sides[axis], rates[axis] = first - extent * WIDER - LEAST, rate
    finite = math.isfinite(sides[axis]) and math.isfinite(rates[axis])
    if not finite:
        sides[axis], rates[axis] = -np.inf, 0.0
    return finite


@inlined
def _fit_leaf(node, box, moving):
    lo, hi, velocity, reference = box
    start, stop, ndim, end = moving.start, moving.stop, lo.shape[0], reference + moving.left
    first, last, share = min(start, end) - reference, min(stop, end) - reference, 0.0
    if start < end < stop:
        share = (end - start) / (stop - start)
    node.loose = 0.0
    for axis in range(ndim):
        first_shift, last_shift, bent = velocity[axis] * first, velocity[axis] * last, 0.0
        if share > 0.0:  # it stops meanwhile, so far beside the line
            bent = (last_shift - first_shift) * (1.0 - share)
        extent = abs(lo[axis]) + abs(hi[axis])
        extent += abs(velocity[axis]) * (abs(start) + abs(stop) + abs(reference))
        per_second, below, above = 1.0 / (stop - start), min(bent, 0.0), max(bent, 0.0)
        below, above = lo[axis] + below, hi[axis] + above
        bounds = _set_side(
            *(node.lower, node.lower_rates, axis),
            *(below + first_shift, below + last_shift, per_second, extent),
        )
        bounds &= _set_side(
            *(node.upper, node.upper_rates, axis),
            *(-(above + first_shift), -(above + last_shift), per_second, extent),
        )
        # Rounding loses at most as much as the widening, and the query as much again.
        node.loose += 3.0 * (extent * WIDER + LEAST) + abs(bent) if bounds else np.nan


@inlined
def _ends(side, rate, other, other_rate, length):
    """The lesser of two sides at the start, and at the stop."""
    return min(side, other), min(side + rate * length, other + other_rate * length)


@inlined
def _fit_inner(node, one, other, moving):
    length, far = moving.stop - moving.start, 0.25 * (abs(moving.start) + abs(moving.stop))
    for axis in range(node.lower.shape[0]):
        sides = one.lower[axis], one.lower_rates[axis], other.lower[axis], other.lower_rates[axis]
        lower, fastest = _ends(*sides, length), abs(sides[1]) + abs(sides[3])
        sides = one.upper[axis], one.upper_rates[axis], other.upper[axis], other.upper_rates[axis]
        upper = _ends(*sides, length)
        extent = abs(lower[0]) + abs(upper[0]) + (abs(lower[1]) + abs(upper[1]))
        # The last time of a course is rounded: it may go on beyond the span, where the line
        # through two ends leaves boxes that part there. (That of a leaf is its own at any time.)
        extent += (abs(sides[1]) + abs(sides[3]) + fastest) * far
        _set_side(node.lower, node.lower_rates, axis, *lower, 1.0 / length, extent)
        _set_side(node.upper, node.upper_rates, axis, *upper, 1.0 / length, extent)


@inlined
def _named(layout, root, node):
    """The node of the tree that a node of a layout becomes; the root that of the tree."""
    if layout.slots.shape[0] == 0:
        return node
    if is_leaf(node):
        return 2 * layout.slots[node >> 1]
    if node == layout.root:
        return root
    return np.int64(layout.root) if node == root else node


@inlined
def _area_then(node, ahead):
    """Half area of bounds, so long after the start of the span."""
    low, high = stack_array(3, np.float64), stack_array(3, np.float64)
    ndim = node.lower.shape[0]
    for axis in range(ndim):
        low[axis] = node.lower[axis] + node.lower_rates[axis] * ahead
        high[axis] = -(node.upper[axis] + node.upper_rates[axis] * ahead)
    return half_area(low[:ndim], high[:ndim], 1.0)


@lean_kernel
def fit_nodes(tree, moving, layout, order, areas):
    """Fill moving.nodes, (2 capacity,) of `moving_dtype`, over the span, and `areas`, (3,): those
    of the tree, of the bounds at the start and at the stop. `order`, (2 capacity,) int64, is
    scratch. Returns 0, or REFUSED if the tree is of another version.
    """
    fitted, root, own = moving.nodes, np.int64(tree.state[ROOT]), layout.slots.shape[0] == 0
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    nodes = tree.nodes if own else layout.nodes
    stack, top, count = stack_array(DEEPEST, np.int64), 0, 0
    node = root if own else np.int64(layout.root)
    while node != NONE:
        order[count] = node
        count += 1
        node, top = next_node(nodes, node, not is_leaf(node), stack, top)
    areas[:], length = 0.0, moving.stop - moving.start
    for i in range(count - 1, -1, -1):
        node = _named(layout, root, order[i])
        here, there = fitted[node], nodes[order[i]]
        if is_leaf(node):
            here.left = here.right = node
            here.mask = tree.nodes[node].mask
            _fit_leaf(here, box_of(tree, moving, node >> 1), moving)
        else:
            left = _named(layout, root, np.int64(there.left))
            right = _named(layout, root, np.int64(there.right))
            here.left, here.right = left, right
            here.mask = fitted[left].mask | fitted[right].mask
            _fit_inner(here, fitted[left], fitted[right], moving)
            areas[AT_START] += _area_then(here, 0.0)
            areas[AT_STOP] += _area_then(here, length)
            if own:
                areas[AT_REST] += node_area(nodes, node, 1.0)
    end_query(tree.state)
    return np.int64(0)


@inlined
def fetch_children(nodes, node):
    """Ask for the memory of a node's children, while it is looked at; of a leaf for its own."""
    prefetch(nodes, np.int64(nodes[node].left), 2)
    prefetch(nodes, np.int64(nodes[node].right), 2)


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
def begin_asking(tree, moving, count):
    """`begin_query` of so many queries at one time: 0; REFUSED; or OUTSIDE after so many that the
    bounds are to be checked first. Queries over a span of time count 0.
    """
    left = tree.state[QUERIES_LEFT]
    if count > 0 and left != EVER_SO_MANY:
        count = (count + ROWS - 1) // ROWS
        looked = left < EVER_SO_MANY
        left = LOOKED - left if looked else left
        tree.state[QUERIES_LEFT] = max(left - count, 0)
        if left <= count and not looked:
            return np.int64(OUTSIDE)
    return np.int64(0 if begin_query(tree.state, moving.version) else REFUSED)


@inlined
def moments_of(pace, count):
    """How many of so many courses count, given one pace for all or a pace a row."""
    return count if pace.shape[0] == 1 and pace[0] == 0.0 else 0


@inlined
def begin_rows(tree, moving, at, count):
    """`begin_asking` of so many rows, at times of their own or one for all, and `end_query`;
    OUTSIDE, too, where bounds could be fitted to a time and do not hold, NOT_FINITE where one is
    not.
    """
    for row in range(min(at.shape[0], count)):
        if not math.isfinite(at[row]):
            return np.int64(NOT_FINITE)
        if covers(moving, at[row], 0.0, 0.0) == 0:
            return np.int64(OUTSIDE)
    why = begin_asking(tree, moving, count)
    if why == 0:
        end_query(tree.state)
    return why


@inlined
def set_fronts(fronts, moving, lo, hi, direction):
    """Write what `moving_sides` asks for, (FRONTS,), of a box that goes somewhere."""
    fronts[: 2 * HALF], fronts[2 * HALF :] = np.inf, 0.0
    for axis in range(moving.velocities[0].velocity.shape[0]):
        fronts[axis], fronts[HALF + axis] = hi[axis], -lo[axis]
        fronts[2 * HALF + axis], fronts[3 * HALF + axis] = direction[axis], -direction[axis]


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


def no_motion(ndim: int) -> Moving:
    """To tell a compiler the types."""
    nodes = np.empty(0, moving_dtype(ndim))
    return Moving(velocity_records(0, ndim), nodes, 0.0, 0.0, 0, False, np.inf)
