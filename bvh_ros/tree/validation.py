# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Is the tree what it must be? Structure (links, counts, free lists) and metrics (boxes, masks,
heights) are checked apart.
"""

import numpy as np

from .building import height_limit
from .compiling import kernel
from .nodes import COUNT, FREE_INNER, FREE_LEAF, NONE, ROOT, SLOT_MASK, is_leaf

SOUND = 0
FUTURE_HANDLE = 13
COMPLAINTS = {
    1: 'the root has a parent',
    2: 'a child does not name its parent',
    3: 'a leaf has no live handle of its slot',
    4: 'a node is reached twice or lies outside the storage',
    5: 'the number of leaves reached is not the number of boxes',
    6: 'a free list does not hold exactly the free places',
    7: 'a box is not the union of its children',
    8: 'a mask is not the union of its children',
    9: 'a height is not one more than the higher child',
    10: 'a fat box does not contain the exact box',
    11: 'the tree is higher than 4 log2(n) + 4',
    12: 'a box is not finite, or its lo exceeds its hi',
    FUTURE_HANDLE: 'a leaf has a handle that was never given',
}


@kernel
def check_structure(nodes, handles, state):
    """Return (complaint, node); SOUND if links, counts and free lists are right."""
    seen = np.zeros(nodes.shape[0], np.bool_)
    stack, top, leaves = np.empty(nodes.shape[0] + 1, np.int64), 0, 0
    if state[ROOT] != NONE:
        stack[0], top = state[ROOT], 1
        if not 0 <= state[ROOT] < nodes.shape[0]:
            return 4, state[ROOT]
        if nodes[state[ROOT]].parent != NONE:
            return 1, state[ROOT]
    while top > 0:
        top -= 1
        node = stack[top]
        if node < 0 or node >= nodes.shape[0] or seen[node]:
            return 4, node
        seen[node] = True
        if is_leaf(node):
            leaves += 1
            if handles[node >> 1] < 0 or handles[node >> 1] & SLOT_MASK != node >> 1:
                return 3, node
            continue
        for child in (np.int64(nodes[node].left), np.int64(nodes[node].right)):
            if child < 0 or child >= nodes.shape[0] or nodes[child].parent != node:
                return 2, node
            stack[top] = child
            top += 1
    if leaves != state[COUNT]:
        return 5, state[ROOT]
    free = 0
    for head in (state[FREE_LEAF], state[FREE_INNER]):
        node = head
        while node != NONE:
            if node < 0 or node >= nodes.shape[0] or seen[node]:
                return 6, node
            seen[node] = True
            free += 1
            node = np.int64(nodes[node].parent)
    inner = max(leaves - 1, 0)
    return (SOUND, NONE) if free + leaves + inner == nodes.shape[0] else (6, NONE)


@kernel
def check_metrics(nodes, heights, tight, state):
    """Return (complaint, node); SOUND if boxes, masks and heights are those of the children. The
    structure must be sound.
    """
    if state[ROOT] == NONE:
        return SOUND, NONE
    if heights[state[ROOT]] > height_limit(state[COUNT]):
        return 11, state[ROOT]
    stack, top = np.empty(nodes.shape[0] + 1, np.int64), 1
    stack[0] = state[ROOT]
    while top > 0:
        top -= 1
        node = stack[top]
        here = nodes[node]
        if is_leaf(node):
            if heights[node] != 0:
                return 9, node
            for axis in range(here.lo.shape[0]):
                if not (-np.inf < here.lo[axis] <= here.hi[axis] < np.inf):
                    return 12, node
            if tight.shape[0] > 0:
                box = tight[node >> 1]
                for axis in range(here.lo.shape[0]):
                    if not (here.lo[axis] <= box.lo[axis] <= box.hi[axis] <= here.hi[axis]):
                        return 10, node
            continue
        left, right = nodes[here.left], nodes[here.right]
        for axis in range(here.lo.shape[0]):
            if here.lo[axis] != min(left.lo[axis], right.lo[axis]) or here.hi[axis] != max(
                left.hi[axis], right.hi[axis]
            ):
                return 7, node
        if here.mask != left.mask | right.mask:
            return 8, node
        if heights[node] != 1 + max(heights[here.left], heights[here.right]):
            return 9, node
        stack[top], stack[top + 1] = here.left, here.right
        top += 2
    return SOUND, NONE
