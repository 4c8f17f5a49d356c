# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances at a time, among obstacles that have velocities: how `moving` is called.
Scenes without velocities need none of this.
"""

import math
from functools import partial
from typing import Any

import numpy as np

from ...tree.boxes.nearest_packets import are_dense
from ...tree.boxes.ordering import order_of
from ...tree.jit.compiling import entry_point
from ...tree.motion.nearest import Near
from ...tree.motion.nearest_packets import Bounded
from ...tree.nodes import COUNT, NONE, View
from ...tree.store.workers import in_threads
from ..geometry.shapes import Floats, along_axes
from ..results import SceneHit
from ..store.mesh_store import Hulls
from ..store.obstacles import Obstacles
from ..store.places import at_rest, movers, nobody_rests, rest
from ..store.spare import Spare
from .clearance import NOT_ASKED, Neighbours, room_for
from .kept import FEW, Known, Scratch, no_rows
from .moving import Then, touch_rows
from .moving_neighbours import clear_rows, near_rows
from .nearness import MANY
from .overlaps import as_wanted
from .query_rows import FAULTY, NO_GIVEN, number_of
from .query_shape import QueryShape
from .touching import ROUNDED
from .touching_rows import ALL, HITS, Points, Signed, bodies_of
from .touching_rows import COUNT as COUNTED
from .touching_rows import Near as Nearest
from .touching_rows import room_for as answers_for

MOST = 16  # boxes that packets look for


class TimedDistances:
    """Overlaps and distances of one scene at other times."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._spare = Spare(Scratch)
        self._entries: dict[tuple[Any, ...], Any] = {}

    # ---- one query

    def find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, at: float
    ) -> list[SceneHit]:
        """What a query touches at a time, in the order of `overlaps.Overlaps.find`."""
        scratch, tree, done = self._spare.take(), self._held.tree, 0
        scratch.limits[0], scratch.masks[0] = query.tolerance, mask
        asked = query.record, query.bounds[None], scratch.limits, scratch.masks, NO_GIVEN
        while not done:
            view, found = tree.view(), scratch.found
            known = self._known(scratch, view, at, hulls)
            given = asked, (0, 1, COUNTED, 0), known.room, found, scratch.answers
            done, wanted, _, compared = self._call(view, touch_rows, known.then, given, None)
            if not done:
                scratch.have_room(wanted)
        if compared:
            self._held.columns.pairs_compared += compared
        count = scratch.answers[1].item(0)
        hits = self._held.hits(found, found.order[:count].tolist()) if count else []
        self._spare.give(scratch)
        return hits

    def find_near(
        self, point: Floats, k: int, limits: tuple[float, np.uint32], signed: Signed, at: float
    ) -> list[SceneHit]:
        """What is nearest to a point at a time, in the order of `nearness.Nearness.find`."""
        scratch, held, done = self._spare.take(), self._held, 0
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
        hits = held.hits(found, order[:k])
        self._spare.give(scratch)
        return hits

    # ---- batches

    def touching(
        self, rows: tuple[Any, ...], hulls: Hulls | None, at: Any, threads: int, wanted: int
    ) -> Any:
        """What is `wanted` of what n queries touch at times, as `overlaps.Overlaps.answer` has
        it; `at` (s) is one for all or (n,).
        """
        columns, count, view = self._held.columns, number_of(rows), self._held.tree.view()
        told = answers_for(count, wanted)
        if threads == 1 and not columns.shadows:  # without what others take
            scratch = self._spare.take()
            known = self._known(scratch, view, at, hulls)
            given = rows, (0, count, wanted, 0), known.room, scratch.found, told
            done = self._call(view, touch_rows, known.then, given, None)
            self._spare.give(scratch)
            if done[0] == count:
                columns.pairs_compared += done[3]
                return as_wanted(told, [told[2][: done[2]]], wanted, False)
        return self._touching(view, rows, hulls, at, threads, wanted, told)

    def _touching(
        self,
        view: View,
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
                known = self._known(scratch, view, at, hulls)
                if wanted == ALL:
                    answers = *told[:2], np.empty(room, np.uint32), *told[3:]
                given = rows, (start, stop, wanted, total), known.room, scratch.found, answers
                done = self._call(view, touch_rows, known.then, given, None)
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
        count, tree = len(points.points), self._held.tree
        told, view = no_rows(count, k), tree.view()
        among = self._among(view, signed)
        if threads == 1 and count < MANY:  # without what others take
            scratch = self._spare.take()
            now = self._known(scratch, view, at, None)
            given = points, None, (0, count, k, *among), now.room, scratch.found, told
            done, wanted, _ = self._call(view, near_rows, now.then, given, signed)
            self._spare.give(scratch)
            if done == count:
                return told
            if wanted == FAULTY:
                return None
        return told if self._nearest(view, points, (k, *among), at, threads, told) else None

    def _nearest(
        self,
        view: View,
        points: Points,
        asked: tuple[int, bool, int, bool, Signed],
        at: Any,
        threads: int,
        told: Nearest,
    ) -> bool:
        """The same, in parts; whether all points are finite."""
        signed, count, tree = asked[-1], len(points.points), self._held.tree
        near, known = self._in_packets(points, asked, at)
        variant: Any = signed if known is None else (signed, Bounded)
        if near is not None:
            points = points._replace(order=near.order)

        def work(start: int, stop: int) -> bool:
            if near is not None and known is not None and tree.motion is not None:
                tree.motion.bound_many(tree, near._replace(order=near.order[start:stop]), known)
            scratch = self._spare.take()
            while start < stop:
                now = self._known(scratch, view, at, None)
                given = points, known, (start, stop, *asked), now.room, scratch.found, told
                start, wanted, _ = self._call(view, near_rows, now.then, given, variant)
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
        self, points: Points, asked: tuple[int, bool, int, bool, Signed], at: Any
    ) -> tuple[Near, Bounded] | tuple[None, None]:
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
            order = order_of(self._held.tree, where)
        limits = np.maximum(points.reaches * ROUNDED, points.reaches)
        times = np.array([at]) if type(at) is float else at
        near = Near(where, limits, points.masks, times, wanted, order)
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
        count, view = number_of(rows), self._held.tree.view()
        everybody = view.tree.state.item(COUNT)
        told = room_for(count, NOT_ASKED if itself == NONE else np.empty(count, np.int64))
        given = view, rows, hulls, (reaches, everybody, itself, signed), at, told
        if threads == 1:
            return told if self._clear(*given, 0, count) else None
        return told if all(in_threads(partial(self._clear, *given), count, threads)) else None

    def _clear(
        self,
        view: View,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        asked: tuple[Floats, int, int, Signed],
        at: Any,
        told: Neighbours,
        start: int,
        stop: int,
    ) -> bool:
        """Fill in the rows [start, stop); whether all are legal."""
        alike = asked[2] == NONE and not self._held.columns.shaped
        scratch = self._spare.take()
        while start < stop:
            now = self._known(scratch, view, at, hulls)
            question = start, stop, *asked, alike and not len(now.then.rest_slots)
            given = rows, question, now.room, told
            start, wanted = self._call(view, clear_rows, now.then, given, asked[3])
            if wanted == FAULTY:
                return False
            scratch.have_room(wanted)
        self._spare.give(scratch)
        return True

    # ---- kernels

    def _among(self, view: View, signed: Signed) -> tuple[bool, int, bool, Signed]:
        """What `near_rows` is told of all rows."""
        columns = self._held.columns
        shaped, twice = columns.shaped > 0, columns.shadows > 0
        some_more = shaped or twice or self._held.uncertainty > 0.0 or signed is not None
        return some_more, view.tree.state.item(COUNT), twice, signed

    def _known(self, scratch: Scratch, view: View, at: Any, hulls: Hulls | None) -> Known:
        """What a kernel is told of times, and of one until the next one."""
        held, known, columns = self._held, scratch.known, self._held.columns
        if type(at) is not float:
            then = self._then(at, hulls)
            return Known(view.version, None, None, 0.0, then, scratch.room(then))
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
        known = Known(view.version, *ours, until, then, scratch.room(then))
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

    def _call(self, view: View, kernel: Any, then: Then, given: tuple[Any, ...], kind: Any) -> Any:
        """Call a kernel; `kind` stands, with it, for the types of what it is given."""
        tree: Any = self._held.tree
        variant, motion = (kernel, kind, then.bodies.hulls is not None), tree._motion
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
