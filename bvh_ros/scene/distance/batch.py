# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of overlaps, of what is nearest, and of clearances: at rest, and what they share with
those at times, see `moving`.
"""

from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    BOOL,
    CHANGES,
    INT64,
    NONE,
    UINT32,
    OpenTree,
    begin_query,
    end_query,
    is_finite,
    leaf_box,
    nearest,
    of_row,
)
from ...tree.access import COUNT as EVERYBODY
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..names import Slots
from ..results import NO_NODE
from ..shapes.shape import FINE, Floats
from ..store import Columns
from . import narrow_phase
from .narrow_phase import box_gap, gap
from .penetration import (
    signed_distance_in_box,
    signed_distance_in_obstacle,
    signed_distance_of_shapes,
)
from .query import (
    FAULTY,
    NARROW,
    REFUSED,
    ROUNDED,
    AtRest,
    QueryShape,
    found_in,
    lie_at_rest,
    make_row,
    order_found,
    overlap_kernel,
)

# ---- Which obstacles touch query shapes.

# Whether distances have a sign: None, not False, so that kernels without it do not have its code.
Signed: TypeAlias = Literal[True] | None

ANY, COUNT, FIRST, ALL, HITS = range(5)  # what is wanted of each row
OPEN = -1  # only exact arithmetic decides
FEW = 64  # handles that there is room for at first
WANTED = {'any': ANY, 'count': COUNT, 'first': FIRST, 'all': ALL, 'hits': HITS}


class Answers(NamedTuple):
    """What overlap queries find: of each row, if it is wanted."""

    touched: Any
    """(n,) whether there is any, if that is all that is wanted."""
    numbers: Any
    """(n,) how many there are; where ALL are wanted (n + 1,), offsets of theirs."""
    handles: Any
    """(n,) of the first, NO_NODE without any; where ALL are wanted those of all hits, row
    after row."""
    distances: Any
    """(n,) of the first, inf without any."""
    points: Any
    """The same, (n, 3), NaN without any."""


NO_HANDLES = np.empty(0, np.uint32)
NOT_WANTED = np.empty(0, BOOL), np.empty(0, INT64), NO_HANDLES, np.empty(0), np.empty((0, 3))


def room_for(count: int, wanted: int) -> tuple[Any, ...]:
    """Room for what is wanted of so many rows, plain `Answers`."""
    touched, numbers, handles, distances, points = NOT_WANTED
    if wanted == ANY:
        touched = np.empty(count, BOOL)
    elif wanted == COUNT:
        numbers = np.empty(count, INT64)
    elif wanted == FIRST:
        handles = np.empty(count, UINT32)
    elif wanted == ALL:
        numbers, handles = np.empty(count + 1, INT64), np.empty(FEW, UINT32)
        numbers[0] = 0
    else:
        numbers, handles = np.empty(count, INT64), np.empty(count, UINT32)
        distances, points = np.empty(count), np.empty((count, 3))
    return touched, numbers, handles, distances, points


@inlined
def answer_overlaps(world, flat, rows, place, options, node_handles, found, answers, answer_one):
    """Answer the rows [start, stop) of `QueryRows` by `Answers`, both as plain tuples; place =
    (start, stop), options = (what is wanted, handles before these rows). Returns (rows done, room
    wanted in `found`, handles written, pairs compared, those of them that took more digits): fewer
    rows than there are where there is no room for the next one, or where it is OPEN, FAULTY or, if
    the world is `flat`, NARROW, which stands for the room.

    answer_one(world, row, query, mask, enough, node_handles, found) does what `find_touching`
    does; a negative count is returned instead of rows.
    """
    (row, stop), (wanted, before), (records, _, tolerances, masks, _) = place, options, rows
    written, compared, more, needed = 0, 0, 0, np.int64(0)
    own, box = stack_array(1, records), stack_array((2, 3), np.float64)
    while row < stop:
        record, bounds, fault = make_row(rows, row, own, box)
        aligned, height = not record[0].shaped, record[0].position[2]
        if fault != FINE or (flat and not aligned):
            needed = np.int64(FAULTY if fault != FINE else NARROW)
            break
        tolerance, mask = of_row(tolerances, row), of_row(masks, row)
        query = QueryShape(record, bounds, aligned, tolerance, height)
        needed, doubtful, pairs, digits = answer_one(
            world, row, query, mask, wanted == ANY, node_handles, found
        )
        compared, more = compared + pairs, more + digits
        if needed < 0:
            row = needed
            break
        if needed > found.slots.shape[0]:
            break
        if wanted == ALL and written + needed > answers[2].shape[0]:
            break
        if doubtful > 0 and (wanted != ANY or needed == doubtful):
            needed = np.int64(OPEN)
            break
        written = write_row(node_handles, found, needed, wanted, answers, row, before, written)
        row += 1
    return np.int64(row), needed, written, compared, more


@inlined
def _answer_one(world, row, query, mask, enough, node_handles, found):
    return overlap_kernel(world.tree, world.bodies, query, mask, enough, node_handles, found)


@lean_kernel
def overlap_rows(view, bodies, node_handles, memory, rows, place, options, answers):
    """`answer_overlaps` among obstacles at rest, and the version of the tree; REFUSED instead of
    rows if it is changed.
    """
    if not begin_query(view.tree.state, view.version):
        return np.int64(REFUSED), np.int64(0), 0, 0, 0, np.int64(0)
    world, found = AtRest(view.tree, bodies), found_in(memory)
    done = answer_overlaps(
        world, bodies is None, rows, place, options, node_handles, found, answers, _answer_one
    )
    version = view.tree.state[CHANGES]
    end_query(view.tree.state)
    return (*done, version)


@inlined
def write_row(node_handles, found, count, wanted, answers, row, before, written):
    """Write what is wanted of a row; return how many handles are written, with those of rows
    before it, behind `before` others.
    """
    touched, numbers, handles, _, _ = answers
    if wanted == ANY:
        touched[row] = count > 0
    elif wanted == ALL:
        for i in range(count):
            handles[written + i] = node_handles[found.slots[found.order[i]]]
        written += count
        numbers[row + 1] = before + written
    if wanted in (FIRST, HITS):
        write_first(node_handles, found, count, wanted, answers, row)
    if wanted in (COUNT, HITS):
        numbers[row] = count
    return written


@inlined
def write_first(node_handles, found, count, wanted, answers, row):
    """Write the first."""
    first, (_, _, handles, distances, points) = found.order[0], answers
    handles[row] = node_handles[found.slots[first]] if count > 0 else NO_NODE
    if wanted == HITS:
        distances[row] = found.distances[first] if count > 0 else np.inf
        for axis in range(3):
            points[row, axis] = found.points[first, axis] if count > 0 else np.nan


# ---- Which obstacles are nearest to points, by their true shapes.
#
# No shape is nearer than its box. So the tree gives the nearest boxes, ever more of them, until
# the next box is farther than the k-th nearest shape among them.

MORE = 4  # times as many boxes, where those so far do not decide


class Points(NamedTuple):
    """n points."""

    points: Any
    """(n, 3)"""
    reaches: Any
    """The largest distance, one for all or (n,)."""
    masks: Any
    """One for all, or (n,)."""
    order: Any
    """In which they are answered, (n,); empty: as they stand."""
    before: Any = None
    """What packets found of the rows, `Bounded`, if they did."""


class Near(NamedTuple):
    """What is nearest to n points, k a row."""

    handles: Any
    distances: Any
    points: Any


def room_for_near(count: int, k: int) -> Near:
    """Room for k of each of so many rows."""
    # As Near(...), which would take one more call of a function of Python's.
    parts = np.empty((count, k), UINT32), np.empty((count, k)), np.empty((count, k, 3))
    return tuple.__new__(Near, parts)


@inlined
def answer_nearest(
    world, points, place, options, node_handles, found, near, in_order, neighbours, lie
):
    """Fill in the rows of `Points` in the places [start, stop) of their order in `near`; place =
    (start, stop), options = (k, how many boxes more are likely to be wanted, whether an
    obstacle may stand at two places, see slicing.py, `Signed`). Returns (rows done, room wanted in
    `found`, how many were found at last): fewer rows than there are where there is no room, or
    where a point is FAULTY, which stands for the room.

    neighbours(world, row, low, high, k, reach, mask, found) writes the slots of k boxes that are
    nearest to a box, or of some more, as `nearest`; it returns (how many, whether there may be
    more, how far the obstacles in these are at least). A negative number of them is returned
    instead of rows. `in_order`: it writes them in order, nearest first. lie(world, row, slot,
    point, signed, found, place) fills in how an obstacle lies to a point.
    """
    (done, stop), (k, more, twice, signed) = place, options
    wanted, count, everybody = np.int64(0), np.int64(0), world.tree.state[EVERYBODY]
    while done < stop:
        row = points.order[done] if points.order.shape[0] > 0 else done
        point, reach = points.points[row], of_row(points.reaches, row)
        if not is_finite(point, point):
            wanted = np.int64(FAULTY)
            break
        limit, mask, filled = max(reach * ROUNDED, reach), of_row(points.masks, row), 0
        wanted = np.int64(min(k + more, everybody + 1))
        while wanted <= found.slots.shape[0]:
            count, others, last = neighbours(world, row, point, point, wanted, limit, mask, found)
            if count < 0:
                return count, wanted, count
            farthest = np.inf
            for i in range(count):
                if in_order and found.bounds[i] > farthest:  # so are all that follow
                    count, others = np.int64(i), False
                    break
                slot, found.points[i, 2] = found.slots[i], point[2]
                lie(world, row, slot, point, signed, found, i)
                if k == 1:
                    farthest = min(farthest, max(found.distances[i], 0.0) * ROUNDED)
            order_found(found, count, node_handles)
            filled = keep(found, count, (k, reach, twice), node_handles, near, row)
            farthest = max(near.distances[row, k - 1], 0.0) * ROUNDED if filled == k else np.inf
            if not others or last > farthest or (in_order and more == 0):
                break
            wanted = min(wanted * MORE, everybody + 1)
        if wanted > found.slots.shape[0]:
            break
        pad(near, row, filled)
        done += 1
    return np.int64(done), wanted, count


@inlined
def _neighbours(world, row, low, high, wanted, reach, mask, found):
    count = nearest(world.tree, low, high, wanted, reach, mask, found.slots, found.bounds)
    return count, count >= wanted, found.bounds[count - 1] if count > 0 else np.inf


@inlined
def _lie(world, row, slot, point, signed, found, place):
    lie_at_rest(world.tree, world.bodies, slot, point, found, place)
    _lie_within(world.tree, world.bodies, slot, point, signed, found, place)


@inlined
def _lie_within(tree, bodies, slot, point, signed, found, place):
    """Where distances have a sign, how deep the point is in an obstacle."""
    if signed is None:
        return
    if bodies is None:
        lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
        signed_distance_in_box(lo, hi, point, found, place)
    else:
        signed_distance_in_obstacle(bodies, slot, point, found, place)


@lean_kernel
def nearest_rows(view, bodies, node_handles, memory, points, place, options, near):
    """`answer_nearest` among obstacles at rest, as `overlap_rows`."""
    if not begin_query(view.tree.state, view.version):
        return np.int64(REFUSED), np.int64(0), np.int64(0), np.int64(0)
    world, found = AtRest(view.tree, bodies), found_in(memory)
    done = answer_nearest(
        world, points, place, options, node_handles, found, near, True, _neighbours, _lie
    )
    version = view.tree.state[CHANGES]
    end_query(view.tree.state)
    return (*done, version)


@lean_kernel
def keep(found, count, options, node_handles, near, row):
    """Write the first k that are within reach to a row of `near`; return how many there are."""
    k, reach, twice = options
    filled = 0
    for i in range(count):
        place = found.order[i]
        handle, repeated = node_handles[found.slots[place]], False
        if filled == k or not found.distances[place] <= reach:
            break
        if twice:
            for j in range(filled):
                repeated = repeated or near.handles[row, j] == handle
        if repeated:
            continue
        near.handles[row, filled], near.distances[row, filled] = handle, found.distances[place]
        for axis in range(3):
            near.points[row, filled, axis] = found.points[place, axis]
        filled += 1
    return filled


@inlined
def pad(near, row, filled):
    """Write that there is nothing more."""
    for j in range(filled, near.handles.shape[1]):
        near.handles[row, j], near.distances[row, j] = NO_NODE, np.inf
        near.points[row, j] = np.nan


# ---- How far shapes are from the nearest obstacle, by their true shapes.
#
# No two shapes are nearer than their boxes. So the tree gives the nearest boxes, ever more of
# them, until the next box is farther than the nearest shape among them.

ROUNDED_GAP = 1.0 + 2.0**-40  # no computed distance is off by as much


class Neighbours(NamedTuple):
    """The obstacles nearest to n shapes."""

    slots: Any
    """(n,) NONE where there is none; empty where the caller needs none."""
    distances: Any
    points: Any
    """(n, 3): the shape's."""
    other_points: Any
    """(n, 3): the obstacle's."""
    handles: Any
    """(n,) uint32 node handles of the obstacles, NO_NODE where there is none."""


NO_SLOTS = np.empty(0, INT64)


def room_for_neighbours(count: int, slots: bool) -> Neighbours:
    """Room for so many rows, with their slots or without."""
    places = np.empty(count, INT64) if slots else NO_SLOTS
    distances, handles = np.empty(count), np.empty(count, UINT32)
    # As Neighbours(...), which would take one more call of a function of Python's.
    parts = places, distances, np.empty((count, 3)), np.empty((count, 3)), handles
    return tuple.__new__(Neighbours, parts)


@inlined
def answer_clearances(
    world, rows, place, options, node_handles, found, results, in_order, neighbours, look
):
    """Fill in the rows [start, stop) of `Neighbours`; rows as of `QueryRows`, place = (start,
    stop), options = (reaches, the slot of the obstacle that is the only row, or NONE, `Signed`,
    whether the nearest box is likely to be that of the nearest obstacle). Returns (rows done, room
    wanted in `found`): fewer rows than there are where there is no room, or where a shape is
    FAULTY, which stands for the room.

    `in_order`, `neighbours`: see `answer_nearest`. look(world, row, shape, slot, reach, signed,
    node_handles, results) keeps an obstacle, if it is nearer than what is there.
    """
    (row, stop), (reaches, itself, signed, alike) = place, options
    (records, _, _, masks, _), wanted, besides = rows, np.int64(0), np.int64(NONE)
    everybody = world.tree.state[EVERYBODY]
    own, box = stack_array(1, records), stack_array((2, 3), np.float64)
    if itself != NONE:
        besides = node_handles[itself]
    while row < stop:
        record, bounds, fault = make_row(rows, row, own, box)
        if fault != FINE:
            wanted = np.int64(FAULTY)
            break
        reach, mask = of_row(reaches, row), of_row(masks, row)
        write_none(results, row)
        farthest = np.inf
        limit, wanted, looked = max(reach * ROUNDED_GAP, reach), np.int64(2), np.int64(0)
        if alike and not record[0].shaped:
            wanted = np.int64(1)
        while wanted <= found.slots.shape[0]:
            count, others, last = neighbours(
                world, row, bounds[0], bounds[1], wanted, limit, mask, found
            )
            if count < 0:
                return count, wanted
            for i in range(looked, count):
                slot = found.slots[i]
                if in_order and found.bounds[i] > farthest:  # so are all that follow
                    others = False
                    break
                if node_handles[slot] != besides:
                    look(world, row, record[0], slot, reach, signed, node_handles, results)
                    farthest = max(results.distances[row], 0.0) * ROUNDED_GAP
            if not others or last > farthest:
                break
            looked = count if in_order else np.int64(0)
            wanted = min(wanted * MORE, everybody + 1)
        if wanted > found.slots.shape[0]:
            break
        row += 1
    return np.int64(row), wanted


@inlined
def _look(world, row, one, slot, reach, signed, node_handles, results):
    look_at_shape(
        *(world.bodies, slot, one, None, slot, reach, signed, node_handles, results, row)
    )


@lean_kernel
def clearance_rows(view, bodies, node_handles, memory, rows, place, options, results):
    """`answer_clearances` among obstacles at rest, as `overlap_rows`."""
    if not begin_query(view.tree.state, view.version):
        return np.int64(REFUSED), np.int64(0), np.int64(0)
    world, found, itself = AtRest(view.tree, bodies), found_in(memory), options[1]
    if itself != NONE:
        records, corners, _, _, _ = rows
        lo, hi = leaf_box(view.tree.nodes, view.tree.tight, 2 * itself)
        records[0] = bodies.shapes[itself]
        for axis in range(lo.shape[0]):
            corners[0, 0, axis], corners[0, 1, axis] = lo[axis], hi[axis]
    done = answer_clearances(
        world, rows, place, options, node_handles, found, results, True, _neighbours, _look
    )
    version = view.tree.state[CHANGES]
    end_query(view.tree.state)
    return (*done, version)


@lean_kernel
def apart(one, other, bodies, signed, points):
    """Distance of a shape from an obstacle; minus the depth, if it is `signed`."""
    planar = bodies.footprints is not None
    if one.shaped or other.shaped:
        distance = gap(one, bodies.query_hulls, other, bodies.hulls, planar, points)
    else:
        distance = box_gap(one, other, 2 if planar else 3, points)
    if signed is not None:
        distance = signed_distance_of_shapes(one, other, bodies, distance, points)
    return distance


@lean_kernel
def look_at_shape(bodies, place, one, growths, slot, reach, signed, node_handles, results, row):
    """Keep the obstacle of a slot, which stands at a place of `bodies`, if it is nearer than what
    is there; ties by handle. `growths`: those of the shape and the obstacle, or None.
    """
    points = stack_array((2, 3), np.float64)
    distance = apart(one, bodies.shapes[place], bodies, signed, points)
    if growths is not None:
        distance = grow_both(points, distance, growths, signed)
    if bodies.footprints is not None:
        points[0, 2] = points[1, 2] = one.position[2]
    keep_nearer(node_handles, (slot, distance, reach), points, results, row)


@inlined
def grow_both(points, distance, growths, signed):
    """The distance of two shapes after both have grown, and their points."""
    if not growths[0] + growths[1] > 0.0:
        return distance
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


@inlined
def write_none(results, row):
    """Write that there is none."""
    results.handles[row], results.distances[row] = NO_NODE, np.inf
    if results.slots.shape[0] > 0:
        results.slots[row] = NONE
    for axis in range(3):
        results.points[row, axis] = results.other_points[row, axis] = np.nan


@inlined
def keep_nearer(node_handles, found, points, results, row):
    """Keep an obstacle, found = (slot, distance, reach), and points (2, 3), if it is nearer than
    what is there; ties by handle.
    """
    slot, distance, reach = found
    if distance > reach or distance > results.distances[row]:
        return
    handle, best = node_handles[slot], np.int64(results.handles[row])  # NO_NODE is the last one
    if distance == results.distances[row] and best < handle:
        return
    results.distances[row], results.handles[row] = distance, handle
    if results.slots.shape[0] > 0:
        results.slots[row] = slot
    for axis in range(3):
        results.points[row, axis], results.other_points[row, axis] = (
            points[0, axis],
            points[1, axis],
        )


# ---- Which obstacles touch each other.


def find_pairs(tree: OpenTree, columns: Columns, mask: int) -> Slots:
    """Slots (m, 2) of all obstacles that touch each other, the older of a pair first, sorted."""
    pairs = tree.slots(tree.overlap_pairs(mask))
    narrow = columns.geometry['shaped'][pairs].any(axis=1)
    if not narrow.any():
        return pairs
    touches = np.asarray(~narrow)
    found = np.empty(np.count_nonzero(narrow), np.bool_)
    planar = columns.footprint is not None
    columns.pairs_compared += len(found)
    columns.pairs_in_more_digits += narrow_phase.near_pairs(
        columns.geometry, columns.hulls, pairs[narrow], planar, found
    )
    touches[narrow] = found
    return pairs[touches]


def each_once(columns: Columns, pairs: Slots) -> Slots:
    """Pairs of different obstacles, each once, where one may stand at two places."""
    handles = columns.node_handle[pairs]
    order = np.argsort(handles, axis=1)
    pairs, handles = np.take_along_axis(pairs, order, 1), np.take_along_axis(handles, order, 1)
    row = np.unique(handles, axis=0, return_index=True)[1]
    return pairs[row[handles[row, 0] != handles[row, 1]]]


def corners(records: NDArray[np.void]) -> tuple[Floats, Floats]:
    """Lowest and highest corners of axis-aligned boxes, the same doubles that the tree holds."""
    return records['position'] - records['half'], records['position'] + records['half']
