# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arrays of a tree, which are replaced only all at once.

Where there is no more room, larger arrays are made and named as heir of the old ones. One kernel
fills them, and forbids to change the old ones for ever; then they are the tree's. Whoever is
interrupted in between leaves the rest to the next call, which sees the heir.
"""

import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit.compiling import lean_kernel
from ..nodes import (
    ALL_PLACES,
    COUNT,
    FREE_INNER,
    FREE_LEAF,
    NONE,
    REMOVED,
    ROOT,
    SERIAL,
    SHAPES,
    TURN,
    aligned_empty,
    box_dtype,
    link_free,
    node_dtype,
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


class Storage(NamedTuple):
    """What kernels read and write, see `nodes`; they take the first five."""

    nodes: NDArray[Any]
    heights: NDArray[np.int16]
    tight: NDArray[Any]
    """Exact boxes by slot where nodes are fat, else empty."""
    handles: NDArray[np.int64]
    """By slot, NONE where it is free."""
    state: NDArray[np.int64]
    heirs: list['Storage']
    """Once it is outgrown: the first is the heir."""
    process: int
    """Where it was made: a turn that is taken in a forked process may never be given back."""


def allocate(ndim: int, capacity: int, fat: bool) -> Storage:
    """Storage for so many boxes that waits to be filled."""
    state = np.zeros(ALL_PLACES, np.int64)
    state[TURN] = UNFILLED
    return Storage(
        aligned_empty(2 * capacity, node_dtype(ndim)),
        np.empty(2 * capacity, np.int16),
        np.empty(capacity if fat else 0, box_dtype(ndim)),
        np.empty(capacity, np.int64),
        state,
        [],
        os.getpid(),
    )


def new_storage(ndim: int, capacity: int, fat: bool) -> Storage:
    """Storage of an empty tree."""
    storage = allocate(ndim, capacity, fat)
    storage.heights.fill(0)
    storage.state[TURN], storage.state[SERIAL] = 0, 1
    clear(*storage[:5])
    return storage


@lean_kernel
def clear(nodes, heights, tight, handles, state):
    """Remove all boxes."""
    refused = begin_change(state, ANY_VERSION)
    if refused != 0:
        return refused
    state[REMOVED] += state[COUNT]
    state[ROOT], state[COUNT], state[FREE_LEAF], state[FREE_INNER] = NONE, 0, NONE, NONE
    handles[:] = NONE
    link_free(nodes, state, 0, handles.shape[0])
    state[SHAPES] += 1
    end_change(state, True)
    return 0


@lean_kernel
def inherit(
    nodes,
    heights,
    tight,
    handles,
    state,
    new_nodes,
    new_heights,
    new_tight,
    new_handles,
    new_state,
):
    """Fill an heir, unless it is; CHANGED if the old storage is being changed.

    The turn that this takes at the old storage is that of a query that never ends: it may be read
    further on, but not be changed.
    """
    if replace_atomically(new_state, TURN, UNFILLED, CHANGING) != UNFILLED:
        return 0
    if add_atomically(state, TURN, 1) < 0:
        add_atomically(state, TURN, -1)
        new_state[TURN] = UNFILLED
        return CHANGED
    for i in range(nodes.shape[0]):
        old, new = nodes[i], new_nodes[i]
        new.left, new.right, new.parent, new.mask = old.left, old.right, old.parent, old.mask
        for axis in range(old.lo.shape[0]):
            new.lo[axis], new.hi[axis] = old.lo[axis], old.hi[axis]
        new_heights[i] = heights[i]
    count = handles.shape[0]
    for slot in range(new_handles.shape[0]):
        new_handles[slot] = handles[slot] if slot < count else NONE
    for slot in range(new_tight.shape[0] if new_tight.shape[0] < count else count):
        box = new_tight[slot]
        for axis in range(box.lo.shape[0]):
            if tight.shape[0] > 0:
                box.lo[axis], box.hi[axis] = tight[slot].lo[axis], tight[slot].hi[axis]
            else:
                leaf = nodes[2 * slot]
                box.lo[axis], box.hi[axis] = leaf.lo[axis], leaf.hi[axis]
    for place in range(state.shape[0]):
        if place != TURN:
            new_state[place] = state[place]
    new_heights[nodes.shape[0] :] = 0
    link_free(new_nodes, new_state, count, new_handles.shape[0])
    add_atomically(new_state, TURN, -CHANGING)
    return 0
