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
from ..entries import entry_points
from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import stack_array
from ..jit.moving_sides import square_beside
from ..nodes import DEEPEST, ROOT, is_leaf
from ..store.turns import NOT_FINITE, REFUSED, begin_query, end_query
from .bounds import FRONTS, covers, set_fronts
from .casting import OUTSIDE, is_sound, no_motion
from .meeting import box_of
from .sums import gap, surely_below

# Squares whose root says something, and by how much it is rounded down.
LEAST_SQUARE, MOST_SQUARE, LESS = 1e-290, 1e308, 1.0 - 2.0**-49


class Near(NamedTuple):
    """What is asked for."""

    points: NDArray[np.float64]
    """Shape (n, ndim)."""
    reaches: NDArray[np.float64]
    """The largest distance, a row, as of the masks."""
    masks: NDArray[np.uint32]
    at: NDArray[np.float64]
    """A time a row."""
    k: int


@inlined
def _apart_then(box, axis, low, high, at):
    """How far a box is from the one from low to high on an axis, 0 where they touch; inf where
    that exceeds the largest double.
    """
    lo, hi, velocity, reference = box
    way = velocity[axis] * (at - reference)
    below, above = (lo[axis] - high[axis]) + way, (low[axis] - hi[axis]) - way
    # One side tells it, as the other is surely passed; a choice costs less than a guess.
    lower = below > above
    plane, front = (lo[axis], high[axis]) if lower else (hi[axis], low[axis])
    apart = _gap_now(plane, front, velocity[axis], at, reference)
    apart = apart if lower else -apart
    plane, front, way = (low[axis], hi[axis], -way) if lower else (lo[axis], high[axis], way)
    if not surely_below(plane, front, way):
        below = _gap_now(lo[axis], high[axis], velocity[axis], at, reference)
        apart = max(below, -_gap_now(hi[axis], low[axis], velocity[axis], at, reference))
    return max(apart, 0.0)


@inlined
def _gap_now(plane, front, velocity, at, reference):
    """As a double; inf where it exceeds the largest."""
    high, _, exponent = gap(plane, front, velocity, at, reference)
    return high if exponent == 0 else math.ldexp(high, exponent)


@lean_kernel
def distance_then(box, low, high, at):
    """Distance of a box at a time from the one from low to high, 0 where they touch."""
    longest, total, ndim = 0.0, 0.0, box[0].shape[0]
    for axis in range(ndim):
        apart = _apart_then(box, axis, low, high, at)
        longest = max(longest, apart)
        total += apart * apart
    if 1e-140 < longest < 1e140 or longest == 0.0 or math.isinf(longest):
        return math.sqrt(total)
    exponent = math.frexp(longest)[1]  # as in `boxes.nearest.distance`
    total = 0.0
    for axis in range(ndim):
        apart = math.ldexp(_apart_then(box, axis, low, high, at), -exponent)
        total += apart * apart
    return math.ldexp(math.sqrt(total), exponent)


@lean_kernel
def nearest_then(tree, moving, near, exact, found, distances):
    """Write handles of the nearest, near = (low, high, at, k, reach, mask), and distances, to
    arrays (k,), nearest first; return how many there are. NOT_FINITE if it is no box or time,
    OUTSIDE if the bounds do not hold for the time. Where `exact` is None, what is told of a box
    is how far it is at least.
    """
    low, high, at, k, reach, mask = near
    nodes, root = moving.nodes, tree.state[ROOT]
    if not is_sound(low, high, low, (at, 0.0)):
        return np.int64(NOT_FINITE)
    bounded = covers(moving, at, 0.0, 0.0)
    if bounded == 0:
        return np.int64(OUTSIDE)
    stack, squares = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64)
    stack[0], squares[0], top = root, 0.0, (0 if root < 0 else 1)
    count, limit, ahead = np.int64(0), pruning_limit(reach), at - moving.start
    fronts = stack_array(FRONTS, np.float64)
    set_fronts(fronts, moving, low, high, low)
    while top > 0:
        top -= 1
        node = stack[top]
        if squares[top] > limit or nodes[node].mask & mask == 0:
            continue
        square = squares[top]
        while not is_leaf(node):
            first, second = np.int64(nodes[node].left), np.int64(nodes[node].right)
            square, other = 0.0, 0.0
            if bounded > 0:
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
        if not is_leaf(node) or nodes[node].mask & mask == 0:
            continue
        if exact is None:
            apart = _at_least(square)
        else:
            apart = distance_then(box_of(tree, moving, node >> 1), low, high, at)
        if apart <= reach:
            count = insert_candidate(*(found, distances, tree.handles, count, k, node >> 1, apart))
            if count == k:
                limit = pruning_limit(distances[k - 1])
    name_row(tree.handles, found, distances, count)
    return count


@inlined
def _at_least(square):
    """A distance, rounded down, from its computed square."""
    return 0.0 if square < LEAST_SQUARE else math.sqrt(min(square, MOST_SQUARE)) * LESS


@lean_kernel
def nearest_one(tree, moving, near, found, distances):
    """`nearest_then`; REFUSED if the tree is of another version."""
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    count = nearest_then(tree, moving, near, True, found, distances)
    end_query(tree.state)
    return np.int64(count)


@lean_kernel
def nearest_rows(tree, moving, rows, found, distances):
    """Row by row, to `found` and `distances`, (n, k), padded with NONE and inf: 0, or why not."""
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    why = np.int64(0)
    for i in range(rows.points.shape[0]):
        point = rows.points[i]
        near = point, point, rows.at[i], rows.k, rows.reaches[i], rows.masks[i]
        why = min(nearest_then(tree, moving, near, True, found[i], distances[i]), np.int64(0))
        if why < 0:
            break
    end_query(tree.state)
    return why


_ROW, _ROWS, _IDS = np.empty(0), np.empty((0, 3)), np.empty(0, np.int64)
one_entry = entry_points(
    *(nearest_one, no_motion, (_ROW, _ROW, 0.0, 1, 0.0, np.uint32(0)), _IDS, _ROW)
)
rows_entry = entry_points(
    *(nearest_rows, no_motion, Near(_ROWS, _ROW, np.empty(0, np.uint32), _ROW, 1)),
    *(np.empty((0, 1), np.int64), _ROWS),
)
