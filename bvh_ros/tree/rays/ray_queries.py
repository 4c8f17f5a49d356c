# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays meet, one by one or in batches. Each method checks its input and calls one kernel."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..nodes import ALL, NONE
from ..results import RayHit, RayHits
from ..store.arrays import Floats, Ids
from ..timed import NOW
from . import raycasting
from .ray_asking import RayAsking
from .raycasting import EVERY

# An array: numpy takes as long to make one of a number as for all else.
_NO_BOX = np.array(NONE)


class RayQueries(RayAsking):
    """What rays meet."""

    def raycast(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        t_max: float = np.inf,
        mask: int = ALL,
        skip_inside: bool = False,
        at: float | None = NOW,
        pace: float = NOW,
    ) -> RayHit | None:
        """Return the first box that the ray meets.

        Parameters
        ----------
        origin, direction : array_like, shape (ndim,)
            The ray is ``origin + t * direction``, ``0 <= t <= t_max``. A zero direction asks for
            the point `origin`.
        t_max : float
            In units of `direction`: metres if that is a unit vector of metres. May be inf.
        mask : int
            Only boxes with ``box_mask & mask != 0`` are seen.
        skip_inside : bool
            Ignore boxes that contain the origin; else such a box is hit at ``t = 0`` with a zero
            normal.
        at, pace : float
            Of boxes that have velocities: when the ray starts, s, and how much later it is a unit
            of t. So `t` is when and where who moves along it meets the first box.

        Returns
        -------
        RayHit or None
            Which box is first is decided exactly, ties by the smaller handle.

        Raises
        ------
        ValueError
            If an argument has the wrong shape or is NaN, infinite (`t_max` may be) or negative
            (`t_max`).

        Examples
        --------
        >>> from bvh_ros import DynamicBVH
        >>> tree = DynamicBVH(ndim=2)
        >>> wall = tree.insert([4, -1], [5, 1])
        >>> hit = tree.raycast([0, 0], [2, 0])
        >>> hit.id == wall, hit.t, hit.normal.tolist()
        (True, 2.0, [-1.0, 0.0])
        """
        mode = raycasting.CLOSEST
        found = self._cast(origin, direction, t_max, mask, skip_inside, mode, at, pace)
        if found is None:
            return None
        handle, t, place = found
        return RayHit(handle, t, place[0], place[1])

    def raycast_all(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        t_max: float = np.inf,
        mask: int = ALL,
        skip_inside: bool = False,
        at: float | None = NOW,
        pace: float = NOW,
    ) -> list[RayHit]:
        """Return every box that the ray meets, nearest first (exactly; ties by handle). Arguments
        as `raycast`.
        """
        origin = checks.point('origin', origin, self._ndim)
        direction = checks.point('direction', direction, self._ndim)
        limit, seen = checks.limit('t_max', t_max), checks.mask(mask)
        motion = self._motion_at(at, pace)
        if motion is not None:
            some = origin[None], direction[None], limit, seen, skip_inside
            _, ids, found, places = motion.every_ray(self, some, (at, pace))
            rows = zip(ids.tolist(), found.ts.tolist(), *places, strict=True)
            return [RayHit(*row) for row in rows]
        view, skip = self.view(), checks.flag('skip_inside', skip_inside)
        asked = np.array([limit]), np.array([seen]), skip, EVERY, True
        rays = origin[None], direction[None], *asked
        _, end, met = raycasting.every_hit(view, rays, False)
        hits = [
            self._hit(view, origin, direction, *row)
            for row in zip(*(column[:end].tolist() for column in met), strict=True)
        ]
        self.check_unchanged(view)
        return hits

    def occluded(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        t_max: float = np.inf,
        mask: int = ALL,
        skip_inside: bool = False,
        at: float | None = NOW,
        pace: float = NOW,
    ) -> bool:
        """Whether the ray meets any box; cheaper than `raycast`. Arguments as there."""
        asked = t_max, mask, skip_inside, raycasting.ANY, at, pace
        return self._cast(origin, direction, *asked) is not None

    def raycast_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        threads: int = 1,
        at: ArrayLike | None = NOW,
        pace: ArrayLike = NOW,
    ) -> RayHits:
        """First hits of n rays, the same as `raycast` gives one by one.

        Parameters
        ----------
        origins, directions : array_like, shape (n, ndim)
        t_max, mask, at, pace : one for all rays, or array_like of shape (n,)
        threads : int
            The rays are shared among so many threads; the answer does not depend on it.

        Raises
        ------
        ValueError
            As `raycast`; the message names the first bad row.
        """
        mode = raycasting.CLOSEST
        return self._first(origins, directions, t_max, mask, skip_inside, mode, threads, at, pace)

    def occluded_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        threads: int = 1,
        at: ArrayLike | None = NOW,
        pace: ArrayLike = NOW,
    ) -> NDArray[np.bool_]:
        """Whether each of n rays meets any box, shape (n,). Arguments as `raycast_many`."""
        mode = raycasting.ANY
        hits = self._first(origins, directions, t_max, mask, skip_inside, mode, threads, at, pace)
        return np.asarray(hits.ids != _NO_BOX)

    def raycast_all_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        at: ArrayLike | None = NOW,
        pace: ArrayLike = NOW,
    ) -> tuple[Ids, Ids, Floats]:
        """Every hit of n rays: (offsets, ids, t); those of ray i are ``[offsets[i]:offsets[i +
        1]]``, nearest first.
        """
        ndim = self._ndim
        origins, directions = checks.both(checks.WAYS, origins, directions, ndim)
        motion = self._motion
        if motion is not None or not at is pace is NOW:
            motion = self._motion_at(at, pace, len(origins))
        if motion is not None:
            way = (
                checks.points('origins', origins, ndim),
                checks.points('directions', directions, ndim),
            )
            some = *way, t_max, mask, skip_inside
            offsets, ids, found, _ = motion.every_ray(self, some, (at, pace))
            return offsets, ids, found.ts
        count = len(origins)
        limits, masks, skip = checks.FOREVER, checks.EVERYTHING, skip_inside
        if t_max is not np.inf:
            limits = checks.limits_or_one('t_max', t_max, count)
        if mask is not ALL:
            masks = checks.masks_or_one(mask, count)
        if skip is not False:
            skip = checks.flag('skip_inside', skip)
        rays = origins, directions, limits, masks, skip, EVERY, True
        offsets, end, (ids, ts, _) = raycasting.every_hit(self.latest(), rays, True)
        return offsets, ids[:end], ts[:end]
