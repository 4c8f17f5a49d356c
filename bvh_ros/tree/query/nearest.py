# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The k boxes nearest to a point or box, at rest and at a time, for one query and for many.

One query goes depth first, the nearer child first (Roussopoulos et al. 1995). The points of a
dense batch go in packets of eight neighbours, which share the nodes that they load (Wald et al.
2001, "Interactive Rendering with Coherent Ray Tracing").

A distance is computed with a relative error below 4 u (u = 2**-53: one rounding of a difference,
one each of square, sum and root), or to within 1e-322 where it is subnormal; it is infinite only
where the exact one exceeds the largest double. Which box is nearer is decided by the computed
distances, ties by the smaller handle; so the answer does not depend on the shape of the tree.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import Floats
from ..compiler import inlined, lean_kernel, stack_array, trailing_zeros
from ..nodes import DEEPEST, NONE, ROOT, Tree, entry_points, is_leaf, leaf_box
from ..simd.float64x8 import EIGHT, at_most8, count_bits, gap_squares8
from ..store.turns import ANY_VERSION, NOT_FINITE, REFUSED, begin_query, end_query
from .overlap import is_box
from .ray import of_row
from .slab import PAD, TINY
from .traversal import Stack, next_leaf, push_root

Ids = NDArray[np.int64]
LARGEST_SQUARE = float(np.finfo(np.float64).max)


class Near(NamedTuple):
    """A query at rest."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    k: int
    reach: float
    """The largest distance."""
    mask: int | np.uint32


class Best(NamedTuple):
    """The nearest boxes so far, nearest first."""

    slots: Ids
    distances: NDArray[np.float64]


class PointQueries(NamedTuple):
    """A batch of n query points."""

    points: NDArray[np.float64]
    """Shape (n, ndim)."""
    k: int
    reaches: NDArray[np.float64]
    """The largest distance, a row or one for all."""
    masks: NDArray[np.uint32]
    """A mask a row, or one for all."""
    order: Ids
    """The order in which rows are answered; as they stand if it is empty."""


# ---- distances


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
def within(square, limit):
    """A squared distance if it is within a limit, else inf. It only prunes: where it overflows or
    vanishes, so does its limit.
    """
    return min(square, LARGEST_SQUARE) if square <= limit else np.inf


@inlined
def _square(nodes, node, query, limit):
    if nodes[node].mask & query.mask == 0:
        return np.inf
    lo, hi, total = nodes[node].lo, nodes[node].hi, 0.0
    for axis in range(lo.shape[0]):
        gap = max(lo[axis] - query.high[axis], 0.0, query.low[axis] - hi[axis])
        total += gap * gap
    return within(total, limit)


@inlined
def pruning_limit(reach):
    """What the squared distance of a node's box may be if a box within `reach` can lie in it."""
    return reach * reach * PAD * PAD + TINY


# ---- one query


@inlined
def visit_nearest(tree, nodes, root, query, best, limit, square, look_at):
    """Visit the leaves whose squared distance is within a limit, nearer children first. Return how
    many boxes are found, and the last limit.

    look_at(tree, query, leaf, square, best, count, limit) puts a leaf among the best and returns
    the new count and limit. square(nodes, node, query, limit) is as `enter` of `next_leaf`.
    """
    stack = Stack(stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64))
    top, count = push_root(nodes, root, query, limit, stack, square), np.int64(0)
    while top > 0:
        leaf, top = next_leaf(nodes, query, limit, stack, top, square)
        if leaf == NONE:
            break
        apart = stack.entries[top]
        count, limit = look_at(tree, query, leaf, apart, best, count, limit)
    return count, limit


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
def keep_if_near(tree, query, slot, gap, best, count, limit):
    """Put a box at a distance among the best; return how many there are, and the new limit."""
    if gap <= query.reach:
        k = query.k
        count = insert_candidate(best.slots, best.distances, tree.handles, count, k, slot, gap)
        if count == k:
            limit = pruning_limit(best.distances[k - 1])
    return count, limit


@inlined
def _look_at(tree, query, leaf, square, best, count, limit):
    lo, hi = leaf_box(tree.nodes, tree.tight, leaf)
    gap = distance(lo, hi, query.low, query.high)
    return keep_if_near(tree, query, leaf >> 1, gap, best, count, limit)


@inlined
def _nearest(tree, query, slots, distances):
    best, limit = Best(slots, distances), pruning_limit(query.reach)
    root = tree.state[ROOT]
    return visit_nearest(tree, tree.nodes, root, query, best, limit, _square, _look_at)[0]


@lean_kernel
def nearest(tree, low, high, k, reach, mask, slots, distances):
    """Write the k nearest to a box, or point, within `reach`, nearest first; return how many there
    are.
    """
    return _nearest(tree, Near(low, high, k, reach, mask), slots, distances)


@inlined
def name_row(handles, slots, distances, count):
    """Replace the first `count` slots by handles; pad the row by NONE and inf."""
    for j in range(slots.shape[0]):
        if j < count:
            slots[j] = handles[slots[j]]
        else:
            slots[j], distances[j] = NONE, np.inf


@lean_kernel
def nearest_one(tree, low, high, k, max_distance, mask, found, distances):
    """Write handles and distances of the k nearest to a box or point, nearest first; return how
    many there are. NOT_FINITE if it is no box, REFUSED if the tree is being changed.
    """
    if not is_box(low, high):
        return np.int64(NOT_FINITE)
    if not begin_query(tree.state, ANY_VERSION):
        return np.int64(REFUSED)
    count = nearest(tree, low, high, k, max_distance, mask, found, distances)
    name_row(tree.handles, found, distances, count)
    end_query(tree.state)
    return np.int64(count)


# ---- many points


@inlined
def _query_of(points, row):
    point = points.points[row]
    return Near(point, point, points.k, of_row(points.reaches, row), of_row(points.masks, row))


@lean_kernel
def nearest_rows(tree, version, points, found, distances):
    """Write handles and distances row by row, padded with NONE and inf. Return 0; NOT_FINITE if a
    point is not, REFUSED if the tree is changed meanwhile.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    for i in range(points.points.shape[0]):
        row = points.order[i] if points.order.shape[0] > 0 else i
        query = _query_of(points, row)
        if not is_box(query.low, query.high):
            end_query(tree.state)
            return np.int64(NOT_FINITE)
        count = _nearest(tree, query, found[row], distances[row])
        name_row(tree.handles, found[row], distances[row], count)
    end_query(tree.state)
    return np.int64(0)


class Packet(NamedTuple):
    """The state of eight points, one a lane."""

    points: NDArray[np.float64]
    """A row of eight for each coordinate; the row WHEN of `float64x8` for times."""
    limits: NDArray[np.float64]
    """What the squared distance of a node may be."""
    counts: NDArray[np.int64]
    """How many boxes are found."""
    stack: NDArray[np.int64]
    squares: NDArray[np.float64]
    """The squared distances of the nodes on the stack, eight a node."""
    both: NDArray[np.float64]
    """Those of two children; at first of what was on top of the stack. Apart from the others, as
    eight are copied at once then.
    """


_PLACES, _SQUARES, _BOTH = EIGHT * 4, EIGHT * DEEPEST, EIGHT * 2  # numba needs them as globals


@inlined
def no_packet():
    """Room for a packet, on the stack."""
    return Packet(
        stack_array(_PLACES, np.float64),
        stack_array(EIGHT, np.float64),
        stack_array(EIGHT, np.int64),
        stack_array(DEEPEST, np.int64),
        stack_array(_SQUARES, np.float64),
        stack_array(_BOTH, np.float64),
    )


@inlined
def load(queries, rows, packet):
    """Fill the lanes; those beyond the last row reach nothing. Returns the union of the masks."""
    union, points, limits = np.uint32(0), queries.points, packet.limits
    for lane in range(EIGHT):
        row = rows[min(lane, rows.shape[0] - 1)]
        for axis in range(points.shape[1]):
            packet.points[axis * EIGHT + lane] = points[row, axis]
        limits[lane] = (
            pruning_limit(of_row(queries.reaches, row)) if lane < rows.shape[0] else -1.0
        )
        packet.counts[lane], packet.squares[lane] = 0, 0.0
        union |= of_row(queries.masks, row)
    return union


@inlined
def _descend(nodes, top, mask, packet, squares):
    """From the node on top of the stack follow the child that is nearer to most lanes down to a
    leaf, the other goes onto the stack: (leaf, lanes in reach, where in `both` its squares are,
    top); no lanes if no leaf is in reach.
    """
    waiting, both, limits, top = packet.squares, packet.both, packet.limits, top - 1
    node, at, bits = packet.stack[top], 0, at_most8(waiting, top * EIGHT, limits)
    for lane in range(EIGHT):
        both[lane] = waiting[top * EIGHT + lane]
    while bits != np.uint32(0) and nodes[node].mask & mask != 0 and not is_leaf(node):
        near, far, at, far_at = np.int64(nodes[node].left), np.int64(nodes[node].right), 0, EIGHT
        squares(nodes, near, packet, 0)
        squares(nodes, far, packet, EIGHT)
        bits, far_bits = at_most8(both, 0, limits), at_most8(both, EIGHT, limits)
        closer = at_most8(both, 0, both[EIGHT:])
        if 2 * count_bits(closer & (bits | far_bits)) < count_bits(bits | far_bits):
            near, far, bits, far_bits, at, far_at = far, near, far_bits, bits, far_at, at
        if bits == np.uint32(0):
            node, bits, at = far, far_bits, far_at
            continue
        if far_bits != np.uint32(0):
            for lane in range(EIGHT):
                waiting[top * EIGHT + lane] = both[far_at + lane]
            packet.stack[top] = far
            top += 1
        node = near
    return node, bits if nodes[node].mask & mask != 0 else np.uint32(0), at, top


@inlined
def visit_packet(tree, nodes, points, rows, mask, packet, best, squares, look_at_row):
    """Visit the leaves that are within the limit of any lane of a packet of rows that is loaded.

    look_at_row(tree, points, row, lane, leaf, square, best, count, limit) does what `look_at` of
    `visit_nearest` does. squares(nodes, node, packet, at) writes the squared distances of a node
    to packet.both[at : at + 8].
    """
    packet.stack[0], top = tree.state[ROOT], 1
    while top > 0:
        leaf, bits, at, top = _descend(nodes, top, mask, packet, squares)
        while bits != np.uint32(0):
            lane = np.int64(trailing_zeros(bits))
            bits = np.uint32(bits & np.uint32(bits - np.uint32(1)))
            row, square = rows[lane], packet.both[at + lane]
            if nodes[leaf].mask & of_row(points.masks, row) != 0:
                packet.counts[lane], packet.limits[lane] = look_at_row(
                    *(tree, points, row, lane, leaf, square, best),
                    *(packet.counts[lane], packet.limits[lane]),
                )


@inlined
def _squares(nodes, node, packet, at):
    gap_squares8(nodes, node, packet.points, packet.both, at)


@inlined
def _look_at_row(tree, points, row, lane, leaf, square, best, count, limit):
    best_of_row = Best(best.slots[row], best.distances[row])
    return _look_at(tree, _query_of(points, row), leaf, square, best_of_row, count, limit)


@lean_kernel
def nearest_packets(tree, version, points, found, distances):
    """`nearest_rows` of finite points, eight rows of `order` at a time."""
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    packet, best = no_packet(), Best(found, distances)
    for first in range(0, points.order.shape[0], EIGHT):
        rows = points.order[first : first + EIGHT]
        mask = load(points, rows, packet)
        visit_packet(tree, tree.nodes, points, rows, mask, packet, best, _squares, _look_at_row)
        for lane in range(rows.shape[0]):
            row = rows[lane]
            name_row(tree.handles, found[row], distances[row], packet.counts[lane])
    end_query(tree.state)
    return np.int64(0)


_ROWS, _ROW, _IDS = np.empty((0, 3)), np.empty(0), np.empty((0, 1), np.int64)
NO_POINTS = PointQueries(_ROWS, 1, _ROW, np.empty(0, np.uint32), np.empty(0, np.int64))
one_entry = entry_points(
    *(nearest_one, _ROW, _ROW, 1, 0.0, np.uint32(0)), *(np.empty(0, np.int64), _ROW)
)
rows_entry = entry_points(nearest_rows, 0, NO_POINTS, _IDS, _ROWS)
packets_entry = entry_points(nearest_packets, 0, NO_POINTS, _IDS, _ROWS)


# ---- the order of many points: neighbours load the same nodes

# A batch is dense if it has so many points a box, and at least so many: then eight neighbours
# share most nodes. Chosen, not tuned: with 1/10 a box packets were slower than one by one.
PER_BOX, FEW = 1 / 4, 64
MANY, NO_ORDER = 512, np.empty(0, np.int64)  # from so many points on their order pays
CELL_BITS = 5  # of a point on each axis: a key of three axes fits an int16


def are_dense(points: int, boxes: int) -> bool:
    """Whether packets answer a batch of so many points."""
    return boxes > 0 and points >= max(PER_BOX * boxes, FEW)


@inlined
def _cell(points, i, center, per_length):
    """The cell of a point, with the bits of the axes interleaved (Morton 1966)."""
    key = np.int64(0)
    for axis in range(points.shape[1]):
        place = (points[i, axis] - center[axis]) * per_length * 0.5 + 0.5
        cell = np.int64(min(max(place, 0.0), 0.999) * (1 << CELL_BITS))
        for bit in range(CELL_BITS):
            key |= ((cell >> bit) & 1) << (3 * bit + axis)
    return key


@lean_kernel
def cell_keys(points, lo, hi, keys):
    """Fill in the cells of `points`, (n, ndim), in a grid over the intersection of their bounds
    and the box from `lo` to `hi`.
    """
    center, half = stack_array(3, np.float64), 1e-300
    for axis in range(points.shape[1]):
        least, largest = np.inf, -np.inf
        for i in range(points.shape[0]):
            least, largest = min(least, points[i, axis]), max(largest, points[i, axis])
        least, largest = max(least, lo[axis]), min(largest, hi[axis])
        center[axis] = least * 0.5 + largest * 0.5
        half = max(half, largest * 0.5 - least * 0.5)
    for i in range(points.shape[0]):
        keys[i] = _cell(points, i, center, 1.0 / half)


def order_of(tree: Tree, points: Floats) -> Ids:
    """The order in which points, finite and of shape (n, ndim), are answered: sorted by their
    cells, so that consecutive ones are near each other. Empty if the tree is.
    """
    root, keys = tree.state.item(ROOT), np.empty(len(points), np.int16)
    if root < 0:
        return NO_ORDER
    bounds = tree.nodes[root]
    cell_keys(points, bounds['lo'], bounds['hi'], keys)
    return np.argsort(keys, kind='stable')  # a radix sort
