# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays through the binary tree: the first hit, any hit or all of them, with one traversal.

The nearer child first, the other on a stack with its entry distance, and no visit to what is entered after the best hit.
"""

import numpy as np

from .compiling import kernel
from .nodes import NONE, ROOT, is_leaf, leaf_box
from .overlapping import grown
from .slab import DIRECTION, INSIDE, ORIGIN, PAD, TINY, compare_hits, enters, meets, prepare_ray, traversal_distance

CLOSEST, ANY, EVERY = range(3)


@kernel
def raycast(nodes, heights, tight, handles, root, ray, t_max, mask, skip_inside, mode, slots, ts, axes, filled):
    """Cast one ray; append hits to (slots, ts, axes) from `filled` on and return the arrays, grown if need be, and the new count.

    CLOSEST leaves one hit or none, ANY the first one found, EVERY all, in no order.
    """
    if root == NONE or nodes[root].mask & mask == 0:
        return slots, ts, axes, filled
    scale, wide = prepare_ray(ray, nodes[root].lo, nodes[root].hi)
    limit = traversal_distance(t_max, scale)
    best = NONE
    begin = filled
    height = np.int64(heights[root])
    stack, entries = np.empty(height + 2, np.int64), np.empty(height + 2)
    stack[0], entries[0], top = root, enters(nodes[root].lo, nodes[root].hi, ray, limit, wide), 1
    while top > 0:
        top -= 1
        node = stack[top]
        if entries[top] > limit * PAD + TINY or entries[top] == np.inf:
            continue
        while not is_leaf(node):
            first, second = np.int64(nodes[node].left), np.int64(nodes[node].right)
            first_entry = second_entry = np.inf
            if nodes[first].mask & mask != 0:
                first_entry = enters(nodes[first].lo, nodes[first].hi, ray, limit, wide)
            if nodes[second].mask & mask != 0:
                second_entry = enters(nodes[second].lo, nodes[second].hi, ray, limit, wide)
            if second_entry < first_entry:
                first, second = second, first
                first_entry, second_entry = second_entry, first_entry
            if first_entry == np.inf:
                node = NONE
                break
            if second_entry < np.inf:
                stack[top], entries[top] = second, second_entry
                top += 1
            node = first
        if node == NONE:
            continue
        lo, hi = leaf_box(nodes, tight, node)
        hit, t, axis = meets(lo, hi, ray, t_max)
        if not hit or (skip_inside and axis == INSIDE):
            continue
        slot = node >> 1
        if mode == CLOSEST and best != NONE:
            best_lo, best_hi = leaf_box(nodes, tight, 2 * best)
            order = compare_hits(lo, hi, t, axis, best_lo, best_hi, ts[begin], axes[begin], ray)
            if order > 0 or (order == 0 and handles[slot] > handles[best]):
                continue
        elif filled == slots.shape[0]:
            slots, ts, axes = grown(slots), grown(ts), grown(axes)
        best = slot
        place = begin if mode == CLOSEST else filled
        slots[place], ts[place], axes[place] = slot, t, axis
        filled = place + 1
        if mode == CLOSEST:
            limit = traversal_distance(t, scale)
        elif mode == ANY:
            break
    return slots, ts, axes, filled


@kernel
def _load_ray(ray, origins, directions, i):
    for axis in range(origins.shape[1]):
        ray[ORIGIN, axis] = origins[i, axis]
        ray[DIRECTION, axis] = directions[i, axis]


@kernel
def raycast_rows(
    nodes, heights, tight, handles, root, origins, directions, t_max, masks, skip_inside, mode, start, stop, slots, ts, axes
):
    """First (CLOSEST) or any hit (ANY) of the rays [start, stop); slot NONE and t inf where there is none."""
    ray = np.empty((3, origins.shape[1]))
    for i in range(start, stop):
        _load_ray(ray, origins, directions, i)
        filled = raycast(
            nodes, heights, tight, handles, root, ray, t_max[i], masks[i], skip_inside, mode, slots, ts, axes, i
        )[3]
        if filled == i:
            slots[i], ts[i], axes[i] = NONE, np.inf, INSIDE


@kernel
def raycast_every_row(nodes, heights, tight, handles, root, origins, directions, t_max, masks, skip_inside, offsets):
    """All hits of every ray, as (slots, ts, axes); those of ray i stand at [offsets[i], offsets[i + 1]), in no order."""
    ray = np.empty((3, origins.shape[1]))
    slots, ts, axes, filled = np.empty(64, np.int64), np.empty(64), np.empty(64, np.int64), 0
    for i in range(origins.shape[0]):
        _load_ray(ray, origins, directions, i)
        slots, ts, axes, filled = raycast(
            nodes, heights, tight, handles, root, ray, t_max[i], masks[i], skip_inside, EVERY, slots, ts, axes, filled
        )
        offsets[i + 1] = filled
    return slots[:filled], ts[:filled], axes[:filled]


@kernel
def settle_order(nodes, tight, handles, origins, directions, offsets, slots, ts, axes):
    """Bring hits that are sorted by computed distance into the order of the exact one, then of handles.

    Few are out of place, so insertion does it. Each t then becomes the largest up to it: within 2 ulp still, and never falling.
    """
    ray = np.empty((3, origins.shape[1]))
    for i in range(origins.shape[0]):
        _load_ray(ray, origins, directions, i)
        for j in range(offsets[i] + 1, offsets[i + 1]):
            slot, t, axis = slots[j], ts[j], axes[j]
            lo, hi = leaf_box(nodes, tight, 2 * slot)
            place = j
            while place > offsets[i]:
                other = slots[place - 1]
                other_lo, other_hi = leaf_box(nodes, tight, 2 * other)
                order = compare_hits(lo, hi, t, axis, other_lo, other_hi, ts[place - 1], axes[place - 1], ray)
                if order > 0 or (order == 0 and handles[slot] > handles[other]):
                    break
                slots[place], ts[place], axes[place] = other, ts[place - 1], axes[place - 1]
                place -= 1
            slots[place], ts[place], axes[place] = slot, t, axis
        for j in range(offsets[i] + 1, offsets[i + 1]):
            ts[j] = max(ts[j], ts[j - 1])
