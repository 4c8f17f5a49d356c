# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes against the tree, and the tree against itself. Closed boxes: touching counts. Comparisons of doubles, so all of it is exact."""

import numpy as np

from .compiling import kernel
from .nodes import NONE, is_leaf, leaf_box


@kernel
def grown(array):
    bigger = np.empty(2 * array.shape[0], array.dtype)
    bigger[: array.shape[0]] = array
    return bigger


@kernel
def touch(lo, hi, other_lo, other_hi):
    for axis in range(lo.shape[0]):
        if lo[axis] > other_hi[axis] or other_lo[axis] > hi[axis]:
            return False
    return True


@kernel
def overlap(nodes, heights, tight, root, query, mask, found, count):
    """Append the slots whose box touches the query record's; return (found, grown if need be, and the new count)."""
    if root == NONE:
        return found, count
    stack = np.empty(np.int64(heights[root]) + 2, np.int64)
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
            if count == found.shape[0]:
                found = grown(found)
            found[count] = node >> 1
            count += 1
    return found, count


@kernel
def overlap_many(nodes, heights, tight, root, queries, masks, start, stop, sizes):
    """Slots that the queries [start, stop) touch, one query after the other; sizes[i] is how many query i does."""
    found, count = np.empty(64, np.int64), 0
    for i in range(start, stop):
        before = count
        found, count = overlap(nodes, heights, tight, root, queries[i], masks[i], found, count)
        sizes[i] = count - before
    return found[:count]


@kernel
def overlap_pairs(nodes, heights, tight, root, mask):
    """All pairs of touching boxes, as slots in a flat array: the tree against itself, two nodes at a time."""
    found, count = np.empty(64, np.int64), 0
    if root == NONE:
        return found[:0]
    stack = np.empty(8 * (np.int64(heights[root]) + 2), np.int64)
    stack[0], stack[1], top = root, root, 2
    while top > 0:
        top -= 2
        a, b = stack[top], stack[top + 1]
        if nodes[a].mask & mask == 0 or nodes[b].mask & mask == 0:
            continue
        if a == b:
            if is_leaf(a):
                continue
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
            stack[top], stack[top + 1], stack[top + 2], stack[top + 3] = nodes[a].left, b, nodes[a].right, b
            top += 4
            continue
        a_lo, a_hi = leaf_box(nodes, tight, a)
        b_lo, b_hi = leaf_box(nodes, tight, b)
        if touch(a_lo, a_hi, b_lo, b_hi):
            if count == found.shape[0]:
                found = grown(found)
            found[count], found[count + 1] = a >> 1, b >> 1
            count += 2
    return found[:count]
