# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a box touches at some time: what it meets where it goes nowhere."""

import numpy as np

from ..entries import entry_points
from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import stack_array
from ..jit.moving_sides import is_beside
from ..nodes import DEEPEST, NONE, ROOT, is_leaf
from ..rays.slab import DIRECTION, ORIGIN, RAY_ROWS, UPPER, set_swept_box
from ..store.turns import NOT_FINITE, REFUSED, begin_query, end_query
from .bounds import FRONTS, covers, set_fronts
from .casting import OUTSIDE, is_sound, no_motion
from .meeting import Course, box_of, meet
from .sums import surely_below


@inlined
def touches_then(box, course):
    """Whether a course that goes nowhere touches a box that moves: exactly."""
    lo, hi, velocity, reference = box
    clear = True
    for axis in range(lo.shape[0]):
        way = velocity[axis] * (course.at - reference)
        low, high = course.ray[ORIGIN, axis], course.ray[UPPER, axis]
        if surely_below(high, lo[axis], -way) or surely_below(hi[axis], low, way):
            return False
        clear &= surely_below(lo[axis], high, way) and surely_below(low, hi[axis], -way)
    return clear or meet(box, course, 0.0)[0]


@lean_kernel
def overlap_then(tree, moving, course, mask, slots):
    """Write the slots, in no order, of what a course touches that goes nowhere, while no time
    passes; return how many, of which as many are written as there is room for.
    """
    nodes, root, ahead = moving.nodes, tree.state[ROOT], course.at - moving.start
    if root == NONE:
        return np.int64(0)
    bounded, count = covers(moving, course.at, 0.0, 0.0) > 0, np.int64(0)
    stack, fronts = stack_array(DEEPEST, np.int64), stack_array(FRONTS, np.float64)
    set_fronts(fronts, moving, course.ray[ORIGIN], course.ray[UPPER], course.ray[DIRECTION])
    stack[0], top = root, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if nodes[node].mask & mask == 0 or (bounded and is_beside(nodes, node, fronts, ahead)):
            continue
        if not is_leaf(node):
            stack[top], stack[top + 1] = nodes[node].left, nodes[node].right
            top += 2
            continue
        hit = touches_then(box_of(tree, moving, node >> 1), course)
        if hit and count < slots.shape[0]:
            slots[count] = node >> 1
        count += hit
    return np.int64(count)


@lean_kernel
def overlap_one(tree, moving, box, mask, at, slots):
    """Handles, in no order, of what the box = (lo, hi, nowhere) touches, to `slots`: how many, of
    which as many are written as there is room for; NOT_FINITE if it is no box, OUTSIDE, or
    REFUSED.
    """
    lo, hi, nowhere = box
    if not is_sound(lo, hi, nowhere, (at, 0.0)):
        return np.int64(NOT_FINITE)
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    if covers(moving, at, 0.0, 0.0) == 0:
        end_query(tree.state)
        return np.int64(OUTSIDE)
    course = Course(stack_array((RAY_ROWS, 3), np.float64), at, 0.0)
    set_swept_box(course.ray, lo, hi, nowhere)
    count = overlap_then(tree, moving, course, mask, slots)
    for i in range(min(count, slots.shape[0])):
        slots[i] = tree.handles[slots[i]]
    end_query(tree.state)
    return count


_ROW, _IDS = np.empty(0), np.empty(0, np.int64)
one_entry = entry_points(overlap_one, no_motion, (_ROW,) * 3, np.uint32(0), 0.0, _IDS)
