# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Storage: the only place that knows how a node lies in memory.

One record array holds the whole tree. Slot k owns two places in it: node 2k is the leaf of slot k,
and node 2k + 1 is an inner node (any inner node: n leaves have n - 1 of them, wherever one was
free). So a node's number says whether it is a leaf:

    node      0      1      2      3      4      5   ...
            leaf   inner   leaf  inner   leaf  inner
    slot      0             1             2

A node is 64 bytes in 3D: one cache line. Free places form two lists, linked through `parent`.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compiler import entry_point, inlined, lean_kernel

NONE = -1
ALL = 0xFFFFFFFF  # the query mask that sees every box

SLOT_BITS = 26  # 67 million boxes at once, and 2**37 insertions over a tree's life
SLOT_MASK = (1 << SLOT_BITS) - 1
LAST_SERIAL = (1 << (63 - SLOT_BITS)) - 1

# No tree is higher once a change is done, see `height_limit`. During one, a new leaf may
# add a level, and rotations none beyond this: a stack of nodes fits an array of DEEPEST.
HIGHEST = 4 * SLOT_BITS + 4
DEEPEST = 128

# Places in the small state array that kernels read and write. A change is one kernel, which also
# keeps the books: so whatever interrupts Python, they fit the tree.
ROOT, COUNT, FREE_LEAF, FREE_INNER, RAYS, EXACT_RAYS = range(6)
STATE_PLACES = 6  # so far a file holds them
(
    SERIAL,  # of the next insertion
    REFITS,  # boxes moved since the last look at the cost
    BUILT_COUNT,  # boxes, ...
    BUILT_COST,  # ... and cost (a float64) after the last bulk build
    OWES,  # whether the tree is too high or its cost due for a look, see `changing`
    CHANGES,  # the version of the tree
    WRITTEN,  # leaves that were put in, taken out or written anew; the last are RECENT
    TURN,  # see `turns`
    INSERTED,
    REMOVED,
    KEPT,
    REINSERTED,
    REFITTED,
    REBUILDS,
    QUERIES_LEFT,  # until bounds of moving nodes are looked at again, see `motion.bounds`
) = range(6, 21)
RECENT = 21  # here begins a ring of the slots that were written last
RECENT_PLACES = 128
ALL_PLACES = RECENT + RECENT_PLACES
COUNTERS = {
    'inserted': INSERTED,
    'removed': REMOVED,
    'kept': KEPT,
    'reinserted': REINSERTED,
    'refitted': REFITTED,
    'rebuilds': REBUILDS,
}


class Tree(NamedTuple):
    """The arrays of a tree, as kernels read and write them."""

    nodes: NDArray[Any]
    """Of `node_dtype`, shape (2 capacity,)."""
    heights: NDArray[np.int16]
    """Levels below each node."""
    tight: NDArray[Any]
    """Of `box_dtype`: exact boxes by slot where nodes are fat, else empty."""
    handles: NDArray[np.int64]
    """By slot, NONE where it is free."""
    state: NDArray[np.int64]
    """The places above."""


class View(NamedTuple):
    """A tree as it is now, for a query of several steps."""

    tree: Tree
    version: int
    """`state[CHANGES]`: kernels refuse another one."""


# One object for all trees: numba knows a record at once by its address, another one like it only
# by comparing every field, which takes a scalar ray 6 % of its time.
@functools.cache
def node_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a node; the number of dimensions is part of the type, so compiled loops over axes
    are unrolled.
    """
    return np.dtype(
        [
            ('lo', np.float64, (ndim,)),
            ('hi', np.float64, (ndim,)),
            ('left', np.int32),
            ('right', np.int32),
            ('parent', np.int32),
            ('mask', np.uint32),
        ]
    )


@functools.cache
def box_dtype(ndim: int) -> np.dtype[Any]:
    """Record of an exact box; kept beside the nodes only where a margin makes the leaves' boxes
    fat.
    """
    return np.dtype([('lo', np.float64, (ndim,)), ('hi', np.float64, (ndim,))])


def aligned_empty(count: int, dtype: np.dtype[Any], alignment: int = 64) -> NDArray[Any]:
    """Uninitialised array whose first byte lies on a cache line, so that a 64-byte record never
    straddles two.
    """
    buffer = np.empty(count * dtype.itemsize + alignment, np.uint8)
    start = -buffer.ctypes.data % alignment
    return buffer[start : start + count * dtype.itemsize].view(dtype)


@functools.cache
def empty_tree(ndim: int) -> Tree:
    """Arrays without places, to tell a compiler the types."""
    numbers, nodes = np.empty(0, np.int64), np.empty(0, node_dtype(ndim))
    return Tree(nodes, np.empty(0, np.int16), np.empty(0, box_dtype(ndim)), numbers, numbers)


@inlined
def floor_log2(count):
    return math.frexp(float(count))[1] - 1


@inlined
def height_limit(count):
    """At most 4 log2(count) + 4."""
    return 4 * floor_log2(count) + 4


@inlined
def is_leaf(node):
    return node & 1 == 0


@inlined
def slot_of(handle):
    """The slot that a live handle names."""
    return handle & SLOT_MASK


@inlined
def find_slot(handles, handle):
    """The slot of a handle, NONE if it names no box."""
    slot = handle & SLOT_MASK
    if handle >= 0 and slot < handles.shape[0] and handles[slot] == handle:
        return slot
    return np.int64(NONE)


@inlined
def next_node(nodes, node, below, stack, top):
    """One step of a walk over a subtree, parents first: (the node after `node`, top of the stack);
    NONE after the last one. `below`: whether the children of `node` are walked over.
    """
    if below:
        stack[top] = nodes[node].left
        return np.int64(nodes[node].right), top + 1
    if top == 0:
        return np.int64(NONE), top
    return stack[top - 1], top - 1


@inlined
def note_written(state, slot):
    """Remember that the leaf of a slot is not what it was."""
    state[RECENT + state[WRITTEN] % RECENT_PLACES] = slot
    state[WRITTEN] += 1


@inlined
def note_all_written(state):
    state[WRITTEN] += RECENT_PLACES + 1


@inlined
def leaf_box(nodes, tight, leaf):
    """The exact box of a leaf: beside the nodes where they are fat, else the node's own."""
    if tight.shape[0] > 0:
        box = tight[leaf >> 1]
        return box.lo, box.hi
    node = nodes[leaf]
    return node.lo, node.hi


@lean_kernel
def link_free(nodes, state, start, stop):
    """Put the slots [start, stop) on the free lists, lowest slot first out."""
    for slot in range(stop - 1, start - 1, -1):
        nodes[2 * slot].parent = state[FREE_LEAF]
        nodes[2 * slot + 1].parent = state[FREE_INNER]
        state[FREE_LEAF] = 2 * slot
        state[FREE_INNER] = 2 * slot + 1


@inlined
def take_leaf(nodes, state):
    leaf = state[FREE_LEAF]
    state[FREE_LEAF] = nodes[leaf].parent
    state[COUNT] += 1
    return leaf


@inlined
def take_inner(nodes, state):
    inner = state[FREE_INNER]
    state[FREE_INNER] = nodes[inner].parent
    return inner


@inlined
def free_leaf(nodes, state, leaf):
    nodes[leaf].mask = 0  # hides it in a snapshot that still has it
    nodes[leaf].parent = state[FREE_LEAF]
    state[FREE_LEAF] = leaf
    state[COUNT] -= 1


@inlined
def free_inner(nodes, state, inner):
    nodes[inner].parent = state[FREE_INNER]
    state[FREE_INNER] = inner


@inlined
def replace_child(nodes, state, parent, old, new):
    """Hang `new` where `old` hung; `parent` NONE means that `old` was the root."""
    if parent == NONE:
        state[ROOT] = new
    elif nodes[parent].left == old:
        nodes[parent].left = new
    else:
        nodes[parent].right = new
    nodes[new].parent = parent


@inlined
def refit_node(nodes, heights, node):
    """Make box, mask and height of an inner node those of its children; true if any of them
    changed.
    """
    here = nodes[node]
    left, right = nodes[here.left], nodes[here.right]
    mask = left.mask | right.mask
    height = 1 + max(heights[here.left], heights[here.right])
    changed = mask != here.mask or height != heights[node]
    here.mask = mask
    heights[node] = height
    for axis in range(here.lo.shape[0]):
        lo = min(left.lo[axis], right.lo[axis])
        hi = max(left.hi[axis], right.hi[axis])
        changed |= lo != here.lo[axis] or hi != here.hi[axis]
        here.lo[axis] = lo
        here.hi[axis] = hi
    return changed


# ---- how Python calls the kernels of a tree: as machine code, see `compiling.entry_point`


def entry_points(
    kernel: Any, *arguments: Any, alongside: Callable[[int], object] | None = None
) -> Callable[[int], Callable[..., Any]]:
    """Return what gives, for a number of dimensions, the `entry_point` of a kernel of a tree and
    arguments of these types; compiled or loaded at its first use. An argument whose type depends
    on that number is a function of it. `alongside` takes it, too, see `entry_point`.
    """

    @functools.cache
    def of_dimensions(ndim: int) -> Callable[..., Any]:
        others = (argument(ndim) if callable(argument) else argument for argument in arguments)
        next_one = None if alongside is None else functools.partial(alongside, ndim)
        return entry_point(kernel, empty_tree(ndim), *others, alongside=next_one)

    return of_dimensions
