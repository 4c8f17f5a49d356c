# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All pairs of touching boxes: the leaves in blocks of eight, tested one against eight at a time.

The leaves are packed in the tree's order, so those of a block are neighbours. The boxes around the
blocks are packed in blocks of eight in turn, and so on up to one: a tree of eight children a node
made in one pass for this call, of the exact boxes. It is traversed against itself, two blocks at a
time.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compiler import entry_point, inlined, lean_kernel, stack_array, trailing_zeros
from ..nodes import DEEPEST, NONE, ROOT, SLOT_BITS, entry_points, is_leaf, leaf_box, next_node
from ..simd.float64x8 import EIGHT, touching8
from ..store.turns import REFUSED, begin_query, end_query

ALL_LANES = np.uint32((1 << EIGHT) - 1)

# Two blocks and a lane an entry; every level leaves fewer than 64 entries.
_ENTRY = 3
_STACK = _ENTRY * EIGHT * EIGHT * (SLOT_BITS // 3 + 2)


@functools.cache
def block_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a block: whole cache lines."""
    rows = (ndim, EIGHT)
    return np.dtype(
        [('lo', np.float64, rows), ('hi', np.float64, rows), ('children', np.int64, (EIGHT,))]
    )


def blocks_needed(leaves: int) -> int:
    """Blocks of all levels."""
    total, level = 0, max(leaves, 1)
    while level > 1 or total == 0:
        level = -(-level // EIGHT)
        total += level
    return total


@inlined
def _place(blocks, number, lo, hi, child):
    block, lane = blocks[number // EIGHT], number % EIGHT
    for axis in range(lo.shape[0]):
        block.lo[axis, lane], block.hi[axis, lane] = lo[axis], hi[axis]
    block.children[lane] = child


@lean_kernel
def _pack_leaves(nodes, tight, root, mask, blocks):
    """Fill the blocks of the lowest level with the leaves of the mask; return how many."""
    stack, top, node, count = stack_array(DEEPEST, np.int64), 0, np.int64(root), 0
    while node != NONE:
        selected = nodes[node].mask & mask != 0
        if selected and is_leaf(node):
            lo, hi = leaf_box(nodes, tight, node)
            _place(blocks, count, lo, hi, ~(node >> 1))
            count += 1
        node, top = next_node(nodes, node, selected and not is_leaf(node), stack, top)
    return count


@lean_kernel
def _pack_above(blocks, first, last, above):
    """Fill the blocks from `above` on with the boxes around the blocks [first, last)."""
    lo, hi = stack_array(3, np.float64), stack_array(3, np.float64)
    ndim = blocks[0].lo.shape[0]
    for number in range(first, last):
        block = blocks[number]
        for axis in range(ndim):
            low, high = block.lo[axis, 0], block.hi[axis, 0]
            for lane in range(1, EIGHT):  # comparisons with the NaN of an empty lane are false
                low = block.lo[axis, lane] if block.lo[axis, lane] < low else low
                high = block.hi[axis, lane] if block.hi[axis, lane] > high else high
            lo[axis], hi[axis] = low, high
        _place(blocks, above * EIGHT + number - first, lo[:ndim], hi[:ndim], number)


@lean_kernel
def pack(tree, version, mask, blocks):
    """Fill `blocks` level by level; return the topmost block, NONE if the mask selects no box,
    REFUSED if the tree is changed meanwhile.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    first, boxes = 0, 0
    if tree.state[ROOT] != NONE:
        boxes = _pack_leaves(tree.nodes, tree.tight, tree.state[ROOT], mask, blocks)
    end_query(tree.state)
    empty = stack_array(3, np.float64)
    empty[0] = empty[1] = empty[2] = np.nan
    nothing = empty[: blocks[0].lo.shape[0]]
    while boxes > 0:
        last = first + (boxes + EIGHT - 1) // EIGHT
        for number in range(first * EIGHT + boxes, last * EIGHT):
            _place(blocks, number, nothing, nothing, NONE)
        if last == first + 1:
            return np.int64(first)
        _pack_above(blocks, first, last, last)
        first, boxes = last, last - first
    return np.int64(NONE)


@lean_kernel
def touching_pairs(blocks, root, found):
    """Write all pairs of touching boxes as slots, flat; return how many numbers.

    A return beyond the array's end says how large it should have been: what did not fit is
    counted, not written.
    """
    stack = stack_array(_STACK, np.int64)
    stack[0], stack[1], stack[2], top, count = root, root, NONE, _ENTRY, 0
    while top > 0:
        top -= _ENTRY
        # The block b is the child in one lane of the level above: its bounds are there.
        a, b, bounds = stack[top], stack[top + 1], stack[top + 2]
        lanes = ALL_LANES if a == b else touching8(blocks, a, blocks, bounds // 8, bounds % 8)
        lowest = blocks[a].children[0] < 0
        while lanes != np.uint32(0):
            i = np.int64(trailing_zeros(lanes))
            lanes = np.uint32(lanes & np.uint32(lanes - np.uint32(1)))
            touched = touching8(blocks, b, blocks, a, i)
            if a == b:  # each pair once, and no leaf with itself
                touched = np.uint32(touched & (lanes if lowest else lanes | np.uint32(1 << i)))
            while touched != np.uint32(0):
                j = np.int64(trailing_zeros(touched))
                touched = np.uint32(touched & np.uint32(touched - np.uint32(1)))
                child, other = blocks[a].children[i], blocks[b].children[j]
                if not lowest:
                    stack[top], stack[top + 1], stack[top + 2] = child, other, b * EIGHT + j
                    top += _ENTRY
                    continue
                if count + 2 <= found.shape[0]:
                    found[count], found[count + 1] = ~child, ~other
                count += 2
    return np.int64(count)


def _no_blocks(ndim: int) -> NDArray[Any]:
    return np.empty(0, block_dtype(ndim))


pack_entry = entry_points(pack, 0, np.uint32(0), _no_blocks)


@functools.cache
def pairs_entry(ndim: int) -> Callable[..., Any]:
    """The machine code of `touching_pairs`."""
    return entry_point(touching_pairs, _no_blocks(ndim), 0, np.empty(0, np.int64))
