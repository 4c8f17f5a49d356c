# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bulk build, rebuild and refit, all within a height budget.

Every split uses up one level. Where the cheapest split would leave a side more boxes than the
levels that remain can hold, the range is halved at its median instead: a bound on height is a
bound on the stacks and on the worst query, whatever the scene.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..area import tree_cost
from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import LANES, prefetch, stack_array
from ..nodes import (
    BUILT_COST,
    BUILT_COUNT,
    COUNT,
    DEEPEST,
    FREE_INNER,
    NONE,
    REBUILDS,
    REFITS,
    ROOT,
    free_inner,
    is_leaf,
    next_node,
    refit_node,
    take_inner,
)
from .binning import NODE, binned_sah_split, levels_needed, rescale_items

TREELET = 512  # leaves of a subtree that `optimize` rebuilds at once: it stays in the near caches
_RANGES = 4 * DEEPEST
NEAR = 64  # leaves of a subtree that is finished while its nodes are in the near caches


@inlined
def floor_log2(count):
    return math.frexp(float(count))[1] - 1


@lean_kernel
def _attach(nodes, parent, node):
    """Hang a node below its parent, on the left first."""
    nodes[node].parent = parent
    if parent != NONE:
        if nodes[parent].left == NONE:
            nodes[parent].left = node
        else:
            nodes[parent].right = node


@inlined
def _push(ranges, top, start, stop, levels, parent):
    """Put a range on the stack; returns its new top."""
    place = 4 * top
    ranges[place], ranges[place + 1] = start, stop
    ranges[place + 2], ranges[place + 3] = levels, parent
    return top + 1


@inlined
def _adopt_back(nodes, heights, made, first, stop):
    """Adopt the nodes made[first:stop], made before their children, from the last one on."""
    for i in range(stop - 1, first - 1, -1):
        refit_node(nodes, heights, np.int64(made[i]))


class Room(NamedTuple):
    """Memory to build in; `items` and `numbers` are one array, see `binning`."""

    items: NDArray[np.float32]
    """Eight places an item, for twice as many items as there are leaves."""
    numbers: NDArray[np.int32]
    """The same memory."""
    made: NDArray[np.int32]
    """An inner node a leaf."""


def room_to_build(count: int) -> Room:
    """Memory to build a tree of so many boxes, or any part of it.

    It is made before anything changes: within a change nothing may be short of memory.
    """
    places = 2 * LANES * (count + TREELET)
    room = np.empty(places + count, np.int32)
    return Room(room[:places].view(np.float32), room[:places], room[places:])


@lean_kernel
def build(nodes, heights, state, room, count, levels):
    """Build a subtree over the nodes that `numbers` names, with at most `levels` levels of inner
    nodes; return its root.

    `room` is from `room_to_build`: `count` of its items are reordered, and there is room for as
    many.
    """
    items, numbers, made = room.items, room.numbers, room.made
    if count == 1:
        return np.int64(numbers[NODE])
    rescale_items(nodes, items, numbers, 0, count)
    made_count = 0
    ranges = stack_array(_RANGES, np.int64)  # start, stop, levels allowed, parent
    top = _push(ranges, 0, 0, count, levels, NONE)
    root = state[FREE_INNER]  # the first that is taken
    near, near_made = -1, 0  # where the stack ends below the treelet, and what was made before it
    while top > 0:
        top -= 1
        start, stop = ranges[4 * top], ranges[4 * top + 1]
        allowed, parent = ranges[4 * top + 2], ranges[4 * top + 3]
        if near < 0 and stop - start <= NEAR:
            near, near_made = top, made_count
            for item in range(start, stop):
                prefetch(nodes, numbers[item * LANES + NODE], 1)
        if stop - start == 1:
            _attach(nodes, parent, np.int64(numbers[start * LANES + NODE]))
        else:
            node = take_inner(nodes, state)
            nodes[node].left = NONE
            _attach(nodes, parent, node)
            made[made_count] = node
            made_count += 1
            begin, middle = binned_sah_split(nodes, items, numbers, start, stop, allowed)
            top = _push(ranges, top, middle, begin + stop - start, allowed - 1, node)
            top = _push(ranges, top, begin, middle, allowed - 1, node)
        if top == near:
            _adopt_back(nodes, heights, made, near_made, made_count)
            near, made_count = -1, near_made
    _adopt_back(nodes, heights, made, 0, made_count)
    return root


@lean_kernel
def count_leaves(nodes, root):
    stack, top, node, count = stack_array(DEEPEST, np.int64), 0, np.int64(root), 0
    while node != NONE:
        count += is_leaf(node)
        node, top = next_node(nodes, node, not is_leaf(node), stack, top)
    return count


@lean_kernel
def post_order(nodes, root, order):
    """Number the inner nodes below and with `root`, parents before children: read it backwards for
    children first. Returns how many there are.
    """
    stack, top, node, count = stack_array(DEEPEST, np.int64), 0, np.int64(root), 0
    while node != NONE:
        if not is_leaf(node):
            order[count] = node
            count += 1
        node, top = next_node(nodes, node, not is_leaf(node), stack, top)
    return count


@lean_kernel
def free_inner_nodes(nodes, state, root, most, numbers):
    """Free the inner nodes from `root` down to the largest subtrees of at most `most` leaves;
    return how many of those there are, in `numbers`.
    """
    stack, top, node, count = stack_array(DEEPEST, np.int64), 0, np.int64(root), 0
    while node != NONE:
        below = not (is_leaf(node) or (most > 1 and count_leaves(nodes, node) <= most))
        here = node
        node, top = next_node(nodes, node, below, stack, top)
        if below:
            free_inner(nodes, state, here)
        else:
            numbers[count * LANES + NODE] = here
            count += 1
    return count


@lean_kernel
def rebuild_subtree(nodes, heights, state, root, room, count, levels):
    """Build the subtree below `root` again over its `count` leaves, within `levels` levels; return
    its new root.
    """
    parent = np.int64(nodes[root].parent)
    numbers = room.numbers
    # Where it hangs is noted before `root` itself is freed and perhaps taken again.
    on_left = parent != NONE and nodes[parent].left == root
    is_root = state[ROOT] == root
    free_inner_nodes(nodes, state, root, 1, numbers)
    fresh = build(nodes, heights, state, room, count, levels)
    nodes[fresh].parent = parent
    if is_root:
        state[ROOT] = fresh
    elif parent == NONE:
        return fresh  # a subtree that hangs nowhere yet
    elif on_left:
        nodes[parent].left = fresh
    else:
        nodes[parent].right = fresh
    return fresh


@inlined
def height_limit(count):
    """At most 4 log2(count) + 4."""
    return 4 * floor_log2(count) + 4


@inlined
def is_too_high(heights, state):
    """After a change: two numbers to compare, and nearly always nothing to do."""
    return state[ROOT] != NONE and heights[state[ROOT]] > height_limit(state[COUNT])


@lean_kernel
def build_levels(count):
    """Levels that a bulk build may use: enough for SAH to have its way in real scenes, few enough
    to leave insertions room.
    """
    return 3 * floor_log2(count) + 2


@lean_kernel
def rebalance(nodes, heights, state, room):
    """Rebuild balanced what makes the tree higher than `height_limit` (a scapegoat, Galperin and
    Rivest 1993).
    """
    while is_too_high(heights, state):
        node = state[ROOT]
        while not is_leaf(node):  # to the deepest leaf
            left, right = np.int64(nodes[node].left), np.int64(nodes[node].right)
            node = left if heights[left] > heights[right] else right
        leaves = 1
        # up to the first subtree that is too high for its leaves
        while heights[node] <= 2 * floor_log2(leaves) + 2:
            parent = np.int64(nodes[node].parent)
            other = np.int64(
                nodes[parent].right if nodes[parent].left == node else nodes[parent].left
            )
            leaves += count_leaves(nodes, other)
            node = parent
        levels = levels_needed(leaves) + 1
        node = rebuild_subtree(nodes, heights, state, node, room, leaves, levels)
        node = np.int64(nodes[node].parent)
        while node != NONE:
            refit_node(nodes, heights, node)
            node = np.int64(nodes[node].parent)


@lean_kernel
def build_all(nodes, heights, handles, state, room):
    """Build the whole tree again over every live slot."""
    count, placed = state[COUNT], 0
    if count == 0:
        state[ROOT] = NONE
        return
    numbers = room.numbers
    if state[ROOT] != NONE:
        free_inner_nodes(nodes, state, state[ROOT], 1, numbers)
    for slot in range(handles.shape[0]):
        if handles[slot] >= 0:
            numbers[placed * LANES + NODE] = 2 * slot
            placed += 1
    levels = build_levels(count)
    state[ROOT] = build(nodes, heights, state, room, count, levels)
    nodes[state[ROOT]].parent = NONE


@lean_kernel
def build_anew(nodes, heights, handles, state, room):
    """Build the whole tree again, and book its cost."""
    build_all(nodes, heights, handles, state, room)
    rebalance(nodes, heights, state, room)
    cost = tree_cost(nodes, state[ROOT]) if state[ROOT] != NONE else 0.0
    state[REFITS], state[BUILT_COUNT] = 0, state[COUNT]
    state.view(np.float64)[BUILT_COST] = cost
    state[REBUILDS] += 1


@lean_kernel
def refit_all(nodes, heights, root, order):
    """Make every inner box tight again, children before parents, without changing the tree's
    shape. `order` is scratch, a number an inner node.
    """
    if root == NONE or is_leaf(root):
        return
    count = post_order(nodes, root, order)
    for i in range(count - 1, -1, -1):
        refit_node(nodes, heights, np.int64(order[i]))


@lean_kernel
def optimize(nodes, heights, state, room):
    """Rebuild every treelet by SAH, then the tree's top over them.

    Less work than a whole build, and less gain: what the upper levels have divided badly stays
    divided. (Bittner et al. 2013 insert nodes again instead; here one such insertion takes longer
    than a whole build takes for a box.)
    """
    if state[COUNT] < 3:
        return
    items, numbers = room.items, room.numbers
    treelets = free_inner_nodes(nodes, state, state[ROOT], TREELET, numbers)
    state[ROOT] = NONE
    below = 2 * LANES * treelets  # the top needs what comes before
    room_below = Room(items[below:], numbers[below:], room.made)
    for i in range(treelets):
        root = np.int64(numbers[i * LANES + NODE])
        nodes[root].parent = NONE
        leaves = count_leaves(nodes, root)
        if leaves > 2:
            levels = build_levels(leaves)
            root = rebuild_subtree(nodes, heights, state, root, room_below, leaves, levels)
        numbers[i * LANES + NODE] = root
    levels = build_levels(treelets)
    root = build(nodes, heights, state, room, treelets, levels)
    nodes[root].parent = NONE
    state[ROOT] = root
