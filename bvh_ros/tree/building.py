# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bulk build by binned SAH (Wald 2007, "On fast Construction of SAH-based Bounding Volume Hierarchies") within a height budget.

Every split uses up one level. Where the cheapest split would leave a side more boxes than the levels that remain can hold, the
range is halved at its median instead: a bound on height is a bound on the stacks and on the worst query, whatever the scene.
"""

import math

import numpy as np

from .area import half_area
from .compiling import inlined, kernel, lean_kernel
from .machine import stack_array
from .nodes import COUNT, DEEPEST, NONE, ROOT, adopt, free_inner, is_leaf, take_inner

BINS = 16


@inlined
def levels_needed(count):
    """Height of a balanced tree over `count` leaves: ceil(log2(count))."""
    mantissa, exponent = math.frexp(float(count))
    return exponent - 1 if mantissa == 0.5 else exponent


@inlined
def floor_log2(count):
    return math.frexp(float(count))[1] - 1


@inlined
def _center(item, axis):
    return item.lo[axis] * 0.5 + item.hi[axis] * 0.5


@inlined
def _swap(items, i, j):
    a, b = items[i], items[j]
    a.left, b.left = b.left, a.left
    for axis in range(a.lo.shape[0]):
        a.lo[axis], b.lo[axis] = b.lo[axis], a.lo[axis]
        a.hi[axis], b.hi[axis] = b.hi[axis], a.hi[axis]


@lean_kernel
def _halve(items, start, stop, axis):
    """Quickselect (Hoare 1961): returns the middle, with no centre on its left above one on its right."""
    middle = (start + stop) >> 1
    low, high = start, stop - 1
    while low < high:
        pivot = _center(items[(low + high) >> 1], axis)
        i, j = low, high
        while i <= j:
            while _center(items[i], axis) < pivot:
                i += 1
            while _center(items[j], axis) > pivot:
                j -= 1
            if i <= j:
                _swap(items, i, j)
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return middle


@inlined
def _fill_bins(items, start, stop, axis, origin, per_length, bins, bin_boxes, bin_count):
    for b in range(bins):
        bin_count[b] = 0
        box = bin_boxes[b]
        for k in range(box.lo.shape[0]):
            box.lo[k] = np.inf
            box.hi[k] = -np.inf
    for i in range(start, stop):
        item = items[i]
        b = min(np.int64((_center(item, axis) - origin) * per_length), bins - 1)
        bin_count[b] += 1
        _grow(bin_boxes[b], item)


@inlined
def _grow(box, other):
    for k in range(box.lo.shape[0]):
        box.lo[k] = min(box.lo[k], other.lo[k])
        box.hi[k] = max(box.hi[k], other.hi[k])


@inlined
def _cheapest_bin(bins, bin_boxes, bin_count, scale, right_cost, sweep):
    """The bin before which a split has the least sum of area times count, as (cost, bin)."""
    empty, box = sweep[0], sweep[1]
    for k in range(box.lo.shape[0]):
        box.lo[k], box.hi[k] = empty.lo[k], empty.hi[k]
    count = 0
    for b in range(bins - 1, 0, -1):
        _grow(box, bin_boxes[b])
        count += bin_count[b]
        right_cost[b] = half_area(box.lo, box.hi, scale) * count if count > 0 else np.inf
    for k in range(box.lo.shape[0]):
        box.lo[k], box.hi[k] = empty.lo[k], empty.hi[k]
    count = 0
    best_cost, best = np.inf, 0
    for b in range(1, bins):
        _grow(box, bin_boxes[b - 1])
        count += bin_count[b - 1]
        if count > 0:
            cost = half_area(box.lo, box.hi, scale) * count + right_cost[b]
            if cost < best_cost:
                best_cost, best = cost, b
    return best_cost, best


@inlined
def _divide(items, start, stop, axis, origin, per_length, bins, split):
    """Move the items of the bins before `split` to the front; returns where the others begin."""
    i, j = start, stop - 1
    while i <= j:
        if min(np.int64((_center(items[i], axis) - origin) * per_length), bins - 1) < split:
            i += 1
        else:
            _swap(items, i, j)
            j -= 1
    return i


@lean_kernel
def split_range(items, start, stop, levels, all_axes, bin_boxes, bin_count, right_cost, sweep):
    """Where to split items[start:stop], reordered so that both sides are contiguous and each fits below `levels` levels."""
    count = stop - start
    if count == 2:
        return start + 1
    box, centers = sweep[2], sweep[3]
    for k in range(box.lo.shape[0]):
        box.lo[k] = centers.lo[k] = np.inf
        box.hi[k] = centers.hi[k] = -np.inf
    for i in range(start, stop):
        item = items[i]
        _grow(box, item)
        for k in range(box.lo.shape[0]):
            center = _center(item, k)
            centers.lo[k] = min(centers.lo[k], center)
            centers.hi[k] = max(centers.hi[k], center)
    widest = 0
    for k in range(1, box.lo.shape[0]):
        if centers.hi[k] - centers.lo[k] > centers.hi[widest] - centers.lo[widest]:
            widest = k
    if centers.lo[widest] == centers.hi[widest]:
        return (start + stop) >> 1
    longest = 0.0
    for k in range(box.lo.shape[0]):
        longest = max(longest, box.hi[k] * 0.5 - box.lo[k] * 0.5)
    scale = math.ldexp(1.0, min(-math.frexp(longest)[1], 1022))
    bins = BINS if count > 12 else 8 if count > 4 else 4
    best_cost, best_axis, best_bin, best_per_length = np.inf, 0, 0, 0.0
    for axis in range(box.lo.shape[0]):
        if axis != widest and not all_axes:
            continue
        per_length = bins / (centers.hi[axis] - centers.lo[axis])
        if not (0.0 < per_length < np.inf):
            continue
        _fill_bins(items, start, stop, axis, centers.lo[axis], per_length, bins, bin_boxes, bin_count)
        cost, split = _cheapest_bin(bins, bin_boxes, bin_count, scale, right_cost, sweep)
        if cost < best_cost:
            best_cost, best_axis, best_bin, best_per_length = cost, axis, split, per_length
    if best_cost < np.inf:
        middle = _divide(items, start, stop, best_axis, centers.lo[best_axis], best_per_length, bins, best_bin)
        if levels_needed(max(middle - start, stop - middle)) < levels:
            return middle
    return _halve(items, start, stop, widest)


@kernel
def build(nodes, heights, state, items, count, levels, all_axes):
    """Build a subtree over the nodes named in items[:count].left, with at most `levels` levels of inner nodes; return its root.

    `items` are copies of the nodes, so that every pass runs through memory in order; they are reordered.
    """
    if count == 1:
        return np.int64(items[0].left)
    bin_boxes, sweep = np.empty(BINS, nodes.dtype), np.empty(4, nodes.dtype)
    bin_count, right_cost = np.empty(BINS, np.int64), np.empty(BINS)
    for k in range(sweep[0].lo.shape[0]):
        sweep[0].lo[k], sweep[0].hi[k] = np.inf, -np.inf
    made, made_count = np.empty(count - 1, np.int32), 0
    ranges = np.empty((levels + 2, 4), np.int64)  # start, stop, levels allowed, parent
    ranges[0, 0], ranges[0, 1], ranges[0, 2], ranges[0, 3] = 0, count, levels, NONE
    top = 1
    while top > 0:
        top -= 1
        start, stop, allowed, parent = ranges[top, 0], ranges[top, 1], ranges[top, 2], ranges[top, 3]
        if stop - start == 1:
            node = np.int64(items[start].left)
        else:
            node = take_inner(nodes, state)
            nodes[node].left = NONE
            made[made_count] = node
            made_count += 1
            middle = split_range(
                items, start, stop, allowed, all_axes, bin_boxes, bin_count, right_cost, sweep
            )
            for first, last in ((middle, stop), (start, middle)):
                ranges[top, 0], ranges[top, 1], ranges[top, 2], ranges[top, 3] = first, last, allowed - 1, node
                top += 1
        nodes[node].parent = parent
        if parent != NONE:
            if nodes[parent].left == NONE:
                nodes[parent].left = node
            else:
                nodes[parent].right = node
    for i in range(made_count - 1, -1, -1):
        adopt(nodes, heights, np.int64(made[i]))
    return np.int64(made[0])


@lean_kernel
def put_item(nodes, items, place, node):
    here, item = nodes[node], items[place]
    item.left = node
    for axis in range(here.lo.shape[0]):
        item.lo[axis] = here.lo[axis]
        item.hi[axis] = here.hi[axis]


@lean_kernel
def dissolve(nodes, heights, state, root, items, cut):
    """Free the inner nodes from `root` down to subtrees of height `cut`; return how many of those, named in `items`."""
    stack = stack_array(DEEPEST, np.int64)
    stack[0], top, count = root, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        if heights[node] <= cut:
            put_item(nodes, items, count, node)
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
def rebuild_subtree(nodes, heights, state, root, count, levels, all_axes):
    """Build the subtree below `root` again over its `count` leaves, within `levels` levels; return its new root."""
    parent = np.int64(nodes[root].parent)
    items = np.empty(count, nodes.dtype)
    # The place in the parent is kept by a mark, since `root` itself may be freed and taken again.
    on_left = parent != NONE and nodes[parent].left == root
    dissolve(nodes, heights, state, root, items, 0)
    fresh = build(nodes, heights, state, items, count, levels, all_axes)
    nodes[fresh].parent = parent
    if parent == NONE:
        state[ROOT] = fresh
    elif on_left:
        nodes[parent].left = fresh
    else:
        nodes[parent].right = fresh
    return fresh


@inlined
def height_limit(count):
    """At most 4 log2(count) + 4."""
    return 4 * floor_log2(count) + 4


@lean_kernel
def build_levels(count):
    """Levels that a bulk build may use: enough for SAH to have its way in real scenes, few enough to leave insertions room."""
    return 3 * floor_log2(count) + 2


@kernel
def rebalance(nodes, heights, state, count):
    """Rebuild balanced what makes the tree higher than `height_limit` (a scapegoat, Galperin and Rivest 1993)."""
    while heights[state[ROOT]] > height_limit(count):
        node = state[ROOT]
        while not is_leaf(node):  # to the deepest leaf
            left, right = np.int64(nodes[node].left), np.int64(nodes[node].right)
            node = left if heights[left] > heights[right] else right
        leaves = 1
        while heights[node] <= 2 * floor_log2(leaves) + 2:  # up to the first subtree that is too high for its leaves
            parent = np.int64(nodes[node].parent)
            other = np.int64(nodes[parent].right if nodes[parent].left == node else nodes[parent].left)
            leaves += count_leaves(nodes, other)
            node = parent
        node = rebuild_subtree(nodes, heights, state, node, leaves, levels_needed(leaves) + 1, True)
        node = np.int64(nodes[node].parent)
        while node != NONE:
            adopt(nodes, heights, node)
            node = np.int64(nodes[node].parent)


@kernel
def build_all(nodes, heights, handles, state, all_axes):
    """Build the whole tree again over every live slot."""
    count, placed = state[COUNT], 0
    if count == 0:
        state[ROOT] = NONE
        return
    items = np.empty(count, nodes.dtype)
    if state[ROOT] != NONE:
        dissolve(nodes, heights, state, state[ROOT], items, 0)
    for slot in range(handles.shape[0]):
        if handles[slot] >= 0:
            put_item(nodes, items, placed, 2 * slot)
            placed += 1
    levels = build_levels(count)
    state[ROOT] = build(nodes, heights, state, items, count, levels, all_axes)
    nodes[state[ROOT]].parent = NONE


@kernel
def refit_all(nodes, heights, root):
    """Make every inner box tight again, children before parents, without changing the tree's shape."""
    if is_leaf(root):
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




@inlined
def keep_height(nodes, heights, state):
    """After a change: nothing to do but compare two numbers, nearly always."""
    if heights[state[ROOT]] > height_limit(state[COUNT]):
        rebalance(nodes, heights, state, state[COUNT])


TREELET = 256  # leaves of a subtree that `optimize` rebuilds at once: small enough for the first-level cache


@kernel
def optimize(nodes, heights, state):
    """Rebuild every treelet by SAH, then the tree's top over them: cheaper than a whole build, and the leaves' neighbours stay."""
    count = state[COUNT]
    if count > 2:
        root = state[ROOT]
        rebuild_subtree(nodes, heights, state, root, count, build_levels(count), True)
