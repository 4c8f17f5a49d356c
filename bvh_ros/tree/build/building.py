# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bulk build and refit, within a height budget.

Every split uses up one level. Where the cheapest split would leave a side more boxes than the
levels that remain can hold, the range is halved at its median instead: a bound on height is a
bound on the stacks and on the worst query, whatever the scene.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import LANES, prefetch, stack_array
from ..nodes import DEEPEST, FREE_INNER, NONE, is_leaf, next_node, refit_node, take_inner
from .binning import NODE, binned_sah_split, rescale_items

TREELET = 512  # leaves of a subtree that `optimize` rebuilds at once: it stays in the near caches
_RANGES = 4 * DEEPEST
NEAR = 64  # leaves of a subtree that is finished while its nodes are in the near caches


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
def refit_all(nodes, heights, root, order):
    """Make every inner box tight again, children before parents, without changing the tree's
    shape. `order` is scratch, a number an inner node.
    """
    if root == NONE or is_leaf(root):
        return
    count = post_order(nodes, root, order)
    for i in range(count - 1, -1, -1):
        refit_node(nodes, heights, np.int64(order[i]))
