# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bulk build and refit, within a height budget.

Every split uses up one level. Where the cheapest split would leave a side more boxes than the
levels that remain can hold, the range is halved at its median instead: a bound on height is a
bound on the stacks and on the worst query, whatever the scene. Eight boxes are joined in pairs.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..area import area_scale, area_unit, half_area, node_area, tree_cost
from ..compiler import LANES, copy8, inlined, lean_kernel, prefetch, stack_array
from ..nodes import (
    BUILT_COST,
    BUILT_COUNT,
    COUNT,
    DEEPEST,
    NONE,
    REBUILDS,
    REFITS,
    ROOT,
    aligned_empty,
    floor_log2,
    free_inner,
    height_limit,
    is_leaf,
    next_node,
    refit_node,
    take_inner,
)
from ..simd.float32x8 import pair_up
from .binning import (
    BIN_FLOATS,
    NO_SPLIT,
    NODE,
    PART,
    PLAN,
    SMALL_RANGE,
    choose_split,
    clear_bins,
    compute_bounds,
    divide,
    fill_bins,
    halve,
    levels_needed,
    longest_edge,
    plan_range,
    rescale_items,
)

FEW = LANES  # boxes at most that are joined pair by pair
_BOTH = 2 * FEW  # of two groups of boxes
NEAR = 64  # leaves of a subtree that is finished while its nodes are in the near caches
_AHEAD = 32  # how far ahead free nodes are prefetched: often they lie side by side

# A range of items on the stack: the levels it may use; 2 * its parent, + 1 if it is the right
# child; its split, if it is planned; a bit for each of its sides that may be too small for its
# units, or if it is not planned, for itself.
START, STOP, LEVELS, PLACE, LAST, SMALL, _PLACES = range(7)
_RANGES = DEEPEST + 2
_RANGE_PLACES, _PLAN_PLACES = _PLACES * _RANGES, PLAN * _RANGES


# ---- Memory to build in. It is made before a change begins: within a change memory must not run
# short.


TREELET = 512  # leaves of a subtree that `optimize` rebuilds at once: it stays in the near caches
KEPT = 1 << 22  # bytes of room at most that are kept for the next build


class Room(NamedTuple):
    """Memory to build in; `items` and `numbers` are one array, see `binning`."""

    items: NDArray[np.float32]
    """Eight places an item, for twice as many items as there are leaves."""
    numbers: NDArray[np.int32]
    """The same memory."""
    made: NDArray[np.int32]
    """An inner node a leaf."""


def room_to_build(count: int) -> Room:
    """Memory to build a tree of so many boxes, or any part of it."""
    places = 2 * LANES * (count + TREELET)
    room = aligned_empty(places + count, np.dtype(np.int32))
    return Room(room[:places].view(np.float32), room[:places], room[places:])


spare: list[Room] = []  # one, unless it is in use


def spare_room(count: int) -> Room:
    """`room_to_build`, or what the last build has left, if that fits.

    Of a build of 10,000 boxes the room is a quarter of the memory. With it, the system gets as
    much back after a tree is gone that it takes the rest, too: new memory for all of the next one
    is half its time.
    """
    try:
        room = spare.pop()  # at once: no other thread has it, nor a signal handler
    except IndexError:
        return room_to_build(count)
    return room if count <= len(room.made) <= 2 * count else room_to_build(count)


def leave_room(room: Room) -> None:
    """What `spare_room` gave is not used any more."""
    if room.items.nbytes <= KEPT:
        spare[:] = [room]


# ---- a build


class Work(NamedTuple):
    """What a build has on the stack."""

    bins: NDArray[np.float32]
    """Of both sides of a split."""
    plan: NDArray[np.float32]
    """Of the range that is split."""
    ranges: NDArray[np.int64]
    """Those to come."""
    plans: NDArray[np.float32]
    """A plan for each of them."""


@inlined
def _attach(nodes, place, node):
    """Hang a node at its place."""
    parent = place >> 1
    nodes[node].parent = parent
    if parent != NONE:
        left, right = nodes[parent].left, nodes[parent].right
        # No branch: it would be guessed wrong half the time.
        nodes[parent].left = node if place & 1 == 0 else left
        nodes[parent].right = right if place & 1 == 0 else node


@inlined
def _adopt(nodes, heights, node, left, right, scale):
    """Make a node the parent of two; returns its area."""
    here, a, b = nodes[node], nodes[left], nodes[right]
    here.left, here.right, here.mask = left, right, a.mask | b.mask
    a.parent = b.parent = node
    heights[node] = 1 + max(heights[left], heights[right])
    for axis in range(here.lo.shape[0]):
        here.lo[axis] = min(a.lo[axis], b.lo[axis])
        here.hi[axis] = max(a.hi[axis], b.hi[axis])
    return half_area(here.lo, here.hi, scale)


@inlined
def _adopt_back(nodes, heights, made, first, stop, scale):
    """Adopt the children of the nodes made[first:stop], made before these, from the last one on;
    returns the sum of their areas.
    """
    total = 0.0
    for i in range(stop - 1, first - 1, -1):
        node = np.int64(made[i])
        left, right = np.int64(nodes[node].left), np.int64(nodes[node].right)
        total += _adopt(nodes, heights, node, left, right, scale)
    return total


@inlined
def _join(nodes, heights, state, names, pairs, first, count, scale):
    """Join nodes, those named from names[first] on, as `pairs` says; returns the root, and the sum
    of the areas of all inner nodes.
    """
    fresh, node, total = stack_array(FEW, np.int64), names[first], 0.0
    for i in range(count - 2, -1, -1):
        fresh[i] = take_inner(nodes, state)  # parents before children
        prefetch(nodes, fresh[i] + _AHEAD, 1)
    for i in range(count - 1):
        node, older, younger = fresh[i], first + (pairs[first + i] & 7), pairs[first + i] >> 3
        total += _adopt(nodes, heights, node, names[older], names[first + younger], scale)
        names[older] = node
    return node, total


@lean_kernel
def _join_few(nodes, heights, state, room, ranges, top, several, scale):
    """Join range `top` and, if `several` is 2, the one below it pair by pair, of at most FEW items
    each, and hang them at their places; returns the root of the last one, and the sum of the areas
    of all inner nodes.
    """
    names, pairs = stack_array(_BOTH, np.int64), stack_array(_BOTH, np.int32)
    at, other = _PLACES * top, _PLACES * (top - several + 1)
    for here, first in ((at, 0), (other, FEW)):
        start, count = ranges[here + START], ranges[here + STOP] - ranges[here + START]
        for i in range(count):
            names[first + i] = room.numbers[(start + i) * LANES + NODE]
        if ranges[here + SMALL] != 0 and count > 2:
            rescale_items(nodes, room.items, room.numbers, start, start + count)
    start, count = ranges[at + START], ranges[at + STOP] - ranges[at + START]
    start2, count2 = ranges[other + START], ranges[other + STOP] - ranges[other + START]
    pairs[0] = pairs[FEW] = 1 << 3  # of two
    if max(count, count2) > 2:
        planar = nodes[0].lo.shape[0] == 2
        pair_up(room.items, start, count, start2, count2, planar, pairs)
    node, total = _join(nodes, heights, state, names, pairs, 0, count, scale)
    _attach(nodes, ranges[at + PLACE], node)
    if several == 2:
        node, more = _join(nodes, heights, state, names, pairs, FEW, count2, scale)
        _attach(nodes, ranges[other + PLACE], node)
        total += more
    return node, total


@inlined
def _push(ranges, top, start, stop, levels, place, last, small):
    """Put a range on the stack; returns its new top."""
    at = _PLACES * top
    ranges[at + START], ranges[at + STOP], ranges[at + LEVELS] = start, stop, levels
    ranges[at + PLACE], ranges[at + LAST], ranges[at + SMALL] = place, last, small
    return top + 1


@inlined
def _plan(nodes, room, start, stop, work):
    """As `choose_split` of a range of which nothing is known."""
    box, centers = stack_array(LANES, np.float32), stack_array(LANES, np.float32)
    compute_bounds(room.items, start, stop, box, centers)
    if longest_edge(box) < SMALL_RANGE:
        rescale_items(nodes, room.items, room.numbers, start, stop)
        compute_bounds(room.items, start, stop, box, centers)
    plan_range(work.plan, box, centers)
    fill_bins(work.bins, room.items, start, stop, work.plan)
    return choose_split(work.bins, 0, work.plan, 0, stop - start, nodes[0].lo.shape[0] == 2)


@inlined
def _plan_side(work, side, top, size, planar):
    """As `choose_split` of a side that was binned; its plan goes to that of range `top`."""
    own, part = PLAN * top, PART * (side + 1)
    for i in range(PART):
        work.plans[own + i] = work.plan[part + i]
    return choose_split(work.bins, side, work.plans, own, size, planar)


@lean_kernel
def _split(nodes, room, work, top, node):
    """Let two sides take the place of range `top`, whose node is `node`."""
    ranges, at, planar = work.ranges, _PLACES * top, nodes[0].lo.shape[0] == 2
    start, stop, levels = ranges[at + START], ranges[at + STOP], ranges[at + LEVELS] - 1
    last, small, size = ranges[at + LAST], ranges[at + SMALL], stop - start
    for i in range(0, PLAN, LANES):
        copy8(work.plan, i, work.plans, PLAN * top + i)
    if last == NO_SPLIT and size > FEW:
        last, small = _plan(nodes, room, start, stop, work)
    middle, binned = start, size > 2 * FEW  # else hardly ever a side has more than FEW
    if last != NO_SPLIT:
        half = room.items.shape[0] // (2 * LANES)
        shift = half if start < half else -half
        if binned:
            clear_bins(work.bins)
        middle = divide(room.items, start, stop, shift, work.plan, last, binned, work.bins)
        start, stop = start + shift, stop + shift
    most = max(middle - start, stop - middle)
    if most == size or most > np.int64(1) << min(levels, 62):
        middle, binned, small = halve(room.items, start, stop), False, 3
    last, below = np.int64(NO_SPLIT), small >> 1
    if binned and below == 0 and stop - middle > FEW:
        last, below = _plan_side(work, 1, top, stop - middle, planar)
    _push(work.ranges, top, middle, stop, levels, 2 * node + 1, last, below)
    last, below = np.int64(NO_SPLIT), small & 1
    if binned and below == 0 and middle - start > FEW:
        last, below = _plan_side(work, 0, top + 1, middle - start, planar)
    _push(work.ranges, top + 1, start, middle, levels, 2 * node, last, below)


@inlined
def _is_few(ranges, range_number):
    """Whether a range is joined pair by pair."""
    at = _PLACES * range_number
    return ranges[at + STOP] - ranges[at + START] <= min(FEW, ranges[at + LEVELS] + 1)


@lean_kernel
def build(nodes, heights, state, room, count, levels):
    """Build a subtree over the nodes that `numbers` names, with at most `levels` levels of inner
    nodes; return its root, and its cost as of `tree_cost`.

    `room` is a `Room`: `count` of its items are reordered, and there is room for as
    many.
    """
    work = Work(
        stack_array(BIN_FLOATS, np.float32),
        stack_array(PLAN, np.float32),
        stack_array(_RANGE_PLACES, np.int64),
        stack_array(_PLAN_PLACES, np.float32),
    )
    scale = area_unit(2.0 * rescale_items(nodes, room.items, room.numbers, 0, count))
    ranges, made, made_count = work.ranges, room.made, 0
    root, total, top = (
        np.int64(NONE),
        0.0,
        _push(work.ranges, 0, 0, count, levels, -1, NO_SPLIT, 0),
    )
    near, near_made = -1, 0  # where the stack ends below the treelet, and what was made before it
    while top > 0:
        top -= 1
        at = _PLACES * top
        start, stop, place = ranges[at + START], ranges[at + STOP], ranges[at + PLACE]
        if near < 0 and stop - start <= NEAR:
            near, near_made = top, made_count
            for item in range(start, stop):
                prefetch(nodes, room.numbers[item * LANES + NODE], 1)
        if _is_few(ranges, top):
            several = 2 if top > near and _is_few(ranges, top - 1) else 1
            node, area = _join_few(nodes, heights, state, room, ranges, top, several, scale)
            total += area
            top -= several - 1
        else:
            node = take_inner(nodes, state)
            made[made_count] = node
            made_count += 1
            _split(nodes, room, work, top, node)
            _attach(nodes, place, node)
            top += 2
        root = node if place < 0 else root
        if top == near:
            total += _adopt_back(nodes, heights, made, near_made, made_count, scale)
            near, made_count = -1, near_made
    total += _adopt_back(nodes, heights, made, 0, made_count, scale)
    around = node_area(nodes, root, scale)
    return root, total / around if around > 0.0 else count - 1.0


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
    shape; returns its cost as of `tree_cost`. `order` is scratch, a number an inner node.
    """
    if root == NONE or is_leaf(root):
        return 0.0
    count, total = post_order(nodes, root, order), 0.0
    scale = area_scale(nodes, root, root)  # of the boxes as they were: nearly always the same
    for i in range(count - 1, -1, -1):
        node = np.int64(order[i])
        refit_node(nodes, heights, node)
        total += node_area(nodes, node, scale)
    if scale != area_scale(nodes, root, root):
        return tree_cost(nodes, root)
    around = node_area(nodes, root, scale)
    return total / around if around > 0.0 else float(count)


# ---- Building again: the whole tree, what is too high of it, or treelets and the top over them


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
