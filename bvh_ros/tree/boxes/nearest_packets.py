# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The boxes nearest to many points: eight neighbouring points go down the tree together.

As packets of rays do (Wald et al. 2001, "Interactive Rendering with Coherent Ray Tracing"), they
share the nodes that they load, and a node is left when it is too far for all of them. Distances,
order and ties are those of `nearest`, point by point. Points that have nothing in common visit
the union of what each would: packets are for batches that are dense and sorted.
"""

import numpy as np

from ..jit.compiling import inlined, lean_kernel
from ..jit.float64x8 import EIGHT, at_most8, count_bits, gap_squares8
from ..jit.intrinsics import stack_array, trailing_zeros
from ..nodes import DEEPEST, ROOT, is_leaf, leaf_box
from ..store.turns import begin_query, end_query
from .nearest import distance, insert_candidate, name_row, pruning_limit

_PLACES = EIGHT * 3  # coordinates of a packet
_SQUARES = EIGHT * DEEPEST
_BOTH = EIGHT * 2


@inlined
def _load(points, max_distances, masks, rows, packet, limits, counts):
    """Fill the lanes; those beyond the last row reach nothing. Returns the union of the masks."""
    union = np.uint32(0)
    for lane in range(EIGHT):
        row = rows[min(lane, rows.shape[0] - 1)]
        for axis in range(points.shape[1]):
            packet[axis * EIGHT + lane] = points[row, axis]
        limits[lane] = pruning_limit(max_distances[row]) if lane < rows.shape[0] else -1.0
        counts[lane] = 0
        union |= masks[row]
    return union


@inlined
def _descend(nodes, node, bits, mask, packet, limits, stack, squares, top, both):
    """Follow the child that is nearer to most lanes to a leaf, the other onto the stack: (leaf,
    lanes in reach, top); no lanes where none is.
    """
    while bits != np.uint32(0) and nodes[node].mask & mask != 0 and not is_leaf(node):
        near, far = np.int64(nodes[node].left), np.int64(nodes[node].right)
        gap_squares8(nodes, near, packet, both, 0)
        gap_squares8(nodes, far, packet, both, EIGHT)
        bits, far_bits, far_at = at_most8(both, 0, limits), at_most8(both, EIGHT, limits), EIGHT
        closer = at_most8(both, 0, both[EIGHT:])
        if 2 * count_bits(closer & (bits | far_bits)) < count_bits(bits | far_bits):
            near, far, bits, far_bits, far_at = far, near, far_bits, bits, 0
        if bits == np.uint32(0):
            node, bits = far, far_bits
            continue
        if far_bits != np.uint32(0):
            for lane in range(EIGHT):
                squares[top * EIGHT + lane] = both[far_at + lane]
            stack[top] = far
            top += 1
        node = near
    return node, bits if nodes[node].mask & mask != 0 else np.uint32(0), top


@inlined
def update_nearest(
    nodes, tight, handles, leaf, bits, points, rows, k, reaches, masks, limits, counts, slots, gaps
):
    """Let the lanes of `bits` keep the leaf where it is among their nearest."""
    lo, hi = leaf_box(nodes, tight, leaf)
    while bits != np.uint32(0):
        lane = np.int64(trailing_zeros(bits))
        bits = np.uint32(bits & np.uint32(bits - np.uint32(1)))
        row = rows[lane]
        if nodes[leaf].mask & masks[row] == 0:
            continue
        gap = distance(lo, hi, points[row])
        if gap <= reaches[row]:
            counts[lane] = insert_candidate(
                slots[row], gaps[row], handles, counts[lane], k, leaf >> 1, gap
            )
            if counts[lane] == k:
                limits[lane] = pruning_limit(gaps[row, k - 1])


@lean_kernel
def nearest_packets(
    nodes, tight, handles, state, version, points, order, k, max_distances, masks, slots, distances
):
    """Write the k nearest of every point as `nearest.nearest_many` does, eight rows of `order`
    at a time.
    """
    if not begin_query(state, version):
        return False
    root = state[ROOT]
    packet, limits = stack_array(_PLACES, np.float64), stack_array(EIGHT, np.float64)
    stack, squares = stack_array(DEEPEST, np.int64), stack_array(_SQUARES, np.float64)
    both, counts = stack_array(_BOTH, np.float64), stack_array(EIGHT, np.int64)
    for first in range(0, order.shape[0], EIGHT):
        rows = order[first : first + EIGHT]
        mask = _load(points, max_distances, masks, rows, packet, limits, counts)
        stack[0], top = root, 1
        for lane in range(EIGHT):
            squares[lane] = 0.0
        while top > 0:
            top -= 1
            bits = at_most8(squares, top * EIGHT, limits)
            leaf, bits, top = _descend(
                nodes, stack[top], bits, mask, packet, limits, stack, squares, top, both
            )
            update_nearest(
                nodes,
                tight,
                handles,
                leaf,
                bits,
                points,
                rows,
                k,
                max_distances,
                masks,
                limits,
                counts,
                slots,
                distances,
            )
        for lane in range(rows.shape[0]):
            row = rows[lane]
            name_row(handles, slots[row], distances[row], counts[lane])
    end_query(state)
    return True
