# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Building again: the whole tree, what is too high of it, or treelets and the top over them."""

import numpy as np

from ..compiler import LANES, inlined, lean_kernel, stack_array
from ..nodes import (
    BUILT_COST,
    BUILT_COUNT,
    COUNT,
    DEEPEST,
    NONE,
    REBUILDS,
    REFITS,
    ROOT,
    floor_log2,
    free_inner,
    height_limit,
    is_leaf,
    next_node,
    refit_node,
)
from .binning import NODE, levels_needed
from .building import TREELET, Room, build

# The cost is looked at after so many moves a box; if it has become so much higher than it was
# when built, or the number of boxes so different, the tree is built anew.
REFITS_BEFORE_A_LOOK = 1
WORSE = 1.2


@lean_kernel
def count_leaves(nodes, root):
    stack, top, node, count = stack_array(DEEPEST, np.int64), 0, np.int64(root), 0
    while node != NONE:
        count += is_leaf(node)
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
    fresh, _ = build(nodes, heights, state, room, count, levels)
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
    """Build the whole tree again over every live slot; returns its cost."""
    count, placed = state[COUNT], 0
    if count == 0:
        state[ROOT] = NONE
        return 0.0
    numbers = room.numbers
    if state[ROOT] != NONE:
        free_inner_nodes(nodes, state, state[ROOT], 1, numbers)
    for slot in range(handles.shape[0]):
        if handles[slot] >= 0:
            numbers[placed * LANES + NODE] = 2 * slot
            placed += 1
    levels = build_levels(count)
    state[ROOT], cost = build(nodes, heights, state, room, count, levels)
    nodes[state[ROOT]].parent = NONE
    return cost


@lean_kernel
def build_anew(nodes, heights, handles, state, room):
    """Build the whole tree again, and book its cost."""
    cost = build_all(nodes, heights, handles, state, room)
    state[REFITS], state[BUILT_COUNT] = 0, state[COUNT]
    state.view(np.float64)[BUILT_COST] = cost
    state[REBUILDS] += 1


@inlined
def is_due(state):
    """Whether a look at the cost is."""
    return state[REFITS] >= REFITS_BEFORE_A_LOOK * state[COUNT] > 0


@lean_kernel
def look_at_cost(nodes, heights, handles, state, room, cost):
    """Build the tree anew if this cost of it, or the number of its boxes, is no more what it was
    when it was built.
    """
    state[REFITS] = 0
    count, built = state[COUNT], state[BUILT_COUNT]
    worse = cost > WORSE * state.view(np.float64)[BUILT_COST]
    if worse or not 0.8 * built < count < 1.25 * built:
        build_anew(nodes, heights, handles, state, room)


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
    root, _ = build(nodes, heights, state, room, treelets, levels)
    nodes[root].parent = NONE
    state[ROOT] = root
