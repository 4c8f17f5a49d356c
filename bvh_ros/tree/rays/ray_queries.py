# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays meet, one by one or in batches. Each method checks its input and calls one kernel."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..nodes import ALL, NONE
from ..results import RayHit, RayHits
from ..store.arrays import Arrays, Floats, Ids, View
from ..store.turns import IS_CHANGED, accepted, count_rays
from ..store.workers import in_threads
from ..wide import raycasting as wide_raycasting
from ..wide.ray_streams import RAYS_AT_ONCE, make_scratch
from . import ray_hits, raycasting
from .slab import RAY_ROWS


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
        start = checks.point('origin', origin, self.ndim)
        way = checks.point('direction', direction, self.ndim)
        reach, seen = checks.limit('t_max', t_max), checks.mask(mask)
        view = self.view()
        found = self.every_hit(view, start[None], way[None], reach, seen, skip_inside)
        hits = [
            self._hit(view, start, way, *row)
            for row in zip(*(column.tolist() for column in found[1:]), strict=True)
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
        return np.asarray(hits.ids != NONE)

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
        starts = checks.points('origins', origins, self.ndim)
        ways = checks.points('directions', directions, self.ndim, len(starts))
        view = self.view()
        offsets, slots, ts, _ = self.every_hit(view, starts, ways, t_max, mask, skip_inside)
        ids = view[2][slots]
        self.check_unchanged(view)
        return offsets, ids, ts

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
        shape = (self.ndim,)
        start = checks.floats_to_read('origin', origin, shape)
        way = checks.floats_to_read('direction', direction, shape)
        if start.shape != shape or way.shape != shape:
            checks.point('origin', start, self.ndim)
            checks.point('direction', way, self.ndim)
        reach, seen = checks.limit('t_max', t_max), checks.mask(mask)
        place = np.empty((2 + RAY_ROWS, self.ndim))
        nodes, _, tight, handles, state, heirs, _ = self._storage
        if heirs:
            nodes, _, tight, handles, state, _, _ = self._settled()
        handle, t = ray_hits.raycast_entry(self.ndim)(
            nodes,
            tight,
            handles,
            state,
            start,
            way,
            reach,
            seen,
            checks.flag('skip_inside', skip_inside),
            mode,
            place,
        )
        if handle == ray_hits.NOT_FINITE:
            checks.point('origin', start, self.ndim)
            checks.point('direction', way, self.ndim)
        if handle == ray_hits.REFUSED:
            raise RuntimeError(IS_CHANGED)
        return None if handle < 0 else (handle, t, place)

    def _hit(
        self, view: View, start: Floats, way: Floats, slot: int, t: float, axis: int
    ) -> RayHit:
        nodes, tight, handles, _, _ = view
        place = np.empty((2, self.ndim))
        ray_hits.locate(nodes, tight, start, way, slot, t, axis, place)
        return RayHit(int(handles[slot]), t, place[0], place[1])

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
        starts = checks.rows('origins', origins, self.ndim)
        count = len(starts)
        ways = checks.rows('directions', directions, self.ndim, count)
        reaches = checks.limits('t_max', t_max, 1 if np.isscalar(t_max) else count)
        seen = checks.masks(mask, 1 if np.isscalar(mask) else count)
        rays = starts, ways, reaches, seen, checks.flag('skip_inside', skip_inside)
        described = count if mode == raycasting.CLOSEST else 0
        # One piece of memory: three make the allocator give theirs back to the system after each
        # batch, and fetching it anew, page by page, costs a tenth of a ray among 1,000 boxes.
        room = np.empty(count + described * (1 + self.ndim))
        hits = RayHits(
            room[:count].view(np.int64),
            room[count : count + described],
            room[count + described :].reshape(described, self.ndim),
        )
        view = self.view()
        left, exact = self._first_wide(view, rays, mode, threads, hits)
        if left.size:
            checks.finite('origins', starts)
            checks.finite('directions', ways)

        def cast(start: int, stop: int) -> int:
            scratch, rows = np.empty((RAY_ROWS, self.ndim)), left[start:stop]
            return accepted(ray_hits.raycast_rows(*view, scratch, *rays, mode, rows, *hits))

        exact += sum(in_threads(cast, len(left), threads))
        count_rays(view[3], count, exact)  # once all are answered: what is refused counts none
        return hits

    def _first_wide(
        self, view: View, rays: tuple[Any, ...], mode: int, threads: int, hits: RayHits
    ) -> tuple[Ids, int]:
        """Answer what the snapshot can: the rows left, and how many others were exact work."""
        count = len(hits.ids)
        snapshot = self._snapshot_for(count, view)
        if snapshot is None:
            return np.arange(count), 0
        marks = np.empty(count, np.bool_)

        def cast(start: int, stop: int) -> int:
            done = wide_raycasting.cast_rows(
                *snapshot[:-1],
                *view,
                *make_scratch(stop - start, self.ndim, snapshot.depth),
                *rays,
                mode == raycasting.ANY,
                start,
                stop,
                *hits,
                marks,
            )
            return accepted(done)

        exact = in_threads(cast, count, threads, 2 * RAYS_AT_ONCE)
        return np.flatnonzero(marks), sum(exact)

    def every_hit(
        self,
        view: View,
        starts: Floats,
        ways: Floats,
        t_max: ArrayLike,
        mask: ArrayLike,
        skip_inside: bool,
    ) -> tuple[Ids, Ids, Floats, Ids]:
        """`raycast_all_many` of good input: offsets, slots, t and axes entered; right if the tree
        is unchanged afterwards.
        """
        count = len(starts)
        reaches, seen = checks.limits('t_max', t_max, count), checks.masks(mask, count)
        skips = checks.flag('skip_inside', skip_inside)
        return raycasting.every_hit(view, starts, ways, reaches, seen, skips)
