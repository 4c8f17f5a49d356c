# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Is the tree what it must be? Structure (links, counts, free lists) and metrics (boxes, masks,
heights) are checked apart.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiler import kernel
from .nodes import (
    COUNT,
    EXACT_RAYS,
    FREE_INNER,
    FREE_LEAF,
    LAST_SERIAL,
    NONE,
    RAYS,
    ROOT,
    SLOT_BITS,
    SLOT_MASK,
    STATE_PLACES,
    Tree,
    box_dtype,
    height_limit,
    is_leaf,
    node_dtype,
)

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
    14: 'a free slot has a handle',
    15: 'two handles have one serial number',
}


def array_forms(ndim: int, capacity: int, fat: bool) -> dict[str, tuple[Any, tuple[int, ...]]]:
    """Type and shape of each array of a tree; `fat`: exact boxes are kept beside the nodes."""
    return {
        'nodes': (node_dtype(ndim), (2 * capacity,)),
        'heights': (np.dtype(np.int16), (2 * capacity,)),
        'tight': (box_dtype(ndim), (capacity if fat else 0,)),
        'handles': (np.dtype(np.int64), (capacity,)),
        'state': (np.dtype(np.int64), (STATE_PLACES,)),
    }


def complaint_about(ndim: int, margin: float, serial: int, arrays: Tree) -> str | None:
    """What is broken about a tree of these arrays, whose next serial number is `serial`; None if
    it is sound.

    Nothing is read before it is known to be there: the arrays' forms first, then links, each
    looked at before it is followed, and only then what hangs on them.
    """
    complaint = _look_at_forms(ndim, margin, arrays)
    if complaint:
        return complaint
    if not 1 <= serial <= LAST_SERIAL + 1:
        return f'the next serial number is {serial}'
    kind, node = check_structure(arrays.nodes, arrays.handles, arrays.state)
    if kind == SOUND:
        kind, node = check_metrics(arrays.nodes, arrays.heights, arrays.tight, arrays.state)
    if kind == SOUND:
        kind, node = _check_serials(arrays.handles, serial)
    return None if kind == SOUND else f'{COMPLAINTS[kind]} (node {node})'


def _look_at_forms(ndim: int, margin: float, arrays: Tree) -> str | None:
    tight, state, capacity = arrays.tight, arrays.state, len(arrays.handles)
    if not 1 <= capacity <= SLOT_MASK + 1:
        return f'there is room for {capacity} boxes, which is not from 1 to {SLOT_MASK + 1}'
    if margin > 0.0 and not len(tight):
        return 'the exact boxes are missing, which a tree with a margin has'
    forms = array_forms(ndim, capacity, bool(len(tight)))
    each: tuple[NDArray[Any], ...] = arrays
    for (name, (dtype, shape)), array in zip(forms.items(), each, strict=True):
        if array.dtype != dtype or array.shape != shape:
            return (
                f'the {name} must be {dtype} of shape {shape}, '
                f'not {array.dtype} of shape {array.shape}'
            )
        if not array.flags.carray or array.ctypes.data % 8:
            return f'the {name} do not lie in memory as kernels read them'
    if state[RAYS] < 0 or state[EXACT_RAYS] < 0:
        return 'a number of rays is negative'
    return None


def _check_serials(handles: Any, serial: int) -> tuple[int, int]:
    """Return (complaint, node); SOUND if every live handle was given, and once."""
    slots = np.flatnonzero(handles >= 0)
    serials = handles[slots] >> SLOT_BITS
    order = np.argsort(serials)
    slots, serials = slots[order], serials[order]
    if len(serials) and not (serials[0] > 0 and serials[-1] < serial):
        return FUTURE_HANDLE, 2 * int(slots[-1 if serials[0] > 0 else 0])
    twice = np.flatnonzero(serials[1:] == serials[:-1])
    return (15, 2 * int(slots[twice[0]])) if len(twice) else (SOUND, NONE)


@kernel
def check_structure(nodes, handles, state):
    """Return (complaint, node); SOUND if links, counts, depth and free lists are right: then no
    traversal leaves the arrays or its stack.
    """
    visited, deepest = np.zeros(nodes.shape[0], np.bool_), height_limit(state[COUNT])
    stack, top, leaves = np.empty(nodes.shape[0] + 1, np.int64), 0, 0
    depths = np.empty(nodes.shape[0] + 1, np.int16)
    if state[ROOT] != NONE:
        stack[0], depths[0], top = state[ROOT], 0, 1
        if not 0 <= state[ROOT] < nodes.shape[0]:
            return 4, state[ROOT]
        if nodes[state[ROOT]].parent != NONE:
            return 1, state[ROOT]
    while top > 0:
        top -= 1
        node, depth = stack[top], depths[top]
        if node < 0 or node >= nodes.shape[0] or visited[node]:
            return 4, node
        if depth > deepest:
            return 11, node
        visited[node] = True
        if is_leaf(node):
            leaves += 1
            if handles[node >> 1] < 0 or handles[node >> 1] & SLOT_MASK != node >> 1:
                return 3, node
            continue
        for child in (np.int64(nodes[node].left), np.int64(nodes[node].right)):
            if child < 0 or child >= nodes.shape[0] or nodes[child].parent != node:
                return 2, node
            stack[top], depths[top] = child, depth + 1
            top += 1
    if leaves != state[COUNT]:
        return 5, state[ROOT]
    for slot in range(handles.shape[0]):
        if handles[slot] != NONE and not visited[2 * slot]:
            return 14, 2 * slot
    free = 0
    for inner_ones, node in enumerate((state[FREE_LEAF], state[FREE_INNER])):
        while node != NONE:
            if node < 0 or node >= nodes.shape[0] or visited[node] or node & 1 != inner_ones:
                return 6, node
            visited[node] = True
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
