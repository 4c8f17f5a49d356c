# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stacks of rays that go through the wide snapshot one by one.

An entry is a node or ~slot of a leaf, and above that the bits of a float32: where the ray enters.
"""

import numpy as np

from ..compiler import WIDTH, inlined, trailing_zeros
from ..simd.float32x16 import seen16
from .collapse_plan import DEEPEST_WIDE
from .ray_streams import without_lowest
from .raycasting import ALL32
from .snapshot import LOOSE_NODES

# So many rays are tested against the root one behind the other: what none of them decides yet the
# processor need not guess.
ABREAST = 8
STACK = DEEPEST_WIDE + LOOSE_NODES
_CHILD = np.int64(0xFFFFFFFF)


@inlined
def push_root(snapshot, mask, lanes, nearest, stack):
    """Put on an empty stack what is met of the root, as `push_children`, and loose nodes; return
    the top.
    """
    if mask != ALL32:
        lanes = np.uint32(lanes & seen16(snapshot.masks, 0, mask))
    top = push_children(snapshot, np.int64(0), lanes, nearest, stack, 0)
    return push_loose(snapshot, stack, top)


@inlined
def push_loose(snapshot, stack, top):
    """Put the nodes that every ray visits on the stack; return the new top."""
    for loose in range(snapshot.loose):
        stack[top] = snapshot.size + loose
        top += 1
    return top


@inlined
def push_children(snapshot, node, lanes, nearest, stack, top):
    """Put the children in `lanes` on the stack, the nearest on top; return the new top."""
    bottom = top
    while lanes != np.uint32(0):
        lane = np.int64(trailing_zeros(lanes))
        lanes = without_lowest(lanes)
        child = np.int64(snapshot.children[node * WIDTH + lane])
        entry = np.int64(nearest[lane]) << 32 | (child & _CHILD)
        place = top
        while place > bottom and stack[place - 1] < entry:
            stack[place] = stack[place - 1]
            place -= 1
        stack[place] = entry
        top += 1
    return top


@inlined
def child_of(entry):
    """Node, or ~slot of a leaf."""
    return np.int64(np.int32(entry & _CHILD))
