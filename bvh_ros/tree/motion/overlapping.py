# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a box touches at some time: what it meets where it goes nowhere."""

import numpy as np

from ..entries import entry_points
from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import stack_array
from ..nodes import DEEPEST, NONE, ROOT, is_leaf
from ..rays.slab import ORIGIN, RAY_FLOATS, RAY_ROWS, UPPER, set_swept_box
from ..store.turns import NOT_FINITE, REFUSED, begin_query, end_query
from .bounds import covers
from .casting import OUTSIDE, is_sound, no_motion
from .meeting import Course, box_of, meet


@inlined
def _is_apart(node, course, ahead):
    """Whether the bounds of a node surely do not touch what goes nowhere. What is not a number
    bounds nothing: comparisons with it are false.
    """
    largest = -np.inf
    for axis in range(node.lo.shape[0]):
        below = node.lo[axis] + node.lo_rate[axis] * ahead - course.ray[UPPER, axis]
        above = course.ray[ORIGIN, axis] - node.hi[axis] - node.hi_rate[axis] * ahead
        gap = below if below > above else above
        largest = gap if gap > largest else largest
    return largest > 0.0


@lean_kernel
def overlap_then(tree, moving, course, mask, slots):
    """Write the slots, in no order, of what a course touches that goes nowhere, while no time
    passes; return how many, of which as many are written as there is room for.
    """
    nodes, root, ahead = moving.nodes, tree.state[ROOT], course.at - moving.start
    if root == NONE:
        return np.int64(0)
    bounded, count = covers(moving, course.at, 0.0, 0.0) > 0, np.int64(0)
    stack = stack_array(DEEPEST, np.int64)
    stack[0], top = root, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if nodes[node].mask & mask == 0 or (bounded and _is_apart(nodes[node], course, ahead)):
            continue
        if not is_leaf(node):
            stack[top], stack[top + 1] = nodes[node].left, nodes[node].right
            top += 2
            continue
        hit, _, _ = meet(box_of(tree, moving, node >> 1), course, 0.0)
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
    course = Course(stack_array(RAY_FLOATS, np.float64).reshape(RAY_ROWS, 3), at, 0.0)
    set_swept_box(course.ray, lo, hi, nowhere)
    count = overlap_then(tree, moving, course, mask, slots)
    for i in range(min(count, slots.shape[0])):
        slots[i] = tree.handles[slots[i]]
    end_query(tree.state)
    return count


_ROW, _IDS = np.empty(0), np.empty(0, np.int64)
one_entry = entry_points(overlap_one, no_motion, (_ROW,) * 3, np.uint32(0), 0.0, _IDS)
