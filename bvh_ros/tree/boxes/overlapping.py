# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes against the tree. Closed boxes: touching counts. Comparisons of doubles, so all of it is
exact.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..entries import entry_points
from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import stack_array
from ..nodes import DEEPEST, NONE, ROOT, View, is_leaf, leaf_box, next_node
from ..store.turns import ANY_VERSION, NOT_FINITE, REFUSED, accepted, begin_query, end_query


class Queries(NamedTuple):
    """Closed boxes that are asked about."""

    lo: NDArray[np.float64]
    hi: NDArray[np.float64]
    masks: NDArray[np.uint32]
    """A mask a box, or one for all."""


@inlined
def touch(lo, hi, other_lo, other_hi):
    for axis in range(lo.shape[0]):
        if lo[axis] > other_hi[axis] or other_lo[axis] > hi[axis]:
            return False
    return True


@lean_kernel
def overlap(tree, lo, hi, mask, found, count):
    """Write the slots whose box touches the closed one from lo to hi from found[count] on; return
    where the next would go.

    A return beyond the array's end says how large it should have been: what did not fit is
    counted, not written.
    """
    nodes, root = tree.nodes, tree.state[ROOT]
    if root == NONE:
        return np.int64(count)
    stack, top, node = stack_array(DEEPEST, np.int64), 0, np.int64(root)
    while node != NONE:
        here = nodes[node]
        met = here.mask & mask != 0 and touch(here.lo, here.hi, lo, hi)
        if met and is_leaf(node):
            leaf_lo, leaf_hi = leaf_box(nodes, tree.tight, node)
            if touch(leaf_lo, leaf_hi, lo, hi):
                if count < found.shape[0]:
                    found[count] = node >> 1
                count += 1
        node, top = next_node(nodes, node, met and not is_leaf(node), stack, top)
    return np.int64(count)


@lean_kernel
def overlap_one(tree, lo, hi, mask, found):
    """Handles of the boxes that touch the one from lo to hi, in no order: how many, of which as
    many are written as there is room for; NOT_FINITE if it is no box, REFUSED if the tree is being
    changed.
    """
    for axis in range(lo.shape[0]):
        if not (np.isfinite(lo[axis]) and np.isfinite(hi[axis]) and lo[axis] <= hi[axis]):
            return np.int64(NOT_FINITE)
    if not begin_query(tree.state, ANY_VERSION):
        return np.int64(REFUSED)
    count = overlap(tree, lo, hi, mask, found, 0)
    for i in range(min(count, found.shape[0])):
        found[i] = tree.handles[found[i]]
    end_query(tree.state)
    return count


@lean_kernel
def overlap_rows(tree, version, queries, start, stop, found, sizes):
    """Handles of the boxes that the `queries` [start, stop) touch, one query after the other;
    sizes[i] is how many query i does.

    Returns (queries done, room wanted): fewer than there are where there is no room for what the
    next one touches, negative if the tree is changed meanwhile.
    """
    if not begin_query(tree.state, version):
        return np.int64(-1), np.int64(0)
    count, end, done = np.int64(0), np.int64(0), np.int64(start)
    while done < stop:
        mask = queries.masks[done if queries.masks.shape[0] > 1 else 0]
        end = overlap(tree, queries.lo[done], queries.hi[done], mask, found, count)
        if end > found.shape[0]:
            break
        sizes[done] = end - count
        count = end
        done += 1
    for i in range(count):
        found[i] = tree.handles[found[i]]
    end_query(tree.state)
    return done, np.int64(end)


_ROWS, _IDS = np.empty((0, 3)), np.empty(0, np.int64)
_QUERIES = Queries(_ROWS, _ROWS, np.empty(0, np.uint32))
one_entry = entry_points(overlap_one, np.empty(0), np.empty(0), np.uint32(0), _IDS)
rows_entry = entry_points(overlap_rows, 0, _QUERIES, 0, 0, _IDS, _IDS)


def overlap_many(
    view: View, queries: Queries, start: int, stop: int, sizes: NDArray[np.int64]
) -> NDArray[np.int64]:
    """`overlap_rows` with as much room as it takes; RuntimeError if the tree is changed
    meanwhile.
    """
    parts, room, kernel = [], 64, rows_entry(queries.lo.shape[1])
    while True:
        found = np.empty(room, np.int64)
        done, wanted = kernel(*view, queries, start, stop, found, sizes)
        parts.append(found[: int(sizes[start : accepted(done)].sum())])
        if done == stop:
            return parts[0] if len(parts) == 1 else np.concatenate(parts)
        start, room = done, max(2 * room, wanted)
