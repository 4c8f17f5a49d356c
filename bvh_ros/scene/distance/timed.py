# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances at a time, among obstacles that have velocities."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    CHANGES,
    NONE,
    NOTHING,
    UINT32,
    PointQueries,
    Tree,
    are_dense,
    in_threads,
    order_of,
)
from ...tree.access import COUNT as COUNTED
from ...tree.compiler import entry_point
from ...tree.motion.access import Bounded, times_of
from ..results import SceneHit
from ..shapes.footprint import FOOTPRINT
from ..shapes.hull import Hulls
from ..shapes.shape import GEOMETRY, Floats, along_axes
from ..store import Obstacles, ScratchPool, movers
from .batch import (
    ALL,
    HITS,
    MANY,
    NO_ORDER,
    NO_SLOTS,
    Near,
    Neighbours,
    Points,
    Signed,
    as_wanted,
    bodies_of,
    room_for_neighbours,
)
from .batch import COUNT as WANT_COUNT
from .batch import room_for as answers_for
from .moving import ROOM, QueryTimes, clear_rows, near_rows, touch_rows
from .query import FAULTY, FOUND, NO_GIVEN, ROUNDED, Found, QueryShape, found_in, number_of

# ---- What one query at a time leaves to the next, see `TimedDistances`.

FEW = 64  # obstacles that there is room for at first


class CachedArguments(NamedTuple):
    """Arguments of kernels while the world has one version and these arrays."""

    version: int
    bodies: Any
    then: QueryTimes
    memory: tuple[Any, Any]
    """See `moving.room_in`."""


class Scratch:
    """Room that kernels write to, see `Spare`. And what they read of one query, as making arrays
    of one row would take longer than most queries.
    """

    def __init__(self) -> None:
        self.at, self.limits, self.masks = np.empty(1), np.empty(1), np.empty(1, np.uint32)
        self.point = np.empty((1, 3))
        self.points = Points(self.point, self.limits, self.masks, NO_ORDER)
        self.answers, self.results = answers_for(1, WANT_COUNT), no_rows(1, 1)
        self.make_room(FEW)

    def make_room(self, count: int) -> None:
        """Have room for at least so many."""
        self.cached: CachedArguments | None = None
        self.floats = np.zeros(ROOM * 2 * count)
        self.shape, self.footprint = np.empty(1, GEOMETRY), np.empty(1, FOOTPRINT)
        self.found: Found = found_in.py_func(self.floats[: FOUND * 2 * count])

    def memory(self, then: QueryTimes) -> tuple[Any, Any]:
        """What of it kernels write to as they look at what stands there then."""
        footprint = None if then.bodies.footprints is None else self.footprint
        spare = then.bodies._replace(shapes=self.shape, footprints=footprint)
        return self.floats, spare

    def have_room(self, count: int) -> None:
        """`make_room` if there is less."""
        if count > len(self.found.slots):
            self.make_room(count)


def no_rows(count: int, k: int) -> Near:
    # As Near(...), which would take one more call of a function of Python's.
    parts = np.empty((count, k), UINT32), np.empty((count, k)), np.empty((count, k, 3))
    return tuple.__new__(Near, parts)


# ---- Overlaps and distances at a time, among obstacles that have velocities: how `moving` is
# called, and one query. Scenes without velocities need none of this.


class OneTimed:
    """One query at a time, and how kernels are called."""

    def __init__(self, store: Obstacles) -> None:
        self._store = store
        self._spare = ScratchPool(Scratch)
        self._entries: dict[tuple[Any, ...], Any] = {}

    def find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, at: float
    ) -> list[SceneHit]:
        """What a query touches at a time, in the order of `batch.Overlaps.find`."""
        scratch, tree, done = self._spare.take(), self._store.tree, 0
        scratch.limits[0], scratch.masks[0] = query.tolerance, mask
        options = query.record, query.bounds[None], scratch.limits, scratch.masks, NO_GIVEN
        while not done:
            arrays, found = tree._settled().tree, scratch.found
            then, memory = self._arguments(scratch, arrays, at, hulls)
            given = options, (0, 1, WANT_COUNT, 0), memory, scratch.answers
            done, wanted, _, compared = self._call(arrays, touch_rows, then, given, None)
            if not done:
                scratch.have_room(wanted)
        if compared:
            self._store.columns.pairs_compared += compared
        count = scratch.answers[1].item(0)
        hits = self._store.hits(found, found.order[:count].tolist()) if count else []
        self._spare.give(scratch)
        return hits

    def find_near(
        self, point: Floats, k: int, limits: tuple[float, np.uint32], signed: Signed, at: float
    ) -> list[SceneHit]:
        """What is nearest to a point at a time, in the order of `batch.Nearness.find`."""
        scratch, store, done = self._spare.take(), self._store, 0
        scratch.point[0] = point
        reach, scratch.masks[0] = limits
        scratch.limits[0] = reach
        if k > FEW:  # not more room than for all
            k = min(k, max(len(store.tree), 1))
        if scratch.results.handles.shape[1] != k:
            scratch.results = no_rows(1, k)
        while not done:
            arrays, found = store.tree._settled().tree, scratch.found
            then, memory = self._arguments(scratch, arrays, at, None)
            options = 0, 1, k, *self._among(arrays, signed)
            given = scratch.points, None, options, memory, scratch.results
            done, wanted, count = self._call(arrays, near_rows, then, given, signed)
            if not done:
                scratch.have_room(wanted)
        distances = found.distances[:count].tolist()
        order = [row for row in found.order[:count].tolist() if distances[row] <= reach]
        if store.columns.shadows:
            handles = store.columns.node_handle[found.slots[order]]
            first = np.sort(np.unique(handles, return_index=True)[1])
            order = [order[place] for place in first]
        hits = store.hits(found, order[:k])
        self._spare.give(scratch)
        return hits

    # ---- kernels

    def _among(self, arrays: Tree, signed: Signed) -> tuple[bool, int, bool, Signed]:
        """The arguments of `near_rows` for all rows."""
        store, columns = self._store, self._store.columns
        shaped, twice = columns.shaped > 0, columns.shadows > 0
        some_more = shaped or twice or store.uncertainty > 0.0 or signed is not None
        return some_more, arrays[4].item(COUNTED), twice, signed

    def _arguments(
        self, scratch: Scratch, arrays: Tree, at: Any, hulls: Hulls | None
    ) -> tuple[QueryTimes, tuple[Any, Any]]:
        """The times for a kernel, and the part of `scratch` that it writes to."""
        cached, version = scratch.cached, arrays[4].item(CHANGES)
        bodies = self._store.columns.bodies
        if cached is not None and hulls is None and cached[0] == version and cached[1] is bodies:
            _, _, then, memory = cached
        else:
            then = self._then(scratch.at, hulls)
            memory = scratch.memory(then)
            scratch.cached = (
                CachedArguments(version, bodies, then, memory) if hulls is None else None
            )
        if type(at) is float:
            scratch.at[0] = at
            return then, memory
        return tuple.__new__(QueryTimes, (*then[:2], at, *then[3:])), memory

    def _then(self, at: Floats, hulls: Hulls | None) -> QueryTimes:
        store = self._store
        ends = movers(store)[1:] if store.uncertainty else (0.0, 0.0)
        places = bodies_of(store.columns, hulls), store.columns.node_handle
        return QueryTimes(*places, at, store.uncertainty, *ends)

    def _call(
        self, arrays: Tree, kernel: Any, then: QueryTimes, given: tuple[Any, ...], kind: Any
    ) -> Any:
        """Call a kernel; `kind` stands, with it, for the types of what it is given."""
        tree: Any = self._store.tree
        variant, motion = (kernel, kind, type(then[0].hulls)), tree._motion
        if motion is None:
            raise RuntimeError('no obstacle of this scene has a velocity')
        entry = self._entries.get(variant)
        if entry is None:
            entry = entry_point(kernel, arrays, motion.moving, then, *given)
            self._entries[variant] = entry
        done = entry(arrays, motion.bounds, then, *given)
        return done if done[0] >= 0 else self._call_again(entry, then, given)

    def _call_again(self, entry: Any, then: QueryTimes, given: tuple[Any, ...]) -> Any:
        """Call it with bounds that hold for these times."""
        tree: Any = self._store.tree
        spans = partial(times_of, then.at, NOTHING, NOTHING)
        return tree._motion.ask(tree, spans, lambda *arrays: entry(*arrays, then, *given))


# ---- Batches of overlaps and distances at a time, or each at its own.

MOST = 16  # boxes that packets look for


class TimedDistances(OneTimed):
    """Overlaps and distances of one scene at other times."""

    def touching(
        self, rows: tuple[Any, ...], hulls: Hulls | None, at: Any, threads: int, wanted: int
    ) -> Any:
        """What is `wanted` of what n queries touch at times, as `batch.Overlaps.answer` has
        it; `at` (s) is one for all or (n,).
        """
        store, count = self._store, number_of(rows)
        columns, arrays = store.columns, store.tree._settled().tree
        results = answers_for(count, wanted)
        if threads == 1 and not columns.shadows:  # without what others take
            scratch = self._spare.take()
            then, memory = self._arguments(scratch, arrays, at, hulls)
            given = rows, (0, count, wanted, 0), memory, results
            done, _, written, compared = self._call(arrays, touch_rows, then, given, None)
            self._spare.give(scratch)
            if done == count:
                if compared:
                    columns.pairs_compared += compared
                if wanted != ALL and wanted != HITS:
                    return results[wanted]
                return as_wanted(results, [results[2][:written]], wanted, False)
        return self._touching(arrays, rows, hulls, at, threads, wanted, results)

    def _touching(
        self,
        arrays: Tree,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        at: Any,
        threads: int,
        wanted: int,
        results: tuple[Any, ...],
    ) -> Any:
        """The same, in parts."""
        columns, count = self._store.columns, number_of(rows)
        shadows, parts = columns.shadows > 0, []

        def work(start: int, stop: int) -> Any:
            begin, total, room, answers, some = start, 0, FEW, results, []
            scratch = self._spare.take()
            while start < stop:
                then, memory = self._arguments(scratch, arrays, at, hulls)
                if wanted == ALL:
                    answers = *results[:2], np.empty(room, np.uint32), *results[3:]
                given = rows, (start, stop, wanted, total), memory, answers
                done = self._call(arrays, touch_rows, then, given, None)
                start, needed, written, compared = done
                if needed == FAULTY:
                    return None
                if written:
                    some.append(answers[2][:written])
                columns.pairs_compared += compared
                total, room = total + written, max(2 * room, needed)
                scratch.have_room(needed)
            self._spare.give(scratch)
            return begin, stop, some

        for done in in_threads(work, count, threads):
            if done is None:
                return None
            begin, stop, some = done
            if wanted == ALL and begin > 0:
                results[1][begin + 1 : stop + 1] += results[1][begin]
            parts += some
        every = None
        if shadows and wanted in (WANT_COUNT, HITS):
            every = self.touching(rows, hulls, at, threads, ALL)
        return as_wanted(results, parts, wanted, shadows, every)

    def nearest(
        self, points: Points, k: int, signed: Signed, at: Any, threads: int
    ) -> Near | None:
        """The k obstacles nearest to n points at times, one in seconds for all or (n,); None if a
        point is not finite.
        """
        count, arrays = len(points.points), self._store.tree._settled().tree
        results, among = no_rows(count, k), self._among(arrays, signed)
        if threads == 1 and count < MANY:  # without what others take
            scratch = self._spare.take()
            then, memory = self._arguments(scratch, arrays, at, None)
            given = points, None, (0, count, k, *among), memory, results
            done, wanted, _ = self._call(arrays, near_rows, then, given, signed)
            self._spare.give(scratch)
            if done == count:
                return results
            if wanted == FAULTY:
                return None
        return results if self._nearest(points, (k, *among), at, threads, results) else None

    def _nearest(
        self,
        points: Points,
        options: tuple[int, bool, int, bool, Signed],
        at: Any,
        threads: int,
        results: Near,
    ) -> bool:
        """The same, in parts; whether all points are finite."""
        signed, count, tree = options[-1], len(points.points), self._store.tree
        view = tree.view()
        near, packets = self._in_packets(points, options)
        variant: Any = signed if packets is None else (signed, Bounded)
        if near is not None:
            points = points._replace(order=near.order)

        def work(start: int, stop: int) -> bool:
            if near is not None and packets is not None and tree.motion is not None:
                rows = near._replace(order=near.order[start:stop])
                tree.motion.bound_many(tree, at, rows, packets)
            scratch = self._spare.take()
            while start < stop:
                then, memory = self._arguments(scratch, view.tree, at, None)
                given = points, packets, (start, stop, *options), memory, results
                start, wanted, _ = self._call(view.tree, near_rows, then, given, variant)
                if wanted == FAULTY:
                    return False
                scratch.have_room(wanted)
            self._spare.give(scratch)
            return True

        finite = all(in_threads(work, count, threads))
        if packets is not None:
            tree.check_unchanged(view)
        return finite

    def _in_packets(
        self, points: Points, options: tuple[int, bool, int, bool, Signed]
    ) -> tuple[PointQueries, Bounded] | tuple[None, None]:
        """The query of a batch that is dense enough, and room for what is found. `near_rows` finds
        the rest itself, and all where obstacles grow.
        """
        (k, some_more, everybody, *_), count = options, len(points.points)
        wanted, ndim = min(k + some_more, everybody + 1), self._store.tree.ndim
        dense = count >= MANY and are_dense(count, everybody)
        if not dense or wanted > MOST or self._store.uncertainty:
            return None, None
        where, order = along_axes(points.points, ndim), points.order
        if not len(order):
            order = order_of(self._store.tree.view().tree, where)
        limits = np.maximum(points.reaches * ROUNDED, points.reaches)
        near = PointQueries(where, wanted, limits, points.masks, order)
        slots, counts = np.empty((count, wanted), np.int64), np.empty(count, np.int64)
        return near, Bounded(slots, counts, np.empty(count))

    def clearances(
        self,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        options: tuple[Floats, int, Signed],
        at: Any,
        threads: int,
    ) -> Neighbours | None:
        """The obstacles nearest to n shapes at times, one in seconds for all or (n,); options =
        (reaches, the slot of the obstacle that is the only row, or NONE, whether distances have a
        sign). None if a row that is `given` is not legal.
        """
        reaches, itself, signed = options
        count, arrays = number_of(rows), self._store.tree._settled().tree
        everybody = arrays[4].item(COUNTED)
        results = room_for_neighbours(
            count, NO_SLOTS if itself == NONE else np.empty(count, np.int64)
        )
        alike = itself == NONE and not self._store.columns.shaped
        if threads == 1:  # without what others take
            scratch = self._spare.take()
            then, memory = self._arguments(scratch, arrays, at, hulls)
            given = rows, (0, count, reaches, everybody, itself, signed, alike), memory, results
            done, wanted = self._call(arrays, clear_rows, then, given, signed)
            self._spare.give(scratch)
            if done == count:
                return results
            if wanted == FAULTY:
                return None
        every = arrays, rows, hulls, (reaches, everybody, itself, signed, alike), at, results
        return results if all(in_threads(partial(self._clear, *every), count, threads)) else None

    def _clear(
        self,
        arrays: Tree,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        options: tuple[Floats, int, int, Signed, bool],
        at: Any,
        results: Neighbours,
        start: int,
        stop: int,
    ) -> bool:
        """Fill in the rows [start, stop); whether all are legal."""
        scratch = self._spare.take()
        while start < stop:
            then, memory = self._arguments(scratch, arrays, at, hulls)
            given = rows, (start, stop, *options), memory, results
            start, wanted = self._call(arrays, clear_rows, then, given, options[3])
            if wanted == FAULTY:
                return False
            scratch.have_room(wanted)
        self._spare.give(scratch)
        return True
