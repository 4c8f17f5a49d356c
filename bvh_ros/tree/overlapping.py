# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes against the tree. Closed boxes: touching counts. Comparisons of doubles, so all of it is
exact.
"""

import numpy as np

from .compiling import inlined, kernel, lean_kernel
from .machine import stack_array
from .nodes import DEEPEST, NONE, is_leaf, leaf_box


@kernel
def grown(array, need):
    """A copy with room for `need` items at least, and twice as many as before."""
    bigger = np.empty(max(2 * array.shape[0], need), array.dtype)
    for i in range(array.shape[0]):
        bigger[i] = array[i]
    return bigger


@inlined
def touch(lo, hi, other_lo, other_hi):
    for axis in range(lo.shape[0]):
        if lo[axis] > other_hi[axis] or other_lo[axis] > hi[axis]:
            return False
    return True


@lean_kernel
def overlap(nodes, tight, root, query, mask, found, count):
    """Write the slots whose box touches the query record's from found[count] on; return where the
    next would go.

    A return beyond the array's end says how large it should have been: what did not fit is
    counted, not written.
    """
    if root == NONE:
        return count
    stack = stack_array(DEEPEST, np.int64)
    stack[0], top = root, 1
    while top > 0:
        top -= 1
        node = stack[top]
        here = nodes[node]
        if here.mask & mask == 0 or not touch(here.lo, here.hi, query.lo, query.hi):
            continue
        if not is_leaf(node):
            stack[top], stack[top + 1] = here.right, here.left
            top += 2
            continue
        lo, hi = leaf_box(nodes, tight, node)
        if touch(lo, hi, query.lo, query.hi):
            if count < found.shape[0]:
                found[count] = node >> 1
            count += 1
    return count


@kernel
def overlap_many(nodes, tight, root, queries, masks, start, stop, sizes):
    """Slots that the queries [start, stop) touch, one query after the other; sizes[i] is how many
    query i does.
    """
    found, count = np.empty(64, np.int64), 0
    for i in range(start, stop):
        end = overlap(nodes, tight, root, queries[i], masks[i], found, count)
        if end > found.shape[0]:  # there are more than fit: make room and ask again
            found = grown(found, end)
            overlap(nodes, tight, root, queries[i], masks[i], found, count)
        sizes[i] = end - count
        count = end
    return found[:count]
