# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Queries about a scene whose obstacles have velocities, at a time or while it passes.

What they need is imported with the first of them: no scene without velocities needs it.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..tree.access import FIRST_TIME, LAST_TIME, checks
from .cast.arguments import BoxHit, Rays, Sweep
from .results import CastHits
from .rows import column
from .shapes.shape import Floats
from .store import EXACT, Obstacles, all_in_seconds, in_seconds

if TYPE_CHECKING:
    from .cast.motion_batch import Times
    from .distance.moving import TimedDistances


class CastModules(NamedTuple):
    """Modules of `cast` for other times, by name: an import statement takes half a microsecond."""

    motion: Any
    motion_batch: Any


class TimedQueries:
    """The world at other times than that of its last update."""

    def __init__(self, store: Obstacles) -> None:
        self._store = store
        self._distances: TimedDistances | None = None
        self._modules: CastModules | None = None

    def distances(self) -> 'TimedDistances':
        """Overlaps and distances at other times."""
        if self._distances is None:
            from .distance.moving import TimedDistances

            self._distances = TimedDistances(self._store)
        return self._distances

    def _cast(self) -> CastModules:
        """Rays and balls at other times."""
        if self._modules is None:
            from .cast import motion, motion_batch

            self._modules = CastModules(motion, motion_batch)
        return self._modules

    # ---- times

    def time_matters(self, at: Any, until: Any, count: int) -> bool:
        """Whether time can change the answer: a time is given, and something moves. ValueError
        if these are no times in ns, `until` not before `at`.
        """
        if at is None:
            if until is not None:
                raise ValueError('until needs at')
            return False
        last = at if until is None else until
        if type(at) is type(last) is int and FIRST_TIME <= at <= last <= LAST_TIME:
            return self._store.moves  # much the most common
        start = column('at', at, rows_needed(at, until, count), LAST_TIME, FIRST_TIME)
        if until is not None:
            stop = column('until', until, len(start), LAST_TIME, FIRST_TIME)
            early = np.flatnonzero(stop < start)
            if len(early):
                raise ValueError(f'until must not be before at: row {early[0]} is')
        return self._store.moves

    def second(self, at: Any) -> float:
        """One of `seconds`."""
        if type(at) is int:
            return self._store.second(at)
        return float(self._store.seconds(column('at', at, 1, LAST_TIME, FIRST_TIME))[0])

    def seconds(self, at: Any, count: int) -> Any:
        """`at` as the tree has it, one in seconds for all or (count,); None if it does not matter.
        ValueError if these are no times in ns.
        """
        store = self._store
        if type(at) is int and FIRST_TIME <= at <= LAST_TIME and store.moves:  # the most common
            since = at - store.epoch
            return since / 1e9 if -EXACT < since < EXACT else store.second(at)
        if (
            type(at) is np.ndarray
            and at.dtype is checks.INT64
            and at.shape == (count,)
            and store.moves
        ):
            return store.seconds(at)
        if not self.time_matters(at, None, count):
            return None
        return store.seconds(column('at', at, count, LAST_TIME, FIRST_TIME))

    def spans(self, at: Any, until: Any, count: int) -> tuple[Floats, Floats] | None:
        """When n ways start, s, and how many seconds pass a unit of t, one for all or (n,); None
        if it does not matter. ValueError as of `time_matters`.
        """
        if not self.time_matters(at, until, count):
            return None
        return self._columns(at, until, count)

    def _when(self, at: Any, until: Any) -> tuple[float, float]:
        """When one ray starts, s, and how many seconds pass a unit of t."""
        store, last = self._store, at if until is None else until
        if not type(at) is type(last) is int:
            (start,), (pace,) = (rows.tolist() for rows in self._columns(at, until, 1))
            return start, pace
        begin, end = at - store.epoch, last - store.epoch
        if -EXACT < begin <= end < EXACT:  # as `store.second`, of which two calls take as long
            return begin / 1e9, (end - begin) / 1e9
        return store.second(at), in_seconds(last - at)

    def _columns(self, at: Any, until: Any, count: int) -> tuple[Floats, Floats]:
        """When rays start, s, and how many seconds pass a unit of t: one for all or (count,)."""
        rows = rows_needed(at, until, count)
        starts = column('at', at, rows, LAST_TIME, FIRST_TIME)
        if until is None:
            return self._store.seconds(starts), np.zeros(rows)
        stops = column('until', until, rows, LAST_TIME, FIRST_TIME).astype(np.longdouble)
        return self._store.seconds(starts), all_in_seconds(stops - starts)

    def _times(self, at: Any, until: Any, t_max: Floats, count: int) -> 'Times':
        """The times of rays that end at t_max."""
        batch = (self._modules or self._cast())[1]
        if type(at) is int and (until is None or type(until) is int):
            start, pace = self._when(at, until)
            limit = t_max.item() if len(t_max) == 1 else t_max.max(initial=0.0).item()
            stop = start if pace == 0.0 else start + limit * pace
            bounded = -batch.LONGEST < start <= stop < batch.LONGEST
            return tuple.__new__(batch.Times, (start, pace, start, stop, bounded))
        epoch, last = self._store.epoch, at if until is None else until
        within = max(epoch - EXACT + 1, FIRST_TIME), min(epoch + EXACT - 1, LAST_TIME)
        rows = [whole_rows(at, count), whole_rows(last, count)]
        if rows[0] is not None and rows[1] is not None:
            starts, paces = np.empty(count), np.empty(count)
            fits, first, end = batch.times_entry()(*rows, t_max, epoch, within, starts, paces)
            if fits:
                return tuple.__new__(batch.Times, (starts, paces, first, end, True))
        starts, paces = self._columns(at, until, count)
        (first, end), bounded = batch.times_of(starts, paces, t_max)
        return tuple.__new__(batch.Times, (starts, paces, first, end, bounded))

    def _span(self, at: Any, until: Any) -> tuple[float, float]:
        """First and last time of rows, s."""
        times = self._times(at, until, np.ones(1), len(at))
        return times.first, times.last

    def is_prepared(self, at: Any, until: Any) -> bool:
        """Whether all is there that questions about these times, (n,) arrays, need."""
        motion = self._store.tree.motion
        if motion is None or not self._store.moves:
            return True
        return motion.holds(self._store.tree.view().version, *self._span(at, until))

    def prepare(self, count: int, at: Any, until: Any) -> None:
        """Prepare what n rows about these times need; `count` of them are rays."""
        motion = self._store.tree.motion
        if motion is not None and self._store.moves:
            motion.prepare(self._store.tree, count, *self._span(at, until))

    def refit(self) -> None:
        """Prepare questions about the time from the newest data on, if some came before."""
        motion = self._store.tree.motion
        if motion is not None and self._store.moves:
            motion.refit(self._store.tree, self._store.second(self._store.newest))

    # ---- rays and balls

    def first_ray(
        self, ends: tuple[Floats, Floats], ball: tuple[float, np.uint32, bool], at: Any, until: Any
    ) -> BoxHit | None:
        """The first hit of a ray or ball, as `cast.motion.first_of_one`."""
        motion = (self._modules or self._cast()).motion
        found: BoxHit | None = motion.first_of_one(self._store, ends, ball, self._when(at, until))
        return found

    def every_ray(
        self, sweep: Sweep, at: Any, until: Any, most: int | None = None
    ) -> Iterable[BoxHit]:
        """All hits of a ray or ball, in order."""
        when = self._when(at, until)
        found: Iterable[BoxHit] = self._cast().motion.cast_every(self._store, sweep, when, most)
        return found

    def first_rays(self, rays: Rays, at: Any, until: Any, threads: int) -> CastHits:
        """First hits of n rays, or balls."""
        times, batch = self._times(at, until, rays.t_max, len(rays.origins)), self._cast()[1]
        hits: CastHits = batch.first_hits(self._store, rays, times, threads)
        return hits


def whole_rows(times: Any, count: int) -> Any:
    """Times as an array for a kernel, if they are the most common: integers of 64 bits in an
    array, or one number; else None.
    """
    if type(times) is int and FIRST_TIME <= times <= LAST_TIME:
        return np.array([times])
    if (
        type(times) is np.ndarray
        and times.dtype is checks.INT64
        and times.shape == (count,)
        and times.flags.carray
    ):
        return times
    return None


def rows_needed(at: Any, until: Any, count: int) -> int:
    """How many rows times have: 1 where one time is for all."""
    return 1 if type(at) is int and (until is None or type(until) is int) else count
