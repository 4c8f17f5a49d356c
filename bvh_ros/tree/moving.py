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

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .build.building import build_anew, is_due, look_at_cost, rebalance, refit_all
from .compiler import inlined, lean_kernel, prefetch, stack_array
from .insertion import insert_leaf, remove_leaf
from .nodes import (
    COUNT,
    INSERTED,
    KEPT,
    NONE,
    RECENT_PLACES,
    REFITS,
    REFITTED,
    REINSERTED,
    REMOVED,
    ROOT,
    SERIAL,
    SLOT_BITS,
    free_leaf,
    note_all_written,
    note_written,
    take_leaf,
)

LARGEST = 1.7976931348623157e308
_AHEAD = 32  # how far ahead free leaves are prefetched: often they lie side by side
LARGEST_FAT = 5.0  # margins and displacements by which a fat box may be larger than the exact one


class Change(NamedTuple):
    """Rows of boxes that are inserted, removed or moved."""

    rows: NDArray[np.int64]
    """Slots; of boxes to insert: room for their handles."""
    lo: NDArray[np.float64]
    """Shape (n, ndim), as the next two."""
    hi: NDArray[np.float64]
    ahead: NDArray[np.float64]
    """Where boxes that move are expected to be next, relative to now; a row for all, or each."""
    masks: NDArray[np.uint32]
    """Of boxes to insert."""
    order: NDArray[np.int32]
    """Scratch: two numbers a box to move."""


class Policy(NamedTuple):
    """How a tree does it."""

    margin: float
    branch_and_bound: bool
    refit_share: float
    """The share of the boxes from which on those that move near by are refitted."""
    rebuild_share: float
    """The share from which on, of those that move far, the tree is built anew."""


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
        slack = LARGEST_FAT * (margin + abs(displacement[axis]))
        low, high = _fat_bounds(lo[axis], hi[axis], slack, 0.0)
        if not (low <= here.lo[axis] <= lo[axis] and hi[axis] <= here.hi[axis] <= high):
            return False
    return True


@lean_kernel
def insert_rows(tree, change, policy, link, room):
    """Insert rows of boxes, with ascending serial numbers; their handles go to `change.rows`. link
    False: the caller builds the tree.
    """
    nodes, state = tree.nodes, tree.state
    still = stack_array(3, np.float64)
    still[0] = still[1] = still[2] = 0.0
    for i in range(change.lo.shape[0]):
        leaf = take_leaf(nodes, state)
        prefetch(nodes, leaf + _AHEAD, 1)
        write_leaf(nodes, tree.tight, leaf, change.lo[i], change.hi[i], policy.margin, still)
        nodes[leaf].mask = change.masks[i]
        tree.heights[leaf] = 0
        slot = leaf >> 1
        tree.handles[slot] = change.rows[i] = (state[SERIAL] + i) << SLOT_BITS | slot
        note_written(state, slot)
        if link:
            insert_leaf(nodes, tree.heights, state, leaf, policy.branch_and_bound)
            rebalance(nodes, tree.heights, state, room)
    state[SERIAL] += change.lo.shape[0]
    state[INSERTED] += change.lo.shape[0]


@lean_kernel
def remove_rows(tree, slots, room):
    for slot in slots:
        remove_leaf(tree.nodes, tree.heights, tree.state, 2 * slot)
        free_leaf(tree.nodes, tree.state, 2 * slot)
        tree.handles[slot] = NONE
        note_written(tree.state, slot)
        rebalance(tree.nodes, tree.heights, tree.state, room)
    tree.state[REMOVED] += slots.shape[0]


@lean_kernel
def move_leaf(tree, leaf, lo, hi, margin, displacement, branch_and_bound):
    """Take the leaf out and insert it at its new place."""
    nodes, heights, state = tree.nodes, tree.heights, tree.state
    remove_leaf(nodes, heights, state, leaf)
    write_leaf(nodes, tree.tight, leaf, lo, hi, margin, displacement)
    insert_leaf(nodes, heights, state, leaf, branch_and_bound)
    note_written(state, leaf >> 1)


@inlined
def _row_ahead(change, row):
    return row if change.ahead.shape[0] > 1 else 0


@inlined
def _is_near(nodes, leaf, lo, hi):
    """Whether a box is still about where its leaf is in the tree: its centre within the
    grandparent, or moved by no more than its own edges.

    Of uniform boxes that move by up to an edge 40 % leave the grandparent's box. Refitted in
    place, such a one widens its ancestors by no more than its own size.
    """
    before, is_near = nodes[leaf], True
    for axis in range(before.lo.shape[0]):
        center = lo[axis] * 0.5 + hi[axis] * 0.5
        # The leaf's box is the fat one: halves do not overflow.
        moved = abs(center * 0.5 - (before.lo[axis] * 0.25 + before.hi[axis] * 0.25))
        is_near &= moved <= hi[axis] * 0.5 - lo[axis] * 0.5
    if is_near:
        return True  # others in memory are not looked at
    parent = np.int64(before.parent)
    if parent == NONE or nodes[parent].parent == NONE:
        return True
    around, inside = nodes[nodes[parent].parent], True
    for axis in range(around.lo.shape[0]):
        center = lo[axis] * 0.5 + hi[axis] * 0.5
        inside &= around.lo[axis] <= center <= around.hi[axis]
    return inside


@lean_kernel
def classify_moves(tree, change, margin, near, far):
    """Number the rows whose box has left its fat box, near and far; return how many of each.

    For the others only the exact box is written.
    """
    nodes, tight, slots = tree.nodes, tree.tight, change.rows
    near_count, far_count = 0, 0
    for i in range(slots.shape[0]):
        leaf, lo, hi = 2 * slots[i], change.lo[i], change.hi[i]
        if fits(nodes, tight, leaf, lo, hi, margin, change.ahead[_row_ahead(change, i)]):
            write_tight(tight, leaf, lo, hi)
        elif _is_near(nodes, leaf, lo, hi):
            near[near_count] = i
            near_count += 1
        else:
            far[far_count] = i
            far_count += 1
    return near_count, far_count


@lean_kernel
def reinsert_rows(tree, rows, change, policy, room):
    state = tree.state
    for row in rows:
        leaf, lo, hi = 2 * change.rows[row], change.lo[row], change.hi[row]
        ahead, branch_and_bound = change.ahead[_row_ahead(change, row)], policy.branch_and_bound
        move_leaf(tree, leaf, lo, hi, policy.margin, ahead, branch_and_bound)
        rebalance(tree.nodes, tree.heights, state, room)
    state[REINSERTED] += rows.shape[0]
    state[REFITS] += rows.shape[0]


@lean_kernel
def write_rows(tree, rows, change, margin):
    for i in rows:
        leaf, lo, hi = 2 * change.rows[i], change.lo[i], change.hi[i]
        write_leaf(
            tree.nodes, tree.tight, leaf, lo, hi, margin, change.ahead[_row_ahead(change, i)]
        )
    if rows.shape[0] > RECENT_PLACES:
        note_all_written(tree.state)
        return
    for i in rows:
        note_written(tree.state, change.rows[i])


@lean_kernel
def move_rows(tree, change, policy, room):
    """Few that leave their fat boxes, and those that go far, are inserted again one by one; many
    that stay near are written in place. Returns how many did either.
    """
    state, order, total = tree.state, change.order, change.rows.shape[0]
    near_count, far_count = classify_moves(
        tree, change, policy.margin, order[:total], order[total:]
    )
    near, far = order[:near_count], order[total : total + far_count]
    count = near_count + far_count
    state[KEPT] += total - count
    if count == 0:
        return count
    if far_count >= policy.rebuild_share * state[COUNT]:
        write_rows(tree, near, change, policy.margin)
        write_rows(tree, far, change, policy.margin)
        build_anew(tree.nodes, tree.heights, tree.handles, state, room)
        return count
    if count >= policy.refit_share * state[COUNT]:
        write_rows(tree, near, change, policy.margin)
        cost = refit_all(tree.nodes, tree.heights, state[ROOT], room.made)
        state[REFITTED] += near_count
        state[REFITS] += near_count
        near = near[:0]
        if far_count == 0 and is_due(state):
            look_at_cost(tree.nodes, tree.heights, tree.handles, state, room, cost)
    for rows in (near, far):
        reinsert_rows(tree, rows, change, policy, room)
    return count
