# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes against the tree, and the tree against itself. Closed boxes: touching counts. Comparisons
of doubles, so all of it is exact.
"""

import numpy as np

from .compiling import inlined, kernel, lean_kernel
from .machine import stack_array
from .nodes import DEEPEST, NONE, is_leaf, leaf_box

PAIR_STACK = 8 * DEEPEST  # two nodes a pair, and at most two pairs a level of either tree


@kernel
def grown(array, need):
    """A copy with room for `need` items at least, and twice as many as before."""
    bigger = np.empty(max(2 * array.shape[0], need), array.dtype)
    bigger[: array.shape[0]] = array
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


@lean_kernel
def overlap_pairs(nodes, heights, tight, root, mask, found):
    """Write all pairs of touching boxes as slots, flat: the tree against itself, two nodes at a
    time; return how many numbers.

    As `overlap`, a return beyond the array's end says how large it should have been.
    """
    count = 0
    if root == NONE:
        return count
    stack = stack_array(PAIR_STACK, np.int64)
    stack[0], stack[1], top = root, root, 2
    while top > 0:
        top -= 2
        a, b = stack[top], stack[top + 1]
        if nodes[a].mask & mask == 0 or nodes[b].mask & mask == 0:
            continue
        if a == b:
            if not is_leaf(a):
                left, right = np.int64(nodes[a].left), np.int64(nodes[a].right)
                stack[top], stack[top + 1], stack[top + 2] = left, right, left
                stack[top + 3], stack[top + 4], stack[top + 5] = left, right, right
                top += 6
            continue
        if not touch(nodes[a].lo, nodes[a].hi, nodes[b].lo, nodes[b].hi):
            continue
        if heights[a] < heights[b]:
            a, b = b, a
        if not is_leaf(a):
            stack[top], stack[top + 1], stack[top + 2], stack[top + 3] = (
                nodes[a].left,
                b,
                nodes[a].right,
                b,
            )
            top += 4
            continue
        a_lo, a_hi = leaf_box(nodes, tight, a)
        b_lo, b_hi = leaf_box(nodes, tight, b)
        if touch(a_lo, a_hi, b_lo, b_hi):
            if count + 2 <= found.shape[0]:
                found[count], found[count + 1] = a >> 1, b >> 1
            count += 2
    return count
