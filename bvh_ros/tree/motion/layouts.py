# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes for another time than that of the tree, which was built where boxes were told to be."""

import functools

import numpy as np
from numpy.typing import NDArray

from ..compiler import WIDTH
from ..dynamic_bvh import DynamicBVH
from ..nodes import CHANGES, NONE, ROOT, TURN, View, empty_tree
from ..store.turns import IS_CHANGED
from ..wide.snapshot import Snapshot, take_snapshot
from .bounds import Layout
from .velocities import told_to

FARTHEST = 1e300  # m: a tree takes finite boxes


@functools.cache
def layout_of_tree(ndim: int) -> Layout:
    """To leave boxes in the nodes of the tree."""
    return Layout(empty_tree(ndim).nodes, NONE, np.empty(0, np.int64))


def lay_out(view: View, kept: NDArray[np.void], at: float, left: float) -> Layout:
    """Nodes built over the places of all boxes at a time, rounded, which go on for `left` s:
    `bounds` are fitted to them.
    """
    (tree, _), slots = _built(view, kept, at, left)
    return Layout(tree.nodes, tree.state.item(ROOT), slots)


def snapshot_then(view: View, kept: NDArray[np.void], at: float, left: float) -> Snapshot | None:
    """A snapshot of such nodes, for `sweeping`."""
    built, slots = _built(view, kept, at, left)
    snapshot = take_snapshot(built)
    if snapshot is None:
        return None
    children = snapshot.children[: snapshot.size * WIDTH]
    children[children < 0] = ~slots[~children[children < 0]]
    return snapshot


def _built(
    view: View, kept: NDArray[np.void], at: float, left: float
) -> tuple[View, NDArray[np.int64]]:
    """A tree of all boxes at a time, and their slots in the other tree, in its order of slots;
    RuntimeError if that is being changed.
    """
    (nodes, _, tight, handles, state), version = view
    slots = np.flatnonzero(handles >= 0)
    boxes, masks = tight[slots] if len(tight) else nodes[2 * slots], nodes['mask'][2 * slots]
    velocities, references = told_to(kept, handles, slots)
    if state.item(TURN) < 0 or state.item(CHANGES) != version:
        raise RuntimeError(IS_CHANGED)
    with np.errstate(over='ignore'):
        ways = velocities * np.minimum(at - references, left)[:, None]
        lo, hi = (np.clip(boxes[side] + ways, -FARTHEST, FARTHEST) for side in ('lo', 'hi'))
    return DynamicBVH.from_boxes(lo, hi, mask=masks).view(), slots
