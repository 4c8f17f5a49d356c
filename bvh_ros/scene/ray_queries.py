# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays and swept balls meet in a scene. Each method checks its input and asks a kernel."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..tree import checks
from ..tree.access import ALL, EVERYTHING
from .cast import batch, boxes
from .cast.arguments import THIN, UNIT_T_MAX, Rays, Sweep, refuse_infinite
from .results import CastHits, SceneHit
from .store import Obstacles
from .timed_queries import TimedQueries


class RayQueries:
    """What rays meet. Any number of threads may ask while none changes the scene."""

    _store: Obstacles
    _timed: TimedQueries

    def raycast(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        radius: float = 0.0,
        mask: int = ALL,
        skip_inside: bool = False,
        at: float | None = None,
        until: float | None = None,
    ) -> SceneHit | None:
        """Return the first obstacle on the segment from start to goal.

        Parameters
        ----------
        start, goal : array_like, shape (3,), or (2,) in a planar scene
            Ends of the segment, m. If they are equal, the query is the point (the ball) at
            `start`.
        radius : float
            Of a ball swept along the segment, m; 0 is a thin ray.
        mask : int
            Only obstacles with ``categories & mask != 0`` are seen.
        skip_inside : bool
            Ignore obstacles that the point or ball touches at the start.
        at, until : time, optional
            An int in ns, or a float in s: the segment is left at `at`, and reached at `until`,
            while obstacles with velocities move; without `until`, the world is frozen at that
            time. None: it is as of the last update.

        Returns
        -------
        SceneHit or None
            `t` is where the ray's point or the ball's centre is between start (0) and goal (1).
            `point` lies on the obstacle, `normal` leads from there to the ball's centre. An
            obstacle that contains the start is met at ``t = 0`` with a zero normal; the normal is
            zero as well where the ball's centre is no farther from the obstacle than rounding.
            Among axis-aligned boxes it is decided exactly whether a ray or a ball touches, and
            which obstacle is first. Other shapes touch too where rounding cannot tell, see
            `cast.shapes`, and so do boxes that a ball meets at a time; but a mesh meets a thin ray
            exactly in its own frame. Ties go to the smaller handle.

        Raises
        ------
        ValueError
            If an argument is NaN, infinite, negative (`radius`) or of the wrong shape.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        store, radius = self._store, checks.limit('radius', radius)
        if radius == math.inf:
            raise ValueError('radius must be finite')
        planar = store.planar
        ends = checks.vector('start', start, 3, planar), checks.vector('goal', goal, 3, planar)
        ball = radius, checks.mask(mask), checks.flag('skip_inside', skip_inside)
        if (at is not None or until is not None) and self._timed.time_matters(at, until, 1):
            hit = self._timed.first_ray(ends, ball, at, until)
        elif radius == 0.0 and not store.columns.shaped:
            hit = boxes.first(store.tree, *ends, *ball[1:])
        else:
            hit = batch.first_of_one(store.tree, store.columns, ends, ball)
        return None if hit is None else store.hit(*hit)

    def raycast_all(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        radius: float = 0.0,
        mask: int = ALL,
        skip_inside: bool = False,
        most: int | None = None,
        at: float | None = None,
        until: float | None = None,
    ) -> list[SceneHit]:
        """Return all obstacles on the segment, nearest first, ties by handle.

        Arguments as `raycast`. TooManyHitsError, a ValueError, if there are more than `most`: an
        answer is never cut short. For a ball that counts what it may touch, before the last digit
        is looked at.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        ends, direction, radius = boxes.segment(start, goal, radius, self._store.planar)
        most = checks.whole_or_none('most', most, 0)
        store, bits, skip = self._store, checks.mask(mask), checks.flag('skip_inside', skip_inside)
        sweep = Sweep(ends[0], direction, radius, bits, skip, True)
        if self._timed.time_matters(at, until, 1):
            found = self._timed.every_ray(sweep, at, until, most)
        elif radius > 0.0 or store.columns.shaped:
            found = batch.hits_in_order(store.tree, store.columns, ends[1], sweep, most)
        else:
            found = boxes.every(store.tree, ends[0], direction, bits, skip, most)
        return store.each_once([store.hit(*hit) for hit in found])

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
        origins, directions : array_like, shape (n, 3), or (n, 2) in a planar scene
            One of them may be one row: the same for all rays.
        t_max, mask : one for all rays, or array_like of shape (n,)
            `t_max` may be infinite, but for balls and where obstacles grow.
        skip_inside : bool
            Ignore obstacles that contain a ray's origin, or that a ball touches there.
        threads : int
            The rays are shared among so many threads; the answer does not depend on it.
        radius : one for all rays, or array_like of shape (n,), optional
            Of balls that go along them, m. Where it is above zero, t_max must be finite.
        at, until : one for all rays, or array_like of shape (n,), optional
            As in `raycast`; `until` is when t is 1.

        Returns
        -------
        CastHits
            `t` in units of the directions.

        Raises
        ------
        ValueError
            If an argument is NaN, infinite where it may not be, negative (`t_max`, `radius`) or of
            the wrong shape; the message names the first bad row.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        given = origins, directions, 3, self._store.planar
        origins, directions = checks.both(checks.RAY_ARGUMENTS, *given)
        limits = checks.limits_or_one('t_max', t_max, len(origins))
        rays = (
            origins,
            directions,
            limits,
            mask,
            0.0 if radius is None else radius,
            False,
            checks.flag('skip_inside', skip_inside),
        )
        return self._first_hits(rays, threads, at, until)

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
        """First obstacles that n balls touch; a row is what `raycast` says.

        Parameters
        ----------
        starts, goals : array_like, shape (n, 3), or (n, 2) in a planar scene
            Ends of the segments, m. One of them may be one row: the same for all.
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
        if self._store.change.unfinished:
            self._store.change.require_none()
        origins, ends = checks.both(('starts', 'goals'), starts, goals, 3, self._store.planar)
        rays = (
            origins,
            ends,
            UNIT_T_MAX,
            mask,
            radius,
            True,
            checks.flag('skip_inside', skip_inside),
        )
        return self._first_hits(rays, threads, at, until)

    def _first_hits(self, given: tuple[Any, ...], threads: int, at: Any, until: Any) -> CastHits:
        """First hits of `Rays` whose masks and radii are still to be checked."""
        origins, directions, limits, mask, radius, to_goals, skip = given
        store, count, radii = self._store, len(origins), THIN
        masks = EVERYTHING if mask is ALL else checks.masks_or_one(mask, count)
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        if type(radius) is not float or radius != 0.0:
            radii = checks.lengths_or_one('radius', radius, count)
            # numpy's any() takes as long as a row.
            if not (radii.item() if len(radii) == 1 else radii.any()):
                radii = THIN
        # As Rays(...), which would take one more call of a function of Python's.
        parts = origins, directions, limits, masks, radii, to_goals, skip, False
        rays: Rays = tuple.__new__(Rays, parts)
        if (at is not None or until is not None) and self._timed.time_matters(at, until, count):
            return self._timed.first_rays(rays, at, until, threads)
        if radii is THIN and not store.columns.shaped:
            hits = boxes.first_hits(store.tree, store.columns.node_handle, rays, threads)
        else:
            hits = batch.first_hits(store.tree, store.columns, rays, threads)
        if hits is None:
            refuse_infinite(rays)
        assert hits is not None
        return hits
