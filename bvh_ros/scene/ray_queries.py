# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays and swept balls meet in a scene. Each method checks its input and asks a kernel."""

import numpy as np
from numpy.typing import ArrayLike

from ..tree.access import ALL, EVERYTHING, checks
from .cast import boxes, exact_ball
from .cast.arguments import WHOLE_WAY, Rays, ways_entry
from .geometry.shapes import Floats
from .moments import Moments
from .ray_batches import RayBatches
from .results import CastHits, SceneHit, require_few
from .store.obstacles import Obstacles


class RayQueries:
    """What rays meet. Any number of threads may ask while none changes the scene."""

    _held: Obstacles
    _moments: Moments
    _batches: RayBatches

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
            `cast.shapes`. Ties go to the smaller handle.

        Raises
        ------
        ValueError
            If an argument is NaN, infinite, negative (`radius`) or of the wrong shape.
        """
        if self._held.change.unfinished:
            self._held.change.require_none()
        if self._moments.meant(at, until, 1):
            return self._moments.first((start, goal, radius), mask, skip_inside, at, until)
        held, radius = self._held, checks.limit('radius', radius)
        if radius == 0.0 and not held.columns.shaped:
            start, goal = checks.vector('start', start, 3), checks.vector('goal', goal, 3)
            hit = boxes.first(held.tree, start, goal, checks.mask(mask), bool(skip_inside))
            return None if hit is None else held.hit(*hit)
        origin, direction, radius = boxes.segment(start, goal, radius)
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
        if self._held.change.unfinished:
            self._held.change.require_none()
        origin, direction, radius = boxes.segment(start, goal, radius)
        if self._moments.meant(at, until, 1):
            way = origin, direction, radius
            return self._moments.every(way, mask, skip_inside, at, until, most)
        if radius == 0.0 and not self._held.columns.shaped:
            hits = boxes.every(
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
        if self._held.change.unfinished:
            self._held.change.require_none()
        origins, directions = checks.both(checks.WAYS, origins, directions, 3)
        count, skip = len(origins), bool(skip_inside)
        limits = checks.limits_or_one('t_max', t_max, count)
        masks = EVERYTHING if mask is ALL else checks.masks_or_one(mask, count)
        asked = origins, directions, limits, masks
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        radii, held = checks.NOTHING, self._held
        timed = at is not None or until is not None
        if at is not None and threads == 1 and radius is None:
            found = self._moments.few(asked, radii, skip, at, until, False)
            if found is not None:
                return found
        if timed and (radius is not None or held.planar or held.columns.shaped):
            checks.finite('origins', origins)  # else a kernel looks
            checks.finite('directions', directions)
        if radius is not None:
            radii = checks.lengths_or_one('radius', radius, count)
        if not timed:
            found = self._batches.now(asked, radii, (False, skip), threads)
            if found is not None:
                return found
        return self._batches.first(Rays(*asked), radii, skip, (at, until), threads)

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
        if self._held.change.unfinished:
            self._held.change.require_none()
        origins, ends = checks.both(('starts', 'goals'), starts, goals, 3)
        count, skip = len(origins), bool(skip_inside)
        masks = EVERYTHING if mask is ALL else checks.masks_or_one(mask, count)
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        radii, found = checks.lengths_or_one('radius', radius, count), None
        asked = origins, ends, WHOLE_WAY, masks
        if at is None and until is None:
            found = self._batches.now(asked, radii, (True, skip), threads)
        elif at is not None and threads == 1:
            found = self._moments.few(asked, radii, skip, at, until, True)
        if found is not None:
            return found
        ways = np.empty((count, 3))
        far = ways_entry()(origins, ends, ways)
        if far >= 0:
            checks.finite('starts', origins)
            checks.finite('goals', ends)
            raise ValueError(f'the segment of row {far} is longer than the largest double')
        rays = Rays(origins, ways, WHOLE_WAY, masks)
        return self._batches.first(rays, radii, skip, (at, until), threads)

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
            asked = exact_ball.Sweep(origin, direction, radius, checks.mask(mask), skip, every)
            rows = exact_ball.cast_ball(held.tree, held.columns, asked, most)
        else:
            masks = np.full(1, checks.mask(mask))
            rays = Rays(origin[None], direction[None], np.ones(1), masks)
            found = self._batches.cast(rays, skip, every)
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
