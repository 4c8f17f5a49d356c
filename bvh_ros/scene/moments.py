# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions about a scene whose obstacles have velocities, at a time or while it passes."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ..tree import checks
from ..tree.store.workers import in_threads
from .casting.arguments import Rays, every_row, row_by_row, ways_of
from .geometry.shapes import Floats
from .results import NO_NODE, CastHits, SceneHit, require_few
from .store.obstacles import Obstacles
from .store.places import at_rest
from .store.updating import FIRST_TIME, LAST_TIME, column

if TYPE_CHECKING:
    from .casting.seen import Times
    from .distance.timed import TimedDistances

Way = tuple[Floats, Floats, float]  # origin, direction, radius


class Moments:
    """The world of other times than that of its last update."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._distances: TimedDistances | None = None

    def distances(self) -> 'TimedDistances':
        """Overlaps and distances at other times."""
        if self._distances is None:
            from .distance.timed import TimedDistances  # no scene without velocities needs it

            self._distances = TimedDistances(self._held)
        return self._distances

    def meant(self, at: Any, until: Any, count: int) -> bool:
        """Whether it matters when: a time is asked for, and something moves. ValueError if these
        are no times in ns, `until` not before `at`.
        """
        if at is None:
            if until is not None:
                raise ValueError('until needs at')
            return False
        start = column('at', at, rows_needed(at, until, count), LAST_TIME, FIRST_TIME)
        if until is not None:
            stop = column('until', until, len(start), LAST_TIME, FIRST_TIME)
            early = np.flatnonzero(stop < start)
            if len(early):
                raise ValueError(f'until must not be before at: row {early[0]} is')
        return self._held.moves

    def seconds(self, at: Any, count: int) -> Floats:
        """`at` as the tree has it, (count,)."""
        return self._held.seconds(column('at', at, count, LAST_TIME, FIRST_TIME))

    def _times(self, at: Any, until: Any, count: int) -> 'Times':
        """Times in seconds, one for all or (count,)."""
        from .casting.seen import Times  # no scene without velocities needs it

        rows = rows_needed(at, until, count)
        start = self.seconds(at, rows)
        if until is None:
            return Times(start, np.zeros(rows))
        stop = self._held.seconds(column('until', until, rows, LAST_TIME, FIRST_TIME))
        return Times(start, stop - start)

    def _tree_knows(self, rays: Rays, radii: Floats, times: 'Times') -> bool:
        """Whether the tree alone decides: boxes and thin rays, while nobody rests or grows."""
        held = self._held
        if held.columns.shaped or held.uncertainty or radii.any():
            return False
        return not len(at_rest(held, times.last(rays.t_max)))

    def first(self, way: Way, mask: int, skip: bool, at: Any, until: Any) -> SceneHit | None:
        """What a ray, or ball, meets first."""
        held, (origin, direction, radius) = self._held, way
        (start,), (pace,) = (column.tolist() for column in self._times(at, until, 1))
        looks = held.columns.shaped or held.uncertainty or radius > 0.0
        if looks or len(at_rest(held, start + pace)):
            hits = self.every(way, mask, skip, at, until)
            return hits[0] if hits else None
        ndim = held.tree.ndim
        flat = origin[:ndim], direction[:ndim]
        hit = held.tree.raycast(*flat, 1.0, mask, skip, at=start, pace=pace)
        if hit is None:
            return None
        place = np.zeros((2, 3))
        place[0, 2], place[0, :ndim], place[1, :ndim] = origin[2], hit.point, hit.normal
        return held.hit(held.tree.slot(hit.id), hit.t, place[0], place[1])

    def every(
        self, way: Way, mask: int, skip: bool, at: Any, until: Any, most: int | None = None
    ) -> list[SceneHit]:
        """What a ray, or ball, meets, in order."""
        origin, direction, radius = way
        masks = np.full(1, checks.mask(mask))
        rays = Rays(origin[None], direction[None], np.ones(1), masks)
        met = self._met(rays, np.full(1, radius), skip, self._times(at, until, 1))
        require_few(len(met.slots), most)
        columns = met.slots.tolist(), met.ts.tolist(), met.points, met.normals
        hits = [self._held.hit(*row) for row in zip(*columns, strict=True)]
        return self._held.each_once(hits)

    def _met(self, rays: Rays, radii: Floats, skip: bool, times: 'Times') -> Any:
        from .casting.moving import cast_then  # no scene without velocities needs it

        return cast_then(self._held, rays, radii, bool(skip), times)

    def first_of_many(
        self, rays: Rays, radii: Floats, skip: bool, when: tuple[Any, Any], threads: int
    ) -> CastHits:
        """What n rays, or balls, meet first; when = (at, until)."""
        count, times = len(rays.origins), self._times(*when, len(rays.origins))
        ways_of(rays, radii)  # refuses balls without an end
        if self._tree_knows(rays, radii, times):
            from .casting.moving import first_boxes

            return first_boxes(self._held, rays, skip, times, threads)
        rays = row_by_row(rays)
        hits = CastHits(
            *(np.full(count, NO_NODE, np.uint32), np.full(count, np.inf)),
            *(np.full((count, 3), np.nan), np.zeros((count, 3))),
        )
        columns = *rays, *(every_row(one, count) for one in (radii, *times))

        def work(start: int, stop: int) -> None:
            *some, balls, begin, pace = (column[start:stop] for column in columns)
            met = self._met(Rays(*some), balls, skip, times._replace(at=begin, pace=pace))
            rows, first = np.unique(met.rows, return_index=True)
            rows += start
            hits.handles[rows] = self._held.columns.node_handle[met.slots[first]]
            hits.t[rows], hits.points[rows] = met.ts[first], met.points[first]
            hits.normals[rows] = met.normals[first]

        in_threads(work, count, threads)
        return hits


def rows_needed(at: Any, until: Any, count: int) -> int:
    """How many rows say when: 1 where one time is for all."""
    return 1 if type(at) is int and (until is None or type(until) is int) else count
