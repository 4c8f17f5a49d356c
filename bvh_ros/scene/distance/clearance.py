# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far shapes are from the nearest obstacle, by their true shapes.

No two shapes are nearer than their boxes. So the tree is asked for the nearest boxes, ever more of
them, until the next box is farther than the nearest shape among those it has named.
"""

import math
import threading
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...tree import checks
from ...tree.boxes.nearest import nearest
from ...tree.checks import INT64, UINT32
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.nodes import COUNT, NONE, View
from ...tree.rays.raycasting import of_row
from ...tree.store.turns import begin_query, end_query
from ...tree.store.workers import in_threads
from ..geometry.canonical import FINE
from ..geometry.shapes import Floats
from ..results import NO_NODE
from ..store.columns import Columns
from ..store.mesh_store import Hulls
from .closest import fill_corners, length
from .gjk import CORE_ROWS
from .narrow_phase import fill_cores, ordered
from .query_rows import FAULTY, QueryRows, make_row
from .simplex import FIRST, SECOND, SLACK, WAY_ROOM, dot
from .sinking import sink_shape
from .sure_gap import sure_bounds
from .touching_rows import RowKernel, Signed, bodies_of

ROUNDED = 1.0 + 2.0**-40  # no computed distance is off by as much
MORE = 4
FEW = 32  # boxes that there is room for at first


class Neighbours(NamedTuple):
    """The obstacles nearest to n shapes."""

    slots: Any
    """(n,) NONE where there is none."""
    distances: Any
    points: Any
    """(n, 3): the shape's."""
    other_points: Any
    """(n, 3): the obstacle's."""
    handles: Any
    """(n,) uint32 node handles of the obstacles, NO_NODE where there is none."""


def room_for(count: int) -> Neighbours:
    """Room for so many rows."""
    points, handles = (np.empty((count, 3)), np.empty((count, 3))), np.empty(count, UINT32)
    # As Neighbours(...), which would take one more call of a function of Python's.
    parts = np.empty(count, INT64), np.empty(count), *points, handles
    return tuple.__new__(Neighbours, parts)


class Room(NamedTuple):
    """For the boxes that the tree names."""

    slots: Any
    bounds: Any


@lean_kernel
def gap(one, hulls, other, other_hulls, planar, points):
    """Distance of two shapes, 0 if they touch; fill in the closest points, or twice a common
    one. It is the same from either side.
    """
    if ordered(one, other):
        return ordered_gap(one, hulls, other, other_hulls, planar, points)
    distance = ordered_gap(other, other_hulls, one, hulls, planar, points)
    for axis in range(3):
        points[0, axis], points[1, axis] = points[1, axis], points[0, axis]
    return distance


@lean_kernel
def ordered_gap(one, hulls, other, other_hulls, planar, points):
    first = stack_array((CORE_ROWS, 3), np.float64)
    second = stack_array((CORE_ROWS, 3), np.float64)
    way = stack_array(WAY_ROOM, np.float64)
    cores, (radius, other_radius), exponent = fill_cores(
        *(one, hulls, other, other_hulls), planar, (first, second)
    )
    limit = radius + other_radius + SLACK
    low, high, _ = sure_bounds(cores[0], cores[1], limit, True, way)
    apart = high if high - low <= SLACK else low
    touching = apart <= limit
    for axis in range(3):
        way[axis] = way[FIRST + axis] - way[SECOND + axis]
    share, other_share = surfaces(radius, other_radius, math.sqrt(dot(way, way)), touching)
    for axis in range(3):
        points[0, axis] = way[FIRST + axis] - share * way[axis]
        points[1, axis] = way[FIRST + axis] - other_share * way[axis]
        for row in range(2):
            points[row, axis] = math.ldexp(points[row, axis], exponent) + one.position[axis]
    return 0.0 if touching else math.ldexp(apart - radius - other_radius, exponent)


@lean_kernel
def surfaces(radius, other_radius, length, touching):
    """Where the surfaces are on the way from a point of one core to a point of the other, in
    shares of it; twice a point in both where they touch.
    """
    if touching:
        share = radius / max(radius + other_radius, length) if radius > 0.0 else 0.0
        return share, share
    return radius / length, 1.0 - other_radius / length


@lean_kernel
def box_gap(one, other, ndim, points):
    """`gap` of two axis-aligned boxes: between their faces, and in the middle where they face
    each other.
    """
    corners = stack_array((4, 3), np.float64)
    gaps = stack_array(3, np.float64)
    fill_corners(one, corners[:2])
    fill_corners(other, corners[2:])
    for axis in range(3):
        # Of what they have in common, if low <= high.
        low = max(corners[0, axis], corners[2, axis])
        high = min(corners[1, axis], corners[3, axis])
        gaps[axis] = max(low - high, 0.0) if axis < ndim else 0.0
        for row in range(2):
            if low <= high:
                points[row, axis] = low * 0.5 + high * 0.5
            elif corners[2 * row, axis] >= low:
                points[row, axis] = corners[2 * row, axis]
            else:
                points[row, axis] = corners[2 * row + 1, axis]
    return length(gaps)


@lean_kernel
def clearance_rows(view, bodies, rows, asked, place, node_handles, room, told):
    """Fill in the rows [start, stop) of `told`; asked = (reaches, the node handle that is not
    looked at, `touching_rows.Signed`), place = (start, stop). Returns (rows done, room wanted):
    fewer than there are where there is no room, REFUSED if the tree is changed, FAULTY if a shape
    is not legal.
    """
    reaches, besides, signed = asked
    tree, (row, stop), everybody = view.tree, place, view.tree.state[COUNT]
    if not begin_query(tree.state, view.version):
        return -1, 0
    wanted, own, box = 0, stack_array(1, rows.records), stack_array((2, 3), np.float64)
    while row < stop:
        record, bounds, fault = make_row(rows, row, own, box)
        if fault != FINE:
            row = FAULTY
            break
        tell_nobody(told, row)
        reach, wanted, looked = of_row(reaches, row), min(2, everybody + 1), 0
        while wanted <= room.slots.shape[0]:
            low, high = bounds[0], bounds[1]
            limit, mask = max(reach * ROUNDED, reach), of_row(rows.masks, row)
            count = nearest(tree, low, high, wanted, limit, mask, room.slots, room.bounds)
            fresh = room.slots[looked:count]
            asked_of = reach, besides, signed
            look_at(bodies, record[0], row, asked_of, node_handles, fresh, told)
            distance = max(told.distances[row], 0.0)
            if count < wanted or room.bounds[count - 1] > distance * ROUNDED:
                break
            looked, wanted = count, min(wanted * MORE, everybody + 1)
        if wanted > room.slots.shape[0]:
            break
        row += 1
    end_query(tree.state)
    return row, wanted


@lean_kernel
def apart(one, other, bodies, signed, points):
    """Distance of a shape from an obstacle; minus the depth, if it is `signed`."""
    planar = bodies.footprints is not None
    if one.shaped or other.shaped:
        distance = gap(one, bodies.query_hulls, other, bodies.hulls, planar, points)
    else:
        distance = box_gap(one, other, 2 if planar else 3, points)
    if signed is not None:
        distance = sink_shape(one, other, bodies, distance, points)
    return distance


@lean_kernel
def look_at(bodies, one, row, asked, node_handles, slots, told):
    """Keep the nearest of some obstacles, if it is nearer than what is there; ties by handle."""
    (reach, besides, signed), points = asked, stack_array((2, 3), np.float64)
    for i in range(slots.shape[0]):
        slot = slots[i]
        if node_handles[slot] != besides:
            distance = apart(one, bodies.shapes[slot], bodies, signed, points)
            if bodies.footprints is not None:
                points[0, 2] = points[1, 2] = one.position[2]
            keep_nearer(node_handles, (slot, distance, reach), points, told, row)


@inlined
def tell_nobody(told, row):
    """Write that there is none."""
    told.slots[row], told.handles[row] = NONE, NO_NODE
    told.distances[row] = np.inf
    for axis in range(3):
        told.points[row, axis] = told.other_points[row, axis] = np.nan


@inlined
def keep_nearer(node_handles, found, points, told, row):
    """Keep an obstacle, found = (slot, distance, reach), and points (2, 3), if it is nearer than
    what is there; ties by handle.
    """
    slot, distance, reach = found
    best = told.slots[row]
    if distance > reach or distance > told.distances[row]:
        return
    handle, tied = node_handles[slot], distance == told.distances[row] and best != NONE
    if tied and node_handles[best] < handle:
        return
    told.slots[row], told.distances[row], told.handles[row] = slot, distance, handle
    for axis in range(3):
        told.points[row, axis], told.other_points[row, axis] = points[0, axis], points[1, axis]


class Kept(threading.local):
    """Room that a thread keeps: to make it takes a tenth of a call of one row."""

    def __init__(self) -> None:
        self.room = Room(np.empty(FEW, INT64), np.empty(FEW))


class Clearances:
    """Distances in one scene."""

    def __init__(self, tree: DynamicBVH, columns: Columns) -> None:
        self._tree = tree
        self._columns = columns
        self._kept = Kept()
        kinds: tuple[Signed, ...] = (None, True)
        self._kernels = {signed: RowKernel(clearance_rows).call for signed in kinds}

    def find_rows(
        self, rows: QueryRows, hulls: Hulls | None, asked: tuple[Floats, int, Signed], threads: int
    ) -> Neighbours | None:
        """The obstacles nearest to n shapes, ties by handle; asked = (reaches, the node handle
        that is not looked at, whether distances have a sign). None if a row that is `given` is not
        legal.
        """
        columns, view = self._columns, self._tree.view()
        count = rows.number()
        bodies = bodies_of(columns, hulls)
        told = room_for(count)
        if threads == 1:  # without what others take
            every = rows, asked, (0, count), columns.node_handle, self._kept.room, told
            if self._kernels[asked[2]](view, bodies, every)[0] == count:
                return told
        given = view, bodies, rows, asked, told
        return told if all(in_threads(partial(self._work, *given), count, threads)) else None

    def _work(
        self,
        view: View,
        bodies: Any,
        rows: QueryRows,
        asked: tuple[Any, ...],
        told: Neighbours,
        start: int,
        stop: int,
    ) -> bool:
        """Fill in the rows [start, stop); whether all are legal."""
        wanted, kernel, handles = FEW, self._kernels[asked[2]], self._columns.node_handle
        while start < stop:
            room = Room(np.empty(wanted, INT64), np.empty(wanted))
            given = rows, asked, (start, stop), handles, room, told
            start, wanted = kernel(view, bodies, given)
            if start == FAULTY:
                return False
        return True

    def nearest_other(self, slot: int, signed: Signed) -> Neighbours:
        """What is nearest to the obstacle of a slot."""
        records, handle = self._columns.geometry[slot : slot + 1], self._columns.node_handle[slot]
        lo, hi = self._tree.boxes(self._columns.tree_handle[slot : slot + 1])
        bounds = np.zeros((1, 2, 3))
        bounds[0, 0, : lo.shape[1]], bounds[0, 1, : lo.shape[1]] = lo, hi
        rows = QueryRows(records, bounds, np.zeros(1), checks.EVERYTHING)
        asked = checks.FOREVER, int(handle), signed
        found = self.find_rows(rows, self._columns.hulls, asked, 1)
        assert found is not None
        return found
