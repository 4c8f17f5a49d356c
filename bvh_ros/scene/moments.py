# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions about a scene whose obstacles have velocities, at a time or while it passes."""

from typing import Any

import numpy as np

from ..tree import checks
from ..tree.store.workers import in_threads
from .casting.arguments import Rays, ways_of
from .geometry.shapes import Floats
from .results import NO_NODE, CastHits, SceneHit, require_few
from .store.obstacles import Obstacles
from .store.places import at_rest
from .store.updating import FIRST_TIME, LAST_TIME, column

Way = tuple[Floats, Floats, float]  # origin, direction, radius


class Moments:
    """The world of other times than that of its last update."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held

    def meant(self, at: Any, until: Any, count: int) -> bool:
        """Whether it matters when: a time is asked for, and something moves. ValueError if these
        are no times in ns, `until` not before `at`.
        """
        if at is None:
            if until is not None:
                raise ValueError('until needs at')
            return False
        start = column('at', at, count, LAST_TIME, FIRST_TIME)
        if until is not None:
            early = np.flatnonzero(column('until', until, count, LAST_TIME, FIRST_TIME) < start)
            if len(early):
                raise ValueError(f'until must not be before at: row {early[0]} is')
        return self._held.moves

    def seconds(self, at: Any, count: int) -> Floats:
        """`at` as the tree has it, (count,)."""
        return self._held.seconds(column('at', at, count, LAST_TIME, FIRST_TIME))

    def _times(self, at: Any, until: Any, count: int) -> tuple[Floats, Floats]:
        """(at, pace) in seconds."""
        start = self.seconds(at, count)
        if until is None:
            return start, np.zeros(count)
        stop = self._held.seconds(column('until', until, count, LAST_TIME, FIRST_TIME))
        return start, stop - start

    def first(self, way: Way, mask: int, skip: bool, at: Any, until: Any) -> SceneHit | None:
        """What a ray, or ball, meets first."""
        held, (origin, direction, radius) = self._held, way
        (start,), (pace,) = self._times(at, until, 1)
        if radius > 0.0 or held.columns.shaped or len(at_rest(held, float(start + pace))):
            hits = self.every(way, mask, skip, at, until)
            return hits[0] if hits else None
        ndim = held.tree.ndim
        flat = origin[:ndim], direction[:ndim]
        hit = held.tree.raycast(*flat, 1.0, mask, skip, at=float(start), pace=float(pace))
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

    def _met(self, rays: Rays, radii: Floats, skip: bool, times: tuple[Floats, Floats]) -> Any:
        from .casting.moving import cast_then  # no scene without velocities needs it
        from .casting.seen import Times

        return cast_then(self._held, rays, radii, bool(skip), Times(*times))

    def first_of_many(
        self, rays: Rays, radii: Floats, skip: bool, at: Any, until: Any, threads: int
    ) -> CastHits:
        """What n rays, or balls, meet first."""
        count = len(rays.origins)
        ways_of(rays, radii)  # refuses balls without an end
        hits = CastHits(
            *(np.full(count, NO_NODE, np.uint32), np.full(count, np.inf)),
            *(np.full((count, 3), np.nan), np.zeros((count, 3))),
        )
        columns = *rays, radii, *self._times(at, until, count)

        def work(start: int, stop: int) -> None:
            *some, balls, begin, pace = (column[start:stop] for column in columns)
            met = self._met(Rays(*some), balls, skip, (begin, pace))
            rows, first = np.unique(met.rows, return_index=True)
            rows += start
            hits.handles[rows] = self._held.columns.node_handle[met.slots[first]]
            hits.t[rows], hits.points[rows] = met.ts[first], met.points[first]
            hits.normals[rows] = met.normals[first]

        in_threads(work, count, threads)
        return hits
