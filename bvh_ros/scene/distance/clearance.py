# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far shapes are from the nearest obstacle, by their true shapes.

No two shapes are nearer than their boxes. So the tree is asked for the nearest boxes, ever more of
them, until the next box is farther than the nearest shape among those it has named.
"""

import threading
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    CHANGES,
    COUNT,
    INT64,
    NONE,
    UINT32,
    DynamicBVH,
    View,
    begin_query,
    checks,
    end_query,
    in_threads,
    nearest,
    of_row,
)
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..geometry.canonical import FINE
from ..geometry.shapes import Floats
from ..results import NO_NODE
from ..store.columns import Columns
from ..store.mesh_store import Hulls
from .gap import box_gap, gap
from .query_rows import FAULTY, NO_GIVEN, make_row
from .sinking import sink_shape
from .touching import REFUSED
from .touching_rows import RowKernel, Signed, bodies_of

ROUNDED = 1.0 + 2.0**-40  # no computed distance is off by as much
MORE = 4
FEW = 32  # boxes that there is room for at first


class Neighbours(NamedTuple):
    """The obstacles nearest to n shapes."""

    slots: Any
    """(n,) NONE where there is none; no array where nobody asks."""
    distances: Any
    points: Any
    """(n, 3): the shape's."""
    other_points: Any
    """(n, 3): the obstacle's."""
    handles: Any
    """(n,) uint32 node handles of the obstacles, NO_NODE where there is none."""


NOT_ASKED = np.empty(0, INT64)


def room_for(count: int, slots: NDArray[np.int64] = NOT_ASKED) -> Neighbours:
    """Room for so many rows."""
    distances, handles = np.empty(count), np.empty(count, UINT32)
    # As Neighbours(...), which would take one more call of a function of Python's.
    parts = slots, distances, np.empty((count, 3)), np.empty((count, 3)), handles
    return tuple.__new__(Neighbours, parts)


class Room(NamedTuple):
    """For the boxes that the tree names."""

    slots: Any
    bounds: Any


@lean_kernel
def clearance_rows(view, bodies, rows, asked, place, node_handles, room, told):
    """Fill in the rows [start, stop) of `told`; rows as of `QueryRows`, asked = (reaches, the
    node handle that is not looked at, `touching_rows.Signed`), place = (start, stop). Returns
    (rows done, room wanted, version of the tree): fewer than there are where there is no room,
    REFUSED if the tree is changed, FAULTY if a shape is not legal.
    """
    (reaches, besides, signed), (records, _, _, masks, _) = asked, rows
    tree, (row, stop) = view.tree, place
    if not begin_query(tree.state, view.version):
        return REFUSED, 0, 0
    version, everybody = tree.state[CHANGES], tree.state[COUNT]
    wanted, own, box = 0, stack_array(1, records), stack_array((2, 3), np.float64)
    while row < stop:
        record, bounds, fault = make_row(rows, row, own, box)
        if fault != FINE:
            row = FAULTY
            break
        tell_nobody(told, row)
        reach, wanted, looked = of_row(reaches, row), min(2, everybody + 1), 0
        while wanted <= room.slots.shape[0]:
            low, high = bounds[0], bounds[1]
            limit, mask = max(reach * ROUNDED, reach), of_row(masks, row)
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
    return row, wanted, version


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
    told.handles[row], told.distances[row] = NO_NODE, np.inf
    if told.slots.shape[0] > 0:
        told.slots[row] = NONE
    for axis in range(3):
        told.points[row, axis] = told.other_points[row, axis] = np.nan


@inlined
def keep_nearer(node_handles, found, points, told, row):
    """Keep an obstacle, found = (slot, distance, reach), and points (2, 3), if it is nearer than
    what is there; ties by handle.
    """
    slot, distance, reach = found
    if distance > reach or distance > told.distances[row]:
        return
    handle, best = node_handles[slot], np.int64(told.handles[row])  # NO_NODE is the last one
    if distance == told.distances[row] and best < handle:
        return
    told.distances[row], told.handles[row] = distance, handle
    if told.slots.shape[0] > 0:
        told.slots[row] = slot
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
        self,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        asked: tuple[Floats, int, Signed],
        threads: int,
        slots: NDArray[np.int64] = NOT_ASKED,
    ) -> Neighbours | None:
        """The obstacles nearest to n shapes, plain `QueryRows`, ties by handle; asked = (reaches,
        the node handle that is not looked at, whether distances have a sign), `slots`: room for
        theirs. None if a row that is `given` is not legal.
        """
        columns, count = self._columns, len(rows[0]) or len(rows[4][1])
        bodies, told, begun = bodies_of(columns, hulls), room_for(count, slots), 0
        view = self._tree.latest() if threads == 1 else self._tree.view()
        if threads == 1:  # without what others take
            room, handles = self._kept.room, columns.node_handle
            every = view, bodies, rows, asked, (0, count), handles, room, told
            begun, _, version = self._kernels[asked[2]](every)
            if begun == count:
                return told
            if begun == FAULTY:
                return None
            view = View(view.tree, version)
        work = partial(self._work, view, bodies, rows, asked, told)
        done = [work(begun, count)] if threads == 1 else in_threads(work, count, threads)
        return told if all(done) else None

    def _work(
        self,
        view: View,
        bodies: Any,
        rows: tuple[Any, ...],
        asked: tuple[Any, ...],
        told: Neighbours,
        start: int,
        stop: int,
    ) -> bool:
        """Fill in the rows [start, stop); whether all are legal."""
        wanted, kernel, handles = FEW, self._kernels[asked[2]], self._columns.node_handle
        while start < stop:
            room = Room(np.empty(wanted, INT64), np.empty(wanted))
            given = view, bodies, rows, asked, (start, stop), handles, room, told
            start, wanted, _ = kernel(given)
            if start == FAULTY:
                return False
        return True

    def nearest_other(self, slot: int, signed: Signed) -> Neighbours:
        """What is nearest to the obstacle of a slot."""
        records, handle = self._columns.geometry[slot : slot + 1], self._columns.node_handle[slot]
        lo, hi = self._tree.boxes(self._columns.tree_handle[slot : slot + 1])
        bounds = np.zeros((1, 2, 3))
        bounds[0, 0, : lo.shape[1]], bounds[0, 1, : lo.shape[1]] = lo, hi
        rows = records, bounds, checks.NOTHING, checks.EVERYTHING, NO_GIVEN
        asked = checks.FOREVER, int(handle), signed
        found = self.find_rows(rows, self._columns.hulls, asked, 1, np.empty(1, INT64))
        assert found is not None
        return found
