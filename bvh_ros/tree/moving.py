# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many boxes in, out or elsewhere in one call, with fat boxes (Catto, GDC 2019) and the three ways
to move many.

A fat box is the exact one grown by the margin, and on the side of a predicted displacement by
that. While the exact box stays in it the tree has nothing to do. A fat box far larger than a new
one would be (five margins, five displacements) is replaced, so that a box that was large or fast
for one tick does not stay large.

These are parts of `changing.change_many`; `room` is from `building.room_to_build`.
"""

import numpy as np

from .build.building import build_anew, rebalance, refit_all
from .insertion import insert_leaf, remove_leaf
from .jit.compiling import inlined, lean_kernel
from .jit.intrinsics import stack_array
from .nodes import (
    COUNT,
    INSERTED,
    KEPT,
    NONE,
    REFITS,
    REFITTED,
    REINSERTED,
    REMOVED,
    ROOT,
    SERIAL,
    SLOT_BITS,
    free_leaf,
    take_leaf,
)

LARGEST = 1.7976931348623157e308
SLACK = 5.0


@inlined
def _fat_bounds(lo, hi, margin, displacement):
    low = lo - margin + min(displacement, 0.0)
    high = hi + margin + max(displacement, 0.0)
    return max(low, -LARGEST), min(high, LARGEST)


@inlined
def write_leaf(nodes, tight, leaf, lo, hi, margin, displacement):
    """Write the boxes of a leaf: the fat one into its node, the exact one beside it where boxes
    are fat.
    """
    here = nodes[leaf]
    for axis in range(here.lo.shape[0]):
        here.lo[axis], here.hi[axis] = _fat_bounds(lo[axis], hi[axis], margin, displacement[axis])
    write_tight(tight, leaf, lo, hi)


@inlined
def write_tight(tight, leaf, lo, hi):
    if tight.shape[0] > 0:
        box = tight[leaf >> 1]
        for axis in range(box.lo.shape[0]):
            box.lo[axis], box.hi[axis] = lo[axis], hi[axis]


@inlined
def fits(nodes, tight, leaf, lo, hi, margin, displacement):
    """Whether the leaf's node may stay as it is: it contains the box and is not far larger than it
    need be.
    """
    here = nodes[leaf]
    for axis in range(here.lo.shape[0]):
        if tight.shape[0] == 0:
            if here.lo[axis] != lo[axis] or here.hi[axis] != hi[axis]:
                return False
            continue
        slack = SLACK * (margin + abs(displacement[axis]))
        low, high = _fat_bounds(lo[axis], hi[axis], slack, 0.0)
        if not (low <= here.lo[axis] <= lo[axis] and hi[axis] <= here.hi[axis] <= high):
            return False
    return True


@lean_kernel
def insert_rows(
    nodes, heights, tight, handles, state, lo, hi, masks, margin, branch_and_bound, link, new, room
):
    """Insert rows of boxes, with ascending serial numbers; their handles go to `new`. link False:
    the caller builds the tree.
    """
    still = stack_array(3, np.float64)
    still[0] = still[1] = still[2] = 0.0
    for i in range(lo.shape[0]):
        leaf = take_leaf(nodes, state)
        write_leaf(nodes, tight, leaf, lo[i], hi[i], margin, still)
        nodes[leaf].mask = masks[i]
        heights[leaf] = 0
        slot = leaf >> 1
        handles[slot] = new[i] = (state[SERIAL] + i) << SLOT_BITS | slot
        if link:
            insert_leaf(nodes, heights, state, leaf, branch_and_bound)
            rebalance(nodes, heights, state, room)
    state[SERIAL] += lo.shape[0]
    state[INSERTED] += lo.shape[0]


@lean_kernel
def remove_rows(nodes, heights, handles, state, slots, room):
    for i in range(slots.shape[0]):
        leaf = 2 * slots[i]
        remove_leaf(nodes, heights, state, leaf)
        free_leaf(nodes, state, leaf)
        handles[slots[i]] = NONE
        rebalance(nodes, heights, state, room)
    state[REMOVED] += slots.shape[0]


@lean_kernel
def move_leaf(nodes, heights, tight, state, leaf, lo, hi, margin, displacement, branch_and_bound):
    """Take the leaf out and insert it at its new place."""
    remove_leaf(nodes, heights, state, leaf)
    write_leaf(nodes, tight, leaf, lo, hi, margin, displacement)
    insert_leaf(nodes, heights, state, leaf, branch_and_bound)


@inlined
def _is_near(nodes, leaf, lo, hi):
    """Whether a box is still about where its leaf is in the tree: its centre within the
    grandparent, or moved by no more than its own edges.

    Of uniform boxes that move by up to an edge 40 % leave the grandparent's box. Refitted in
    place, such a one widens its ancestors by no more than its own size.
    """
    parent = np.int64(nodes[leaf].parent)
    if parent == NONE or nodes[parent].parent == NONE:
        return True
    around, before = nodes[nodes[parent].parent], nodes[leaf]
    inside = beside = True
    for axis in range(around.lo.shape[0]):
        center = lo[axis] * 0.5 + hi[axis] * 0.5
        inside &= around.lo[axis] <= center <= around.hi[axis]
        # The leaf's box is the fat one: halves do not overflow.
        moved = abs(center * 0.5 - (before.lo[axis] * 0.25 + before.hi[axis] * 0.25))
        beside &= moved <= hi[axis] * 0.5 - lo[axis] * 0.5
    return inside or beside


@lean_kernel
def classify_moves(nodes, tight, slots, lo, hi, margin, displacements, near, far):
    """Number the rows whose box has left its fat box, near and far; return how many of each.

    For the others only the exact box is written.
    """
    near_count, far_count = 0, 0
    for i in range(slots.shape[0]):
        leaf = 2 * slots[i]
        if fits(nodes, tight, leaf, lo[i], hi[i], margin, displacements[i]):
            write_tight(tight, leaf, lo[i], hi[i])
        elif _is_near(nodes, leaf, lo[i], hi[i]):
            near[near_count] = i
            near_count += 1
        else:
            far[far_count] = i
            far_count += 1
    return near_count, far_count


@lean_kernel
def reinsert_rows(
    nodes,
    heights,
    tight,
    state,
    rows,
    slots,
    lo,
    hi,
    margin,
    displacements,
    branch_and_bound,
    room,
):
    for row in rows:
        move_leaf(
            nodes,
            heights,
            tight,
            state,
            2 * slots[row],
            lo[row],
            hi[row],
            margin,
            displacements[row],
            branch_and_bound,
        )
        rebalance(nodes, heights, state, room)
    state[REINSERTED] += rows.shape[0]
    state[REFITS] += rows.shape[0]


@lean_kernel
def write_rows(nodes, tight, rows, slots, lo, hi, margin, displacements):
    for i in rows:
        write_leaf(nodes, tight, 2 * slots[i], lo[i], hi[i], margin, displacements[i])


@lean_kernel
def move_rows(arrays, slots, boxes, margin, branch_and_bound, shares, order, room):
    """Few that leave their fat boxes, and those that go far, are inserted again one by one; many
    that stay near are written in place. Returns how many did either.
    """
    nodes, heights, tight, handles, state = arrays
    lo, hi, ahead = boxes
    total = slots.shape[0]
    near_count, far_count = classify_moves(
        nodes, tight, slots, lo, hi, margin, ahead, order[:total], order[total:]
    )
    near, far = order[:near_count], order[total : total + far_count]
    count = near_count + far_count
    state[KEPT] += total - count
    if count == 0:
        return count
    if far_count >= shares[1] * state[COUNT]:
        write_rows(nodes, tight, near, slots, lo, hi, margin, ahead)
        write_rows(nodes, tight, far, slots, lo, hi, margin, ahead)
        build_anew(nodes, heights, handles, state, room)
        return count
    if count >= shares[0] * state[COUNT]:
        write_rows(nodes, tight, near, slots, lo, hi, margin, ahead)
        refit_all(nodes, heights, state[ROOT], room[2])
        state[REFITTED] += near_count
        state[REFITS] += near_count
        near = near[:0]
    for rows in (near, far):
        reinsert_rows(
            nodes,
            heights,
            tight,
            state,
            rows,
            slots,
            lo,
            hi,
            margin,
            ahead,
            branch_and_bound,
            room,
        )
    return count
