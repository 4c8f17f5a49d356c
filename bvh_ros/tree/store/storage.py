# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arrays of a tree, which are replaced only all at once.

Where there is no more room, larger arrays are made and named as heir of the old ones. One kernel
fills them, and forbids to change the old ones for ever; then they are the tree's. A call that is
interrupted in between leaves the rest to the next call, which finds the heir.
"""

import functools
import mmap
import os
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import entry_point, lean_kernel
from ..nodes import (
    ALL_PLACES,
    CHANGES,
    COUNT,
    FREE_INNER,
    FREE_LEAF,
    NONE,
    RECENT_PLACES,
    REMOVED,
    ROOT,
    SERIAL,
    TURN,
    WRITTEN,
    Tree,
    View,
    aligned_empty,
    box_dtype,
    empty_tree,
    entry_points,
    leaf_box,
    link_free,
    node_dtype,
    note_all_written,
)
from .turns import (
    ANY_VERSION,
    CHANGED,
    CHANGING,
    UNFILLED,
    add_atomically,
    begin_change,
    end_change,
    replace_atomically,
)


def touch(array: NDArray[Any]) -> None:
    """Have the system give the memory of a new array now: write to each page what is there."""
    array.view(np.uint8)[:: mmap.PAGESIZE] += 0


def copy_bytes(array: NDArray[Any], into: NDArray[Any]) -> None:
    """Copy an array to the begin of another one: of records numpy would copy field by field."""
    into.view(np.uint8)[: array.nbytes] = array.view(np.uint8)


READ_ONLY = -1


class Storage(NamedTuple):
    """A tree's arrays, and what becomes of them."""

    tree: Tree
    heirs: list['Storage']
    """Once it is outgrown: the first is the heir."""
    process: int
    """Where it was made: a turn that is taken in a forked process may never be given back.
    READ_ONLY: the arrays are those of a mapped file, and a query that never ends has a turn.
    """
    latest: View
    """The tree, whichever version it is of: for the first kernel of a query."""


def storage_of(tree: Tree, process: int) -> Storage:
    """Storage without an heir."""
    return Storage(tree, [], process, View(tree, ANY_VERSION))


def allocate(ndim: int, capacity: int, fat: bool) -> Storage:
    """Storage for so many boxes that waits to be filled."""
    state = np.zeros(ALL_PLACES, np.int64)
    state[TURN] = UNFILLED
    tree = Tree(
        aligned_empty(2 * capacity, node_dtype(ndim)),
        np.empty(2 * capacity, np.int16),
        np.empty(capacity if fat else 0, box_dtype(ndim)),
        np.empty(capacity, np.int64),
        state,
    )
    return storage_of(tree, os.getpid())


def new_storage(ndim: int, capacity: int, fat: bool) -> Storage:
    """Storage of an empty tree, as `clear` leaves it: numpy does that without a kernel to compile,
    and no other object has these arrays yet.
    """
    storage = allocate(ndim, capacity, fat)
    nodes, heights, _, handles, state = storage.tree
    heights.fill(0)
    handles.fill(NONE)
    after = nodes['parent']  # free leaves and inner nodes take turns
    after[:-2] = np.arange(2, len(after), dtype=np.int32)
    after[-2:] = NONE
    state[ROOT], state[FREE_LEAF], state[FREE_INNER], state[SERIAL] = NONE, 0, 1, 1
    state[TURN], state[CHANGES], state[WRITTEN] = 0, 1, RECENT_PLACES + 1
    return storage


@lean_kernel
def clear(tree):
    """Remove all boxes."""
    handles, state = tree.handles, tree.state
    refused = begin_change(state, ANY_VERSION)
    if refused != 0:
        return np.int64(refused)
    state[REMOVED] += state[COUNT]
    state[ROOT], state[COUNT], state[FREE_LEAF], state[FREE_INNER] = NONE, 0, NONE, NONE
    handles[:] = NONE
    link_free(tree.nodes, state, 0, handles.shape[0])
    note_all_written(state)
    end_change(state, True)
    return np.int64(0)


@lean_kernel
def inherit(old, new):
    """Fill an heir, unless it is; CHANGED if the old tree is being changed, or another thread
    fills or changes the heir: handles are looked up without a turn, so none may see it before.

    The turn that this takes at the old tree is that of a query that never ends: it may be read
    further on, but not be changed.
    """
    if replace_atomically(new.state, TURN, UNFILLED, CHANGING) != UNFILLED:
        return np.int64(CHANGED if add_atomically(new.state, TURN, 0) < 0 else 0)
    if add_atomically(old.state, TURN, 1) < 0:
        add_atomically(old.state, TURN, -1)
        new.state[TURN] = UNFILLED
        return np.int64(CHANGED)
    for i in range(old.nodes.shape[0]):
        there, here = old.nodes[i], new.nodes[i]
        here.left, here.right, here.parent = there.left, there.right, there.parent
        here.mask = there.mask
        for axis in range(there.lo.shape[0]):
            here.lo[axis], here.hi[axis] = there.lo[axis], there.hi[axis]
        new.heights[i] = old.heights[i]
    count = old.handles.shape[0]
    for slot in range(new.handles.shape[0]):
        new.handles[slot] = old.handles[slot] if slot < count else NONE
    for slot in range(min(count, new.tight.shape[0])):
        lo, hi = leaf_box(old.nodes, old.tight, 2 * slot)
        box = new.tight[slot]
        for axis in range(lo.shape[0]):
            box.lo[axis], box.hi[axis] = lo[axis], hi[axis]
    for place in range(old.state.shape[0]):
        if place != TURN:
            new.state[place] = old.state[place]
    new.heights[old.nodes.shape[0] :] = 0
    link_free(new.nodes, new.state, count, new.handles.shape[0])
    add_atomically(new.state, TURN, -CHANGING)
    return np.int64(0)


clear_entry = entry_points(clear)


@functools.cache
def inherit_entry(ndim: int) -> Callable[..., Any]:
    """The machine code of `inherit`."""
    return entry_point(inherit, empty_tree(ndim), empty_tree(ndim))
