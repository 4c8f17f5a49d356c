# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree's insertion with some of its steps left out, to measure what each is worth."""

from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np

from ...tree import insertion, moving
from ...tree.area import node_area, union_area
from ...tree.compiling import kernel
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.nodes import NONE, ROOT, take_leaf
from ..rewiring import rewired
from ..scenes import Boxes, Floats

ROTATIONS = ('none', 'on insert', 'on insert and remove')


@numba.njit
def _never(nodes, heights, node):
    return False


class Kernels(NamedTuple):
    """One-by-one insertion and re-insertion of many rows."""

    insert_rows: Any
    reinsert_rows: Any


@cache
def kernels(rotations: str) -> Kernels:
    """Kernels that rotate as told."""
    if rotations == 'on insert and remove':
        return Kernels(moving.insert_rows, moving.reinsert_rows)
    refit = rewired(insertion.refit_ancestors, rotate=_never)
    link = insertion.link_leaf
    if rotations == 'none':
        link = rewired(link, refit_ancestors=refit)
    unlink = rewired(insertion.unlink_leaf, refit_ancestors=refit)
    move = rewired(moving.move_leaf, link_leaf=link, unlink_leaf=unlink)
    return Kernels(
        rewired(moving.insert_rows, link_leaf=link), rewired(moving.reinsert_rows, move_leaf=move)
    )


def grow(boxes: Boxes, search: str, rotations: str) -> DynamicBVH:
    """Insert the boxes one by one, in their order."""
    count = len(boxes.lo)
    tree = DynamicBVH(capacity=count, sibling_search=search)
    tree._row_by_row(
        kernels(rotations).insert_rows,
        count,
        tree._nodes,
        tree._heights,
        tree._tight,
        tree._handles,
        tree._state,
        *boxes,
        np.ones(count, np.uint32),
        0.0,
        1,
        tree._thorough,
        True,
        np.empty(count, np.int64),
    )
    tree._serial += count
    return tree


def reinsert(tree: DynamicBVH, boxes: Boxes, rotations: str) -> None:
    """Move every box of a tree from `grow`, one by one."""
    rows = np.arange(len(boxes.lo))
    slots = rows  # a new tree gives them out in order
    tree._row_by_row(
        kernels(rotations).reinsert_rows,
        len(rows),
        tree._nodes,
        tree._heights,
        tree._tight,
        tree._state,
        rows,
        slots,
        *boxes,
        0.0,
        np.zeros(boxes.lo.shape),
        tree._thorough,
    )


@kernel
def _added_cost(nodes, leaf, sibling):
    """What inserting the leaf beside the sibling adds to the cost: direct and inherited."""
    added = union_area(nodes, sibling, leaf, 1.0)
    node = np.int64(nodes[sibling].parent)
    while node != NONE:
        added += union_area(nodes, node, leaf, 1.0) - node_area(nodes, node, 1.0)
        node = np.int64(nodes[node].parent)
    return added


@kernel
def _compare_choices(nodes, heights, tight, state, lo, hi, excess):
    """Grow a greedy tree; at every insertion note what its choice costs more than the best one."""
    still = np.zeros(lo.shape[1])
    for i in range(lo.shape[0]):
        leaf = take_leaf(nodes, state)
        moving.write_leaf(nodes, tight, leaf, lo[i], hi[i], 0.0, still)
        root = state[ROOT]
        if root != NONE:
            greedy = insertion.greedy_sibling(nodes, heights, root, leaf)
            best = insertion.branch_and_bound_sibling(nodes, heights, root, leaf)
            lowest = _added_cost(nodes, leaf, best)
            excess[i] = (_added_cost(nodes, leaf, greedy) - lowest) / lowest
        insertion.link_leaf(nodes, heights, state, leaf, False)


def greedy_excess(boxes: Boxes) -> Floats:
    """What each greedy choice costs more than the best one, as a share of that, shape (n,)."""
    tree = DynamicBVH(capacity=len(boxes.lo))
    excess = np.zeros(len(boxes.lo))
    _compare_choices(tree._nodes, tree._heights, tree._tight, tree._state, *boxes, excess)
    return excess
