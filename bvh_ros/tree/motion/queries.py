# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The queries of a tree whose boxes move. Arguments are those of the tree's methods of the same
names, which hand them on.
"""

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import box_checks, checks, time_checks
from ..boxes.nearest_packets import are_dense
from ..boxes.ordering import order_of
from ..boxes.overlapping import overlap_many
from ..nodes import COUNT, NONE, View
from ..rays import ray_batches
from ..rays.raycasting import ANY, CLOSEST, EVERY, Found, more_room, room_for_hits
from ..results import RayHits
from ..store.turns import NOT_FINITE
from ..store.workers import in_threads
from ..wide.ray_streams import RAYS_AT_ONCE
from . import casting, nearest, nearest_packets, overlapping, wide_casting
from .bounds import LONGEST
from .casting import Casts, Places
from .motion import Motion
from .nearest import Near
from .nearest_packets import Bounded
from .spans import both_times, span_of, times_of
from .sweeping import Sweep
from .wide_casting import NO_LEAVES, UNSUITED, MovingRays

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]
STILL = np.zeros(1)
FEW = 64  # boxes that there is room for at first
# From so many points on their order is worth being made.
MANY_POINTS, NO_ORDER = 512, np.empty(0, np.int64)


class MotionQueries(Motion):
    """What is asked of moving boxes."""

    def cast(
        self,
        tree: Any,
        swept: tuple[Floats, Floats, Floats],
        asked: tuple[float, np.uint32, bool, int],
        times: tuple[Any, Any],
        place: Floats,
    ) -> tuple[int, float]:
        """`casting.cast_one` of lo, hi, direction: (handle, or NONE or NOT_FINITE, t)."""
        at, pace = times
        if not (type(at) is type(pace) is float):
            times = at, pace = time_checks.moment('at', at), time_checks.moment('pace', pace)
        kernel = casting.one_entry(tree._ndim)
        handle, t = kernel(tree._settled().tree, self.moving, swept, asked, times, place)
        while handle < NONE and handle != NOT_FINITE:
            self.fit(tree, *span_of(at, pace, asked[0]))
            handle, t = kernel(tree._settled().tree, self.moving, swept, asked, times, place)
        if handle == NOT_FINITE:
            time_checks.moments('at', at, None)
            time_checks.moments('pace', pace, None)
        return handle, t

    def overlap(self, tree: Any, box: tuple[Floats, Floats], mask: np.uint32, at: Any) -> Ids:
        """Handles of what a box touches, ascending."""
        if type(at) is not float:
            at = time_checks.moment('at', at)
        ndim, slots = tree._ndim, np.empty(FEW, np.int64)
        kernel = overlapping.one_entry(ndim)
        while True:
            count = kernel(tree._settled().tree, self.moving, box, mask, at, slots)
            if count == NOT_FINITE:
                time_checks.moment('at', at)
                box_checks.box(*box, ndim)
            if 0 <= count <= len(slots):
                handles = slots[:count]
                if count > 1:
                    handles.sort()
                return handles
            if count > 0:
                slots = np.empty(count, np.int64)
            else:
                self.fit(tree, *span_of(at, 0.0, 0.0))

    def nearest(
        self, tree: Any, near: tuple[Floats, Floats, Any, int, float, np.uint32]
    ) -> tuple[Ids, Floats]:
        """`nearest.nearest_one` of (low, high, at, k, reach, mask): (ids, distances)."""
        at, k = near[2], near[3]
        if type(at) is not float:
            at = time_checks.moment('at', at)
            near = *near[:2], at, *near[3:]
        kernel = nearest.one_entry(tree._ndim)
        found, distances = np.empty(k, np.int64), np.empty(k)
        while True:
            count = kernel(tree._settled().tree, self.moving, near, found, distances)
            if count == k:
                return found, distances
            if count == NOT_FINITE:
                time_checks.moment('at', at)
                checks.finite('point', np.array(near[:2]))
            if count >= 0:
                return found[:count], distances[:count]
            self.fit(tree, *span_of(at, 0.0, 0.0))

    def every_ray(
        self, tree: Any, rays: tuple[Any, ...], times: tuple[Any, Any]
    ) -> tuple[Ids, Ids, Found, Places]:
        """`every` hit of rays = (origins, directions, t_max, mask, skip_inside)."""
        origins, directions, t_max, mask, skip_inside = rays
        count, skip = len(origins), checks.flag('skip_inside', skip_inside)
        limits = checks.limits_or_one('t_max', t_max, count)
        rows = limits, checks.masks_or_one(mask, count), *both_times(times, count)
        return self.every(tree, Casts(origins, origins, directions, *rows, skip, EVERY))

    def every(self, tree: Any, casts: Casts) -> tuple[Ids, Ids, Found, Places]:
        """All hits of rays or boxes, nearest first, or the first of each: (offsets, handles, what
        was found, where).
        """
        count, ndim, begun = len(casts.lo), tree.ndim, tree.view()
        offsets, done = np.zeros(count + 1, np.int64), 0
        found = room_for_hits(count if casts.mode != EVERY else 64)
        kernel = casting.rows_entry(ndim)
        spans = functools.partial(times_of, casts.at, casts.pace, casts.t_max)
        while done < count:

            def call(arrays: Any, moving: Any, first: int = done, room: Any = found) -> Any:
                return kernel(arrays, moving, casts, offsets, room, first)

            done, wanted = self.ask(tree, spans, call)
            if done < count:
                found = more_room(found, wanted)
        total = offsets[-1]
        found = Found(found.slots[:total], found.ts[:total], found.axes[:total])
        if casts.mode == EVERY:  # else there is one a row
            rows = np.repeat(np.arange(count), np.diff(offsets))
            order = np.lexsort((begun.tree.handles[found.slots], found.ts, rows))
            found = Found(found.slots[order], found.ts[order], found.axes[order])
        places = Places(np.empty((total, ndim)), np.empty((total, ndim)))
        if casts.mode != ANY:
            kernel = casting.describe_entry(ndim)
            kernel(begun.tree, self.moving, casts, offsets, found, places)
        handles = begun.tree.handles[found.slots]
        tree.check_unchanged(begun)
        return offsets, handles, found, places

    def first_many(
        self,
        tree: Any,
        rays: tuple[Floats, Floats, Floats, Any],
        skip_inside: bool,
        mode: int,
        times: tuple[Any, Any],
        threads: int,
    ) -> RayHits:
        """`raycast_many` of rays = (origins, directions, t_max, masks), and `occluded_many`, of
        which the ids tell it.
        """
        at, pace = times
        if threads == 1 and type(at) is type(pace) is float and len(rays[2]) == 1:
            # What is ready is looked for before anything is made: of few rays, that is most.
            view = tree.view()
            last = at if pace == 0.0 else at + rays[2].item() * pace
            sweep = self.ready_sweep(view, len(rays[0]), at, last)
            if sweep is not None:
                when = np.array([at]), checks.only(pace) if pace else np.array([pace])
                return self._first(tree, view, sweep, (*rays, skip_inside, mode, *when), 1)
        both = both_times(times, len(rays[0]))
        return self.first_at(tree, rays, skip_inside, mode, both, threads)

    def first_at(
        self,
        tree: Any,
        rays: tuple[Floats, Floats, Floats, Any],
        skip_inside: bool,
        mode: int,
        when: tuple[Floats, Floats],
        threads: int,
    ) -> RayHits:
        """`first_many` at good times."""
        count, view = len(rays[0]), tree.view()
        span, every = times_of(*when, rays[2])
        sweep = self.swept_for(tree, view, count, span) if every and count else None
        return self._first(tree, view, sweep, (*rays, skip_inside, mode, *when), threads)

    def _first(
        self, tree: Any, view: View, sweep: Sweep | None, rays: tuple[Any, ...], threads: int
    ) -> RayHits:
        """First hits of rays, what a `MovingRays` holds up to `pace`."""
        known = (self.known(view, 0.0, 0.0), NO_LEAVES[tree._ndim]) if sweep is None else sweep[1:]
        # As MovingRays(...), with less Python.
        asked, count = tuple.__new__(MovingRays, rays + known), len(rays[0])
        hits = ray_batches.room_for(count, tree._ndim, rays[5])
        if threads == 1 and sweep is not None:
            unsuited = wide_casting.cast(view, sweep.snapshot, asked, hits)
        else:
            unsuited = self._shared(tree, view, sweep, asked, hits, threads)
        if unsuited:
            others = np.flatnonzero(hits.ids == UNSUITED)
            _check_finite(asked)
            some = rows_of(hits, count, others)
            self._one_by_one(tree, rows_of(asked, count, others), some)
            for column, part in zip(hits, some, strict=True):
                column[others[: len(part)]] = part
        return hits

    def _shared(
        self, tree: Any, view: View, sweep: Any, rays: MovingRays, hits: RayHits, threads: int
    ) -> int:
        """Answer rays, by so many threads: whether some are UNSUITED."""
        count = len(rays.origins)

        def work(start: int, stop: int) -> int:
            part, into = rays, hits
            if stop - start < count:
                part, into = (rows_of(rows, count, slice(start, stop)) for rows in (rays, hits))
            if sweep is not None:
                return wide_casting.cast(view, sweep.snapshot, part, into)
            self._one_by_one(tree, part, into)
            return 0

        if sweep is None:
            _check_finite(rays)
        return any(in_threads(work, count, threads, 1 if sweep is None else 2 * RAYS_AT_ONCE))

    def _one_by_one(self, tree: Any, rays: MovingRays, hits: RayHits) -> None:
        """Answer rays by the tree's own nodes."""
        if len(rays.origins) == 1:  # with a third of the Python
            swept = *rays.origins, *rays.origins, *rays.directions
            asked = rays.t_max.item(), rays.masks[0], rays.skip_inside, rays.mode
            times, place = (rays.at.item(), rays.pace.item()), np.empty((2, tree._ndim))
            hits.ids[0], t = self.cast(tree, swept, asked, times, place)
            if rays.mode == CLOSEST:
                hits.t[0], hits.normals[0] = t, place[1] if hits.ids[0] >= 0 else 0.0
            return
        casts = Casts(rays.origins, *rays[:4], *rays[6:8], rays.skip_inside, rays.mode)
        offsets, handles, found, places = self.every(tree, casts)
        rows = np.flatnonzero(np.diff(offsets))
        hits.ids[:] = NONE
        hits.ids[rows] = handles
        if rays.mode == CLOSEST:
            hits.t[:], hits.normals[:] = np.inf, 0.0
            hits.t[rows], hits.normals[rows] = found.ts, places.normals

    def overlap_many(
        self,
        tree: Any,
        boxes: tuple[Floats, Floats],
        masks: NDArray[np.uint32],
        at: Any,
        threads: int,
    ) -> tuple[Ids, Ids] | None:
        """What boxes touch at times: (offsets, handles); None if one is no box."""
        times, view = time_checks.moments('at', at, len(boxes[0])), tree.view()
        moving = self.fitted(tree, view.version, *times_of(times, STILL, STILL)[0])
        queries = overlapping.QueriesThen(*boxes, masks, times)
        arrays, entry = (view.tree, moving), overlapping.rows_entry
        return overlap_many(arrays, queries, threads, entry)

    def nearest_many(
        self, tree: Any, points: Floats, k: int, asked: tuple[Any, Any], at: Any
    ) -> tuple[Ids, Floats]:
        """The nearest to points, asked = (max_distance, mask): (ids, distances)."""
        count, boxes = len(points), tree.view().tree.state.item(COUNT)
        limits = checks.limits_or_one('max_distance', asked[0], count)
        masks, times = checks.masks_or_one(asked[1], count), time_checks.moments('at', at, count)
        dense = are_dense(count, boxes) and bool((np.abs(times) < LONGEST).all())
        kernel = (nearest_packets.entry if dense else nearest.rows_entry)(tree.ndim)
        order = order_of(tree, points) if dense or count >= MANY_POINTS else NO_ORDER
        rows = Near(points, limits, masks, times, k, order)
        found, distances = np.empty((count, k), np.int64), np.empty((count, k))
        spans = functools.partial(times_of, times, STILL, STILL)
        self.ask(tree, spans, lambda *arrays: kernel(*arrays, rows, found, distances))
        return found, distances

    def bound_many(self, tree: Any, rows: Near, bounded: Bounded) -> None:
        """Fill in the boxes whose bounds are nearest to the rows of `order`, see
        `nearest_packets`: for who decides by other distances.
        """
        kernel, squares = nearest_packets.bounds_entry(tree.ndim), np.empty(bounded.slots.shape)
        spans = functools.partial(times_of, rows.at, STILL, STILL)
        self.ask(tree, spans, lambda *arrays: kernel(*arrays, rows, bounded, squares))


def _check_finite(rays: MovingRays) -> None:
    checks.finite('origins', rays.origins)
    checks.finite('directions', rays.directions)


def rows_of(table: Any, count: int, rows: Any) -> Any:
    """Some rows of a named tuple of so many; what stands for all, or for none, stays as it is."""
    return type(table)(
        *(
            column[rows] if isinstance(column, np.ndarray) and len(column) == count else column
            for column in table
        )
    )
