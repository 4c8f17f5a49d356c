# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The boxes nearest to many points at times: `boxes.nearest_packets` with bounds that move."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..boxes.nearest_packets import descend, load, no_packet
from ..compiler import inlined, lean_kernel, stack_array, trailing_zeros
from ..entries import entry_points
from ..nodes import ROOT
from ..query.ray import of_row
from ..simd.float64x8 import EIGHT, WHEN, moving_squares8
from ..store.turns import NOT_FINITE, end_query
from .bounds import OUTSIDE, begin_asking, covers, fetch_children, no_motion
from .exact_contact import fetch_box
from .nearest import NO_POINTS, decide, keep_bound


class Bounded(NamedTuple):
    """The boxes whose bounds are nearest to n points."""

    slots: NDArray[np.int64]
    """(n, k)"""
    counts: NDArray[np.int64]
    """How many there are."""
    left_out: NDArray[np.float64]
    """Where those are k, the least square of the distance of others."""


@inlined
def _load_times(moving, asked, rows, packet):
    """Fill in when: 0, or why not."""
    for lane in range(EIGHT):
        at = of_row(asked.at, rows[min(lane, rows.shape[0] - 1)])
        covered = covers(moving, at, 0.0, 0.0)
        if covered <= 0:
            return np.int64(OUTSIDE if covered == 0 else NOT_FINITE)
        packet.points[WHEN * EIGHT + lane] = at - moving.start
    return np.int64(0)


@inlined
def _squares_of(nodes, node, packet, at):
    """As `boxes.nearest_packets` has it, of bounds at the times asked for."""
    fetch_children(nodes, node)
    moving_squares8(nodes, node, packet.points, packet.both, at)


@inlined
def _near(asked, row):
    """What a row asks for, see `nearest.nearest_then`."""
    point, reach = asked.points[row], of_row(asked.reaches, row)
    return point, point, of_row(asked.at, row), asked.k, reach, of_row(asked.masks, row)


@inlined
def _update_bounds(tree, moving, leaf, bits, asked, rows, packet, kept):
    """Let the lanes of `bits` keep the leaf where its bounds are among their nearest; kept =
    (least square that is left out, where its squares are in `both`, slots, squares).
    """
    left_out, place, found, squares = kept
    counts, limits = packet.counts, packet.limits
    while bits != np.uint32(0):
        lane = np.int64(trailing_zeros(bits))
        bits = np.uint32(bits & np.uint32(bits - np.uint32(1)))
        row, near = rows[lane], _near(asked, rows[lane])
        if moving.nodes[leaf].mask & near[5] != 0:
            square, of_lane = packet.both[place + lane], left_out[lane : lane + 1]
            counts[lane], limits[lane] = keep_bound(
                *(tree, moving, near, leaf, square, (found[row], squares[row], of_lane)),
                *(counts[lane], limits[lane]),
            )


@inlined
def _bound(tree, moving, asked, first, packet, left_out, found, squares):
    """Write `nearest.nearest_bounds` of the eight rows of `order` from one on: (0, or why not,
    these rows).
    """
    rows = asked.order[first : first + EIGHT]
    mask = load(asked, rows, packet)
    why = _load_times(moving, asked, rows, packet)
    packet.stack[0], top, left_out[:] = tree.state[ROOT], 1 if why == 0 else 0, np.inf
    while top > 0:
        leaf, bits, place, top = descend(moving.nodes, top, mask, packet, _squares_of)
        kept = left_out, place, found, squares
        _update_bounds(tree, moving, leaf, bits, asked, rows, packet, kept)
    for lane in range(EIGHT):
        left_out[lane] = min(left_out[lane], packet.limits[lane])
    return why, rows


@lean_kernel
def nearest_packets(tree, moving, asked, found, distances):
    """`nearest.nearest_rows` of finite points at times that bounds can hold for, eight rows of
    `order` at a time: 0, or why not.
    """
    why = begin_asking(tree, moving, asked.order.shape[0])
    if why != 0:
        return why
    packet, left_out = no_packet(), stack_array(EIGHT, np.float64)
    for first in range(0, asked.order.shape[0], EIGHT):
        why, rows = _bound(tree, moving, asked, first, packet, left_out, found, distances)
        if why < 0:
            break
        for lane in range(rows.shape[0]):
            for i in range(packet.counts[lane]):
                fetch_box(tree, moving, found[rows[lane], i])
        for lane in range(rows.shape[0]):
            row, bounded = rows[lane], (packet.counts[lane], left_out[lane])
            decide(tree, moving, _near(asked, row), bounded, found[row], distances[row])
    end_query(tree.state)
    return why


@lean_kernel
def bound_packets(tree, moving, asked, bounded, squares):
    """Write `nearest.nearest_bounds` of such rows to `bounded` and `squares`, (n, k): 0, or why
    not.
    """
    why = begin_asking(tree, moving, asked.order.shape[0])
    if why != 0:
        return why
    packet, left_out = no_packet(), stack_array(EIGHT, np.float64)
    for first in range(0, asked.order.shape[0], EIGHT):
        why, rows = _bound(tree, moving, asked, first, packet, left_out, bounded.slots, squares)
        if why < 0:
            break
        for lane in range(rows.shape[0]):
            bounded.counts[rows[lane]] = packet.counts[lane]
            bounded.left_out[rows[lane]] = left_out[lane]
    end_query(tree.state)
    return why


_IDS, _GAPS = np.empty((0, 1), np.int64), np.empty((0, 1))
entry = entry_points(nearest_packets, no_motion, NO_POINTS, _IDS, _GAPS)
bounds_entry = entry_points(
    bound_packets, no_motion, NO_POINTS, Bounded(_IDS, np.empty(0, np.int64), np.empty(0)), _GAPS
)
