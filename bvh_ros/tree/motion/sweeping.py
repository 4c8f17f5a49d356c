# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A wide snapshot of all places where boxes are within a span of time.

Nodes and children are those of the snapshot of boxes at rest; the planes of each leaf bound it
from the start of the span to its stop, those of an inner node its children. It only prunes, so it
serves every ray whose times lie within the span; the shorter that is, the better.

Where boxes go together, places are those that somebody sees who goes with them, at their mean
velocity, the drift: where he is at the start of the span nodes stay as small as at rest, and it is
rays that go further, see `starting`. Leaves: see `leaves`.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compiler import WIDTH, inlined, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import Tree, aligned_empty
from ..store.turns import REFUSED, accepted, begin_query, end_query
from ..wide.snapshot import (
    BLURRED,
    LARGEST_SCENE,
    SMALLEST_SCENE,
    Snapshot,
    blurred_entry,
    no_snapshot,
    on_cache_lines,
    outwards,
    write_planes,
)
from .casting import no_motion
from .leaves import Leaves, leaf_dtype, may_stop, set_leaf, speed_of, swept_side
from .meeting import Moving, box_of

USELESS = -2  # why there is no such snapshot
# Boxes go together if on the average what they sweep is so many times what they sweep as who goes
# along with them sees it.
TOGETHER = 2.0
# No snapshot sees boxes go along for more than so many of its units: then rays begin too far away.
FARTHEST_DRIFT = 2.0**9


class Sweep(NamedTuple):
    """What `wide_casting` asks."""

    snapshot: Snapshot
    moving: Moving
    """What it was made of."""
    leaves: Leaves

    @property
    def nbytes(self) -> int:
        """Memory that is not that of the snapshot at rest."""
        return self.snapshot.planes.nbytes + self.leaves.records.nbytes


def no_sweep(ndim: int) -> Sweep:
    """To tell a compiler the types."""
    leaves = Leaves(np.empty(0, leaf_dtype(ndim)), 0.0)
    return Sweep(no_snapshot(ndim), no_motion(ndim), leaves)


@inlined
def _leaf_of(tree, snapshot, lane):
    """Slot of the leaf that a lane holds, negative if it holds none or one that is gone."""
    slot = ~np.int64(snapshot.children[lane])
    holds = snapshot.masks[lane] != 0 and slot >= 0 and tree.nodes[2 * slot].mask != 0
    return slot if holds else np.int64(-1)


@inlined
def _half_area(sides):
    """Of a box, or of a rectangle half its perimeter."""
    if sides.shape[0] == 2:
        return sides[0] + sides[1]
    return sides[0] * sides[1] + sides[1] * sides[2] + sides[2] * sides[0]


@inlined
def _set_frame(tree, moving, snapshot, frame, drift, mean):
    """Write the centre of all that is swept, as who drifts sees it, units in which it lies within
    [-1, 1], and the mean velocity; return (whether there are such units, as in
    `wide.snapshot.take_snapshot`, whether boxes go together).
    """
    ndim, half, farthest, count = frame.shape[0] - 1, 0.0, 0.0, 0
    length = moving.stop - moving.start
    low, high = stack_array(3, np.float64), stack_array(3, np.float64)
    low[:], high[:], mean[:] = np.inf, -np.inf, 0.0
    # What a box sweeps on the average, and as who goes at the mean velocity sees it.
    swept, apart = stack_array(3, np.float64), stack_array(3, np.float64)
    swept[:] = apart[:] = 0.0
    for lane in range((snapshot.size + snapshot.loose) * WIDTH):
        slot = _leaf_of(tree, snapshot, lane)
        if slot >= 0:
            box = box_of(tree, moving, slot)
            count += 1
            for axis in range(ndim):
                lo, hi = swept_side(box, axis, moving, drift)
                side, speed = box[1][axis] - box[0][axis], speed_of(box, axis, moving)
                mean[axis] += (speed - mean[axis]) / count
                swept[axis] += side + abs(speed) * length
                apart[axis] += side + abs(speed - mean[axis]) * length
                # Written such that what is not a number makes the scene too large.
                low[axis] = low[axis] if low[axis] <= lo else lo
                high[axis] = high[axis] if high[axis] >= hi else hi
    for axis in range(ndim):
        frame[axis] = low[axis] * 0.5 + high[axis] * 0.5
        half = max(half, high[axis] * 0.5 - low[axis] * 0.5)
        far = max(abs(low[axis]), abs(high[axis]))
        farthest = farthest if farthest >= far else far
    if not (SMALLEST_SCENE < half < LARGEST_SCENE and farthest < LARGEST_SCENE):
        return False, False
    frame[ndim] = math.ldexp(1.0, -math.frexp(half)[1])
    return True, TOGETHER * _half_area(apart[:ndim]) < _half_area(swept[:ndim])


@inlined
def _choose_frame(tree, moving, snapshot, frame, last):
    """`_set_frame` and the drift, in the last record: none, or the mean velocity if boxes go
    together. Returns whether a snapshot can be made so.
    """
    mean, farthest, drift = stack_array(3, np.float64), 0.0, last.lo
    drift[:] = 0.0
    for _ in range(2):
        fits, together = _set_frame(tree, moving, snapshot, frame, drift, mean)
        if not (fits and together):
            break
        for axis in range(drift.shape[0]):
            drift[axis], farthest = mean[axis], max(farthest, abs(mean[axis]))
    last.loose = np.float32(farthest != 0.0)
    way = farthest * (moving.stop - moving.start) * frame[drift.shape[0]]
    return fits and way <= FARTHEST_DRIFT


@inlined
def _sweep_leaf(box, lane, moving, frame, drift, planes, leaf):
    """Write the planes and the record of a leaf."""
    # Who may stop meanwhile is going when a ray meets it, or is not: no rounded test tells which.
    ndim, leaf.loose = frame.shape[0] - 1, np.float32(np.inf if may_stop(box, moving) else 0.0)
    for axis in range(ndim):
        lo, hi = swept_side(box, axis, moving, drift)
        set_leaf(leaf, box, axis, moving, frame[ndim])
        write_planes(planes, lane, axis, ndim, outwards(lo, hi, frame[axis], frame[ndim]))


@inlined
def _lane_area(planes, lane, ndim, per_length):
    """Half area of what a lane holds."""
    place, sides = lane // WIDTH * (2 * ndim * WIDTH) + lane % WIDTH, stack_array(3, np.float64)
    for axis in range(ndim):
        upper, lower = planes[place + (axis + ndim) * WIDTH], planes[place + axis * WIDTH]
        sides[axis] = (np.float64(upper) - np.float64(lower)) / per_length
    return _half_area(sides[:ndim])


@inlined
def _unite_child(planes, lane, child, ndim):
    """Write the planes of a lane that holds a wide node."""
    for axis in range(ndim):
        lower = (child * 2 * ndim + axis) * WIDTH
        upper = lower + ndim * WIDTH
        lo, hi = np.float32(np.inf), np.float32(-np.inf)
        for k in range(WIDTH):
            lo, hi = min(lo, planes[lower + k]), max(hi, planes[upper + k])
        write_planes(planes, lane, axis, ndim, (lo, hi))


@lean_kernel
def sweep(tree, moving, snapshot, planes, leaves, frame, areas):
    """Fill `planes`, as those of a snapshot of the tree at rest, and `leaves`, the records of
    `Leaves`, for the span of `moving`, and `frame`, (ndim + 1,): its centre, and its units per
    length; `areas`, (2,): the half area of all wide nodes in the snapshot, and now. Returns 0;
    USELESS if it would be; REFUSED if the tree is of another version than `moving`.
    """
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    ndim, drift, areas[:] = frame.shape[0] - 1, leaves[-1].lo, 0.0
    useful = _choose_frame(tree, moving, snapshot, frame, leaves[-1])
    if useful:
        # From the last to the first: children have greater numbers than their parents.
        for lane in range((snapshot.size + snapshot.loose) * WIDTH - 1, -1, -1):
            slot, child = _leaf_of(tree, snapshot, lane), np.int64(snapshot.children[lane])
            if slot >= 0:
                box = box_of(tree, moving, slot)
                _sweep_leaf(box, lane, moving, frame, drift, planes, leaves[slot])
            elif child >= 0:
                _unite_child(planes, lane, child, ndim)
                areas[0] += _lane_area(snapshot.planes, lane, ndim, snapshot.per_length)
                areas[1] += _lane_area(planes, lane, ndim, frame[ndim])
            else:
                for axis in range(ndim):
                    empty = np.float32(np.inf), np.float32(-np.inf)
                    write_planes(planes, lane, axis, ndim, empty)
    end_query(tree.state)
    return np.int64(0 if useful else USELESS)


_PLANES, _NUMBERS = np.empty(0, np.float32), np.empty(0)
_entry = entry_points(
    *(sweep, no_motion, no_snapshot, _PLANES),
    *(lambda ndim: np.empty(0, leaf_dtype(ndim)), _NUMBERS, _NUMBERS),
)


def swept(tree: Tree, moving: Moving, snapshot: Snapshot) -> tuple[Sweep | None, float]:
    """A snapshot for the span of `moving`, made of that of the tree at rest, and how many times as
    large its nodes are; None where it would prune too little; RuntimeError if the tree is of
    another version than `moving`.
    """
    ndim = len(snapshot.center)
    planes, frame, areas = on_cache_lines(len(snapshot.planes)), np.empty(ndim + 1), np.empty(2)
    records = aligned_empty(len(tree.handles) + 1, leaf_dtype(ndim))
    done = _entry(ndim)(tree, moving, snapshot, planes, records, frame, areas)
    if done == USELESS:
        return None, 1.0
    accepted(done)
    center, per_length = frame[:ndim], float(frame[ndim])
    if accepted(blurred_entry(ndim)(tree, moving.version, BLURRED / per_length)):
        return None, 1.0
    snapshot = snapshot._replace(planes=planes, center=center, per_length=per_length)
    grown = areas.item(1) / areas.item(0) if areas.item(0) > 0.0 else 1.0
    return Sweep(snapshot, moving, Leaves(records, moving.start)), grown
