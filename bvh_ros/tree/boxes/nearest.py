# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The k boxes nearest to a point or box, depth first with the nearer child first (Roussopoulos et
al. 1995).

A distance is computed with a relative error below 4 u (u = 2**-53: one rounding of a difference,
one each of square, sum and root), or to within 1e-322 where it is subnormal; it is infinite only
where the exact one exceeds the largest double. Which box is nearer is decided by the computed
distances, ties by the smaller handle; so the answer does not depend on the shape of the tree.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import inlined, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import DEEPEST, NONE, ROOT, is_leaf, leaf_box
from ..query.ray import of_row
from ..query.slab import PAD, TINY
from ..store.turns import ANY_VERSION, NOT_FINITE, REFUSED, begin_query, end_query


class Points(NamedTuple):
    """What is asked for."""

    points: NDArray[np.float64]
    k: int
    reaches: NDArray[np.float64]
    """The largest distance, one for all or a point."""
    masks: NDArray[np.uint32]
    """The same."""


@inlined
def distance(lo, hi, low, high):
    """Distance of a closed box, from low to high, from another, 0 where they touch; a point is a
    box.
    """
    longest = 0.0
    total = 0.0
    for axis in range(lo.shape[0]):
        gap = max(lo[axis] - high[axis], 0.0, low[axis] - hi[axis])
        longest = max(longest, gap)
        total += gap * gap
    if 1e-140 < longest < 1e140 or longest == 0.0 or math.isinf(longest):
        return math.sqrt(total)
    # Squares would leave the doubles: the same with all gaps times a power of two.
    exponent = math.frexp(longest)[1]
    total = 0.0
    for axis in range(lo.shape[0]):
        gap = math.ldexp(max(lo[axis] - high[axis], 0.0, low[axis] - hi[axis]), -exponent)
        total += gap * gap
    return math.ldexp(math.sqrt(total), exponent)


@inlined
def pruning_limit(reach):
    """What the squared distance of a node's box may be if a box within `reach` can lie in it."""
    return reach * reach * PAD * PAD + TINY


@lean_kernel
def insert_candidate(slots, distances, handles, count, k, slot, gap):
    """Put (slot, gap) in its place among the k best so far; return how many there are now."""
    if count == k:
        if gap > distances[k - 1] or (
            gap == distances[k - 1] and handles[slot] > handles[slots[k - 1]]
        ):
            return count
        count -= 1
    place = count
    while place > 0 and (
        gap < distances[place - 1]
        or (gap == distances[place - 1] and handles[slot] < handles[slots[place - 1]])
    ):
        slots[place], distances[place] = slots[place - 1], distances[place - 1]
        place -= 1
    slots[place], distances[place] = slot, gap
    return count + 1


@inlined
def _square(lo, hi, low, high):
    """Squared distance, only to prune by: where it overflows or vanishes, so does its limit."""
    total = 0.0
    for axis in range(lo.shape[0]):
        gap = max(lo[axis] - high[axis], 0.0, low[axis] - hi[axis])
        total += gap * gap
    return total


@lean_kernel
def nearest(tree, low, high, k, max_distance, mask, slots, distances):
    """Write the k nearest to a box, or point, within `max_distance`, nearest first; return how
    many there are.
    """
    nodes, tight, handles, root = tree.nodes, tree.tight, tree.handles, tree.state[ROOT]
    if root == NONE or k == 0:
        return 0
    stack, squares = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64)
    stack[0], squares[0], top = root, 0.0, 1
    count = 0
    limit = pruning_limit(max_distance)
    while top > 0:
        top -= 1
        node = stack[top]
        if squares[top] > limit or nodes[node].mask & mask == 0:
            continue
        while not is_leaf(node):
            near, far = np.int64(nodes[node].left), np.int64(nodes[node].right)
            near_square = _square(nodes[near].lo, nodes[near].hi, low, high)
            far_square = _square(nodes[far].lo, nodes[far].hi, low, high)
            if far_square < near_square:
                near, far, near_square, far_square = far, near, far_square, near_square
            if far_square <= limit:
                stack[top], squares[top] = far, far_square
                top += 1
            node = near
            if near_square > limit or nodes[near].mask & mask == 0:
                break
        if not is_leaf(node) or nodes[node].mask & mask == 0:
            continue
        lo, hi = leaf_box(nodes, tight, node)
        gap = distance(lo, hi, low, high)
        if gap <= max_distance:
            count = insert_candidate(slots, distances, handles, count, k, node >> 1, gap)
            if count == k:
                limit = pruning_limit(distances[k - 1])
    return count


@inlined
def name_row(handles, slots, distances, count):
    """Handles instead of the first `count` slots; then NONE and inf."""
    for j in range(slots.shape[0]):
        if j < count:
            slots[j] = handles[slots[j]]
        else:
            slots[j], distances[j] = NONE, np.inf


@lean_kernel
def nearest_one(tree, low, high, k, max_distance, mask, found, distances):
    """Handles and distances of the k nearest to a box or point, nearest first: how many there are;
    NOT_FINITE if it is no box, REFUSED if the tree is being changed.
    """
    for axis in range(low.shape[0]):
        if not (np.isfinite(low[axis]) and np.isfinite(high[axis]) and low[axis] <= high[axis]):
            return np.int64(NOT_FINITE)
    if not begin_query(tree.state, ANY_VERSION):
        return np.int64(REFUSED)
    count = nearest(tree, low, high, k, max_distance, mask, found, distances)
    for j in range(count):
        found[j] = tree.handles[found[j]]
    end_query(tree.state)
    return np.int64(count)


@lean_kernel
def nearest_many(tree, version, asked, found, distances):
    """Row by row, handles to `found`, padded with NONE and inf. Returns 0; NOT_FINITE if a point
    is not, REFUSED if the tree is changed meanwhile.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    for i in range(asked.points.shape[0]):
        point, reach, mask = asked.points[i], of_row(asked.reaches, i), of_row(asked.masks, i)
        for axis in range(point.shape[0]):
            if not np.isfinite(point[axis]):
                end_query(tree.state)
                return np.int64(NOT_FINITE)
        count = nearest(tree, point, point, asked.k, reach, mask, found[i], distances[i])
        name_row(tree.handles, found[i], distances[i], count)
    end_query(tree.state)
    return np.int64(0)


_ROWS, _NAMES = np.empty((0, 3)), np.empty((0, 1), np.int64)
NO_POINTS = Points(_ROWS, 1, np.empty(0), np.empty(0, np.uint32))
one_entry = entry_points(
    *(nearest_one, np.empty(0), np.empty(0), 1, 0.0, np.uint32(0)),
    *(np.empty(0, np.int64), np.empty(0)),
)
many_entry = entry_points(nearest_many, 0, NO_POINTS, _NAMES, _ROWS)
