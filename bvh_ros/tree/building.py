# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bulk build, rebuild and refit, all within a height budget.

Every split uses up one level. Where the cheapest split would leave a side more boxes than the
levels that remain can hold, the range is halved at its median instead: a bound on height is a
bound on the stacks and on the worst query, whatever the scene.
"""

import math

import numpy as np

from .binning import NODE, levels_needed, renew_units, split_range
from .compiling import inlined, kernel, lean_kernel
from .machine import LANES, prefetch, stack_array
from .nodes import COUNT, DEEPEST, FREE_INNER, NONE, ROOT, adopt, free_inner, is_leaf, take_inner

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
    ranges[top, 0], ranges[top, 1], ranges[top, 2], ranges[top, 3] = start, stop, levels, parent
    return top + 1


@inlined
def _adopt_back(nodes, heights, made, first, stop):
    """Adopt the nodes made[first:stop], made before their children, from the last one on."""
    for i in range(stop - 1, first - 1, -1):
        adopt(nodes, heights, np.int64(made[i]))


@kernel
def build(nodes, heights, state, items, numbers, count, levels):
    """Build a subtree over the nodes that `numbers` names, with at most `levels` levels of inner
    nodes; return its root.

    `items` (float32) and `numbers` (int32) are one array of eight places an item, see `binning`:
    `count` items, which are reordered, and room for as many.
    """
    if count == 1:
        return np.int64(numbers[NODE])
    renew_units(nodes, items, numbers, 0, count)
    made, made_count = np.empty(count - 1, np.int32), 0
    ranges = np.empty((levels + 2, 4), np.int64)  # start, stop, levels allowed, parent
    top = _push(ranges, 0, 0, count, levels, NONE)
    root = state[FREE_INNER]  # the first that is taken
    near, near_made = -1, 0  # where the stack ends below the treelet, and what was made before it
    while top > 0:
        top -= 1
        start, stop = ranges[top, 0], ranges[top, 1]
        allowed, parent = ranges[top, 2], ranges[top, 3]
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
            begin, middle = split_range(nodes, items, numbers, start, stop, allowed)
            top = _push(ranges, top, middle, begin + stop - start, allowed - 1, node)
            top = _push(ranges, top, begin, middle, allowed - 1, node)
        if top == near:
            _adopt_back(nodes, heights, made, near_made, made_count)
            near, made_count = -1, near_made
    _adopt_back(nodes, heights, made, 0, made_count)
    return root


@lean_kernel
def dissolve(nodes, state, root, marks, numbers):
    """Free the inner nodes from `root` down to the leaves, or to marked nodes (`marks` is empty or
    one a node); return how many of those there are, in `numbers`.
    """
    stack = stack_array(DEEPEST, np.int64)
    stack[0], top, count = root, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        if is_leaf(node) or (marks.shape[0] > 0 and marks[node]):
            numbers[count * LANES + NODE] = node
            count += 1
            continue
        stack[top], stack[top + 1] = nodes[node].left, nodes[node].right
        top += 2
        free_inner(nodes, state, node)
    return count


@lean_kernel
def count_leaves(nodes, root):
    stack = stack_array(DEEPEST, np.int64)
    stack[0], top, count = root, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        if is_leaf(node):
            count += 1
            continue
        stack[top], stack[top + 1] = nodes[node].left, nodes[node].right
        top += 2
    return count


@kernel
def rebuild_subtree(nodes, heights, state, root, count, levels):
    """Build the subtree below `root` again over its `count` leaves, within `levels` levels; return
    its new root.
    """
    parent = np.int64(nodes[root].parent)
    items = np.empty(2 * count * LANES, np.float32)
    numbers = items.view(np.int32)
    # Where it hangs is noted before `root` itself is freed and perhaps taken again.
    on_left = parent != NONE and nodes[parent].left == root
    is_root = state[ROOT] == root
    dissolve(nodes, state, root, np.empty(0, np.bool_), numbers)
    fresh = build(nodes, heights, state, items, numbers, count, levels)
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


@kernel
def rebalance(nodes, heights, state):
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
        node = rebuild_subtree(nodes, heights, state, node, leaves, levels_needed(leaves) + 1)
        node = np.int64(nodes[node].parent)
        while node != NONE:
            adopt(nodes, heights, node)
            node = np.int64(nodes[node].parent)


@kernel
def build_all(nodes, heights, handles, state):
    """Build the whole tree again over every live slot."""
    count, placed = state[COUNT], 0
    if count == 0:
        state[ROOT] = NONE
        return
    items = np.empty(2 * count * LANES, np.float32)
    numbers = items.view(np.int32)
    if state[ROOT] != NONE:
        dissolve(nodes, state, state[ROOT], np.empty(0, np.bool_), numbers)
    for slot in range(handles.shape[0]):
        if handles[slot] >= 0:
            numbers[placed * LANES + NODE] = 2 * slot
            placed += 1
    levels = build_levels(count)
    state[ROOT] = build(nodes, heights, state, items, numbers, count, levels)
    nodes[state[ROOT]].parent = NONE


@kernel
def refit_all(nodes, heights, root):
    """Make every inner box tight again, children before parents, without changing the tree's
    shape.
    """
    if root == NONE or is_leaf(root):
        return
    order, stack = np.empty(2 * 1024, np.int64), stack_array(DEEPEST, np.int64)
    stack[0], top, count = root, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        if count == order.shape[0]:
            order = np.append(order, order)
        order[count] = node
        count += 1
        for child in (np.int64(nodes[node].left), np.int64(nodes[node].right)):
            if not is_leaf(child):
                stack[top] = child
                top += 1
    for i in range(count - 1, -1, -1):
        adopt(nodes, heights, order[i])


TREELET = 512  # leaves of a subtree that `optimize` rebuilds at once: it stays in the near caches


@kernel
def _mark_treelets(nodes, root, marks):
    """Mark and return the largest subtrees of at most TREELET leaves."""
    roots, count = np.empty(64, np.int64), 0
    stack, top = stack_array(DEEPEST, np.int64), 1
    stack[0] = root
    while top > 0:
        top -= 1
        node = stack[top]
        if count_leaves(nodes, node) > TREELET:
            stack[top], stack[top + 1] = nodes[node].left, nodes[node].right
            top += 2
            continue
        if count == roots.shape[0]:
            roots = np.append(roots, roots)
        roots[count] = node
        marks[node] = True
        count += 1
    return roots[:count]


@kernel
def optimize(nodes, heights, state):
    """Rebuild every treelet by SAH, then the tree's top over them.

    Less work than a whole build, and less gain: what the upper levels have divided badly stays
    divided. (Bittner et al. 2013 insert nodes again instead; here one such insertion takes longer
    than a whole build takes for a box.)
    """
    if state[COUNT] < 3:
        return
    marks = np.zeros(nodes.shape[0], np.bool_)
    roots = _mark_treelets(nodes, state[ROOT], marks)
    top_items = np.empty(2 * roots.shape[0] * LANES, np.float32)
    top_numbers = top_items.view(np.int32)
    dissolve(nodes, state, state[ROOT], marks, top_numbers)
    state[ROOT] = NONE
    for i in range(roots.shape[0]):
        root = np.int64(top_numbers[i * LANES + NODE])
        nodes[root].parent = NONE
        leaves = count_leaves(nodes, root)
        if leaves > 2:
            root = rebuild_subtree(nodes, heights, state, root, leaves, build_levels(leaves))
        top_numbers[i * LANES + NODE] = root
    levels = build_levels(roots.shape[0])
    root = build(nodes, heights, state, top_items, top_numbers, roots.shape[0], levels)
    nodes[root].parent = NONE
    state[ROOT] = root


NEITHER, BUILD, OPTIMIZE = range(3)


@kernel
def restructure(nodes, heights, handles, state, how):
    """Build all or optimize, then rebalance: one kernel, so that the build is compiled once."""
    if how == BUILD:
        build_all(nodes, heights, handles, state)
    elif how == OPTIMIZE:
        optimize(nodes, heights, state)
    rebalance(nodes, heights, state)
