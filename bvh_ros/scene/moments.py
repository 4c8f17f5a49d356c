# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions about a scene whose obstacles have velocities, at a time or while it passes."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..tree import checks
from ..tree.access import in_threads
from .cast.arguments import RayRows, Rays, refuse_infinite
from .cast.boxes import segment
from .geometry.shapes import Floats
from .results import CastHits, SceneHit, require_few
from .store.obstacles import EXACT, Obstacles, all_in_seconds, in_seconds
from .store.updating import FIRST_TIME, LAST_TIME, column

if TYPE_CHECKING:
    from .cast.motion import OneWay, Times
    from .distance.timed_batches import TimedDistances

Way = tuple[Floats, Floats, float]  # origin, direction, radius


class Courses(NamedTuple):
    """Modules of `cast`."""

    motion: Any
    motion_batch: Any


class Moments:
    """The world of other times than that of its last update."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._distances: TimedDistances | None = None
        self._one_way: OneWay | None = None
        self._courses: Courses | None = None

    def distances(self) -> 'TimedDistances':
        """Overlaps and distances at other times."""
        if self._distances is None:
            from .distance.timed_batches import (
                TimedDistances,  # no scene without velocities needs it
            )

            self._distances = TimedDistances(self._held)
        return self._distances

    def _courses_then(self) -> 'Courses':
        """What is imported for rays and balls at other times, by name; a statement that imports
        takes half a microsecond each time.
        """
        if self._courses is None:
            from .cast import motion, motion_batch  # no scene without velocities needs it

            self._courses = Courses(motion, motion_batch)
        return self._courses

    def meant(self, at: Any, until: Any, count: int) -> bool:
        """Whether it matters when: a time is asked for, and something moves. ValueError if these
        are no times in ns, `until` not before `at`.
        """
        if at is None:
            if until is not None:
                raise ValueError('until needs at')
            return False
        last = at if until is None else until
        if type(at) is type(last) is int and FIRST_TIME <= at <= last <= LAST_TIME:
            return self._held.moves  # much the most common
        start = column('at', at, rows_needed(at, until, count), LAST_TIME, FIRST_TIME)
        if until is not None:
            stop = column('until', until, len(start), LAST_TIME, FIRST_TIME)
            early = np.flatnonzero(stop < start)
            if len(early):
                raise ValueError(f'until must not be before at: row {early[0]} is')
        return self._held.moves

    def second(self, at: Any) -> float:
        """One of `seconds`."""
        if type(at) is int:
            return self._held.second(at)
        return float(self._held.seconds(column('at', at, 1, LAST_TIME, FIRST_TIME))[0])

    def seconds(self, at: Any, count: int) -> Any:
        """`at` as the tree has it, one in seconds for all or (count,); None if it does not matter.
        ValueError if these are no times in ns.
        """
        held = self._held
        if type(at) is int and FIRST_TIME <= at <= LAST_TIME and held.moves:  # the most common
            since = at - held.epoch
            return since / 1e9 if -EXACT < since < EXACT else held.second(at)
        if (
            type(at) is np.ndarray
            and at.dtype is checks.INT64
            and at.shape == (count,)
            and held.moves
        ):
            return held.seconds(at)
        if not self.meant(at, None, count):
            return None
        return held.seconds(column('at', at, count, LAST_TIME, FIRST_TIME))

    def _times(self, at: Any, until: Any, count: int) -> 'Times':
        """Times in seconds, one for all or (count,)."""
        named = self._courses_then().motion.Times
        if type(at) is int and (until is None or type(until) is int):
            begin, pace = self._way_of_time(at, until)
            return tuple.__new__(named, (np.array([begin]), np.array([pace])))
        rows = rows_needed(at, until, count)
        starts = column('at', at, rows, LAST_TIME, FIRST_TIME)
        start = self._held.seconds(starts)
        if until is None:
            return named(start, np.zeros(rows))
        stops = column('until', until, rows, LAST_TIME, FIRST_TIME).astype(np.longdouble)
        return named(start, all_in_seconds(stops - starts))

    def _way_of_time(self, at: Any, until: Any) -> tuple[float, float]:
        """`_times` of one way."""
        if type(at) is int and (until is None or type(until) is int):
            held = self._held
            begin, end = at - held.epoch, (at if until is None else until) - held.epoch
            if -EXACT < begin <= end < EXACT:  # `held.second`, of which two calls take as long
                start = begin / 1e9
                return start, (end - begin) / 1e9
            start = held.second(at)
            return start, 0.0 if until is None else in_seconds(until - at)
        (start,), (pace,) = (column.tolist() for column in self._times(at, until, 1))
        return start, pace

    def first(
        self, asked: tuple[Any, Any, Any], mask: int, skip: bool, at: Any, until: Any
    ) -> SceneHit | None:
        """What a ray, or ball, meets first; asked = (start, goal, radius)."""
        (start, goal, radius), held, skip = asked, self._held, bool(skip)
        when = self._way_of_time(at, until)
        if self._one_way is None:
            from .cast.motion import OneWay  # no scene without velocities needs it

            self._one_way = OneWay(held)
        thick = checks.limit('radius', radius) > 0.0
        if held.columns.shaped or held.uncertainty or thick:
            hit = self._one_way.first_shape(segment(*asked), checks.mask(mask), skip, when)
        else:
            ends = checks.vector('start', start, 3), checks.vector('goal', goal, 3)
            hit = self._one_way.first_box(*ends, checks.mask(mask), skip, when)
        return None if hit is None else held.hit(*hit)

    def every(
        self, way: Way, mask: int, skip: bool, at: Any, until: Any, most: int | None = None
    ) -> list[SceneHit]:
        """What a ray, or ball, meets, in order."""
        origin, direction, radius = way
        masks = np.full(1, checks.mask(mask))
        rays = RayRows(origin[None], direction[None], np.ones(1), masks)
        times = self._times(at, until, 1)
        met = self._courses_then().motion_batch.cast_then(
            self._held, rays, np.full(1, radius), bool(skip), times
        )
        require_few(len(met.slots), most)
        columns = met.slots.tolist(), met.ts.tolist(), met.points, met.normals
        hits = [self._held.hit(*row) for row in zip(*columns, strict=True)]
        return self._held.each_once(hits)

    def few(self, given: Rays, at: Any, until: Any) -> Any:
        """`first_of_many` with as little Python as can be, in a solid scene; else None, as where
        at and until are not the most common, or `moving_boxes.few_first` says so.
        """
        rays, skip, to_goals = given[:4], given.skip_inside, given.to_goals
        radii = checks.NOTHING if given.radii is None else given.radii
        held, last, t_max = self._held, at if until is None else until, rays[2]
        tree: Any = held.tree
        if held.planar or held.uncertainty or not held.moves:
            return None
        if not len(t_max) or tree._storage.heirs:
            return None
        courses = self._courses or self._courses_then()
        if type(at) is type(last) is int:
            if not FIRST_TIME <= at <= last <= LAST_TIME:
                return None
            begin, end = at - held.epoch, last - held.epoch
            if not -EXACT < begin <= end < EXACT:
                return None
            start = begin / 1e9  # as `_way_of_time`
            pace = (end - begin) / 1e9
            limit = t_max.item() if len(t_max) == 1 else t_max.max().item()
            when, stop = (start, pace), start if pace == 0.0 else start + limit * pace
        else:
            when, start, stop = self._times_of_rows(at, last, t_max, len(rays[0]))
            if when is None:
                return None
        shaped = held.columns.shaped or (radii is not checks.NOTHING and is_any(radii))
        sweep = None if shaped else tree._motion.few_sweep(len(rays[0]))
        if sweep is None:
            sweep = tree._motion.ready_sweep(tree._storage.tree, len(rays[0]), start, stop)
            if sweep is None:
                return None
        if shaped:
            return courses.motion_batch.few_then(held, sweep, rays, radii, skip, when, to_goals)
        return courses.motion_batch.few_first(held, sweep, rays, skip, when, to_goals)

    def _times_of_rows(
        self, at: Any, until: Any, t_max: Floats, count: int
    ) -> tuple[Any, float, float]:
        """`_times` of arrays of integers of 64 bits, or one of them and a number: (times, the
        first, the last); times None where they are something else, or far apart.
        """
        epoch, rows = self._held.epoch, []
        within = max(epoch - EXACT + 1, FIRST_TIME), min(epoch + EXACT - 1, LAST_TIME)
        for told in (at, until):
            if type(told) is int and FIRST_TIME <= told <= LAST_TIME:
                rows.append(np.array([told]))
            elif (
                type(told) is np.ndarray
                and told.dtype is checks.INT64
                and told.shape == (count,)
                and told.flags.carray
            ):
                rows.append(told)
            else:
                return None, 0.0, 0.0
        starts, paces = np.empty(count), np.empty(count)
        fill = self._courses_then().motion.times_entry()
        fits, first, last = fill(*rows, t_max, epoch, within, starts, paces)
        return (starts, paces) if fits else None, first, last

    def first_of_many(self, given: Rays, when: tuple[Any, Any], threads: int) -> CastHits:
        """What n rays, or balls, meet first; when = (at, until)."""
        held, skip, radii = self._held, given.skip_inside, given.radii
        radii, thick = (checks.NOTHING, False) if radii is None else (radii, True)
        count, times = len(given.origins), self._times(*when, len(given.origins))
        if thick or given.to_goals or held.planar or held.columns.shaped or held.uncertainty:
            refuse_infinite(given)  # else a kernel looks
        directions = given.directions - given.origins if given.to_goals else given.directions
        rays = RayRows(given.origins, directions, given.t_max, given.masks)
        batch = self._courses_then().motion_batch
        if not (held.columns.shaped or held.uncertainty or thick):
            return batch.first_boxes(held, rays, skip, times, threads)
        sweep = batch.sweep_for(held, rays, times)

        def first(some: RayRows, balls: Floats, when: 'Times') -> CastHits:
            asked = held, sweep, some, balls, bool(skip), when
            hits, handles, points, normals = batch.first_then(*asked)
            return tuple.__new__(CastHits, (handles, hits.ts, points, normals))

        if threads == 1:
            return first(rays, radii, times)
        columns = *rays, radii, *times

        def work(start: int, stop: int) -> CastHits:
            *some, balls, begin, pace = (
                one[start:stop] if len(one) == count else one for one in columns
            )
            return first(RayRows(*some), balls, times._replace(at=begin, pace=pace))

        parts = in_threads(work, count, threads)
        if len(parts) == 1:
            return parts[0]
        return CastHits(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def rows_needed(at: Any, until: Any, count: int) -> int:
    """How many rows say when: 1 where one time is for all."""
    return 1 if type(at) is int and (until is None or type(until) is int) else count


def is_any(radii: Floats) -> bool:
    """Whether one is not 0."""
    return bool(radii.item(0) if len(radii) == 1 else radii.any())
