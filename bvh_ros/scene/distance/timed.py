# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances at a time, among obstacles that have velocities: how `moving` is called.
Scenes without velocities need none of this.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.boxes.nearest_packets import are_dense
from ...tree.boxes.ordering import order_of
from ...tree.jit.compiling import entry_point
from ...tree.motion.nearest import Near
from ...tree.motion.nearest_packets import Bounded
from ...tree.nodes import COUNT, NONE, View
from ...tree.store.workers import in_threads
from ..geometry.shapes import Floats, along_axes
from ..store.mesh_store import Hulls
from ..store.obstacles import Obstacles
from ..store.places import at_rest, movers, nobody_rests, rest
from ..store.registry import Slots
from .clearance import Neighbours, room_for
from .kept import FEW, Known, Own, Scratch, no_rows
from .moving import Room, Then, touch_rows
from .moving_neighbours import clear_rows, near_rows
from .query_rows import FAULTY, NO_GIVEN, QueryRows
from .query_shape import QueryShape
from .touching import ROUNDED, Found
from .touching_rows import Near as Nearest
from .touching_rows import Points, Signed, bodies_of

MOST = 16  # boxes that packets look for


class Touched(NamedTuple):
    """What n queries touch, by row and in the order in which it is told."""

    rows: NDArray[np.int64]
    slots: Slots
    distances: Floats
    points: Floats


_NONE = np.empty(0, np.int64)
NOTHING = Touched(_NONE, _NONE, np.empty(0), np.empty((0, 3)))


class TimedDistances:
    """Overlaps and distances of one scene at other times."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._own = Own()
        self._entries: dict[tuple[Any, ...], Any] = {}

    # ---- one query: what is known until the next one of this thread, and its rows, in order

    def find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, at: float
    ) -> tuple[Found, list[int]]:
        """What a query touches at a time, as `overlaps.Overlaps.find` has it."""
        scratch, tree, done = self._own.scratch, self._held.tree, 0
        scratch.limits[0], scratch.masks[0] = query.tolerance, mask
        rows = query.record, query.bounds[None], scratch.limits, scratch.masks, NO_GIVEN
        asked, offsets = tuple.__new__(QueryRows, rows), scratch.offsets
        while not done:
            view, found = tree.view(), scratch.found
            known = self._known(scratch, view, at, hulls)
            given = asked, (0, 1, False), offsets, known.room, found
            done, wanted, compared = self._call(view, touch_rows, known.then, given, None)
            if not done:
                scratch.have_room(wanted)
        if compared:
            self._held.columns.pairs_compared += compared
        count = offsets.item(1)
        return found, found.order[:count].tolist() if count else []

    def find_near(
        self, point: Floats, k: int, limits: tuple[float, np.uint32], signed: Signed, at: float
    ) -> tuple[Found, list[int]]:
        """What is nearest to a point at a time, as `nearness.Nearness.find` has it."""
        scratch, held, done = self._own.scratch, self._held, 0
        scratch.point[0] = point
        reach, scratch.masks[0] = limits
        scratch.limits[0] = reach
        if k > FEW:  # not more room than for all
            k = min(k, max(len(held.tree), 1))
        if scratch.told.handles.shape[1] != k:
            scratch.told = no_rows(1, k)
        while not done:
            view, found = held.tree.view(), scratch.found
            known = self._known(scratch, view, at, None)
            asked = 0, 1, k, *self._among(view, signed)
            given = scratch.points, None, asked, known.room, found, scratch.told
            done, wanted, count = self._call(view, near_rows, known.then, given, signed)
            if not done:
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
    ) -> Touched | None:
        """What n queries touch at times (n,), each obstacle once a row. `enough`: one a row will
        do, and where it is nobody is told. None if a row that is `given` is not legal.
        """
        then, columns = self._then(at, hulls), self._held.columns
        view = self._held.tree.view()

        def work(start: int, stop: int) -> tuple[list[Touched], int, bool]:
            compared, parts = 0, [NOTHING]
            while start < stop:
                offsets, found = np.zeros(stop + 1, np.int64), self._own.scratch.found
                given = queries, (start, stop, enough), offsets, self._room(then), found
                done, wanted, pairs = self._call(view, touch_rows, then, given, None)
                if wanted == FAULTY:
                    return [], 0, False
                parts.append(_taken(found, offsets, start, done, enough))
                start, compared = done, compared + pairs
                self._own.scratch.have_room(wanted)
            return parts, compared, True

        each = in_threads(work, len(at), threads)
        if not all(legal for *_, legal in each):
            return None
        columns.pairs_compared += sum(compared for _, compared, _ in each)
        parts = [NOTHING, *(part for some, *_ in each for part in some)]
        every: Any = zip(*parts, strict=True)
        touched = Touched(*(np.concatenate(column) for column in every))
        if columns.shadows and not enough:
            keys = np.stack((touched.rows, columns.node_handle[touched.slots]))
            once = np.sort(np.unique(keys, axis=1, return_index=True)[1])
            every = (column[once] for column in touched)
            touched = Touched(*every)
        return touched

    def nearest(self, points: Points, k: int, signed: Signed, at: Floats, threads: int) -> Nearest:
        """The k obstacles nearest to n points at times (n,)."""
        then, told, tree = self._then(at, None), no_rows(len(at), k), self._held.tree
        view = tree.view()
        among = self._among(view, signed)
        near, known = self._in_packets(points, k, among, at)
        variant: Any = signed if known is None else (signed, Bounded)
        if near is not None:
            points = points._replace(order=near.order)

        def work(start: int, stop: int) -> None:
            if near is not None and known is not None and tree.motion is not None:
                tree.motion.bound_many(tree, near._replace(order=near.order[start:stop]), known)
            while start < stop:
                given = points, known, (start, stop, k, *among), self._room(then)
                more = self._own.scratch.found, told
                start, wanted, _ = self._call(view, near_rows, then, (*given, *more), variant)
                self._own.scratch.have_room(wanted)

        in_threads(work, len(at), threads)
        if known is not None:
            tree.check_unchanged(view)
        return told

    def _in_packets(
        self, points: Points, k: int, among: tuple[bool, int, bool, Signed], at: Floats
    ) -> tuple[Near, Bounded] | tuple[None, None]:
        """What is asked of a batch that is dense enough, and room for what is found; `near_rows`
        asks for the rest itself, as where obstacles grow.
        """
        (some_more, everybody, *_), count = among, len(at)
        wanted, ndim = min(k + some_more, everybody + 1), self._held.tree.ndim
        if not are_dense(count, everybody) or wanted > MOST or self._held.uncertainty:
            return None, None
        where, order = along_axes(points.points, ndim), points.order
        if not len(order):
            order = order_of(self._held.tree, where)
        limits = np.maximum(points.reaches * ROUNDED, points.reaches)
        near = Near(where, limits, points.masks, at, wanted, order)
        slots, counts = np.empty((count, wanted), np.int64), np.empty(count, np.int64)
        return near, Bounded(slots, counts, np.empty(count))

    def clearances(
        self,
        queries: QueryRows,
        hulls: Hulls | None,
        asked: tuple[Floats, int, Signed],
        at: Floats,
        threads: int,
    ) -> Neighbours | None:
        """The obstacles nearest to n shapes at times (n,); asked = (reaches, the slot of the
        obstacle that is the only row, or NONE, whether distances have a sign). None if a row that
        is `given` is not legal.
        """
        reaches, itself, signed = asked
        count, then, view = len(at), self._then(at, hulls), self._held.tree.view()
        everybody = view.tree.state.item(COUNT)
        alike = itself == NONE and not self._held.columns.shaped and not len(then.rest_slots)
        told = room_for(count, np.empty(count if itself != NONE else 0, np.int64))

        def work(start: int, stop: int) -> bool:
            while start < stop:
                question = start, stop, reaches, everybody, itself, signed, alike
                given = queries, question, self._room(then), told
                start, wanted = self._call(view, clear_rows, then, given, signed)
                if wanted == FAULTY:
                    return False
                self._own.scratch.have_room(wanted)
            return True

        return told if all(in_threads(work, count, threads)) else None

    # ---- kernels

    def _among(self, view: View, signed: Signed) -> tuple[bool, int, bool, Signed]:
        """What `near_rows` is told of all rows."""
        columns = self._held.columns
        shaped, twice = columns.shaped > 0, columns.shadows > 0
        some_more = shaped or twice or self._held.uncertainty > 0.0 or signed is not None
        return some_more, view.tree.state.item(COUNT), twice, signed

    def _known(self, scratch: Scratch, view: View, at: float, hulls: Hulls | None) -> Known:
        """What a kernel is told of one time, until the next one."""
        held, known, columns = self._held, scratch.known, self._held.columns
        scratch.at[0] = at
        if (
            known is not None
            and known.version == view.version
            and at <= known.until
            and hulls is None
            and known.geometry is columns.geometry
            and known.hulls is columns.hulls
        ):
            return known
        until = math.inf if math.isinf(held.max_prediction) else movers(held).first_end
        then, ours = self._then(scratch.at, hulls), (columns.geometry, columns.hulls)
        known = Known(view.version, *ours, until, then, self._room(then))
        scratch.known = known if hulls is None and at <= until else None
        return known

    def _then(self, at: Floats, hulls: Hulls | None) -> Then:
        held = self._held
        resting, ends = nobody_rests(held.tree.ndim), (0.0, 0.0)
        if not math.isinf(held.max_prediction):
            last = at.item() if len(at) == 1 else at.max(initial=-np.inf)
            if len(at_rest(held, last)):
                resting = rest(held)
        if held.uncertainty:
            ends = movers(held)[1:3]
        places = bodies_of(held.columns, hulls), held.columns.node_handle
        still = resting.tree.view().tree, resting.slots
        return Then(*places, at, held.max_prediction, held.uncertainty, *ends, *still)

    def _room(self, then: Then) -> Room:
        scratch, planar = self._own.scratch, then.bodies.footprints is not None
        footprint = scratch.footprint if planar else None
        spare = then.bodies._replace(shapes=scratch.shape, footprints=footprint)
        return Room(scratch.slots, scratch.handles, scratch.gaps, spare)

    def _call(self, view: View, kernel: Any, then: Then, given: tuple[Any, ...], kind: Any) -> Any:
        """Call a kernel; `kind` stands, with it, for the types of what it is given."""
        tree, variant = self._held.tree, (kernel, kind, then.bodies.hulls is not None)
        motion = tree.motion
        if motion is None:
            raise RuntimeError('no obstacle of this scene has a velocity')
        entry = self._entries.get(variant)
        if entry is None:
            entry = entry_point(kernel, view.tree, motion.moving, then, *given)
            self._entries[variant] = entry
        done = entry(view.tree, motion.bounds, then, *given)
        if done[0] >= 0:
            return done
        span = (then.at.min(), then.at.max()), True
        return motion.ask(tree, lambda: span, lambda *arrays: entry(*arrays, then, *given))


def _taken(found: Found, offsets: Slots, begin: int, done: int, enough: bool) -> Touched:
    """What a kernel found of the rows from `begin` on, in order; if any one is `enough`, not
    where.
    """
    counts, filled = np.diff(offsets[begin : done + 1]), offsets.item(done)
    if enough:
        rows = np.flatnonzero(counts) + begin
        return NOTHING._replace(rows=rows, slots=found.slots[:filled].copy())
    which = found.order[:filled] + np.repeat(offsets[begin:done], counts)
    rows = np.repeat(np.arange(begin, done), counts)
    return Touched(rows, found.slots[which], found.distances[which], found.points[which])
