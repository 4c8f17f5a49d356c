# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The k boxes nearest to a point or box at a time: the traversals of `query.nearest` among moving
nodes.

The traversal looks for the boxes whose bounds are nearest. Their distances decide, ties by the
smaller handle, unless a box that was left out may be nearer: then a second traversal looks at the
distances of all boxes in reach. Gaps are within a rounding of the exact ones (see `sums`), so
distances are as good as those of boxes at rest.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import inlined, lean_kernel, stack_array
from ..nodes import ROOT, entry_points
from ..query.nearest import (
    NO_POINTS,
    Best,
    keep_if_near,
    load,
    name_row,
    no_packet,
    pruning_limit,
    visit_nearest,
    visit_packet,
    within,
)
from ..query.ray import of_row
from ..simd.float64x8 import EIGHT, WHEN, moving_squares8
from ..simd.moving_sides import square_beside
from ..store.turns import NOT_FINITE, end_query
from .bounds import OUTSIDE, begin_asking, covers, fetch_children, no_motion
from .entries import is_sound
from .exact_contact import box_of, elapsed, fetch_box, gap, moment_of, quick_gap, surely_below
from .overlap import BoxAt, box_at

# Squares whose root says something, and by how much it is rounded down.
LEAST_SQUARE, MOST_SQUARE, LESS = 1e-290, 1e308, 1.0 - 2.0**-49
# What is farther by this factor is left out: more than a box's distance differs from its bounds'.
FARTHER = 1.0 + 2.0**-28
UNBOUNDED = 1  # no bounds can hold for a time of a packet


class NearAt(NamedTuple):
    """A query at a time, among moving boxes."""

    box: BoxAt
    k: int
    reach: float
    """The largest distance."""
    mask: np.uint32


class Bounds(NamedTuple):
    """The boxes whose bounds are nearest so far, nearest first."""

    slots: NDArray[np.int64]
    """Room for k, or for more: then for those that are as near as the k-th, as far as bounds
    tell.
    """
    squares: NDArray[np.float64]
    """The squared distances of their bounds."""
    left_out: NDArray[np.float64]
    """Shape (1,): the least square of a box for which there was no room."""


class Bounded(NamedTuple):
    """The boxes whose bounds are nearest to n points."""

    slots: NDArray[np.int64]
    """(n, k)"""
    counts: NDArray[np.int64]
    """How many there are."""
    left_out: NDArray[np.float64]
    """Where those are k, the least square of the distance of others."""


# ---- distances


@inlined
def _quick_apart(box, axis, low, high, since):
    """How far a box is from the one from low to high on an axis, 0 where they touch, in doubles,
    since = `elapsed`: (how far, whether that is enough). Without branches, so that axes become
    lanes.
    """
    (lo, hi, velocity, _), (since, lost) = box, since
    shift = velocity[axis] * since
    below, above = (lo[axis] - high[axis]) + shift, (low[axis] - hi[axis]) - shift
    # One side tells it, as the other is surely passed; a choice costs less than a guess.
    lower = below > above
    plane, front = (lo[axis], high[axis]) if lower else (hi[axis], low[axis])
    apart, _, enough = quick_gap(plane, front, velocity[axis], since, lost)
    apart = apart if lower else -apart
    plane, front, shift = (low[axis], hi[axis], -shift) if lower else (lo[axis], high[axis], shift)
    return max(apart, 0.0), enough & ((apart > 0.0) | surely_below(plane, front, shift))


@inlined
def _apart_surely(box, axis, low, high, when):
    """How far, whatever the sums are."""
    lo, hi, velocity, reference = box
    below = _gap_now(lo[axis], high[axis], velocity[axis], when, reference)
    above = _gap_now(hi[axis], low[axis], velocity[axis], when, reference)
    return max(below, -above, 0.0)


@inlined
def _gap_now(plane, front, velocity, when, reference):
    """As a double; inf where it exceeds the largest."""
    high, _, exponent = gap(plane, front, velocity, when[0], reference, when[1])
    return high if exponent == 0 else math.ldexp(high, exponent)


@inlined
def distance_at(box, low, high, when):
    """Distance of a box at a time from the one from low to high, 0 where they touch; when = (at,
    nanoseconds).
    """
    longest, total, sure = 0.0, 0.0, True
    since = elapsed(when[0], box[3], when[1])
    for axis in range(box[0].shape[0]):
        apart, enough = _quick_apart(box, axis, low, high, since)
        sure &= enough
        longest = max(longest, apart)
        total += apart * apart
    if sure & ((1e-140 < longest < 1e140) | (longest == 0.0)):
        return math.sqrt(total)
    return _any_distance(box, low, high, when)


@lean_kernel
def _any_distance(box, low, high, when):
    """The same, whatever the sums are; squares as in `boxes.nearest.distance`; inf where it
    exceeds the largest double.
    """
    gaps, longest, total = stack_array(3, np.float64), 0.0, 0.0
    since = elapsed(when[0], box[3], when[1])
    for axis in range(box[0].shape[0]):
        gaps[axis], enough = _quick_apart(box, axis, low, high, since)
        if not enough:
            gaps[axis] = _apart_surely(box, axis, low, high, when)
        longest = max(longest, gaps[axis])
    if longest == 0.0 or math.isinf(longest):
        return longest
    exponent = 0 if 1e-140 < longest < 1e140 else math.frexp(longest)[1]
    for axis in range(box[0].shape[0]):
        apart = math.ldexp(gaps[axis], -exponent)
        total += apart * apart
    return math.ldexp(math.sqrt(total), exponent)


# ---- one query


@inlined
def near_at(moving, at, low, high, k, reach, mask):
    """The query of a box, or point, at a time."""
    return NearAt(box_at(moving, at, low, high), k, reach, mask)


@inlined
def _square(nodes, node, query, limit):
    if nodes[node].mask & query.mask == 0:
        return np.inf
    fetch_children(nodes, node)
    if not query.box.bounded:
        return 0.0
    square = square_beside(nodes, node, query.box.fronts, query.box.ahead)
    return within(square, limit)


@inlined
def _look_at_bounds(tree, query, leaf, square, bounds, count, limit):
    slots, squares, left_out = bounds
    if count == slots.shape[0]:
        left_out[0] = min(left_out[0], max(square, squares[count - 1]))
        if square >= squares[count - 1]:
            return count, limit
        count -= 1
    place = count
    while place > 0 and square < squares[place - 1]:
        slots[place], squares[place] = slots[place - 1], squares[place - 1]
        place -= 1
    slots[place], squares[place] = leaf >> 1, square
    if count + 1 >= query.k:
        limit = min(limit, squares[query.k - 1] * FARTHER + 2.0 * LEAST_SQUARE)
    return count + 1, limit


@lean_kernel
def nearest_bounds(tree, query, slots, squares):
    """Write the boxes whose bounds are nearest, nearest first, and the squares of how far those
    are, see `Bounds`. Return how many there are, and, if they are k or more, the least such square
    of others. Bounds may be within `reach` where the box is not.
    """
    bounds = Bounds(slots, squares, stack_array(1, np.float64))
    bounds.left_out[0] = np.inf
    limit, nodes = pruning_limit(query.reach), query.box.moving.nodes
    count, limit = visit_nearest(
        tree, nodes, tree.state[ROOT], query, bounds, limit, _square, _look_at_bounds
    )
    while count > query.k and squares[count - 1] > limit:
        count -= 1
    return count, min(bounds.left_out[0], limit)


@inlined
def _keep(tree, query, slot, best, count, limit):
    """Put a box among the best, if its distance is within reach: (count, limit, distance)."""
    here, moving = query.box, query.box.moving
    box = box_of(tree, moving, slot)
    when = moment_of(box, here.at, moving.left), moving.nanoseconds
    apart = distance_at(box, here.lo, here.hi, when)
    count, limit = keep_if_near(tree, query, slot, apart, best, count, limit)
    return count, limit, apart


@inlined
def _look_at(tree, query, leaf, square, best, count, limit):
    count, limit, _ = _keep(tree, query, leaf >> 1, best, count, limit)
    return count, limit


@lean_kernel
def _nearest_of_all(tree, query, limit, found, distances):
    """Write slots and distances of the nearest boxes within a limit; return how many there are."""
    nodes, best = query.box.moving.nodes, Best(found, distances)
    return visit_nearest(tree, nodes, tree.state[ROOT], query, best, limit, _square, _look_at)[0]


@inlined
def _decide(tree, query, candidates, left_out, found, distances):
    """Write handles and distances of the nearest boxes, padded with NONE and inf, given what
    `nearest_bounds` returned, and wrote to `found`. Return how many there are.
    """
    best, count, limit, farthest = Best(found, distances), np.int64(0), np.inf, 0.0
    for i in range(candidates):
        fetch_box(tree, query.box.moving, found[i])
    for i in range(candidates):
        count, limit, apart = _keep(tree, query, found[i], best, count, limit)
        farthest = max(farthest, apart)
    if candidates == query.k and not farthest < at_least(left_out):
        limit = pruning_limit(min(query.reach, farthest))
        count = _nearest_of_all(tree, query, limit, found, distances)
    name_row(tree.handles, found, distances, count)
    return count


@inlined
def at_least(square):
    """A distance, rounded down, from its computed square."""
    return 0.0 if square < LEAST_SQUARE else math.sqrt(min(square, MOST_SQUARE)) * LESS


@lean_kernel
def _nearest(tree, query, found, distances):
    """`query.nearest.nearest_one` at a time, once the query is begun."""
    box = query.box
    if not is_sound(box.lo, box.hi, box.lo, (box.at, 0.0)):
        return np.int64(NOT_FINITE)
    if covers(box.moving, box.at, 0.0, 0.0) == 0:
        return np.int64(OUTSIDE)
    candidates, left_out = nearest_bounds(tree, query, found, distances)
    return _decide(tree, query, candidates, left_out, found, distances)


@lean_kernel
def nearest_one(tree, moving, at, low, high, k, reach, mask, found, distances):
    """`query.nearest.nearest_one` at a time; OUTSIDE if the bounds do not hold for it."""
    why = begin_asking(tree, moving, 1)
    if why != 0:
        return why
    query = near_at(moving, at, low, high, k, reach, mask)
    count = _nearest(tree, query, found, distances)
    end_query(tree.state)
    return np.int64(count)


# ---- many points


@inlined
def _query_of(points, row, moving, at):
    point, reach, mask = points.points[row], of_row(points.reaches, row), of_row(points.masks, row)
    return near_at(moving, of_row(at, row), point, point, points.k, reach, mask)


@lean_kernel
def nearest_rows(tree, moving, at, points, found, distances):
    """`query.nearest.nearest_rows` at times, one for all or one a row."""
    why = begin_asking(tree, moving, points.points.shape[0])
    if why != 0:
        return why
    for i in range(points.points.shape[0]):
        row = points.order[i] if points.order.shape[0] > 0 else i
        query = _query_of(points, row, moving, at)
        why = min(_nearest(tree, query, found[row], distances[row]), np.int64(0))
        if why < 0:
            break
    end_query(tree.state)
    return why


@inlined
def _squares(nodes, node, packet, at):
    fetch_children(nodes, node)
    moving_squares8(nodes, node, packet.points, packet.both, at)


@inlined
def _look_at_row(tree, points, row, lane, leaf, square, best, count, limit):
    bounds = Bounds(best.slots[row], best.squares[row], best.left_out[lane : lane + 1])
    return _look_at_bounds(tree, points, leaf, square, bounds, count, limit)


@inlined
def _load_times(moving, at, rows, packet):
    """Fill in the times of a packet: 0; UNBOUNDED if no bounds can hold for one of them; or why
    not.
    """
    done = np.int64(0)
    for lane in range(EIGHT):
        time = of_row(at, rows[min(lane, rows.shape[0] - 1)])
        covered = covers(moving, time, 0.0, 0.0)
        if covered == 0:
            return np.int64(OUTSIDE)
        if not math.isfinite(time):
            return np.int64(NOT_FINITE)
        if covered < 0:
            done = np.int64(UNBOUNDED)
        packet.points[WHEN * EIGHT + lane] = time - moving.start
    return done


@inlined
def _bound_packet(tree, moving, at, points, rows, packet, best):
    """Write `nearest_bounds` of eight rows to `best` and to the packet's counts, if `_load_times`
    returns 0; return that.
    """
    mask = load(points, rows, packet)
    why = _load_times(moving, at, rows, packet)
    best.left_out[:] = np.inf
    if why == 0:
        visit_packet(tree, moving.nodes, points, rows, mask, packet, best, _squares, _look_at_row)
    for lane in range(EIGHT):
        best.left_out[lane] = min(best.left_out[lane], packet.limits[lane])
    return why


@lean_kernel
def nearest_packets(tree, moving, at, points, found, distances):
    """`nearest_rows` of finite points, eight rows of `order` at a time; by distances alone if no
    bounds can hold for one of the eight times.
    """
    why = begin_asking(tree, moving, points.order.shape[0])
    if why != 0:
        return why
    packet, best = no_packet(), Bounds(found, distances, stack_array(EIGHT, np.float64))
    for first in range(0, points.order.shape[0], EIGHT):
        rows = points.order[first : first + EIGHT]
        why = _bound_packet(tree, moving, at, points, rows, packet, best)
        if why < 0:
            break
        for lane in range(rows.shape[0]):
            for i in range(packet.counts[lane] if why == 0 else 0):
                fetch_box(tree, moving, found[rows[lane], i])
        for lane in range(rows.shape[0]):
            row, boxes, left_out = rows[lane], packet.counts[lane], best.left_out[lane]
            query = _query_of(points, row, moving, at)
            if why == 0:
                _decide(tree, query, boxes, left_out, found[row], distances[row])
            else:
                limit = pruning_limit(query.reach)
                count = _nearest_of_all(tree, query, limit, found[row], distances[row])
                name_row(tree.handles, found[row], distances[row], count)
    end_query(tree.state)
    return min(why, np.int64(0))


@lean_kernel
def bound_packets(tree, moving, at, points, bounded, squares):
    """Write `nearest_bounds` of such rows to `bounded` and `squares`, (n, k): 0, or why not."""
    why = begin_asking(tree, moving, points.order.shape[0])
    if why != 0:
        return why
    packet = no_packet()
    best = Bounds(bounded.slots, squares, stack_array(EIGHT, np.float64))
    for first in range(0, points.order.shape[0], EIGHT):
        rows = points.order[first : first + EIGHT]
        why = _bound_packet(tree, moving, at, points, rows, packet, best)
        if why != 0:
            why = np.int64(NOT_FINITE if why == UNBOUNDED else why)
            break
        for lane in range(rows.shape[0]):
            bounded.counts[rows[lane]] = packet.counts[lane]
            bounded.left_out[rows[lane]] = best.left_out[lane]
    end_query(tree.state)
    return why


_ROW, _ROWS, _IDS = np.empty(0), np.empty((0, 3)), np.empty((0, 1), np.int64)
_BOUNDED = Bounded(_IDS, np.empty(0, np.int64), _ROW)
one_entry = entry_points(
    *(nearest_one, no_motion, 0.0, _ROW, _ROW, 1, 0.0, np.uint32(0)),
    *(np.empty(0, np.int64), _ROW),
)
rows_entry = entry_points(nearest_rows, no_motion, _ROW, NO_POINTS, _IDS, _ROWS)
packets_entry = entry_points(nearest_packets, no_motion, _ROW, NO_POINTS, _IDS, _ROWS)
bounds_entry = entry_points(bound_packets, no_motion, _ROW, NO_POINTS, _BOUNDED, _ROWS)
