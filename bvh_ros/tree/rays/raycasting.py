# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays through the binary tree: the first hit, any hit or all of them, with one traversal.

The nearer child first, the other on a stack with its entry distance, and no visit to what is
entered after the best hit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import stack_array
from ..nodes import DEEPEST, NONE, ROOT, is_leaf, leaf_box
from ..store.turns import IS_CHANGED, begin_query, count_rays, end_query
from .slab import (
    EXACT,
    INSIDE,
    PAD,
    RAY_ROWS,
    TINY,
    compare_hits,
    intersect_exact,
    intersect_node,
    prepare_ray,
    set_ray,
    traversal_distance,
)

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

CLOSEST, ANY, EVERY = range(3)


@lean_kernel
def raycast(
    nodes, tight, handles, root, ray, t_max, mask, skip_inside, mode, slots, ts, axes, filled
):
    """Cast one ray and write its hits to (slots, ts, axes) from `filled` on; return where the next
    would go.

    CLOSEST leaves one hit or none, ANY the first one found, EVERY all, in no order. A return
    beyond the arrays' end says how large they should have been: what did not fit is counted, not
    written.
    """
    if root == NONE or nodes[root].mask & mask == 0:
        return filled
    scale, wide = prepare_ray(ray, nodes[root].lo, nodes[root].hi)
    limit = traversal_distance(t_max, scale)
    begin, best = filled, np.int64(NONE)
    stack, entries = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64)
    stack[0], entries[0], top = (
        root,
        intersect_node(nodes[root].lo, nodes[root].hi, ray, limit, wide),
        1,
    )
    while top > 0:
        top -= 1
        if entries[top] == np.inf or entries[top] > limit * PAD + TINY:
            continue
        node, top = descend(nodes, ray, limit, wide, mask, stack, entries, stack[top], top)
        if node == NONE:
            continue
        lo, hi = leaf_box(nodes, tight, node)
        hit, t, axis = intersect_exact(lo, hi, ray, t_max)
        if not hit or (skip_inside and axis == INSIDE):
            continue
        slot = np.int64(node >> 1)
        place = filled
        if mode == CLOSEST:
            if best != NONE and not is_before(
                nodes, tight, handles, ray, slot, t, axis, best, ts[begin], axes[begin]
            ):
                continue
            best, place = slot, begin
            limit = traversal_distance(t, scale)
        if place < slots.shape[0]:
            slots[place], ts[place], axes[place] = slot, t, axis
        filled = place + 1
        if mode == ANY:
            break
    return filled


@inlined
def descend(nodes, ray, limit, wide, mask, stack, entries, node, top):
    """Follow the nearer child down to a leaf, putting the others on the stack; (leaf or NONE, top
    of the stack).
    """
    while not is_leaf(node):
        first, second = np.int64(nodes[node].left), np.int64(nodes[node].right)
        first_entry, second_entry = np.inf, np.inf
        if nodes[first].mask & mask != 0:
            first_entry = intersect_node(nodes[first].lo, nodes[first].hi, ray, limit, wide)
        if nodes[second].mask & mask != 0:
            second_entry = intersect_node(nodes[second].lo, nodes[second].hi, ray, limit, wide)
        if second_entry < first_entry:
            first, second = second, first
            first_entry, second_entry = second_entry, first_entry
        if first_entry == np.inf:
            return np.int64(NONE), top
        if second_entry < np.inf:
            stack[top], entries[top] = second, second_entry
            top += 1
        node = first
    return node, top


@lean_kernel
def is_before(nodes, tight, handles, ray, slot, t, axis, other, other_t, other_axis):
    """Whether the first of two hits of a ray is the nearer, or as near with the smaller handle."""
    lo, hi = leaf_box(nodes, tight, 2 * slot)
    other_lo, other_hi = leaf_box(nodes, tight, 2 * other)
    order = compare_hits(lo, hi, t, axis, other_lo, other_hi, other_t, other_axis, ray)
    return order < 0 or (order == 0 and handles[slot] < handles[other])


@lean_kernel
def raycast_every_row(
    nodes,
    tight,
    handles,
    state,
    version,
    ray,
    origins,
    directions,
    t_max,
    masks,
    skip_inside,
    offsets,
    found,
    first,
):
    """All hits of every ray from `first` on; those of ray i go to [offsets[i], offsets[i + 1]) of
    the arrays `found`: slots, ts and axes, in no order. `ray` is scratch.

    Returns (rays done, room wanted): fewer than there are where there is no room for the hits of
    the next one, negative if the tree is changed meanwhile.
    """
    if not begin_query(state, version):
        return np.int64(-1), np.int64(0)
    slots, ts, axes = found
    done, exact, end = np.int64(first), np.int64(0), np.int64(0)
    while done < origins.shape[0]:
        set_ray(ray, origins[done], directions[done])
        end = raycast(
            nodes,
            tight,
            handles,
            state[ROOT],
            ray,
            t_max[done],
            masks[done],
            skip_inside,
            EVERY,
            slots,
            ts,
            axes,
            offsets[done],
        )
        if end > slots.shape[0]:
            break
        exact += np.int64(ray[EXACT, 0])
        done += 1
        offsets[done] = end
    count_rays(state, done - first, exact)
    end_query(state)
    return done, np.int64(end)


@lean_kernel
def sort_hits_exactly(nodes, tight, handles, ray, origins, directions, offsets, slots, ts, axes):
    """Bring hits that are sorted by computed distance into the order of the exact one, then of
    handles. `ray` is scratch.

    Few are out of place, so insertion does it. Each t then becomes the largest up to it: within 2
    ulp still, and never falling.
    """
    for i in range(origins.shape[0]):
        set_ray(ray, origins[i], directions[i])
        for j in range(offsets[i] + 1, offsets[i + 1]):
            slot, t, axis = slots[j], ts[j], axes[j]
            place = j
            while place > offsets[i] and is_before(
                nodes,
                tight,
                handles,
                ray,
                slot,
                t,
                axis,
                slots[place - 1],
                ts[place - 1],
                axes[place - 1],
            ):
                slots[place], ts[place], axes[place] = (
                    slots[place - 1],
                    ts[place - 1],
                    axes[place - 1],
                )
                place -= 1
            slots[place], ts[place], axes[place] = slot, t, axis
        for j in range(offsets[i] + 1, offsets[i + 1]):
            ts[j] = max(ts[j], ts[j - 1])


def every_hit(
    view: Any, starts: Floats, ways: Floats, t_max: Floats, masks: Any, skip_inside: bool
) -> tuple[Ids, Ids, Floats, Ids]:
    """All hits of all rays in their order, with as much room as it takes: offsets, slots, t and
    axes entered. RuntimeError if the tree is changed before they are found.
    """
    count = len(starts)
    offsets = np.zeros(count + 1, np.int64)
    scratch = np.empty((RAY_ROWS, starts.shape[1]))
    asked = starts, ways, t_max, masks, skip_inside, offsets
    done, found = 0, _room_for_hits(64)
    while done < count:
        done, wanted = raycast_every_row(*view, scratch, *asked, found, done)
        if done < 0:
            raise RuntimeError(IS_CHANGED)
        if done < count:
            full, found = found, _room_for_hits(max(2 * len(found[0]), wanted))
            for old, new in zip(full, found, strict=True):
                new[: len(old)] = old
    nodes, tight, handles, _, _ = view
    total = offsets[-1]
    slots, ts, axes = found[0][:total], found[1][:total], found[2][:total]
    order = np.lexsort((handles[slots], ts, np.repeat(np.arange(count), np.diff(offsets))))
    slots, ts, axes = slots[order], ts[order], axes[order]
    sort_hits_exactly(nodes, tight, handles, scratch, starts, ways, offsets, slots, ts, axes)
    return offsets, slots, ts, axes


def _room_for_hits(count: int) -> tuple[Ids, Floats, Ids]:
    return np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64)
