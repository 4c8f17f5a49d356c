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
from .build import building
from .build.building import build_anew, is_too_high
from .insertion import insert_leaf, remove_leaf
from .jit.compiling import inlined, lean_kernel
from .jit.intrinsics import stack_array
from .moving import fits, insert_rows, move_leaf, move_rows, remove_rows, write_leaf, write_tight
from .nodes import (
    BUILT_COST,
    BUILT_COUNT,
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
    SHAPES,
    SLOT_BITS,
    SLOT_MASK,
    free_leaf,
    take_leaf,
)
from .store.turns import ANY_VERSION, begin_change, end_change

# Why a change is refused, besides those in `turns`.
FULL, OWING, UNKNOWN, NO_NUMBERS = -3, -4, -5, -6
REASONS = -9  # below are no reasons but handles

# The cost is looked at after so many moves a box; if it has become so much higher than it was
# when built, or the number of boxes so different, the tree is built anew.
REFITS_BEFORE_A_LOOK = 1
WORSE = 1.2

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
    if is_too_high(heights, state) or state[REFITS] >= REFITS_BEFORE_A_LOOK * state[COUNT] > 0:
        state[OWES] = 1
    state[SHAPES] += 1
    owes = state[OWES] != 0
    end_change(state, True)
    return owes


@inlined
def _refuses(handles, state, more):
    """Whether so many more boxes find no place, or no numbers."""
    if more > handles.shape[0] - state[COUNT]:
        return FULL
    return NO_NUMBERS if state[SERIAL] + more - 1 > LAST_SERIAL else 0


@lean_kernel
def insert_one(nodes, heights, tight, handles, state, lo, hi, mask, margin, branch_and_bound):
    """Insert a box: its handle, negative if something is owed then; or why not."""
    refused = _begin_one(state)
    if refused != 0:
        return np.int64(refused)
    refused = _refuses(handles, state, 1)
    if refused != 0:
        end_change(state, False)
        return np.int64(refused)
    still = stack_array(3, np.float64)
    still[0] = still[1] = still[2] = 0.0
    leaf = take_leaf(nodes, state)
    write_leaf(nodes, tight, leaf, lo, hi, margin, still)
    nodes[leaf].mask = mask
    handle = state[SERIAL] << SLOT_BITS | leaf >> 1
    handles[leaf >> 1] = handle
    insert_leaf(nodes, heights, state, leaf, branch_and_bound)
    state[SERIAL] += 1
    state[INSERTED] += 1
    return -handle if _end_one(heights, state) else handle


@inlined
def _slot_of(handles, handle):
    slot = handle & SLOT_MASK
    return slot if slot < handles.shape[0] and handles[slot] == handle else NONE


@lean_kernel
def remove_one(nodes, heights, tight, handles, state, handle):
    """Remove a box: 1, or 2 if something is owed then; or why not."""
    refused = _begin_one(state)
    if refused != 0:
        return np.int64(refused)
    slot = _slot_of(handles, handle)
    if slot == NONE:
        end_change(state, False)
        return np.int64(UNKNOWN)
    remove_leaf(nodes, heights, state, 2 * slot)
    free_leaf(nodes, state, 2 * slot)
    handles[slot] = NONE
    state[REMOVED] += 1
    return np.int64(1 + _end_one(heights, state))


@lean_kernel
def move_one(
    nodes, heights, tight, handles, state, handle, lo, hi, margin, displacement, branch_and_bound
):
    """Move a box: 0 if it stays in its fat box, else 1, or 2 if something is owed then; or why
    not.
    """
    refused = _begin_one(state)
    if refused != 0:
        return np.int64(refused)
    slot = _slot_of(handles, handle)
    if slot == NONE:
        end_change(state, False)
        return np.int64(UNKNOWN)
    leaf = 2 * slot
    if fits(nodes, tight, leaf, lo, hi, margin, displacement):
        write_tight(tight, leaf, lo, hi)
        state[KEPT] += 1
        end_change(state, True)
        return np.int64(0)
    move_leaf(nodes, heights, tight, state, leaf, lo, hi, margin, displacement, branch_and_bound)
    state[REINSERTED] += 1
    state[REFITS] += 1
    return np.int64(1 + _end_one(heights, state))


@lean_kernel
def set_masks(nodes, heights, tight, handles, state, version, slots, masks):
    """Write the masks of leaves, and widen or narrow those of their ancestors."""
    refused = begin_change(state, version)
    if refused != 0:
        return refused
    for i in range(slots.shape[0]):
        node = 2 * slots[i]
        nodes[node].mask = masks[i]
        node = np.int64(nodes[node].parent)
        while node != NONE:
            union = nodes[nodes[node].left].mask | nodes[nodes[node].right].mask
            if nodes[node].mask == union:
                break
            nodes[node].mask = union
            node = np.int64(nodes[node].parent)
    state[SHAPES] += 1
    end_change(state, True)
    return 0


@lean_kernel
def change_many(
    nodes,
    heights,
    tight,
    handles,
    state,
    version,
    how,
    rows,
    boxes,
    masks,
    margin,
    branch_and_bound,
    shares,
    order,
    room,
):
    """Everything that may build a part of the tree anew: the number of rows that changed it, or
    why not.

    INSERT writes handles to `rows`, REMOVE and MOVE take slots from there. `boxes` are lo, hi and
    displacements; `shares` are those of the boxes from which on many are refitted, and far ones
    make the tree be built anew. `order` is scratch, two numbers a row of MOVE; `room` is from
    `building.room_to_build`.
    """
    refused = begin_change(state, version)
    if refused != 0:
        return np.int64(refused)
    if how == INSERT:
        refused = _refuses(handles, state, rows.shape[0])
        if refused != 0:
            end_change(state, False)
            return np.int64(refused)
    lo, hi, _ = boxes
    count = np.int64(0)
    if how == INSERT:
        count = rows.shape[0]
        build = count >= max(2, state[COUNT])
        insert_rows(
            nodes,
            heights,
            tight,
            handles,
            state,
            lo,
            hi,
            masks,
            margin,
            branch_and_bound,
            not build,
            rows,
            room,
        )
        if build:
            build_anew(nodes, heights, handles, state, room)
    elif how == REMOVE:
        count = rows.shape[0]
        remove_rows(nodes, heights, handles, state, rows, room)
    elif how == MOVE:
        arrays = nodes, heights, tight, handles, state
        count = move_rows(arrays, rows, boxes, margin, branch_and_bound, shares, order, room)
    elif how == BUILD:
        build_anew(nodes, heights, handles, state, room)
    elif how == OPTIMIZE:
        building.optimize(nodes, heights, state, room)
    if how != MOVE or count > 0 or state[OWES] != 0:
        _settle(nodes, heights, handles, state, room)
        state[SHAPES] += 1
    end_change(state, True)
    return count


@inlined
def _settle(nodes, heights, handles, state, room):
    """See to all that is owed."""
    building.rebalance(nodes, heights, state, room)
    count, built = state[COUNT], state[BUILT_COUNT]
    if state[REFITS] >= REFITS_BEFORE_A_LOOK * count > 0:
        state[REFITS] = 0
        worse = tree_cost(nodes, state[ROOT]) > WORSE * state.view(np.float64)[BUILT_COST]
        if worse or not 0.8 * built < count < 1.25 * built:
            build_anew(nodes, heights, handles, state, room)
    state[OWES] = 0
