# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances among obstacles that move, at a time a row."""

from typing import Any, NamedTuple

import numpy as np

from ...tree.access import NONE, end_query, is_finite, of_row
from ...tree.compiler import inlined, lean_kernel, prefetch, stack_array
from ...tree.motion.access import (
    OUTSIDE,
    at_least,
    begin_asking,
    box_of,
    covers,
    elapsed,
    fetch_box,
    moves,
    near_at,
    nearest_bounds,
    overlap_at,
)
from ..shapes.shape import FINE
from ..store import WIDER
from . import batch
from .batch import ALL, ANY, keep, pad, write_row
from .narrow_phase import length, near
from .penetration import signed_distance_in_obstacle
from .query import (
    FAULTY,
    FOUND,
    LARGEST,
    ROUNDED,
    QueryShape,
    found_in,
    grow,
    look_at,
    make_row,
    order_found,
)

# ---- Overlaps and distances among obstacles that move, at a time a row.
#
# The tree gives the boxes at the time, as real arithmetic has them. `pose_at` then writes each
# obstacle where it stands, and the rest is as for obstacles at rest.

ROOM = FOUND + 2  # floats of a row of `Room` and `Found`


class QueryTimes(NamedTuple):
    """The times of rows, and how obstacles change."""

    bodies: Any
    """`Bodies`, as stored."""
    node_handles: Any
    at: Any
    """s, one for all or (n,)"""
    growth: float
    """Those that move grow at this rate all round, m/s, before and after their stamps."""
    earliest: float
    latest: float
    """The first and the last of their stamps, s."""


class Candidates(NamedTuple):
    """For the boxes that the tree names."""

    slots: Any
    """(n,), as of the gaps."""
    gaps: Any
    spare: Any
    """`Bodies` with one shape: an obstacle where it stands."""


@inlined
def room_in(memory):
    """(`Room`, `Found`) of memory = (one array, ROOM floats a box; what is `spare`), see
    `found_in`.
    """
    floats, spare = memory
    rows = floats.shape[0] // ROOM
    end = FOUND * rows
    slots, gaps = floats[end : end + rows], floats[end + rows : end + 2 * rows]
    return Candidates(slots.view(np.int64), gaps, spare), found_in(floats[:end])


@inlined
def most_growth(then, at):
    """By how much any obstacle may have grown."""
    if then.growth == 0.0:
        return 0.0
    return then.growth * max(at - then.earliest, then.latest - at, 0.0) * WIDER


@inlined
def displacement(velocity, since, left):
    """How far an obstacle has gone along an axis; since = `elapsed`."""
    return min(max(velocity * min(since[0], left), -LARGEST), LARGEST)


@inlined
def pose_at(tree, moving, then, spare, slot, at):
    """Write an obstacle to `spare` where it stands at a time; return by how much it has grown."""
    box = box_of(tree, moving, slot)
    _, _, velocity, reference = box
    displaced, shape = stack_array(3, np.float64), spare.shapes[0]
    since = elapsed(at, reference, moving.nanoseconds)
    spare.shapes[0] = then.bodies.shapes[slot]
    for axis in range(velocity.shape[0]):
        displaced[axis] = displacement(velocity[axis], since, moving.left)
        shape.position[axis] += displaced[axis]
    footprint_at(then.bodies.footprints, spare.footprints, slot, displaced)
    return then.growth * abs(since[0]) if moves(box) else 0.0


@inlined
def footprint_at(footprints, spare, slot, displaced):
    """Write the same of a planar scene."""
    if footprints is not None:
        spare[0] = footprints[slot]
        for axis in range(2):
            spare[0].centre[axis] += displaced[axis]


@lean_kernel
def touch_rows(tree, moving, then, queries, options, memory, answers):
    """Answer the rows [start, stop) by plain `Answers`, options = (start, stop, what
    is wanted, handles before these rows). Returns (rows done, room wanted, handles written, pairs
    compared): fewer rows than there are where there is no room for the next one, or where that is
    not legal, with FAULTY as room wanted; OUTSIDE or REFUSED instead. `memory` holds what
    touches the last row, if not ANY is wanted, see `room_in`.
    """
    room, found = room_in(memory)
    (row, stop, wanted, before), (records, _, tolerances, masks, _) = options, queries
    why = begin_asking(tree, moving, stop - row)
    if why != 0:
        return why, 0, 0, 0
    grown, box = stack_array((2, 3), np.float64), stack_array((2, 3), np.float64)
    own, fit = stack_array(1, records), min(room.slots.shape[0], found.slots.shape[0])
    needed, written, compared = np.int64(0), np.int64(0), np.int64(0)
    ndim = moving.velocities[0].velocity.shape[0]
    while row < stop:
        at, tolerance = of_row(then.at, row), of_row(tolerances, row)
        record, bounds, fault = make_row(queries, row, own, box)
        if covers(moving, at, 0.0, 0.0) == 0:
            row = np.int64(OUTSIDE)
            break
        if fault != FINE:
            needed = np.int64(FAULTY)
            break
        grow(QueryShape(record, bounds, False, tolerance + most_growth(then, at), 0.0), grown)
        low, high, mask = grown[0, :ndim], grown[1, :ndim], of_row(masks, row)
        needed = overlap_at(tree, moving, at, low, high, mask, room.slots, 0)
        if needed > fit or (wanted == ALL and written + needed > answers[2].shape[0]):
            break
        some = record[0], tolerance, at, wanted == ANY
        touching = _touch(tree, moving, then, some, room.slots[:needed], room.spare, found)
        if wanted != ANY:
            order_found(found, touching, then.node_handles)
        written = write_row(
            then.node_handles, found, touching, wanted, answers, row, before, written
        )
        row, compared = row + 1, compared + needed
    end_query(tree.state)
    return np.int64(row), needed, written, compared


@lean_kernel
def _touch(tree, moving, then, options, slots, spare, found):
    """Fill in which of some obstacles touch, options = (shape, tolerance, at, whether one is
    enough), and how they lie to its centre; return how many.
    """
    (solid, tolerance, at, enough), bodies, count, growth = options, then.bodies, 0, 0.0
    # Else the query of the tree was larger than the shape.
    exact = not solid.shaped and tolerance == 0.0 and most_growth(then, at) == 0.0
    for slot in slots:
        touches = exact and not bodies.shapes[slot].shaped
        if not (touches and enough):
            growth = pose_at(tree, moving, then, spare, slot, at)
        shape, planar = spare.shapes[0], bodies.footprints is not None
        if not touches:
            reach = tolerance + growth
            touches, _ = near(shape, bodies.hulls, solid, bodies.query_hulls, reach, planar)
        if touches and enough:
            found.slots[0] = slot
            return 1
        if touches:
            found.slots[count], found.points[count, 2] = 0, solid.position[2]
            look_at(shape, spare.footprints, bodies.hulls, solid.position, found, count)
            found.slots[count] = slot
            apply_growth(found, count, growth, None)
            count += 1
    return count


@inlined
def apply_growth(found, row, growth, signed):
    """How an obstacle lies to the centre after it has grown."""
    if growth == 0.0:
        return
    distance = found.distances[row]
    left, displaced = distance - growth, growth
    if signed is None:
        left, displaced = max(left, 0.0), min(growth, distance)
    for axis in range(3):
        found.points[row, axis] += displaced * found.normals[row, axis]
        if signed is None and left == 0.0:
            found.normals[row, axis] = 0.0
    found.distances[row] = left


# ---- What is nearest to points and shapes among obstacles that move, at a time a row: see
# `moving`.
#
# As `nearest_rows` and `batch.clearance_rows`.

# Room for boxes that are as near as the last one that is wanted: those that a shape touches.
PLACES = 4


@inlined
def _nearest_bounds(tree, near_by, found_before, row, slots, gaps):
    """`nearest_bounds`, from what packets found of this row if they found as many."""
    if found_before is None:
        return nearest_bounds(tree, near_by, slots, gaps)
    if found_before.slots.shape[1] != slots.shape[0]:
        return nearest_bounds(tree, near_by, slots, gaps)
    for i in range(found_before.counts[row]):
        slots[i] = found_before.slots[row, i]
    return found_before.counts[row], found_before.left_out[row]


@inlined
def neighbours(tree, near_by, room, found_before, row):
    """Slots of the boxes nearest to `near_by`, a `NearAt`: (whether there may be more, how far
    those are at least, how many). `found_before`: see `near_rows`.
    """
    wanted = near_by.k
    places = max(wanted, PLACES) if found_before is None else wanted
    slots, gaps = room.slots, room.gaps[:places]
    total, left_out = _nearest_bounds(tree, near_by, found_before, row, slots[:places], gaps)
    more, last = total >= wanted, at_least(left_out)
    return more, last, total


@lean_kernel
def near_rows(tree, moving, then, points, found_before, options, memory, results):
    """Fill in the rows [start, stop) of `results`.

    options = (start, stop, k, whether some boxes more are likely to be wanted, how many there are,
    whether an obstacle may stand at two places, `Signed`). `found_before`: what packets found of
    all rows, `Bounded`, or None. Returns (rows done, room wanted) as `touch_rows`, and how many
    were found at last.
    """
    (room, found), (done, stop, k, some_more, everybody, twice, signed) = room_in(memory), options
    why = begin_asking(tree, moving, stop - done)
    if why != 0:
        return why, 0, np.int64(0)
    wanted, total = 0, np.int64(0)
    while done < stop:
        row = points.order[done] if points.order.shape[0] > 0 else done
        at, point, reach = of_row(then.at, row), points.points[row], of_row(points.reaches, row)
        if covers(moving, at, 0.0, 0.0) == 0:
            done = np.int64(OUTSIDE)
            break
        if not is_finite(point, point):
            end_query(tree.state)
            return np.int64(done), FAULTY, np.int64(0)
        more, mask = most_growth(then, at), of_row(points.masks, row)
        limit, filled = max(reach * ROUNDED, reach) + more, 0
        wanted = min(k + 1 if some_more else k, everybody + 1)
        while wanted <= found.slots.shape[0]:
            near_by = near_at(moving, at, point, point, wanted, limit, mask)
            others, last, total = neighbours(tree, near_by, room, found_before, row)
            _lie(tree, moving, then, (point, at), signed, room, room.slots[:total], found)
            order_found(found, total, then.node_handles)
            filled = keep(found, total, (k, reach, twice), then.node_handles, results, row)
            farthest = max(results.distances[row, k - 1], 0.0) * ROUNDED if filled == k else np.inf
            if not others or last - more > farthest:
                break
            wanted = min(wanted * 4, everybody + 1)
        if wanted > found.slots.shape[0]:
            break
        pad(results, row, filled)
        done += 1
    end_query(tree.state)
    return np.int64(done), wanted, total


@inlined
def _lie(tree, moving, then, options, signed, room, slots, found):
    """Fill in how obstacles lie to a point at a time, options = (point, at)."""
    point, at = options
    for i in range(slots.shape[0]):
        growth = pose_at(tree, moving, then, room.spare, slots[i], at)
        found.slots[i], found.points[i, 2], shape = 0, point[2], room.spare.shapes[0]
        look_at(shape, room.spare.footprints, then.bodies.hulls, point, found, i)
        if signed is not None:
            signed_distance_in_obstacle(shape, room.spare, point, found, i)
        found.slots[i] = slots[i]
        apply_growth(found, i, growth, signed)


@lean_kernel
def clear_rows(tree, moving, then, queries, options, memory, results):
    """Fill in the rows [start, stop) of `results`, a `batch.Neighbours`; options = (start, stop,
    reaches, how many boxes there are, the slot of the obstacle that is the only row, or NONE,
    `Signed`, whether the nearest box is likely to be that of the nearest obstacle).
    Returns (rows done, room wanted) as `touch_rows`.
    """
    row, stop, reaches, everybody, itself, signed, alike = options
    room, _ = room_in(memory)
    why = begin_asking(tree, moving, stop - row)
    if why != 0:
        return why, 0
    (records, bounds, _, masks, _), wanted, handles = queries, 0, then.node_handles
    own = stack_array(1, records)
    box = stack_array((2, 3), np.float64)
    grown, besides = 0.0, np.int64(NONE)
    if itself != NONE:
        grown = put_itself(tree, moving, then, (records, bounds[0]), itself, room.spare)
        besides = handles[itself]
    while row < stop:
        at, reach, mask = of_row(then.at, row), of_row(reaches, row), of_row(masks, row)
        if covers(moving, at, 0.0, 0.0) == 0:
            row = np.int64(OUTSIDE)
            break
        more = most_growth(then, at) + grown
        record, corners, fault = make_row(queries, row, own, box)
        if fault != FINE:
            end_query(tree.state)
            return np.int64(row), FAULTY
        low, high = corners[0], corners[1]
        exact = more == 0.0 and not record[0].shaped
        limit, wanted = max(reach * batch.ROUNDED_GAP, reach) + more, 1 if exact and alike else 2
        while wanted <= room.gaps.shape[0]:
            near_by = near_at(moving, at, low, high, wanted, limit, mask)
            others, last, total = neighbours(tree, near_by, room, None, row)
            batch.write_none(results, row)
            fetch(tree, moving, then, room.slots[:total])
            for slot in room.slots[:total]:
                pair, least = (record[0], slot, at), max(results.distances[row], 0.0)
                passed = least < np.inf and exact and _is_farther(tree, moving, then, pair, least)
                if handles[slot] != besides and not passed:
                    growths = grown, pose_at(tree, moving, then, room.spare, slot, at)
                    pair = record[0], slot, reach
                    _clear(room.spare, pair, growths, signed, handles, results, row)
            distance = max(results.distances[row], 0.0)
            if not others or last - more > distance * batch.ROUNDED_GAP:
                break
            wanted = min(wanted * batch.MORE_BOXES, everybody + 1)
        if wanted > room.gaps.shape[0]:
            break
        row += 1
    end_query(tree.state)
    return np.int64(row), wanted


@inlined
def fetch(tree, moving, then, slots):
    """Prefetch the memory that `pose_at` reads."""
    for slot in slots:
        prefetch(then.bodies.shapes, slot, 2)
        fetch_box(tree, moving, slot)


@inlined
def _is_farther(tree, moving, then, pair, least):
    """Whether two aligned boxes, pair = (shape, slot, at), are farther apart than this: as
    `pose_at` and `box_gap` have it, without a copy or points. For others False.
    """
    one, slot, at = pair
    other, gaps = then.bodies.shapes[slot], stack_array(3, np.float64)
    if other.shaped:
        return False
    _, _, velocity, reference = box_of(tree, moving, slot)
    since = elapsed(at, reference, moving.nanoseconds)
    for axis in range(velocity.shape[0]):
        displaced = displacement(velocity[axis], since, moving.left)
        position, half = other.position[axis] + displaced, other.half[axis]
        low = max(one.position[axis] - one.half[axis], position - half)
        high = min(one.position[axis] + one.half[axis], position + half)
        gaps[axis] = max(low - high, 0.0)
    return length(gaps[: velocity.shape[0]]) > least


@inlined
def put_itself(tree, moving, then, query, slot, spare):
    """Write an obstacle to query = (record, bounds) where it stands at the first time; return by
    how much it has grown.
    """
    record, bounds = query
    lo, hi, velocity, reference = box_of(tree, moving, slot)
    at = then.at[0]
    since = elapsed(at, reference, moving.nanoseconds)
    for axis in range(lo.shape[0]):
        displaced = displacement(velocity[axis], since, moving.left)
        bounds[0, axis], bounds[1, axis] = lo[axis] + displaced, hi[axis] + displaced
    grown = pose_at(tree, moving, then, spare, slot, at)
    record[0] = spare.shapes[0]
    return grown


@lean_kernel
def _clear(spare, pair, growths, signed, node_handles, results, row):
    """Keep an obstacle where it stands, pair = (shape, slot, reach), if it is the nearer one."""
    one, slot, reach = pair
    points = stack_array((2, 3), np.float64)
    distance = batch.apart(one, spare.shapes[0], spare, signed, points)
    if growths[0] + growths[1] > 0.0:
        distance = _grow_both(points, distance, growths, signed)
    if spare.footprints is not None:
        points[0, 2] = points[1, 2] = one.position[2]
    batch.keep_nearer(node_handles, (slot, distance, reach), points, results, row)


@inlined
def _grow_both(points, distance, growths, signed):
    """The distance of two shapes after both have grown, and their points."""
    left = distance - growths[0] - growths[1]
    if signed is None and left <= 0.0:
        share = 0.0 if distance == 0.0 else min(growths[1] / distance, 1.0)
        for axis in range(3):
            points[1, axis] += share * (points[0, axis] - points[1, axis])
            points[0, axis] = points[1, axis]
        return 0.0
    for axis in range(3):
        displaced = (points[0, axis] - points[1, axis]) / distance if distance != 0.0 else 0.0
        points[0, axis] -= growths[0] * displaced
        points[1, axis] += growths[1] * displaced
    return left
