# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays meet, one by one or in batches. Each method checks its input and calls one kernel."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..nodes import ALL, NONE, View
from ..results import RayHit, RayHits
from ..store.arrays import Arrays, Floats, Ids
from ..store.turns import IS_CHANGED, NOT_FINITE, REFUSED, accepted
from ..store.workers import in_threads
from ..wide.ray_streams import RAYS_AT_ONCE
from ..wide.snapshot import Snapshot
from . import ray_batches, ray_hits, raycasting
from .raycasting import Rays

# An array: numpy takes as long to make one of a number as for all else.
_NO_BOX = np.array(NONE)


class RayQueries(Arrays):
    """What rays meet."""

    def raycast(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        t_max: float = np.inf,
        mask: int = ALL,
        skip_inside: bool = False,
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
        found = self._cast(origin, direction, t_max, mask, skip_inside, raycasting.CLOSEST)
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
    ) -> list[RayHit]:
        """Return every box that the ray meets, nearest first (exactly; ties by handle). Arguments
        as `raycast`.
        """
        origin = checks.point('origin', origin, self._ndim)
        direction = checks.point('direction', direction, self._ndim)
        asked = checks.limit('t_max', t_max), checks.mask(mask), skip_inside
        view = self.view()
        found = self.every_hit(view, origin[None], direction[None], *asked)[1]
        hits = [
            self._hit(view, origin, direction, *row)
            for row in zip(*(column.tolist() for column in found), strict=True)
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
    ) -> bool:
        """Whether the ray meets any box; cheaper than `raycast`. Arguments as there."""
        return self._cast(origin, direction, t_max, mask, skip_inside, raycasting.ANY) is not None

    def raycast_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        threads: int = 1,
    ) -> RayHits:
        """First hits of n rays, the same as `raycast` gives one by one.

        Parameters
        ----------
        origins, directions : array_like, shape (n, ndim)
        t_max, mask : one for all rays, or array_like of shape (n,)
        threads : int
            The rays are shared among so many threads; the answer does not depend on it.

        Raises
        ------
        ValueError
            As `raycast`; the message names the first bad row.
        """
        mode = raycasting.CLOSEST
        return self._first(origins, directions, t_max, mask, skip_inside, mode, threads)

    def occluded_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        threads: int = 1,
    ) -> NDArray[np.bool_]:
        """Whether each of n rays meets any box, shape (n,). Arguments as `raycast_many`."""
        mode = raycasting.ANY
        hits = self._first(origins, directions, t_max, mask, skip_inside, mode, threads)
        return np.asarray(hits.ids != _NO_BOX)

    def raycast_all_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
    ) -> tuple[Ids, Ids, Floats]:
        """Every hit of n rays: (offsets, ids, t); those of ray i are ``[offsets[i]:offsets[i +
        1]]``, nearest first.
        """
        origins = checks.points('origins', origins, self._ndim)
        directions = checks.points('directions', directions, self._ndim, len(origins))
        view = self.view()
        offsets, found = self.every_hit(view, origins, directions, t_max, mask, skip_inside)
        ids = view.tree.handles[found.slots]
        self.check_unchanged(view)
        return offsets, ids, found.ts

    def _cast(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        t_max: float,
        mask: int,
        skip_inside: bool,
        mode: int,
    ) -> tuple[int, float, Floats] | None:
        """One ray, with as little Python as can be: (handle, t, point and normal as rows)."""
        ndim = self._ndim
        origin = checks.vector('origin', origin, ndim)
        direction = checks.vector('direction', direction, ndim)
        place = np.empty((2, ndim))
        handle, t = ray_hits.one_entry(ndim)(
            self._settled().tree,
            origin,
            direction,
            checks.limit('t_max', t_max),
            checks.mask(mask),
            checks.flag('skip_inside', skip_inside),
            mode,
            place,
        )
        if handle >= 0:
            return handle, t, place
        if handle == NOT_FINITE:
            checks.point('origin', origin, ndim)
            checks.point('direction', direction, ndim)
        if handle == REFUSED:
            raise RuntimeError(IS_CHANGED)
        return None

    def _hit(
        self, view: View, origin: Floats, direction: Floats, slot: int, t: float, axis: int
    ) -> RayHit:
        tree, place = view.tree, np.empty((2, self._ndim))
        ray_hits.locate_entry(self._ndim)(tree, origin, direction, slot, t, axis, place)
        return RayHit(int(tree.handles[slot]), t, place[0], place[1])

    def _first(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike,
        mask: ArrayLike,
        skip_inside: bool,
        mode: int,
        threads: int,
    ) -> RayHits:
        """First hits, or of any hits no more than ids, in one pass over the memory: what is
        copied, checked or written apart costs a fifth of a ray among 1,000 boxes.
        """
        ndim = self._ndim
        origins = checks.rows('origins', origins, ndim)
        count = len(origins)
        directions = checks.rows('directions', directions, ndim, count)
        t_max = checks.limits_or_one('t_max', t_max, count)
        masks = checks.masks_or_one(mask, count)
        skip_inside = checks.flag('skip_inside', skip_inside)
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        # As Rays(...), which would take one more call of a function of Python's.
        asked = origins, directions, t_max, masks, skip_inside, mode, threads == 1
        rays = tuple.__new__(Rays, asked)
        hits = ray_batches.room_for(count, ndim, mode)
        view = self.view()
        snapshot = self.snapshot_for(count, view)
        if threads == 1:
            exact = ray_batches.cast(view, snapshot, rays, hits)
        else:
            exact = self._cast_in_threads(view, snapshot, rays, hits, threads)
        if exact == NOT_FINITE:
            checks.finite('origins', origins)
            checks.finite('directions', directions)
        accepted(exact)
        return hits

    def _cast_in_threads(
        self, view: View, snapshot: Snapshot | None, rays: Rays, hits: RayHits, threads: int
    ) -> int:
        """How many took exact arithmetic, or why none is counted."""
        count = len(rays.origins)

        def work(start: int, stop: int) -> int:
            part = ray_batches.part_of(rays, hits, start, stop)
            return ray_batches.cast(view, snapshot, *part)

        done = in_threads(work, count, threads, 2 * RAYS_AT_ONCE if snapshot else 1)
        exact: int = min(done) if min(done) < 0 else sum(done)
        # Once all are answered: of what is refused none counts.
        if exact >= 0:
            ray_hits.count_entry(self._ndim)(view.tree, count, exact)
        return exact

    def every_hit(
        self,
        view: View,
        origins: Floats,
        directions: Floats,
        t_max: ArrayLike,
        mask: ArrayLike,
        skip_inside: bool,
    ) -> tuple[Ids, raycasting.Found]:
        """`raycast_all_many` of good input: offsets, and slots, t and axes entered; right if the
        tree is unchanged afterwards.
        """
        count, mode = len(origins), raycasting.EVERY
        t_max, mask = (
            checks.limits_or_one('t_max', t_max, count),
            checks.masks_or_one(mask, count),
        )
        skip_inside = checks.flag('skip_inside', skip_inside)
        rays = Rays(origins, directions, t_max, mask, skip_inside, mode)
        return raycasting.every_hit(view, rays)
