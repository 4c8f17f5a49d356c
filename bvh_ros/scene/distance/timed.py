# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances at a time, among obstacles that have velocities: how `moving` is called.
Scenes without velocities need none of this.
"""

import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.jit.compiling import entry_point
from ...tree.motion.queries import rows_of
from ...tree.nodes import CHANGES
from ...tree.store.workers import in_threads
from ..geometry.footprint import FOOTPRINT
from ..geometry.records import GEOMETRY
from ..geometry.shapes import Floats
from ..store.mesh_store import Hulls
from ..store.obstacles import Obstacles
from ..store.places import at_rest, movers, nobody_rests, rest
from ..store.registry import Slots
from .clearance import Neighbours
from .moving import Room, Then, touch_rows
from .moving_neighbours import clear_rows, near_rows
from .nearness import NO_ORDER
from .query_rows import NO_GIVEN, QueryRows
from .query_shape import QueryShape
from .touching import Found
from .touching_rows import Near, Points, Signed, bodies_of

FEW = 64  # obstacles that there is room for at first


class Touched(NamedTuple):
    """What n queries touch, by row and in the order in which it is told."""

    rows: NDArray[np.int64]
    slots: Slots
    distances: Floats
    points: Floats


_NONE = np.empty(0, np.int64)
NOTHING = Touched(_NONE, _NONE, np.empty(0), np.empty((0, 3)))


class Known(NamedTuple):
    """What kernels are told of a world while it is of one version and its arrays are these."""

    version: int
    geometry: Any
    hulls: Any
    then: Then
    room: Room


class Scratch(threading.local):
    """What a thread's kernels write to; the room for it is kept. And what they read of one query,
    as making arrays of one row would take longer than most queries.
    """

    def __init__(self) -> None:
        self.at, self.limits, self.masks = np.empty(1), np.empty(1), np.empty(1, np.uint32)
        self.offsets, self.told = np.zeros(2, np.int64), _no_rows(1, 1)
        self.make_room(FEW)

    def make_room(self, count: int) -> None:
        """Have room for at least so many."""
        rows = 2 * count
        self.known: Known | None = None
        self.slots, self.handles = np.empty((2, rows), np.int64)
        self.gaps = np.empty(rows)
        self.found = Found(
            *(np.empty(rows, np.int64), np.empty(rows), np.zeros((rows, 3)), np.zeros((rows, 3))),
            *(np.empty(0, np.bool_), np.empty(0), np.empty(rows, np.int64)),
        )
        self.shape, self.footprint = np.empty(1, GEOMETRY), np.empty(1, FOOTPRINT)

    def have_room(self, count: int) -> None:
        """`make_room` if there is less."""
        if count > len(self.gaps):
            self.make_room(count)


class TimedDistances:
    """Overlaps and distances of one scene at other times."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._scratch = Scratch()
        self._entries: dict[tuple[Any, ...], Any] = {}

    # ---- one query: what is known until the next one of this thread, and its rows, in order

    def find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, at: float
    ) -> tuple[Found, list[int]]:
        """What a query touches at a time, as `overlaps.Overlaps.find` has it."""
        scratch, done = self._scratch, 0
        scratch.limits[0], scratch.masks[0] = query.tolerance, mask
        rows = query.record, query.bounds[None], scratch.limits, scratch.masks, NO_GIVEN
        asked, offsets = tuple.__new__(QueryRows, rows), scratch.offsets
        while not done:
            (then, room), found = self._then_once(at, hulls), scratch.found
            given = asked, 0, False, offsets, room, found
            done, wanted, compared = self._call(touch_rows, then, given, None)
            scratch.have_room(wanted)
        self._held.columns.pairs_compared += compared
        return found, found.order[: offsets.item(1)].tolist()

    def find_near(
        self, point: Floats, k: int, limits: tuple[float, np.uint32], signed: Signed, at: float
    ) -> tuple[Found, list[int]]:
        """What is nearest to a point at a time, as `nearness.Nearness.find` has it."""
        (reach, mask), held, scratch, done = limits, self._held, self._scratch, 0
        scratch.limits[0], scratch.masks[0] = reach, mask
        rows = point[None], scratch.limits, scratch.masks, NO_ORDER
        if scratch.told.handles.shape[1] != k:
            scratch.told = _no_rows(1, k)
        asked = 0, 1, k, *self._among(signed)
        while not done:
            (then, room), found = self._then_once(at, None), scratch.found
            given = tuple.__new__(Points, rows), asked, room, found, scratch.told
            done, wanted, count = self._call(near_rows, then, given, signed)
            scratch.have_room(wanted)
        distances = found.distances[:count].tolist()
        order = [row for row in found.order[:count].tolist() if distances[row] <= reach]
        if held.columns.shadows:
            handles = held.columns.node_handle[found.slots[order]]
            first = np.sort(np.unique(handles, return_index=True)[1])
            order = [order[place] for place in first]
        return found, order[:k]

    # ---- batches

    def touching(
        self, queries: QueryRows, hulls: Hulls | None, at: Floats, threads: int, enough: bool
    ) -> Touched:
        """What n queries touch at times (n,), each obstacle once a row. `enough`: one a row will
        do, and where it is nobody is told.
        """
        then, columns = self._then(at, hulls), self._held.columns

        def work(start: int, stop: int) -> tuple[list[Touched], int]:
            some = rows_of(queries, len(at), slice(start, stop))
            when, begin, compared = then._replace(at=at[start:stop]), 0, 0
            parts = [NOTHING]
            while begin < stop - start:
                offsets, found = np.zeros(stop - start + 1, np.int64), self._scratch.found
                given = some, begin, enough, offsets, self._room(then), found
                done, wanted, pairs = self._call(touch_rows, when, given, None)
                parts.append(_taken(found, offsets, begin, done, start))
                begin, compared = done, compared + pairs
                self._scratch.have_room(wanted)
            return parts, compared

        each = in_threads(work, len(at), threads)
        columns.pairs_compared += sum(compared for _, compared in each)
        parts = [NOTHING, *(part for some, _ in each for part in some)]
        every: Any = zip(*parts, strict=True)
        touched = Touched(*(np.concatenate(column) for column in every))
        if columns.shadows:
            keys = np.stack((touched.rows, columns.node_handle[touched.slots]))
            once = np.sort(np.unique(keys, axis=1, return_index=True)[1])
            every = (column[once] for column in touched)
            touched = Touched(*every)
        return touched

    def nearest(self, points: Points, k: int, signed: Signed, at: Floats, threads: int) -> Near:
        """The k obstacles nearest to n points at times (n,)."""
        then, told, among = self._then(at, None), _no_rows(len(at), k), self._among(signed)

        def work(start: int, stop: int) -> None:
            while start < stop:
                asked = start, stop, k, *among
                given = points, asked, self._room(then), self._scratch.found, told
                start, wanted, _ = self._call(near_rows, then, given, signed)
                self._scratch.have_room(wanted)

        in_threads(work, len(at), threads)
        return told

    def clearances(
        self,
        queries: QueryRows,
        hulls: Hulls | None,
        asked: tuple[Floats, int, Signed],
        at: Floats,
        threads: int,
    ) -> Neighbours:
        """The obstacles nearest to n shapes at times (n,); asked = (reaches, the slot of the
        obstacle that is the only row, or NONE, whether distances have a sign).
        """
        reaches, itself, signed = asked
        count, then = len(at), self._then(at, hulls)
        told = Neighbours(np.empty(count, np.int64), np.empty(count), np.empty((count, 2, 3)))

        def work(start: int, stop: int) -> None:
            while start < stop:
                question = start, stop, reaches, len(self._held.tree), itself, signed
                given = queries, question, self._room(then), told
                start, wanted = self._call(clear_rows, then, given, signed)
                self._scratch.have_room(wanted)

        in_threads(work, count, threads)
        return told

    # ---- kernels

    def _among(self, signed: Signed) -> tuple[bool, int, bool, Signed]:
        """What `near_rows` is told of all rows."""
        held = self._held
        shaped, twice = held.columns.shaped > 0, held.columns.shadows > 0
        some_more = shaped or twice or held.uncertainty > 0.0 or signed is not None
        return some_more, len(held.tree), twice, signed

    def _then_once(self, at: float, hulls: Hulls | None) -> tuple[Then, Room]:
        """What a kernel is told of one time, until the next one."""
        held, scratch, known = self._held, self._scratch, self._scratch.known
        scratch.at[0] = at
        version, geometry = held.tree.state.item(CHANGES), held.columns.geometry
        ours, same = held.columns.hulls(), known is not None and known.version == version
        lasts = hulls is None and not len(at_rest(held, at))
        if known is None or not (same and lasts and known.geometry is geometry):
            known = None
        if known is None or known.hulls is not ours:
            then = self._then(scratch.at, hulls)
            known = Known(version, geometry, ours, then, self._room(then))
            scratch.known = known if lasts else None
        return known.then, known.room

    def _then(self, at: Floats, hulls: Hulls | None) -> Then:
        held = self._held
        last = at.item() if len(at) == 1 else at.max(initial=-np.inf)
        resting, ends = nobody_rests(held.tree.ndim), (0.0, 0.0)
        if len(at_rest(held, last)):
            resting = rest(held)
        if held.uncertainty:
            ends = movers(held)[1:3]
        places = bodies_of(held.columns, hulls), held.columns.node_handle
        still = resting.tree.view().tree, resting.slots
        return Then(*places, at, held.max_prediction, held.uncertainty, *ends, *still)

    def _room(self, then: Then) -> Room:
        scratch, planar = self._scratch, then.bodies.footprints is not None
        footprint = scratch.footprint if planar else None
        spare = then.bodies._replace(shapes=scratch.shape, footprints=footprint)
        return Room(scratch.slots, scratch.handles, scratch.gaps, spare)

    def _call(self, kernel: Any, then: Then, given: tuple[Any, ...], signed: Signed) -> Any:
        tree, motion = self._held.tree, self._held.tree.motion
        variant = kernel, signed, then.bodies.hulls is not None
        if motion is None:
            raise RuntimeError('no obstacle of this scene has a velocity')
        entry = self._entries.get(variant)
        if entry is None:
            entry = entry_point(kernel, tree.view().tree, motion.moving, then, *given)
            self._entries[variant] = entry
        done = entry(tree.view().tree, motion.moving, then, *given)
        if done[0] >= 0:
            return done
        span = (then.at.min(), then.at.max()), True
        return motion.ask(tree, lambda: span, lambda *arrays: entry(*arrays, then, *given))


def _no_rows(count: int, k: int) -> Near:
    return Near(np.empty((count, k), np.uint32), np.empty((count, k)), np.empty((count, k, 3)))


def _taken(found: Found, offsets: Slots, begin: int, done: int, start: int) -> Touched:
    """What a kernel found of the rows from `begin` on, in order; rows count from `start`."""
    counts, filled = np.diff(offsets[begin : done + 1]), offsets.item(done)
    which = found.order[:filled] + np.repeat(offsets[begin:done], counts)
    rows = np.repeat(np.arange(start + begin, start + done), counts)
    return Touched(rows, found.slots[which], found.distances[which], found.points[which])
