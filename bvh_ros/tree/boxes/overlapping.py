# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes against the tree. Closed boxes: touching counts. Comparisons of doubles, so all of it is
exact.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import stack_array
from ..nodes import DEEPEST, NONE, ROOT, is_leaf, leaf_box
from ..store.turns import IS_CHANGED, begin_query, end_query


@inlined
def touch(lo, hi, other_lo, other_hi):
    for axis in range(lo.shape[0]):
        if lo[axis] > other_hi[axis] or other_lo[axis] > hi[axis]:
            return False
    return True


@lean_kernel
def overlap(nodes, tight, root, query, mask, found, count):
    """Write the slots whose box touches the query record's from found[count] on; return where the
    next would go.

    A return beyond the array's end says how large it should have been: what did not fit is
    counted, not written.
    """
    if root == NONE:
        return count
    stack = stack_array(DEEPEST, np.int64)
    stack[0], top = root, 1
    while top > 0:
        top -= 1
        node = stack[top]
        here = nodes[node]
        if here.mask & mask == 0 or not touch(here.lo, here.hi, query.lo, query.hi):
            continue
        if not is_leaf(node):
            stack[top], stack[top + 1] = here.right, here.left
            top += 2
            continue
        lo, hi = leaf_box(nodes, tight, node)
        if touch(lo, hi, query.lo, query.hi):
            if count < found.shape[0]:
                found[count] = node >> 1
            count += 1
    return count


@lean_kernel
def overlap_rows(nodes, tight, handles, state, version, queries, masks, start, stop, found, sizes):
    """Handles of the boxes that the queries [start, stop) touch, one query after the other;
    sizes[i] is how many query i does.

    Returns (queries done, room wanted): fewer than there are where there is no room for what the
    next one touches, negative if the tree is changed meanwhile.
    """
    if not begin_query(state, version):
        return np.int64(-1), np.int64(0)
    count, end, done = np.int64(0), np.int64(0), np.int64(start)
    while done < stop:
        end = overlap(nodes, tight, state[ROOT], queries[done], masks[done], found, count)
        if end > found.shape[0]:
            break
        sizes[done] = end - count
        count = end
        done += 1
    for i in range(count):
        found[i] = handles[found[i]]
    end_query(state)
    return done, np.int64(end)


def overlap_many(
    view: Any, queries: NDArray[Any], masks: NDArray[np.uint32], start: int, stop: int, sizes: Any
) -> NDArray[np.int64]:
    """`overlap_rows` with as much room as it takes; RuntimeError if the tree is changed
    meanwhile.
    """
    parts, room = [], 64
    while True:
        found = np.empty(room, np.int64)
        done, wanted = overlap_rows(*view, queries, masks, start, stop, found, sizes)
        if done < 0:
            raise RuntimeError(IS_CHANGED)
        parts.append(found[: int(sizes[start:done].sum())])
        if done == stop:
            return parts[0] if len(parts) == 1 else np.concatenate(parts)
        start, room = done, max(2 * room, wanted)
