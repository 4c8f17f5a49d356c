# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a box touches at some time: what it meets where it goes nowhere."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..boxes.overlapping import FIRST, fill_rows
from ..compiler import inlined, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import DEEPEST, NONE, ROOT, is_leaf
from ..query.ray import of_row
from ..query.slab import RAY_ROWS, set_swept_box
from ..simd.moving_sides import FRONTS, is_behind, is_beside
from ..store.turns import NOT_FINITE, end_query
from .bounds import OUTSIDE, begin_asking, covers, fetch_children, may_ask, no_motion, set_fronts
from .entries import is_sound
from .exact_contact import box_of, course_of, elapsed, meet, moment_of, surely_below


class QueriesThen(NamedTuple):
    """As `boxes.overlapping.Queries`, and when."""

    lo: NDArray[np.float64]
    hi: NDArray[np.float64]
    masks: NDArray[np.uint32]
    at: NDArray[np.float64]
    """s, a time a box, or one for all."""


@lean_kernel
def touches_then(box, low, high, at, moving):
    """Whether a box that moves touches the one from low to high at a time: exactly."""
    lo, hi, velocity, reference = box
    at = moment_of(box, at, moving.left)
    since, _ = elapsed(at, reference, moving.nanoseconds)
    clear, nowhere = True, stack_array(3, np.float64)
    for axis in range(lo.shape[0]):
        way, nowhere[axis] = velocity[axis] * since, 0.0
        if surely_below(high[axis], lo[axis], -way) or surely_below(hi[axis], low[axis], way):
            return False
        clear &= surely_below(lo[axis], high[axis], way)
        clear &= surely_below(low[axis], hi[axis], -way)
    if clear:
        return True
    course = course_of(stack_array((RAY_ROWS, 3), np.float64), at, 0.0, moving)
    set_swept_box(course.ray, low, high, nowhere)
    return meet(box, course, 0.0)[0]


@lean_kernel
def overlap_then(tree, moving, box, mask, found, count):
    """As `boxes.overlapping.overlap`, box = (lo, hi, at)."""
    (lo, hi, at), nodes, root = box, moving.nodes, tree.state[ROOT]
    if root == NONE:
        return np.int64(count)
    bounded, ahead = covers(moving, at, 0.0, 0.0) > 0, at - moving.start
    stack, fronts = stack_array(DEEPEST, np.int64), stack_array(FRONTS, np.float64)
    set_fronts(fronts, moving, lo, hi, lo)
    stack[0], top = root, 1
    if nodes[root].mask & mask == 0 or (bounded and is_beside(nodes, root, fronts, ahead)):
        top = 0
    while top > 0:
        top -= 1
        node = stack[top]
        if is_leaf(node):
            touches = bounded and is_behind(nodes, node, fronts, ahead, nodes[node].loose)
            if not touches:
                there = box_of(tree, moving, node >> 1)
                touches = touches_then(there, lo, hi, at, moving)
            if touches:
                if count < found.shape[0]:
                    found[count] = node >> 1
                count += 1
            continue
        left, right = np.int64(nodes[node].left), np.int64(nodes[node].right)
        for child in (left, right):
            met = nodes[child].mask & mask != 0
            if met and not (bounded and is_beside(nodes, child, fronts, ahead)):
                fetch_children(nodes, child)
                stack[top] = child
                top += 1
    return np.int64(count)


@lean_kernel
def overlap_one(tree, moving, box, mask, at, slots):
    """Handles, in no order, of what the box = (lo, hi) touches, to `slots`: how many, of which as
    many are written as there is room for; NOT_FINITE if it is no box, OUTSIDE, or REFUSED.
    """
    lo, hi = box
    if not is_sound(lo, hi, lo, (at, 0.0)):
        return np.int64(NOT_FINITE)
    if covers(moving, at, 0.0, 0.0) == 0:
        return np.int64(OUTSIDE)
    why = begin_asking(tree, moving, 1)
    if why != 0:
        return why
    count = overlap_then(tree, moving, (lo, hi, at), mask, slots, 0)
    for i in range(min(count, slots.shape[0])):
        slots[i] = tree.handles[slots[i]]
    end_query(tree.state)
    return count


@inlined
def _look(tree, asked, row, found, count):
    queries, moving = asked
    box = queries.lo[row], queries.hi[row], of_row(queries.at, row)
    return overlap_then(tree, moving, box, of_row(queries.masks, row), found, count)


@lean_kernel
def overlap_rows(tree, moving, queries, start, stop, found, offsets):
    """`boxes.overlapping.fill_rows`. From FIRST on the questions are counted, and bounds hold for
    all times for which they can: else OUTSIDE; NOT_FINITE where a time is not, either.
    """
    if start == FIRST:
        why = may_ask(tree, moving, queries.at, queries.lo.shape[0])
        if why != 0:
            return why, np.int64(0), np.int64(0)
    asked = queries, moving
    return fill_rows(tree, moving.version, asked, start, stop, found, offsets, _look)


_ROW, _ROWS, _IDS = np.empty(0), np.empty((0, 3)), np.empty(0, np.int64)
_QUERIES = QueriesThen(_ROWS, _ROWS, np.empty(0, np.uint32), _ROW)
one_entry = entry_points(overlap_one, no_motion, (_ROW, _ROW), np.uint32(0), 0.0, _IDS)
rows_entry = entry_points(overlap_rows, no_motion, _QUERIES, 0, 0, _IDS, _IDS)
