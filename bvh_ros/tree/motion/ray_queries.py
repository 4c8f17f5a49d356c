# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays and swept boxes meet in a tree whose boxes move. Arguments are those of the tree's
methods of the same names, which hand them on.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import checks, time_checks
from ..checks import INT64
from ..nodes import NONE, Tree, View
from ..rays import ray_batches
from ..rays.ray_batches import rows_of
from ..rays.raycasting import ANY, CLOSEST, EVERY, Found, more_room, room_for_hits
from ..results import RayHits
from ..store.turns import NOT_FINITE, accepted
from ..store.workers import in_threads
from ..wide.ray_streams import RAYS_AT_ONCE
from . import casting, wide_casting
from .asked_then import AS_ARRAYS, NO_TIMES, RaysThen
from .casting import Casts, Places
from .few_casting import few_entry
from .motion import Motion
from .spans import both_times, span_of, times_of
from .sweeping import Sweep
from .wide_casting import UNSUITED

FEW_HITS = 64  # are sorted as they are described, one by one

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]


class MotionRays(Motion):
    """What rays and boxes meet on their ways."""

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
        kernel, moving = casting.one_entry(tree._ndim), self.moving if pace else self.bounds
        handle, t = kernel(tree._settled().tree, moving, swept, asked, times, place)
        while handle < NONE and handle != NOT_FINITE:
            span = span_of(at, pace, asked[0])
            moving = self.others(tree, moving, handle, span, pace == 0.0)
            handle, t = kernel(tree._settled().tree, moving, swept, asked, times, place)
        if handle == NOT_FINITE:
            time_checks.moments('at', at, None)
            time_checks.moments('pace', pace, None)
        return handle, t

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

            done, wanted = self.ask(tree, spans, call, not casts.pace.any())
            if done < count:
                found = more_room(found, wanted)
        total = offsets.item(-1)
        found = Found(found.slots[:total], found.ts[:total], found.axes[:total])
        if casts.mode == EVERY and total > FEW_HITS:  # else there is one a row, or they are sorted
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
        skip: bool,
        mode: int,
        times: tuple[Any, Any],
        threads: int,
    ) -> RayHits:
        """`raycast_many` of rays = (origins, directions, t_max, masks), and `occluded_many`, of
        which the ids tell it.
        """
        count, ndim, (at, pace) = len(rays[0]), tree._ndim, times
        if threads == 1 and type(at) is type(pace) is float and not tree._storage.heirs:
            # What is ready is looked for before anything is made: of few rays, that is most.
            hits = self._alike(tree, rays, skip, mode, times)
            if hits is not None:
                return hits
        when = time_checks.times('at', at, count), time_checks.times('pace', pace, count)
        span, every = times_of(*when, rays[2])
        if not every:
            when = both_times(times, count)
        asked = RaysThen(*rays, skip, mode, *when, AS_ARRAYS)
        if threads == 1 and every and count and not tree._storage.heirs:
            hits = self._ready(tree, asked, *span)
            if hits is not None:
                return hits
        view, hits = tree.view(), ray_batches.room_for(count, ndim, mode)
        sweep = self.swept_for(tree, view, count, span) if every and count else None
        self.answer(tree, (view, sweep), asked, hits, threads, wide_casting.cast)
        return hits

    def _alike(
        self,
        tree: Any,
        rays: tuple[Floats, Floats, Floats, Any],
        skip: bool,
        mode: int,
        when: tuple[float, float],
    ) -> Any:
        """Hits of rays that all go at the same time, through what is swept already; None where
        nothing is.
        """
        count, ndim, (at, pace), t_max = len(rays[0]), tree._ndim, when, rays[2]
        sweep = self.few_sweep(count)
        if sweep is None:
            if not len(t_max):
                return None
            limit = t_max.item() if len(t_max) == 1 else t_max.max().item()
            last = at if pace == 0.0 else at + limit * pace
            asked = RaysThen(*rays, skip, mode, NO_TIMES, NO_TIMES, when)
            return self._ready(tree, asked, at, last)
        if mode != CLOSEST:
            hits = ray_batches.room_for(count, ndim, mode)
        else:  # as RayHits(...), which would take one more call of a function of Python's
            parts = np.empty(count, INT64), np.empty(count), np.empty((count, ndim))
            hits = tuple.__new__(RayHits, parts)
        done = few_entry(ndim)(tree._storage.tree, sweep, rays, skip, mode, when, hits)
        if done > 0:
            asked = RaysThen(*rays, skip, mode, NO_TIMES, NO_TIMES, when)
            self._tell_unsuited(tree, asked, hits)
        return hits if done >= 0 else None

    def _ready(self, tree: Any, asked: RaysThen, first: float, last: float) -> Any:
        """Hits of rays from a time to another, through what is swept already; None where nothing
        is.
        """
        count, arrays = len(asked.origins), tree._storage.tree
        sweep = self.ready_sweep(arrays, count, first, last)
        if sweep is None:
            return None
        hits = ray_batches.room_for(count, tree._ndim, asked.mode)
        done = wide_casting.cast(arrays, sweep, asked, hits)
        if done > 0:
            self._tell_unsuited(tree, asked, hits)
        return hits if done >= 0 else None

    def answer(
        self,
        tree: Any,
        seen: tuple[View, Sweep | None],
        asked: RaysThen,
        hits: Any,
        threads: int,
        cast: Callable[[Tree, Sweep, RaysThen, Any], int],
    ) -> bool:
        """Fill in the first hits of rays, a `RayHits` or what has more columns. `cast` is called
        as `wide_casting.cast` of some, where there is a sweep; whether it has told all.
        """
        count, (view, sweep) = len(asked.origins), seen
        if sweep is None:
            _check_finite(asked)

        def work(start: int, stop: int) -> int:
            part, into = asked, hits
            if stop - start < count:
                part, into = (rows_of(rows, count, slice(start, stop)) for rows in (asked, hits))
            if sweep is not None:
                return accepted(cast(view.tree, sweep, part, into))
            self._one_by_one(tree, part, into)
            return 0

        unsuited = in_threads(work, count, threads, 1 if sweep is None else 2 * RAYS_AT_ONCE)
        if any(unsuited):
            self._tell_unsuited(tree, asked, hits)
        return sweep is not None and not any(unsuited)

    def _tell_unsuited(self, tree: Any, rays: RaysThen, hits: Any) -> None:
        """Answer those rays that are UNSUITED."""
        if not len(rays.at):
            rays = rays._replace(at=np.array(rays.when[:1]), pace=np.array(rays.when[1:]))
        count, others = len(rays.origins), np.flatnonzero(hits.ids == UNSUITED)
        _check_finite(rays)
        some = rows_of(hits, count, others)
        self._one_by_one(tree, rows_of(rays, count, others), some)
        for column, part in zip(hits, some, strict=True):
            column[others[: len(part)]] = part

    def _one_by_one(self, tree: Any, rays: RaysThen, hits: Any) -> None:
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


def _check_finite(rays: RaysThen) -> None:
    checks.finite('origins', rays.origins)
    checks.finite('directions', rays.directions)
