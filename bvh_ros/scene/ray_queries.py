# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays and swept balls meet in a scene. Each method checks its input and asks a kernel."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..tree import checks
from ..tree.nodes import ALL
from ..tree.store.workers import in_threads
from .casting import ball_casting, box_casting, casting, sweeping
from .casting.arguments import Found, Rays, radii_of, ways_of
from .casting.sweeping import Balls
from .geometry.shapes import Floats, along_axes
from .moments import Moments
from .results import NO_NODE, CastHits, SceneHit, require_few
from .store.obstacles import Obstacles


class RayQueries:
    """What rays meet. Any number of threads may ask while none changes the scene."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._moments = Moments(held)

    def raycast(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        radius: float = 0.0,
        mask: int = ALL,
        skip_inside: bool = False,
        at: int | None = None,
        until: int | None = None,
    ) -> SceneHit | None:
        """Return the first obstacle on the way from start to goal.

        Parameters
        ----------
        start, goal : array_like, shape (3,)
            Ends of the segment, m. If they are equal, the point (the ball) at `start` is asked
            for.
        radius : float
            Of a ball swept along the segment, m; 0 is a thin ray.
        mask : int
            Only obstacles with ``categories & mask != 0`` are seen.
        skip_inside : bool
            Ignore obstacles that the point or ball touches at the start.
        at, until : int, optional
            ns: the segment is left at `at`, and reached at `until`, while obstacles with
            velocities move; without `until`, the world is frozen at that time. None: it is as
            last told.

        Returns
        -------
        SceneHit or None
            `t` is where the ray's point or the ball's centre is between start (0) and goal (1).
            `point` lies on the obstacle, `normal` leads from there to the ball's centre. An
            obstacle that contains the start is met at ``t = 0`` with a zero normal; the normal is
            zero as well where the ball's centre is no farther from the obstacle than rounding.
            Among axis-aligned boxes it is decided exactly whether a ray or a ball touches, and
            which obstacle is first; other shapes touch too where that cannot be told apart, see
            `frame`. Ties go to the smaller handle.

        Raises
        ------
        ValueError
            If an argument is NaN, infinite, negative (`radius`) or of the wrong shape.
        """
        if self._moments.meant(at, until, 1):
            asked = self._segment(start, goal, radius), mask, skip_inside
            return self._moments.first(*asked, at, until)
        held, radius = self._held, checks.limit('radius', radius)
        if radius == 0.0 and not held.columns.shaped:
            start, goal = checks.vector('start', start, 3), checks.vector('goal', goal, 3)
            hit = box_casting.first(held.tree, start, goal, checks.mask(mask), bool(skip_inside))
            return None if hit is None else held.hit(*hit)
        origin, direction, radius = self._segment(start, goal, radius)
        hits = self._cast_one(origin, direction, radius, mask, skip_inside, False)
        return hits[0] if hits else None

    def raycast_all(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        radius: float = 0.0,
        mask: int = ALL,
        skip_inside: bool = False,
        most: int | None = None,
        at: int | None = None,
        until: int | None = None,
    ) -> list[SceneHit]:
        """Return all obstacles on the way, nearest first, ties by handle.

        Arguments as `raycast`. TooManyHitsError, a ValueError, if there are more than `most`: an
        answer is never cut short. For a ball that counts what it may touch, before the last digit
        is looked at.
        """
        origin, direction, radius = self._segment(start, goal, radius)
        if self._moments.meant(at, until, 1):
            way = origin, direction, radius
            return self._moments.every(way, mask, skip_inside, at, until, most)
        if radius == 0.0 and not self._held.columns.shaped:
            hits = box_casting.every(
                self._held.tree, origin, direction, checks.mask(mask), bool(skip_inside), most
            )
            return self._held.each_once([self._held.hit(*hit) for hit in hits])
        return self._held.each_once(
            self._cast_one(origin, direction, radius, mask, skip_inside, True, most)
        )

    def raycast_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        threads: int = 1,
        radius: ArrayLike | None = None,
        at: ArrayLike | None = None,
        until: ArrayLike | None = None,
    ) -> CastHits:
        """First obstacles on n rays ``origin + t * direction``, ``0 <= t <= t_max``.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
        t_max, mask : one for all rays, or array_like of shape (n,)

        threads : int
            The rays are shared among so many threads; the answer does not depend on it.
        radius : one for all rays, or array_like of shape (n,), optional
            Of balls that go along them, m. Where it is above zero the way has to end.
        at, until : one for all rays, or array_like of shape (n,), optional
            As in `raycast`; `until` is when t is 1.

        Returns
        -------
        CastHits
            `t` in units of the directions.
        """
        origins = checks.points('origins', origins, 3)
        directions = checks.points('directions', directions, 3, len(origins))
        limits, masks = (
            checks.limits('t_max', t_max, len(origins)),
            checks.masks(mask, len(origins)),
        )
        skip, threads = bool(skip_inside), checks.whole('threads', threads, 1)
        rays = Rays(origins, directions, limits, masks)
        if self._moments.meant(at, until, len(origins)):
            radii = radii_of(0.0 if radius is None else radius, len(origins))
            return self._moments.first_of_many(rays, radii, skip, at, until, threads)
        if radius is None:
            return self._first_of_many(rays, skip, threads)
        return self._balls(rays, radii_of(radius, len(origins)), skip, threads)

    def sweep_many(
        self,
        starts: ArrayLike,
        goals: ArrayLike,
        radius: ArrayLike = 0.0,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        threads: int = 1,
        at: ArrayLike | None = None,
        until: ArrayLike | None = None,
    ) -> CastHits:
        """First obstacles on the ways of n balls; a row is what `raycast` says.

        Parameters
        ----------
        starts, goals : array_like, shape (n, 3)
            Ends of the segments, m.
        radius, mask : one for all balls, or array_like of shape (n,)
            As in `raycast`.
        skip_inside : bool
            Ignore obstacles that a ball touches at its start.
        threads : int
            The balls are shared among so many threads; the answer does not depend on it.
        at, until : one for all balls, or array_like of shape (n,), optional
            As in `raycast`.

        Raises
        ------
        ValueError
            As `raycast`; the message names the first bad row.
        """
        origins = checks.points('starts', starts, 3)
        count, skip = len(origins), bool(skip_inside)
        with np.errstate(over='ignore'):
            directions = checks.points('goals', goals, 3, count) - origins
        far = np.flatnonzero(~np.isfinite(directions).all(axis=1))
        if len(far):
            raise ValueError(f'the segment of row {far[0]} is longer than the largest double')
        rays = Rays(origins, directions, np.ones(count), checks.masks(mask, count))
        threads, radii = checks.whole('threads', threads, 1), radii_of(radius, count)
        if self._moments.meant(at, until, count):
            return self._moments.first_of_many(rays, radii, skip, at, until, threads)
        return self._balls(rays, radii, skip, threads)

    def _balls(self, rays: Rays, radii: Floats, skip: bool, threads: int) -> CastHits:
        """First hits of balls that go along rays, and of those that are thin."""
        thin, thick = np.flatnonzero(radii == 0.0), np.flatnonzero(radii > 0.0)
        thin_rays, others = (Rays(*(rows[part] for rows in rays)) for part in (thin, thick))
        if not len(thick):
            return self._first_of_many(rays, skip, threads)
        ways = ways_of(rays, radii)[thick]
        balls = Balls(others.origins, ways, radii[thick], others.masks)
        found = sweeping.first_of_many(self._held.tree, self._held.columns, balls, skip, threads)
        met = found.handles != NO_NODE
        found.t[met] *= others.t_max[met]
        if not len(thin):
            return found
        order = np.argsort(np.concatenate((thin, thick)))
        both: Any = zip(self._first_of_many(thin_rays, skip, threads), found, strict=True)
        return CastHits(*(np.concatenate(columns)[order] for columns in both))

    def _first_of_many(self, rays: Rays, skip_inside: bool, threads: int) -> CastHits:
        """First hits of thin rays."""
        held, count = self._held, len(rays.origins)
        if not held.columns.shaped:
            handles = held.columns.node_handle
            return box_casting.first_of_many(held.tree, handles, rays, skip_inside, threads)
        hits = CastHits(
            *(np.full(count, NO_NODE, np.uint32), np.full(count, np.inf)),
            *(np.full((count, 3), np.nan), np.zeros((count, 3))),
        )

        def work(start: int, stop: int) -> None:
            found = self._cast(Rays(*(rows[start:stop] for rows in rays)), skip_inside, False)
            rows = start + np.flatnonzero(np.diff(found.offsets))
            hits.handles[rows] = held.columns.node_handle[found.hits.slots]
            hits.t[rows], hits.points[rows] = found.hits.ts, found.points
            hits.normals[rows] = found.normals
            if held.planar:
                hits.points[rows, 2] = rays.origins[rows, 2]

        in_threads(work, count, threads)
        return hits

    def _segment(
        self, start: ArrayLike, goal: ArrayLike, radius: float
    ) -> tuple[Floats, Floats, float]:
        radius = checks.limit('radius', radius)
        if math.isinf(radius):
            raise ValueError('radius must be finite')
        origin, end = checks.vector('start', start, 3), checks.vector('goal', goal, 3)
        # Three numbers: Python's own arithmetic takes a fifth of the time of numpy's.
        (x, y, z), (u, v, w) = origin.tolist(), end.tolist()
        way = u - x, v - y, w - z
        if not math.isfinite(way[0] * 0.0 + way[1] * 0.0 + way[2] * 0.0):  # each of them is
            raise box_casting.too_long(origin, end)
        return origin, np.array(way), radius

    def _cast(self, rays: Rays, skip_inside: bool, every: bool) -> Found:
        """Thin rays against the true shapes."""
        held = self._held
        origins, directions = (along_axes(rows, held.tree.ndim) for rows in rays[:2])
        flat = Rays(origins, directions, rays.t_max, rays.masks)
        return casting.cast_all(held.tree, held.columns, flat, skip_inside, every)

    def _cast_one(
        self,
        origin: Floats,
        direction: Floats,
        radius: float,
        mask: int,
        skip_inside: bool,
        every: bool,
        most: int | None = None,
    ) -> list[SceneHit]:
        held, skip = self._held, bool(skip_inside)
        if radius > 0.0:
            asked = ball_casting.Sweep(origin, direction, radius, checks.mask(mask), skip, every)
            rows = ball_casting.cast_ball(held.tree, held.columns, asked, most)
        else:
            masks = np.full(1, checks.mask(mask))
            rays = Rays(origin[None], direction[None], np.ones(1), masks)
            found = self._cast(rays, skip, every)
            hits, points, normals = found.hits, found.points, found.normals
            require_few(len(points), most)
            order = np.lexsort((held.columns.node_handle[hits.slots], hits.ts)).tolist()
            slots, ts = hits.slots.tolist(), hits.ts.tolist()
            rows = ((slots[i], ts[i], points[i], normals[i]) for i in order)
        hits_in_order = [held.hit(*row) for row in rows]
        if held.planar:
            for hit in hits_in_order:
                hit.point[2] = origin[2]
        return hits_in_order
