# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every change is one of these kernels: it is done, with all that is booked of it, or it is not
begun.

What a change needs of memory is given to it. A single box has none for the rare case that the
tree gets too high, or that its cost is due for a look: then it leaves a note, OWES, and the next
change of one box is refused until `change_many` has seen to it.
"""

import numpy as np

from .area import tree_cost
from .build.building import (
    build_anew,
    is_due,
    is_too_high,
    look_at_cost,
    optimize,
    rebalance,
    room_to_build,
)
from .compiler import inlined, lean_kernel, stack_array
from .insertion import insert_leaf, remove_leaf
from .moving import (
    LARGEST,
    Change,
    Policy,
    fits,
    insert_rows,
    move_leaf,
    move_rows,
    remove_rows,
    write_leaf,
    write_tight,
)
from .nodes import (
    COUNT,
    INSERTED,
    KEPT,
    LAST_SERIAL,
    NONE,
    OWES,
    REFITS,
    REINSERTED,
    REMOVED,
    ROOT,
    SERIAL,
    SLOT_BITS,
    entry_points,
    find_slot,
    free_leaf,
    note_all_written,
    note_written,
    take_leaf,
)
from .store.turns import ANY_VERSION, begin_change, end_change

# Why a change is refused, besides those in `turns`.
FULL, OWING, UNKNOWN, NO_NUMBERS, NO_BOX = -3, -4, -5, -6, -7
REASONS = -9  # below are no reasons but handles

INSERT, REMOVE, MOVE, BUILD, OPTIMIZE, SETTLE = range(6)


@inlined
def _begin_one(state):
    refused = begin_change(state, ANY_VERSION)
    if refused == 0 and state[OWES] != 0:
        end_change(state, False)
        refused = OWING
    return refused


@inlined
def _end_one(heights, state):
    """True if something is owed."""
    if is_too_high(heights, state) or is_due(state):
        state[OWES] = 1
    owes = state[OWES] != 0
    end_change(state, True)
    return owes


@inlined
def _refuses(handles, state, more):
    """Whether so many more boxes find no place, or no numbers."""
    if more > handles.shape[0] - state[COUNT]:
        return FULL
    return NO_NUMBERS if state[SERIAL] + more - 1 > LAST_SERIAL else 0


@inlined
def _copy_box(lo, hi, box):
    """Copy a box from the caller's memory, lo and hi as rows of `box`; whether it is one: finite,
    and lo <= hi.
    """
    good = True
    for axis in range(lo.shape[0]):
        box[0, axis], box[1, axis] = lo[axis], hi[axis]
        good &= (box[0, axis] >= -LARGEST) & (box[0, axis] <= box[1, axis])
        good &= box[1, axis] <= LARGEST
    return good


@lean_kernel
def insert_one(tree, lo, hi, mask, margin, branch_and_bound):
    """Insert a box, lo and hi of shape (ndim,) float64: its handle, negative if something is owed
    then; or why not.
    """
    nodes, state = tree.nodes, tree.state
    box, still = stack_array((2, 3), np.float64), stack_array(3, np.float64)
    if not _copy_box(lo, hi, box):
        return np.int64(NO_BOX)
    refused = _begin_one(state)
    if refused != 0:
        return np.int64(refused)
    refused = _refuses(tree.handles, state, 1)
    if refused != 0:
        end_change(state, False)
        return np.int64(refused)
    still[0] = still[1] = still[2] = 0.0
    leaf = take_leaf(nodes, state)
    write_leaf(nodes, tree.tight, leaf, box[0], box[1], margin, still)
    nodes[leaf].mask = mask
    handle = state[SERIAL] << SLOT_BITS | leaf >> 1
    tree.handles[leaf >> 1] = handle
    insert_leaf(nodes, tree.heights, state, leaf, branch_and_bound)
    note_written(state, leaf >> 1)
    state[SERIAL] += 1
    state[INSERTED] += 1
    return -handle if _end_one(tree.heights, state) else handle


@lean_kernel
def remove_one(tree, handle):
    """Remove a box: 1, or 2 if something is owed then; or why not."""
    nodes, heights, state = tree.nodes, tree.heights, tree.state
    slot = find_slot(tree.handles, handle)
    if slot == NONE:
        return np.int64(UNKNOWN)
    refused = _begin_one(state)
    if refused != 0:
        return np.int64(refused)
    if tree.handles[slot] != handle:  # another thread was quicker
        end_change(state, False)
        return np.int64(UNKNOWN)
    remove_leaf(nodes, heights, state, 2 * slot)
    free_leaf(nodes, state, 2 * slot)
    tree.handles[slot] = NONE
    note_written(state, slot)
    state[REMOVED] += 1
    return np.int64(1 + _end_one(heights, state))


@lean_kernel
def move_one(tree, handle, lo, hi, margin, displacement, branch_and_bound):
    """Move a box: 0 if it stays in its fat box, else 1, or 2 if something is owed then; or why
    not.
    """
    state, tight = tree.state, tree.tight
    slot = find_slot(tree.handles, handle)
    if slot == NONE:
        return np.int64(UNKNOWN)
    box = stack_array((2, 3), np.float64)
    if not _copy_box(lo, hi, box):
        return np.int64(NO_BOX)
    refused = _begin_one(state)
    if refused != 0:
        return np.int64(refused)
    if tree.handles[slot] != handle:  # another thread was quicker
        end_change(state, False)
        return np.int64(UNKNOWN)
    leaf = 2 * slot
    if fits(tree.nodes, tight, leaf, box[0], box[1], margin, displacement):
        write_tight(tight, leaf, box[0], box[1])
        state[KEPT] += 1
        end_change(state, True)
        return np.int64(0)
    move_leaf(tree, leaf, box[0], box[1], margin, displacement, branch_and_bound)
    state[REINSERTED] += 1
    state[REFITS] += 1
    return np.int64(1 + _end_one(tree.heights, state))


@lean_kernel
def set_masks(tree, version, slots, masks):
    """Write the masks of leaves, and widen or narrow those of their ancestors."""
    nodes, state = tree.nodes, tree.state
    refused = begin_change(state, version)
    if refused != 0:
        return np.int64(refused)
    for i in range(slots.shape[0]):
        node = 2 * slots[i]
        nodes[node].mask = masks[i]
        note_written(state, slots[i])
        node = np.int64(nodes[node].parent)
        while node != NONE:
            union = nodes[nodes[node].left].mask | nodes[nodes[node].right].mask
            if nodes[node].mask == union:
                break
            nodes[node].mask = union
            node = np.int64(nodes[node].parent)
    end_change(state, True)
    return np.int64(0)


@lean_kernel
def change_many(tree, version, how, change, policy, room):
    """Everything that may build a part of the tree anew: the number of rows that changed it, or
    why not. `how` is INSERT and so on, `change` a `moving.Change`, `policy` a `moving.Policy`;
    `room` is from `building.room_to_build`.
    """
    nodes, heights, handles, state = tree.nodes, tree.heights, tree.handles, tree.state
    refused = begin_change(state, version)
    if refused != 0:
        return np.int64(refused)
    count = change.rows.shape[0]
    if how == INSERT:
        refused = _refuses(handles, state, count)
        if refused != 0:
            end_change(state, False)
            return np.int64(refused)
        build = count >= max(2, state[COUNT])
        insert_rows(tree, change, policy, not build, room)
        if build:
            build_anew(nodes, heights, handles, state, room)
    elif how == REMOVE:
        remove_rows(tree, change.rows, room)
    elif how == MOVE:
        count = move_rows(tree, change, policy, room)
    elif how == BUILD:
        build_anew(nodes, heights, handles, state, room)
        note_all_written(state)  # none is, but a snapshot of the better tree is better, too
    elif how == OPTIMIZE:
        optimize(nodes, heights, state, room)
        note_all_written(state)
    if how != MOVE or count > 0 or state[OWES] != 0:
        _settle(nodes, heights, handles, state, room)
    end_change(state, True)
    return np.int64(count)


@inlined
def _settle(nodes, heights, handles, state, room):
    """See to all that is owed."""
    rebalance(nodes, heights, state, room)
    if is_due(state):
        cost = tree_cost(nodes, state[ROOT])
        look_at_cost(nodes, heights, handles, state, room, cost)
    state[OWES] = 0


def compile_ray(ndim: int) -> None:
    """What a tree that gets its first box is nearly always asked next."""
    from .query.ray import one_entry

    one_entry(ndim)


# How Python calls them: by the number of dimensions, see `compiling.entry_points`.
_POINT, _IDS = np.empty(0), np.empty(0, np.int64)
_NUMBERS = np.empty(0, np.uint32), np.empty(0, np.int32)
_CHANGE = Change(_IDS, *(np.empty((0, 3)),) * 3, *_NUMBERS)
_POLICY = Policy(0.0, False, 0.0, 0.0)
insert_entry = entry_points(
    insert_one, _POINT, _POINT, np.uint32(0), 0.0, False, alongside=compile_ray
)
remove_entry = entry_points(remove_one, 0)
move_entry = entry_points(move_one, 0, _POINT, _POINT, 0.0, _POINT, False)
masks_entry = entry_points(set_masks, 0, _IDS, np.empty(0, np.uint32))
many_entry = entry_points(change_many, 0, 0, _CHANGE, _POLICY, room_to_build(0))
