# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of overlaps and distances at a time, or each at its own."""

from functools import partial
from typing import Any

import numpy as np

from ...tree.access import COUNT, NONE, PointQueries, Tree, are_dense, in_threads, order_of
from ...tree.motion.access import Bounded
from ..geometry.shapes import Floats, along_axes
from ..store.mesh_store import Hulls
from .clearance import NOT_ASKED, Neighbours, room_for
from .kept import FEW, no_rows
from .moving import touch_rows
from .moving_neighbours import clear_rows, near_rows
from .nearness import MANY
from .overlaps import as_wanted
from .query_rows import FAULTY, number_of
from .timed import OneTimed
from .touching import ROUNDED
from .touching_rows import ALL, HITS, Points, Signed
from .touching_rows import COUNT as COUNTED
from .touching_rows import Near as Nearest
from .touching_rows import room_for as answers_for

MOST = 16  # boxes that packets look for


class TimedDistances(OneTimed):
    """Overlaps and distances of one scene at other times."""

    def touching(
        self, rows: tuple[Any, ...], hulls: Hulls | None, at: Any, threads: int, wanted: int
    ) -> Any:
        """What is `wanted` of what n queries touch at times, as `overlaps.Overlaps.answer` has
        it; `at` (s) is one for all or (n,).
        """
        held, count = self._held, number_of(rows)
        columns, arrays = held.columns, held.tree._settled().tree
        told = answers_for(count, wanted)
        if threads == 1 and not columns.shadows:  # without what others take
            scratch = self._spare.take()
            then, memory = self._known(scratch, arrays, at, hulls)
            given = rows, (0, count, wanted, 0), memory, told
            done, _, written, compared = self._call(arrays, touch_rows, then, given, None)
            self._spare.give(scratch)
            if done == count:
                if compared:
                    columns.pairs_compared += compared
                if wanted != ALL and wanted != HITS:
                    return told[wanted]
                return as_wanted(told, [told[2][:written]], wanted, False)
        return self._touching(arrays, rows, hulls, at, threads, wanted, told)

    def _touching(
        self,
        arrays: Tree,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        at: Any,
        threads: int,
        wanted: int,
        told: tuple[Any, ...],
    ) -> Any:
        """The same, in parts."""
        columns, count = self._held.columns, number_of(rows)
        shadows, parts = columns.shadows > 0, []

        def work(start: int, stop: int) -> Any:
            begin, total, room, answers, some = start, 0, FEW, told, []
            scratch = self._spare.take()
            while start < stop:
                then, memory = self._known(scratch, arrays, at, hulls)
                if wanted == ALL:
                    answers = *told[:2], np.empty(room, np.uint32), *told[3:]
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
                told[1][begin + 1 : stop + 1] += told[1][begin]
            parts += some
        every = None
        if shadows and wanted in (COUNTED, HITS):
            every = self.touching(rows, hulls, at, threads, ALL)
        return as_wanted(told, parts, wanted, shadows, every)

    def nearest(
        self, points: Points, k: int, signed: Signed, at: Any, threads: int
    ) -> Nearest | None:
        """The k obstacles nearest to n points at times, one in seconds for all or (n,); None if a
        point is not finite.
        """
        count, arrays = len(points.points), self._held.tree._settled().tree
        told, among = no_rows(count, k), self._among(arrays, signed)
        if threads == 1 and count < MANY:  # without what others take
            scratch = self._spare.take()
            then, memory = self._known(scratch, arrays, at, None)
            given = points, None, (0, count, k, *among), memory, told
            done, wanted, _ = self._call(arrays, near_rows, then, given, signed)
            self._spare.give(scratch)
            if done == count:
                return told
            if wanted == FAULTY:
                return None
        return told if self._nearest(points, (k, *among), at, threads, told) else None

    def _nearest(
        self,
        points: Points,
        asked: tuple[int, bool, int, bool, Signed],
        at: Any,
        threads: int,
        told: Nearest,
    ) -> bool:
        """The same, in parts; whether all points are finite."""
        signed, count, tree = asked[-1], len(points.points), self._held.tree
        view = tree.view()
        near, known = self._in_packets(points, asked)
        variant: Any = signed if known is None else (signed, Bounded)
        if near is not None:
            points = points._replace(order=near.order)

        def work(start: int, stop: int) -> bool:
            if near is not None and known is not None and tree.motion is not None:
                rows = near._replace(order=near.order[start:stop])
                tree.motion.bound_many(tree, at, rows, known)
            scratch = self._spare.take()
            while start < stop:
                then, memory = self._known(scratch, view.tree, at, None)
                given = points, known, (start, stop, *asked), memory, told
                start, wanted, _ = self._call(view.tree, near_rows, then, given, variant)
                if wanted == FAULTY:
                    return False
                scratch.have_room(wanted)
            self._spare.give(scratch)
            return True

        finite = all(in_threads(work, count, threads))
        if known is not None:
            tree.check_unchanged(view)
        return finite

    def _in_packets(
        self, points: Points, asked: tuple[int, bool, int, bool, Signed]
    ) -> tuple[PointQueries, Bounded] | tuple[None, None]:
        """What is asked of a batch that is dense enough, and room for what is found; `near_rows`
        asks for the rest itself, as where obstacles grow.
        """
        (k, some_more, everybody, *_), count = asked, len(points.points)
        wanted, ndim = min(k + some_more, everybody + 1), self._held.tree.ndim
        dense = count >= MANY and are_dense(count, everybody)
        if not dense or wanted > MOST or self._held.uncertainty:
            return None, None
        where, order = along_axes(points.points, ndim), points.order
        if not len(order):
            order = order_of(self._held.tree.view().tree, where)
        limits = np.maximum(points.reaches * ROUNDED, points.reaches)
        near = PointQueries(where, wanted, limits, points.masks, order)
        slots, counts = np.empty((count, wanted), np.int64), np.empty(count, np.int64)
        return near, Bounded(slots, counts, np.empty(count))

    def clearances(
        self,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        asked: tuple[Floats, int, Signed],
        at: Any,
        threads: int,
    ) -> Neighbours | None:
        """The obstacles nearest to n shapes at times, one in seconds for all or (n,); asked =
        (reaches, the slot of the obstacle that is the only row, or NONE, whether distances have a
        sign). None if a row that is `given` is not legal.
        """
        reaches, itself, signed = asked
        count, arrays = number_of(rows), self._held.tree._settled().tree
        everybody = arrays[4].item(COUNT)
        told = room_for(count, NOT_ASKED if itself == NONE else np.empty(count, np.int64))
        alike = itself == NONE and not self._held.columns.shaped
        if threads == 1:  # without what others take
            scratch = self._spare.take()
            then, memory = self._known(scratch, arrays, at, hulls)
            given = rows, (0, count, reaches, everybody, itself, signed, alike), memory, told
            done, wanted = self._call(arrays, clear_rows, then, given, signed)
            self._spare.give(scratch)
            if done == count:
                return told
            if wanted == FAULTY:
                return None
        every = arrays, rows, hulls, (reaches, everybody, itself, signed, alike), at, told
        return told if all(in_threads(partial(self._clear, *every), count, threads)) else None

    def _clear(
        self,
        arrays: Tree,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        asked: tuple[Floats, int, int, Signed, bool],
        at: Any,
        told: Neighbours,
        start: int,
        stop: int,
    ) -> bool:
        """Fill in the rows [start, stop); whether all are legal."""
        scratch = self._spare.take()
        while start < stop:
            then, memory = self._known(scratch, arrays, at, hulls)
            given = rows, (start, stop, *asked), memory, told
            start, wanted = self._call(arrays, clear_rows, then, given, asked[3])
            if wanted == FAULTY:
                return False
            scratch.have_room(wanted)
        self._spare.give(scratch)
        return True
