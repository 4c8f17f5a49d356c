# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shapes of overlap and distance queries, and the kernels of one query."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree.access import (
    ALL,
    ANY_VERSION,
    begin_query,
    checks,
    end_query,
    leaf_box,
    of_row,
    overlap,
)
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..shapes.hull import Hulls, MeshStore
from ..shapes.shadow import seen_from_above
from ..shapes.shape import (
    BOX,
    FINE,
    GEOMETRY,
    MESH,
    NO_BOUNDS,
    NO_MESH,
    NOT_UNIT,
    REASONS,
    TOO_LARGE,
    UINT8,
    Canonical,
    Floats,
    Records,
    Shapes,
    as_one_shape,
    canonical_row,
    canonicalise,
    different,
    fault_of,
    fill_rotation,
    fill_unit,
    is_finite,
    is_unset,
    maps_axes_to_axes,
    rows_entry,
    unchecked_shapes,
)
from ..shapes.shape import UNTURNED as NO_ROTATION
from .narrow_phase import (
    closest_from_above,
    closest_in_box,
    closest_in_obstacle,
    length,
    look_back,
    near,
)

# ---- The shape of an overlap query.

LARGEST = 1.7976931348623157e308

# The box between two corners is so, or is not, because, see `fill_box`.
ALIGNED, TURNED, NOT_FINITE, TOO_LONG, TILTED = range(5)
NO_BOX_REASONS = {
    TOO_LONG: 'the query box is larger than the largest double',
    TILTED: 'in a planar scene the orientation of a box must be about z only',
}


class QueryShape(NamedTuple):
    """A shape to be grown by `tolerance` all round, for kernels."""

    record: Records
    """(1,)"""
    bounds: Floats
    """(2, 3) around the shape itself; the corners of an aligned box exactly."""
    aligned: bool
    """It is a box whose axes are the world's."""
    tolerance: float
    height: float
    """Where the points of a planar scene are put."""


@lean_kernel
def fill_box(start, goal, orientation, planar, records, bounds):
    """Fill in record (1,) and bounds of the box between two corners whose axes are turned; return
    whether it is ALIGNED or TURNED, or why there is none.
    """
    record = records[0]
    if not (is_finite(start) and is_finite(goal) and is_finite(orientation)):
        return NOT_FINITE
    unit, matrix = stack_array(4, np.float64), stack_array((3, 3), np.float64)
    diagonal, centre = stack_array(3, np.float64), stack_array(3, np.float64)
    fill_unit(orientation, unit)
    if planar and (unit[0] != 0.0 or unit[1] != 0.0):
        return TILTED
    point = True
    for axis in range(3):
        flat = planar and axis == 2
        first, second = (0.0, 0.0) if flat else (start[axis], goal[axis])
        diagonal[axis], centre[axis] = second - first, first * 0.5 + second * 0.5
        bounds[0, axis], bounds[1, axis] = min(first, second), max(first, second)
        if not math.isfinite(diagonal[axis]):
            return TOO_LONG
        point = point and diagonal[axis] == 0.0
    if point or maps_axes_to_axes(unit):
        fill_aligned(bounds, centre, record)
        return ALIGNED
    fill_rotation(unit, matrix)
    edges = stack_array(3, np.float64)
    for axis in range(3):
        edges[axis] = abs(
            matrix[0, axis] * diagonal[0]
            + matrix[1, axis] * diagonal[1]
            + matrix[2, axis] * diagonal[2]
        )
    ndim = 2 if planar else 3
    canonical_row(np.uint8(BOX), centre, orientation, edges, ndim, record, bounds)
    return TURNED


@inlined
def fill_aligned(bounds, centre, record):
    record.kind, record.shaped, record.mesh = BOX, False, 0
    for axis in range(3):
        record.position[axis] = centre[axis]
        record.half[axis] = bounds[1, axis] * 0.5 - bounds[0, axis] * 0.5
        record.orientation[axis] = 0.0
    record.orientation[3] = 1.0


@lean_kernel
def grow(query, grown):
    """Fill in bounds of the grown shape, rounded outwards, within the range of doubles."""
    for axis in range(3):
        lo, hi = query.bounds[0, axis], query.bounds[1, axis]
        if query.tolerance > 0.0:
            lo = max(np.nextafter(lo - query.tolerance, -np.inf), -LARGEST)
            hi = min(np.nextafter(hi + query.tolerance, np.inf), LARGEST)
        grown[0, axis], grown[1, axis] = lo, hi


def box_query(
    start: ArrayLike,
    goal: ArrayLike,
    orientation: ArrayLike | None,
    tolerance: float,
    planar: bool,
) -> QueryShape:
    """Check the arguments of `Scene.overlap`."""
    first, second = _coordinates('start', start, 3), _coordinates('goal', goal, 3)
    turn = NO_ROTATION['orientation']
    if orientation is not None:
        turn = _coordinates('orientation', orientation, 4)
        checks.rotations('orientation', turn[None])
    record, bounds = np.empty(1, GEOMETRY), np.empty((2, 3))
    state = fill_box(first, second, turn, planar, record, bounds)
    if state > TURNED:
        for name, value in (('start', first), ('goal', second), ('orientation', turn)):
            checks.point(name, value, len(value))
        raise ValueError(NO_BOX_REASONS[state])
    reach = _tolerance(tolerance)
    return QueryShape(record, bounds, state == ALIGNED, reach, first.item(2))


def _coordinates(name: str, value: ArrayLike, count: int) -> Floats:
    """So many numbers; whether they are finite, the kernel sees."""
    if type(value) is np.ndarray and value.shape == (count,):
        return checks.floats(name, value)
    return checks.point(name, value, count)


def _tolerance(value: float) -> float:
    tolerance = checks.limit('tolerance', value)
    if math.isinf(tolerance):
        raise ValueError('tolerance must be finite')
    return tolerance


# ---- The shapes of overlap and distance queries, other than boxes between corners.

_NO_ROWS = np.empty((0, 3))
NO_RECORDS = np.empty(0, GEOMETRY)
NO_GIVEN = np.empty(0, UINT8), _NO_ROWS, np.empty((0, 4)), _NO_ROWS
# One for all rows, of aligned boxes.
BOXES, UNTURNED = np.zeros(1, UINT8), np.zeros((1, 4))
# Why a kernel answers nothing: a shape is not legal, or needs a narrow phase where none is given.
FAULTY, NARROW = -2, -3


class QueryRows(NamedTuple):
    """n shapes, each to be grown by its tolerance, for kernels."""

    records: Records
    """(n,), or none: then the kernel makes them of what is `given`."""
    bounds: Floats
    """(n, 2, 3) around the shapes themselves; the corners of aligned boxes exactly."""
    tolerances: Floats
    """One for all, or (n,)."""
    masks: NDArray[np.uint32]
    """One for all, or (n,)."""
    given: tuple[Any, ...] = NO_GIVEN
    """Kinds, positions, orientations and sizes: all but positions one for all, or (n,)."""

    def one(self, row: int) -> QueryShape:
        """The query of a row."""
        record = self.records[row : row + 1]
        tolerance = self.tolerances.item(row if len(self.tolerances) > 1 else 0)
        aligned, height = not record['shaped'][0], record['position'].item(2)
        return QueryShape(record, self.bounds[row], aligned, tolerance, height)

    def mask(self, row: int) -> np.uint32:
        """The mask of a row."""
        mask: np.uint32 = self.masks[row if len(self.masks) > 1 else 0]
        return mask


def number_of(rows: tuple[Any, ...]) -> int:
    """How many there are of plain `QueryRows`."""
    return len(rows[0]) or len(rows[4][1])


def begin_shaped(rows: tuple[Any, ...]) -> bool:
    """Whether of plain `QueryRows` one, or the first that is given, seems to be more than an
    axis-aligned box.
    """
    records, _, _, _, (kinds, _, turns, _) = rows
    if kinds is BOXES and turns is UNTURNED:
        return False
    if len(records) or not (len(kinds) and len(turns)):
        return bool(records['shaped'].any())
    if kinds.item(0) != BOX:
        return True
    return turns.item(0) != 0.0 or turns.item(1) != 0.0 or turns.item(2) != 0.0


@inlined
def make_row(rows, row, own, box):
    """(record (1,), bounds (2, 3), fault) of a row; `own` and `box` are room for them where they
    are still to be made.
    """
    records, bounds, _, _, (kinds, positions, orientations, sizes) = rows
    if records.shape[0] > 0:
        return records[row : row + 1], bounds[row], FINE
    kind, position = of_row(kinds, row), positions[row]
    turn = orientations[row if orientations.shape[0] > 1 else 0]
    size = sizes[row if sizes.shape[0] > 1 else 0]
    fault = NO_MESH if kind == MESH else fault_of(kind, position, turn, size)
    if orientations.shape[0] > 1 and is_unset(turn):  # which only `Shapes` may be
        fault = NOT_UNIT
    if fault == FINE:
        canonical_row(kind, position, turn, size, 3, own[0], box)
        if not (is_finite(box[0]) and is_finite(box[1])):
            fault = TOO_LARGE
    return own, box, fault


def given_rows(given: tuple[Any, ...], tolerance: Any, mask: ArrayLike) -> tuple[Any, ...]:
    """A plain `QueryRows` of shapes without meshes, as of `QueryRows.given`, whose records a
    kernel makes, and whose faults it finds.
    """
    count, tolerances, masks = len(given[1]), checks.NOTHING, checks.EVERYTHING
    if type(tolerance) is not float or tolerance != 0.0:
        tolerances = checks.lengths_or_one('tolerance', tolerance, count)
    if mask is not ALL:
        masks = checks.masks_or_one(mask, count)
    return NO_RECORDS, NO_BOUNDS, tolerances, masks, given


def with_records(rows: QueryRows) -> QueryRows:
    """Legal rows with records, as Python reads them."""
    if len(rows.records):
        return rows
    form = canonicalise(_row_by_row(unchecked_shapes(*rows.given), number_of(rows)))
    bounds = np.stack((form.lo, form.hi), axis=1)
    return rows._replace(records=form.records, bounds=bounds, given=NO_GIVEN)


def query_rows(
    given: Shapes, tolerance: ArrayLike, mask: ArrayLike, planar: bool, *names: str
) -> tuple[QueryRows, Hulls | None]:
    """Check arguments, `given` from `as_shapes`, or without meshes with one kind, orientation or
    size for all; the rows, and the arrays of their meshes if they have any. `names`: what the
    positions, sizes and orientations are called where they are not finite; '' if by their row.
    """
    count = len(given.position)
    bounds = np.empty((count, 2, 3))
    # As Canonical(...), which would take one more call of a function of Python's.
    columns = np.empty(count, GEOMETRY), _NO_ROWS, _NO_ROWS, np.empty(count, UINT8)
    form: Canonical = tuple.__new__(Canonical, columns)
    if given.mesh is not None or rows_entry(3)(*given[:4], form, bounds):
        given = _row_by_row(given, count)
        form = canonicalise(given)
        bounds[:, 0], bounds[:, 1] = form.lo, form.hi
    if np.count_nonzero(form.faults):  # but for FINE, which is 0
        for name, rows in zip(
            names, (given.position, given.size, given.orientation), strict=False
        ):
            if name:
                checks.finite(name, rows)
        bad = int(np.argmax(form.faults != FINE))
        reason = REASONS[form.faults[bad]]
        raise ValueError(f'the shape of row {bad} cannot be used: {reason}')
    tolerances = checks.lengths_or_one('tolerance', tolerance, count)
    parts = form.records, bounds, tolerances, checks.masks_or_one(mask, count)
    return tuple.__new__(QueryRows, (*parts, NO_GIVEN)), _hulls(given, form, planar)


def _row_by_row(given: Shapes, count: int) -> Shapes:
    """With all columns of so many rows."""
    every: Any = (np.broadcast_to(rows, (count, *rows.shape[1:])) for rows in given[:4])
    kind, position, orientation, size = map(np.ascontiguousarray, every)
    return unchecked_shapes(kind, position, orientation, size, given.mesh)


def shape_query(shape: Shapes, tolerance: float, planar: bool) -> tuple[QueryShape, Hulls | None]:
    """`query_rows` of one row, as a query of its own."""
    given = as_one_shape(shape, planar)
    rows, hulls = query_rows(given, checks.limit('tolerance', tolerance), ALL, planar)
    return rows.one(0), hulls


def _hulls(given: Shapes, form: Canonical, planar: bool) -> Hulls | None:
    """The arrays of the rows' meshes, whose numbers the records get."""
    if given.mesh is None:  # else a row of kind MESH has a fault
        return None
    rows = np.flatnonzero(form.records['kind'] == MESH)
    if not len(rows):
        return None
    store, meshes = MeshStore(), seen_from_above(given.mesh, form) if planar else given.mesh
    if meshes is not None:
        once, which = different(meshes[rows])
        form.records['mesh'][rows] = np.array([store.take(mesh) for mesh in once])[which]
    return store.hulls


# ---- Which obstacles touch a query shape, and how they lie to its centre: one kernel a query.
#
# Broad phase, exact decision between axis-aligned boxes, narrow phase for the others. Where all
# are boxes, the kernels read the tree alone.

FOUND = 11  # floats of a row of `Found`
REFUSED = -1  # the tree is being changed
ROUNDED = 1.0 + 2.0**-48  # no computed distance is off by as much
CLOSE = 2.0**-49  # of a tolerance: a computed distance this near to it is not decided


class Found(NamedTuple):
    """Obstacles that touch a query, one a row, and how each lies to its centre."""

    slots: Any
    distances: Any
    points: Any
    normals: Any
    doubtful: Any
    """Two boxes as far apart as the tolerance, up to rounding: `overlaps` decides exactly."""
    bounds: Any
    """Distances of the boxes from the tree, in queries for the nearest."""
    order: Any
    """Rows by distance, then node handle."""


@inlined
def found_in(memory):
    """What is found in one array, FOUND floats a row: to hand it over takes a fifth of the time of
    seven.
    """
    rows = memory.shape[0] // FOUND
    return Found(
        memory[:rows].view(np.int64),
        memory[rows : 2 * rows],
        memory[2 * rows : 5 * rows].reshape(rows, 3),
        memory[5 * rows : 8 * rows].reshape(rows, 3),
        memory[8 * rows : 9 * rows].view(np.bool_),  # more than needed
        memory[9 * rows : 10 * rows],
        memory[10 * rows : FOUND * rows].view(np.int64),
    )


@inlined
def within(lo, hi, query):
    """(whether an axis-aligned box is within the tolerance of the query's, whether that is
    sure).
    """
    gaps = stack_array(3, np.float64)
    for axis in range(lo.shape[0]):
        below, above = query.bounds[0, axis] - hi[axis], lo[axis] - query.bounds[1, axis]
        gaps[axis] = max(above, below, 0.0)
    distance = length(gaps[: lo.shape[0]])
    sure = not abs(distance - query.tolerance) <= CLOSE * query.tolerance
    return distance <= query.tolerance, sure


class AtRest(NamedTuple):
    """Obstacles as they are stored, for kernels."""

    tree: Any
    bodies: Any
    """`Bodies`; None where all are axis-aligned boxes, the queries, too."""


class Touch(NamedTuple):
    """Whether an obstacle touches a query."""

    touches: Any
    sure: Any
    """Else only exact arithmetic decides."""
    compared: Any
    """Whether that took a narrow phase."""
    in_more_digits: Any
    growth: Any
    """By how much the obstacle has grown."""


@inlined
def find_touching(world, row, query, mask, enough, node_handles, found, candidates, touch, lie):
    """Fill in what touches a query; return (how many, how many are doubtful, how many pairs were
    compared, how many of them took more digits). More than fit: none is filled in. Where one is
    `enough`, the first that surely touches is the last, and nothing but its slot is filled in.

    candidates(world, row, query, mask, found) writes the slots of all that may touch the query,
    and returns how many they are, or a negative number, which ends it. touch(world, row, query,
    slot) returns a `Touch`. lie(world, row, query, slot, touched, found, place) then fills in how
    the obstacle lies to the centre of the query.
    """
    total, count, doubtful = candidates(world, row, query, mask, found), np.int64(0), 0
    compared, more = 0, 0
    if total < 0 or total > found.slots.shape[0]:
        return total, doubtful, compared, more
    for i in range(total):
        slot = found.slots[i]
        touched = touch(world, row, query, slot)
        compared += touched.compared
        more += touched.in_more_digits
        if touched.sure and not touched.touches:
            continue
        doubtful += not touched.sure
        if enough:
            count += 1
            if touched.sure:
                break
            continue
        found.doubtful[count], found.points[count, 2] = not touched.sure, query.height
        lie(world, row, query, slot, touched, found, count)
        found.slots[count] = slot
        count += 1
    if not enough:
        order_found(found, count, node_handles)
    return count, doubtful, compared, more


@inlined
def _candidates(world, row, query, mask, found):
    grown = stack_array((2, 3), np.float64)
    grow(query, grown)
    return overlap(world.tree, grown[0], grown[1], mask, found.slots, 0)


@inlined
def _touch(world, row, query, slot):
    return _touch_body(world.tree, world.bodies, query, slot)


@inlined
def _touch_body(tree, bodies, query, slot):
    touches, sure, narrow, digits = True, True, False, False
    if bodies is not None:
        shape, planar = bodies.shapes[slot], bodies.footprints is not None
        narrow = shape.shaped or not query.aligned
        if narrow:
            solid, reach = query.record[0], query.tolerance
            touches, digits = near(shape, bodies.hulls, solid, bodies.query_hulls, reach, planar)
    if not narrow and query.tolerance > 0.0:
        lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
        touches, sure = within(lo, hi, query)
    return Touch(touches, sure, narrow, digits, 0.0)


@inlined
def _lie(world, row, query, slot, touched, found, place):
    lie_at_rest(world.tree, world.bodies, slot, query.record[0].position, found, place)


@inlined
def lie_at_rest(tree, bodies, slot, centre, found, row):
    """Fill in how an obstacle at rest lies to a centre."""
    if bodies is None:
        lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
        closest_in_box(lo, hi, centre, found.points[row])
        distance = look_back(found.points[row], centre, lo.shape[0], found.normals[row])
        found.distances[row] = distance
    else:
        look_at(bodies, slot, centre, found, row)


@lean_kernel
def overlap_kernel(tree, bodies, query, mask, enough, node_handles, found):
    """`find_touching` among obstacles at rest, `bodies` as of `AtRest`; REFUSED instead of a count
    if the tree is being changed.
    """
    if not begin_query(tree.state, ANY_VERSION):
        return np.int64(REFUSED), 0, 0, 0
    world = AtRest(tree, bodies)
    done = find_touching(
        world, 0, query, mask, enough, node_handles, found, _candidates, _touch, _lie
    )
    end_query(tree.state)
    return done


@lean_kernel
def look_at(bodies, slot, centre, found, row):
    """Fill in how the obstacle of a slot lies to a centre."""
    point, normal, shape = found.points[row], found.normals[row], bodies.shapes[slot]
    distance = closest_to(shape, bodies.footprints, slot, bodies.hulls, centre, point, normal)
    found.distances[row] = distance


@inlined
def closest_to(shape, footprints, slot, hulls, centre, point, normal):
    """`closest_in_obstacle`, in a planar scene from above."""
    if footprints is None:
        return closest_in_obstacle(shape, hulls, centre, point, normal)
    return closest_from_above(shape, footprints[slot], hulls, centre, point, normal)


@inlined
def comes_before(found, node_handles, one, other):
    """Whether a row comes before another one."""
    if found.distances[one] != found.distances[other]:
        return found.distances[one] < found.distances[other]
    handle, other_handle = node_handles[found.slots[one]], node_handles[found.slots[other]]
    return handle < other_handle or (handle == other_handle and one < other)


@lean_kernel
def order_found(found, count, node_handles):
    """Fill in the order of the rows: heapsort, the last one on top."""
    order = found.order
    for row in range(count):
        order[row] = row
    for root in range(count // 2 - 1, -1, -1):
        sift_down(found, node_handles, root, count)
    for end in range(count - 1, 0, -1):
        order[0], order[end] = order[end], order[0]
        sift_down(found, node_handles, 0, end)


@inlined
def sift_down(found, node_handles, root, count):
    order = found.order
    while 2 * root + 1 < count:
        child = 2 * root + 1
        if child + 1 < count and comes_before(found, node_handles, order[child], order[child + 1]):
            child += 1
        if not comes_before(found, node_handles, order[root], order[child]):
            return
        order[root], order[child] = order[child], order[root]
        root = child
