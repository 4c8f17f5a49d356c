# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The boxes nearest to many points: eight neighbouring points go down the tree together.

As packets of rays do (Wald et al. 2001, "Interactive Rendering with Coherent Ray Tracing"), they
share the nodes that they load, and a node is left when it is too far for all of them. Distances,
order and ties are those of `nearest`, point by point. Points that have nothing in common visit
the union of what each would: packets are for batches that are dense and sorted.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import inlined, lean_kernel, stack_array, trailing_zeros
from ..entries import entry_points
from ..nodes import DEEPEST, ROOT, is_leaf, leaf_box
from ..query.ray import of_row
from ..simd.float64x8 import EIGHT, at_most8, count_bits, gap_squares8
from ..store.turns import REFUSED, begin_query, end_query
from .nearest import NO_POINTS, distance, insert_candidate, name_row, pruning_limit

_PLACES = EIGHT * 4  # coordinates of a packet, and times
_SQUARES = EIGHT * DEEPEST
_BOTH = EIGHT * 2
# Batches dense enough for eight neighbours to share their way: as many points a box, and at least
# so many points. Chosen, not tuned: at 1/10 eight at a time was slower than one by one.
PER_BOX, LEAST = 1 / 4, 64


class Packet(NamedTuple):
    """Eight points on their way, one a lane."""

    points: NDArray[np.float64]
    """A row of eight for each coordinate, and one for times, see `motion.nearest_packets`."""
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


def are_dense(points: int, boxes: int) -> bool:
    """Whether a batch of so many points is for packets."""
    return boxes > 0 and points >= max(PER_BOX * boxes, LEAST)


@inlined
def no_packet():
    """Room for one, on the stack."""
    return Packet(
        stack_array(_PLACES, np.float64),
        stack_array(EIGHT, np.float64),
        stack_array(EIGHT, np.int64),
        stack_array(DEEPEST, np.int64),
        stack_array(_SQUARES, np.float64),
        stack_array(_BOTH, np.float64),
    )


@inlined
def load(asked, rows, packet):
    """Fill the lanes; those beyond the last row reach nothing. Returns the union of the masks."""
    union, points, limits = np.uint32(0), asked.points, packet.limits
    for lane in range(EIGHT):
        row = rows[min(lane, rows.shape[0] - 1)]
        for axis in range(points.shape[1]):
            packet.points[axis * EIGHT + lane] = points[row, axis]
        limits[lane] = pruning_limit(of_row(asked.reaches, row)) if lane < rows.shape[0] else -1.0
        packet.counts[lane], packet.squares[lane] = 0, 0.0
        union |= of_row(asked.masks, row)
    return union


@inlined
def _squares_of(nodes, node, packet, at):
    """Write the squared distances of a node to packet.both[at : at + 8]."""
    gap_squares8(nodes, node, packet.points, packet.both, at)


@inlined
def descend(nodes, top, mask, packet, squares_of):
    """From the node on top of the stack follow the child that is nearer to most lanes to a leaf,
    the other onto the stack: (leaf, lanes in reach, where in `both` its squares are, top); no
    lanes where none is. `squares_of` is `_squares_of`, of these nodes.
    """
    squares, both, limits, top = packet.squares, packet.both, packet.limits, top - 1
    node, at, bits = packet.stack[top], 0, at_most8(squares, top * EIGHT, limits)
    for lane in range(EIGHT):
        both[lane] = squares[top * EIGHT + lane]
    while bits != np.uint32(0) and nodes[node].mask & mask != 0 and not is_leaf(node):
        near, far, at, far_at = np.int64(nodes[node].left), np.int64(nodes[node].right), 0, EIGHT
        squares_of(nodes, near, packet, 0)
        squares_of(nodes, far, packet, EIGHT)
        bits, far_bits = at_most8(both, 0, limits), at_most8(both, EIGHT, limits)
        closer = at_most8(both, 0, both[EIGHT:])
        if 2 * count_bits(closer & (bits | far_bits)) < count_bits(bits | far_bits):
            near, far, bits, far_bits, at, far_at = far, near, far_bits, bits, far_at, at
        if bits == np.uint32(0):
            node, bits, at = far, far_bits, far_at
            continue
        if far_bits != np.uint32(0):
            for lane in range(EIGHT):
                squares[top * EIGHT + lane] = both[far_at + lane]
            packet.stack[top] = far
            top += 1
        node = near
    return node, bits if nodes[node].mask & mask != 0 else np.uint32(0), at, top


@inlined
def update_nearest(tree, leaf, bits, asked, rows, packet, slots, gaps):
    """Let the lanes of `bits` keep the leaf where it is among their nearest."""
    lo, hi = leaf_box(tree.nodes, tree.tight, leaf)
    k, counts = asked.k, packet.counts
    while bits != np.uint32(0):
        lane = np.int64(trailing_zeros(bits))
        bits = np.uint32(bits & np.uint32(bits - np.uint32(1)))
        row = rows[lane]
        if tree.nodes[leaf].mask & of_row(asked.masks, row) == 0:
            continue
        gap = distance(lo, hi, asked.points[row], asked.points[row])
        if gap <= of_row(asked.reaches, row):
            counts[lane] = insert_candidate(
                slots[row], gaps[row], tree.handles, counts[lane], k, leaf >> 1, gap
            )
            if counts[lane] == k:
                packet.limits[lane] = pruning_limit(gaps[row, k - 1])


@lean_kernel
def nearest_packets(tree, version, asked, order, slots, distances):
    """Write the k nearest of every point as `nearest.nearest_many` does, eight rows of `order`
    at a time. Returns 0, or REFUSED.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    packet = no_packet()
    for first in range(0, order.shape[0], EIGHT):
        rows = order[first : first + EIGHT]
        mask = load(asked, rows, packet)
        packet.stack[0], top = tree.state[ROOT], 1
        while top > 0:
            leaf, bits, _, top = descend(tree.nodes, top, mask, packet, _squares_of)
            update_nearest(tree, leaf, bits, asked, rows, packet, slots, distances)
        for lane in range(rows.shape[0]):
            row = rows[lane]
            name_row(tree.handles, slots[row], distances[row], packet.counts[lane])
    end_query(tree.state)
    return np.int64(0)


entry = entry_points(
    *(nearest_packets, 0, NO_POINTS, np.empty(0, np.int64)),
    *(np.empty((0, 1), np.int64), np.empty((0, 1))),
)
