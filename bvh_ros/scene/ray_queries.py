# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays and swept balls meet in a scene. Each method checks its input and asks a kernel."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree import checks
from ..tree.nodes import ALL
from .casting import ball_casting, box_casting, casting
from .geometry.shapes import Floats, along_axes
from .results import NO_NODE, SceneHit, require_few
from .store.obstacles import Obstacles
from .store.registry import Slots

Masks = NDArray[np.uint32]


class RayQueries:
    """What rays meet. Any number of threads may ask while none changes the scene."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held

    def raycast(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        radius: float = 0.0,
        mask: int = ALL,
        skip_inside: bool = False,
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
        origin, direction, radius = self._segment(start, goal, radius)
        if radius == 0.0 and not self._held.columns.shaped:
            hit = box_casting.first(
                self._held.tree, origin, direction, checks.mask(mask), bool(skip_inside)
            )
            return None if hit is None else self._held.hit(*hit)
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
    ) -> list[SceneHit]:
        """Return all obstacles on the way, nearest first, ties by handle.

        Arguments as `raycast`. TooManyHitsError, a ValueError, if there are more than `most`: an
        answer is never cut short. For a ball that counts what it may touch, before the last digit
        is looked at.
        """
        origin, direction, radius = self._segment(start, goal, radius)
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
    ) -> tuple[NDArray[np.uint32], Floats, Floats, Floats]:
        """First obstacles on n thin rays ``origin + t * direction``, ``0 <= t <= t_max``.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
        t_max, mask : one for all rays, or array_like of shape (n,)

        Returns
        -------
        handles : (n,) uint32
            Node handles, NO_NODE (0xFFFFFFFF) where nothing is hit.
        t : (n,)
            In units of the directions; inf where nothing is hit.
        points, normals : (n, 3)
            NaN and zero where nothing is hit.
        """
        starts = checks.points('origins', origins, 3)
        ways = checks.points('directions', directions, 3, len(starts))
        reaches, masks = (
            checks.limits('t_max', t_max, len(starts)),
            checks.masks(mask, len(starts)),
        )
        rays = starts, ways, reaches, masks
        if not self._held.columns.shaped:
            handles = self._held.columns.node_handle
            return box_casting.first_of_many(self._held.tree, handles, rays, bool(skip_inside))
        return self._first_of_many(*rays, skip_inside)

    def _first_of_many(
        self, starts: Floats, ways: Floats, t_max: Floats, masks: Masks, skip_inside: bool
    ) -> tuple[NDArray[np.uint32], Floats, Floats, Floats]:
        """The same against the true shapes."""
        found = self._cast(starts, ways, t_max, masks, skip_inside, False)
        offsets, slots, ts, points, normals = found
        count, rows = len(starts), np.flatnonzero(np.diff(offsets))
        handles, distances = np.full(count, NO_NODE, np.uint32), np.full(count, np.inf)
        places, outwards = np.full((count, 3), np.nan), np.zeros((count, 3))
        handles[rows], distances[rows] = self._held.columns.node_handle[slots], ts
        places[rows], outwards[rows] = points, normals
        if self._held.planar:
            places[rows, 2] = starts[rows, 2]
        return handles, distances, places, outwards

    def _segment(
        self, start: ArrayLike, goal: ArrayLike, radius: float
    ) -> tuple[Floats, Floats, float]:
        radius = checks.limit('radius', radius)
        if math.isinf(radius):
            raise ValueError('radius must be finite')
        origin, end = checks.floats('start', start), checks.floats('goal', goal)
        if origin.shape == end.shape == (3,):
            # Three numbers: Python's own arithmetic takes a fifth of the time of numpy's.
            way = [b - a for a, b in zip(origin.tolist(), end.tolist(), strict=True)]
            if all(map(math.isfinite, way)):  # so both ends are
                return origin, np.array(way), radius
        checks.point('start', origin, 3)
        checks.point('goal', end, 3)
        raise ValueError('the segment from start to goal is longer than the largest double')

    def _cast(
        self,
        starts: Floats,
        ways: Floats,
        t_max: Floats,
        masks: Masks,
        skip_inside: bool,
        every: bool,
    ) -> tuple[Slots, Slots, Floats, Floats, Floats]:
        """Offsets, slots, t, points and normals of thin rays against the true shapes."""
        ndim = self._held.tree.ndim
        rays = along_axes(starts, ndim), along_axes(ways, ndim), t_max, masks
        return casting.cast_all(
            self._held.tree, self._held.columns, rays, bool(skip_inside), every
        )

    def _cast_one(
        self,
        origin: Floats,
        way: Floats,
        radius: float,
        mask: int,
        skip_inside: bool,
        every: bool,
        most: int | None = None,
    ) -> list[SceneHit]:
        seen = checks.mask(mask)
        if radius > 0.0:
            slots, ts, points, normals = ball_casting.cast_ball(
                *(
                    self._held.tree,
                    self._held.columns,
                    origin,
                    way,
                    radius,
                    seen,
                    bool(skip_inside),
                    every,
                ),
                most,
            )
        else:
            masks = checks.masks(seen, 1)
            found = self._cast(origin[None], way[None], np.ones(1), masks, skip_inside, every)
            _, slots, ts, points, normals = found
            require_few(len(slots), most)
            order = np.lexsort((self._held.columns.node_handle[slots], ts))
            slots, ts, points, normals = slots[order], ts[order], points[order], normals[order]
        if self._held.planar:
            points[:, 2] = origin[2]
        hits = zip(slots.tolist(), ts.tolist(), points, normals, strict=True)
        return [self._held.hit(*hit) for hit in hits]
