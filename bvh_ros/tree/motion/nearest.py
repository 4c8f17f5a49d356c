# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The k boxes nearest to a point or box at some time: `boxes.nearest` with bounds that move.

Gaps are within a rounding of the exact ones (see `sums`), so distances are as good as those of
boxes at rest. They decide, ties by the smaller handle.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..boxes.nearest import insert_candidate, name_row, pruning_limit
from ..compiler import inlined, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import DEEPEST, ROOT, is_leaf
from ..query.ray import of_row
from ..simd.moving_sides import FRONTS, square_beside
from ..store.turns import NOT_FINITE, end_query
from .bounds import OUTSIDE, begin_asking, covers, fetch_children, no_motion, set_fronts
from .entries import is_sound
from .exact_contact import box_of, elapsed, fetch_box, gap, moment_of, quick_gap, surely_below

# Squares whose root says something, and by how much it is rounded down.
LEAST_SQUARE, MOST_SQUARE, LESS = 1e-290, 1e308, 1.0 - 2.0**-49
# What is farther by this factor is left out: more than a box's distance differs from its bounds'.
FARTHER = 1.0 + 2.0**-28


class Near(NamedTuple):
    """What is asked for."""

    points: NDArray[np.float64]
    """Shape (n, ndim)."""
    reaches: NDArray[np.float64]
    """The largest distance, a row or one for all, as of masks and times."""
    masks: NDArray[np.uint32]
    at: NDArray[np.float64]
    k: int
    order: NDArray[np.int64]
    """In which rows are asked; as they stand where it is empty."""


@inlined
def _quick_apart(box, axis, low, high, since):
    """How far a box is from the one from low to high on an axis, 0 where they touch, in doubles,
    since = `elapsed`: (how far, whether that is enough). Without branches, so that axes become
    lanes.
    """
    (lo, hi, velocity, _), (since, lost) = box, since
    way = velocity[axis] * since
    below, above = (lo[axis] - high[axis]) + way, (low[axis] - hi[axis]) - way
    # One side tells it, as the other is surely passed; a choice costs less than a guess.
    lower = below > above
    plane, front = (lo[axis], high[axis]) if lower else (hi[axis], low[axis])
    apart, _, enough = quick_gap(plane, front, velocity[axis], since, lost)
    apart = apart if lower else -apart
    plane, front, way = (low[axis], hi[axis], -way) if lower else (lo[axis], high[axis], way)
    return max(apart, 0.0), enough & ((apart > 0.0) | surely_below(plane, front, way))


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
def distance_then(box, low, high, when):
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


@inlined
def _walk(tree, moving, near, limit, kept, keep):
    """Let keep(tree, moving, near, leaf, square, kept, count, limit) look at the leaves whose
    squared distance, computed, is within a limit, and say how many are kept, and the limit from
    then on: what it said last.
    """
    (low, high, at, _, _, mask), nodes, root = near, moving.nodes, tree.state[ROOT]
    bounded, ahead = covers(moving, at, 0.0, 0.0) > 0, at - moving.start
    stack, squares = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64)
    stack[0], squares[0], top = root, 0.0, (0 if root < 0 else 1)
    count, fronts = np.int64(0), stack_array(FRONTS, np.float64)
    set_fronts(fronts, moving, low, high, low)
    while top > 0:
        top -= 1
        node, square = stack[top], squares[top]
        if square > limit or nodes[node].mask & mask == 0:
            continue
        while not is_leaf(node):
            first, second = np.int64(nodes[node].left), np.int64(nodes[node].right)
            square, other = 0.0, 0.0
            fetch_children(nodes, first)
            fetch_children(nodes, second)
            if bounded:
                square = square_beside(nodes, first, fronts, ahead)
                other = square_beside(nodes, second, fronts, ahead)
            if other < square:
                first, second, square, other = second, first, other, square
            if other <= limit:
                stack[top], squares[top] = second, other
                top += 1
            node = first
            if square > limit or nodes[first].mask & mask == 0:
                break
        if is_leaf(node) and square <= limit and nodes[node].mask & mask != 0:
            count, limit = keep(tree, moving, near, node, square, kept, count, limit)
    return count, limit


@inlined
def keep_bound(tree, moving, near, leaf, square, kept, count, limit):
    """By what is known of all: kept = (slots, squares, [least square that is left out]). There may
    be room for more than k: then for those that are as near as the k-th, as far as bounds tell.
    """
    (slots, squares, left_out), k = kept, near[3]
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
    if count + 1 >= k:
        limit = min(limit, squares[k - 1] * FARTHER + 2.0 * LEAST_SQUARE)
    return count + 1, limit


@inlined
def _keep_distance(tree, moving, near, leaf, square, kept, count, limit):
    """By its distance: kept = (slots, distances)."""
    (slots, distances), (low, high, at, k, reach, _) = kept, near
    box = box_of(tree, moving, leaf >> 1)
    at = moment_of(box, at, moving.left)
    apart = distance_then(box, low, high, (at, moving.nanoseconds))
    if apart <= reach:
        count = insert_candidate(slots, distances, tree.handles, count, k, leaf >> 1, apart)
        if count == k:
            limit = pruning_limit(distances[k - 1])
    return count, limit


@lean_kernel
def nearest_bounds(tree, moving, near, slots, squares):
    """Write the k boxes to arrays (k,), or longer ones, whose bounds are nearest, near = (low,
    high, at, k, reach, mask), nearest first, and the squares of how far those are: (how many,
    where they are k or more the least such square of others). Bounds may be within `reach` where
    the box is not.
    """
    left_out, limit = stack_array(1, np.float64), pruning_limit(near[4])
    left_out[0] = np.inf
    kept = slots, squares, left_out
    count, limit = _walk(tree, moving, near, limit, kept, keep_bound)
    while count > near[3] and squares[count - 1] > limit:
        count -= 1
    return count, min(left_out[0], limit)


@lean_kernel
def _nearest_among_all(tree, moving, near, limit, slots, distances):
    """Write slots and distances of the nearest within a limit of their square: how many."""
    return _walk(tree, moving, near, limit, (slots, distances), _keep_distance)[0]


@lean_kernel
def nearest_then(tree, moving, near, found, distances):
    """Write handles of the nearest, near = (low, high, at, k, reach, mask), and distances, to
    arrays (k,), nearest first; return how many there are. NOT_FINITE if it is no box or time,
    OUTSIDE if the bounds do not hold for the time.

    Bounds say whose distances are worth being computed; and whether those are sure to be less than
    all others.
    """
    low, high, at, _, _, _ = near
    if not is_sound(low, high, low, (at, 0.0)):
        return np.int64(NOT_FINITE)
    if covers(moving, at, 0.0, 0.0) == 0:
        return np.int64(OUTSIDE)
    candidates, left_out = nearest_bounds(tree, moving, near, found, distances)
    return decide(tree, moving, near, (candidates, left_out), found, distances)


@inlined
def decide(tree, moving, near, bounded, found, distances):
    """`nearest_then`, from what `nearest_bounds` said and wrote."""
    (low, high, at, k, reach, _), (candidates, left_out) = near, bounded
    count, farthest = np.int64(0), 0.0
    for i in range(candidates):
        fetch_box(tree, moving, found[i])
    for i in range(candidates):
        slot = found[i]
        box = box_of(tree, moving, slot)
        then = moment_of(box, at, moving.left)
        apart = distance_then(box, low, high, (then, moving.nanoseconds))
        farthest = max(farthest, apart)
        if apart <= reach:
            count = insert_candidate(found, distances, tree.handles, count, k, slot, apart)
    if candidates == k and not farthest < at_least(left_out):
        limit = pruning_limit(min(reach, farthest))
        count = _nearest_among_all(tree, moving, near, limit, found, distances)
    name_row(tree.handles, found, distances, count)
    return count


@inlined
def at_least(square):
    """A distance, rounded down, from its computed square."""
    return 0.0 if square < LEAST_SQUARE else math.sqrt(min(square, MOST_SQUARE)) * LESS


@lean_kernel
def nearest_one(tree, moving, near, found, distances):
    """`nearest_then`; REFUSED if the tree is of another version."""
    why = begin_asking(tree, moving, 1)
    if why != 0:
        return why
    count = nearest_then(tree, moving, near, found, distances)
    end_query(tree.state)
    return np.int64(count)


@lean_kernel
def nearest_rows(tree, moving, rows, found, distances):
    """Row by row, to `found` and `distances`, (n, k), padded with NONE and inf: 0, or why not."""
    why = begin_asking(tree, moving, rows.points.shape[0])
    if why != 0:
        return why
    for row in range(rows.points.shape[0]):
        i = rows.order[row] if rows.order.shape[0] > 0 else row
        point, reach, mask = rows.points[i], of_row(rows.reaches, i), of_row(rows.masks, i)
        near = point, point, of_row(rows.at, i), rows.k, reach, mask
        why = min(nearest_then(tree, moving, near, found[i], distances[i]), np.int64(0))
        if why < 0:
            break
    end_query(tree.state)
    return why


_ROW, _ROWS, _IDS = np.empty(0), np.empty((0, 3)), np.empty(0, np.int64)
one_entry = entry_points(
    *(nearest_one, no_motion, (_ROW, _ROW, 0.0, 1, 0.0, np.uint32(0)), _IDS, _ROW)
)
NO_POINTS = Near(_ROWS, _ROW, np.empty(0, np.uint32), _ROW, 1, _IDS)
rows_entry = entry_points(nearest_rows, no_motion, NO_POINTS, np.empty((0, 1), np.int64), _ROWS)
