# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances among obstacles that move: `touching` and `clearance` at a time a row.

The tree says whose boxes are there at the time, as real arithmetic does. Each obstacle is then
written down where it stands (`place`) and looked at as one at rest.
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.access import end_query, of_row
from ...tree.compiler import inlined, lean_kernel, stack_array
from ...tree.motion.access import OUTSIDE, begin_asking, box_of, covers, elapsed, moves, overlap_at
from ..geometry.canonical import FINE
from ..store.places import WIDER
from .narrow_phase import near
from .query_rows import FAULTY, make_row
from .query_shape import LARGEST, QueryShape, grow
from .touching import FOUND, found_in, look_at, order_found
from .touching_rows import ALL, ANY, tell_row

ROOM = FOUND + 2  # floats of a row of `Room` and `Found`


class Then(NamedTuple):
    """When rows are asked about, and what becomes of obstacles."""

    bodies: Any
    """`Bodies`, as obstacles were told."""
    node_handles: Any
    at: Any
    """s, one for all or (n,)"""
    growth: float
    """Those that move grow by so much all round, m/s, since they were told, or until then."""
    earliest: float
    latest: float
    """When the first and the last of them were told, s."""


class Room(NamedTuple):
    """For the boxes that the tree names."""

    slots: Any
    """(n,), as of the gaps."""
    gaps: Any
    spare: Any
    """`Bodies` with one shape: an obstacle where it stands."""


@inlined
def room_in(memory):
    """(`Room`, `Found`) of memory = (one array, ROOM floats a box; what is `spare`), see
    `touching.found_in`.
    """
    floats, spare = memory
    rows = floats.shape[0] // ROOM
    end = FOUND * rows
    slots, gaps = floats[end : end + rows], floats[end + rows : end + 2 * rows]
    return Room(slots.view(np.int64), gaps, spare), found_in(floats[:end])


@inlined
def most_growth(then, at):
    """By how much any obstacle may have grown."""
    if then.growth == 0.0:
        return 0.0
    return then.growth * max(at - then.earliest, then.latest - at, 0.0) * WIDER


@inlined
def gone(velocity, since, left):
    """How far an obstacle has gone along an axis; since = `elapsed`."""
    return min(max(velocity * min(since[0], left), -LARGEST), LARGEST)


@inlined
def place(tree, moving, then, spare, slot, at):
    """Write an obstacle to `spare` where it stands at a time; return by how much it has grown."""
    box = box_of(tree, moving, slot)
    _, _, velocity, reference = box
    way, shape = stack_array(3, np.float64), spare.shapes[0]
    since = elapsed(at, reference, moving.nanoseconds)
    spare.shapes[0] = then.bodies.shapes[slot]
    for axis in range(velocity.shape[0]):
        way[axis] = gone(velocity[axis], since, moving.left)
        shape.position[axis] += way[axis]
    place_footprint(then.bodies.footprints, spare.footprints, slot, way)
    return then.growth * abs(since[0]) if moves(box) else 0.0


@inlined
def place_footprint(footprints, spare, slot, way):
    """Write the same of a planar scene."""
    if footprints is not None:
        spare[0] = footprints[slot]
        for axis in range(2):
            spare[0].centre[axis] += way[axis]


@lean_kernel
def touch_rows(tree, moving, then, queries, asked, memory, answers):
    """Answer the rows [start, stop) by plain `touching_rows.Answers`, asked = (start, stop, what
    is wanted, handles before these rows). Returns (rows done, room wanted, handles written, pairs
    compared): fewer rows than there are where there is no room for the next one, or where that is
    not legal, with FAULTY as room wanted; OUTSIDE or REFUSED instead. `memory` holds what
    touches the last row, if not ANY is wanted, see `room_in`.
    """
    room, found = room_in(memory)
    (row, stop, wanted, before), (records, _, tolerances, masks, _) = asked, queries
    why = begin_asking(tree, moving, stop - row)
    if why != 0:
        return why, 0, 0, 0
    grown, box = stack_array((2, 3), np.float64), stack_array((2, 3), np.float64)
    own, fit = stack_array(1, records), min(room.slots.shape[0], found.slots.shape[0])
    needed, written, compared = np.int64(0), np.int64(0), np.int64(0)
    ndim = moving.kept[0].velocity.shape[0]
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
        met = _touch(tree, moving, then, some, room.slots[:needed], room.spare, found)
        if wanted != ANY:
            order_found(found, met, then.node_handles)
        written = tell_row(then.node_handles, found, met, wanted, answers, row, before, written)
        row, compared = row + 1, compared + needed
    end_query(tree.state)
    return np.int64(row), needed, written, compared


@lean_kernel
def _touch(tree, moving, then, asked, slots, spare, found):
    """Fill in which of some obstacles touch, asked = (shape, tolerance, at, whether one is
    enough), and how they lie to its centre; return how many.
    """
    (solid, tolerance, at, enough), bodies, count, growth = asked, then.bodies, 0, 0.0
    # Else the tree was asked for more than touches.
    exact = not solid.shaped and tolerance == 0.0 and most_growth(then, at) == 0.0
    for slot in slots:
        touches = exact and not bodies.shapes[slot].shaped
        if not (touches and enough):
            growth = place(tree, moving, then, spare, slot, at)
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
            swell(found, count, growth, None)
            count += 1
    return count


@inlined
def swell(found, row, growth, signed):
    """How an obstacle lies to the centre after it has grown."""
    if growth == 0.0:
        return
    distance = found.distances[row]
    left, way = distance - growth, growth
    if signed is None:
        left, way = max(left, 0.0), min(growth, distance)
    for axis in range(3):
        found.points[row, axis] += way * found.normals[row, axis]
        if signed is None and left == 0.0:
            found.normals[row, axis] = 0.0
    found.distances[row] = left
