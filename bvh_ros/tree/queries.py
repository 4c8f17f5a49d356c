# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The questions a tree answers. Each method checks its input, calls one kernel and turns slots
into handles.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import checks, overlapping, proximity, raycasting, wide, wide_raycasting
from .nodes import ALL, COUNT, NONE, ROOT, box_dtype
from .results import RayHit, RayHits
from .slab import INSIDE

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

SORT_FROM_BOXES, SORT_FROM_RAYS = 2_000, 1_000


def in_threads(work: Callable[[int, int], Any], count: int, threads: int) -> list[Any]:
    """Do work(start, stop) over `count` rows in as many pieces as threads; kernels release the
    GIL.
    """
    threads = max(1, min(checks.whole('threads', threads, 1), count))
    if threads == 1:
        return [work(0, count)]
    edges = [count * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, edges[:-1], edges[1:]))


class Queries:
    """Queries of a dynamic BVH. Any number of threads may ask while none changes the tree."""

    ndim: int
    _nodes: NDArray[Any]
    _heights: NDArray[np.int16]
    _tight: NDArray[Any]
    _handles: Ids
    _state: NDArray[np.int64]
    _changes: int
    _lock: Lock
    _snapshot: wide.Snapshot | None
    _snapshot_of: int
    _rays_since: int

    def _tree(self) -> tuple[Any, ...]:
        return self._nodes, self._tight, self._handles, int(self._state[ROOT])

    def _boxes_only(self) -> tuple[Any, ...]:
        return self._nodes, self._tight, int(self._state[ROOT])

    def _to_handles(self, slots: Ids) -> Ids:
        return np.where(slots >= 0, self._handles[slots], NONE)

    # ---- rays

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
        ray = self._ray(origin, direction)
        slots, ts, axes = np.empty(1, np.int64), np.empty(1), np.empty(1, np.int64)
        reach, seen = checks.limit('t_max', t_max), checks.mask(mask)
        found = raycasting.raycast(
            *self._tree(),
            ray,
            reach,
            seen,
            bool(skip_inside),
            raycasting.CLOSEST,
            slots,
            ts,
            axes,
            0,
        )
        return self._hit(ray, int(slots[0]), float(ts[0]), int(axes[0])) if found else None

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
        ray = self._ray(origin, direction)
        _, slots, ts, axes = self._every(
            ray[:1].copy(), ray[1:2].copy(), t_max, checks.mask(mask), skip_inside
        )
        return [
            self._hit(ray, *row)
            for row in zip(slots.tolist(), ts.tolist(), axes.tolist(), strict=True)
        ]

    def occluded(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        t_max: float = np.inf,
        mask: int = ALL,
        skip_inside: bool = False,
    ) -> bool:
        """Whether the ray meets any box; cheaper than `raycast`. Arguments as there."""
        ray = self._ray(origin, direction)
        slots, ts, axes = np.empty(1, np.int64), np.empty(1), np.empty(1, np.int64)
        reach, seen = checks.limit('t_max', t_max), checks.mask(mask)
        return bool(
            raycasting.raycast(
                *self._tree(),
                ray,
                reach,
                seen,
                bool(skip_inside),
                raycasting.ANY,
                slots,
                ts,
                axes,
                0,
            )
        )

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
        starts, ways = self._rays(origins, directions)
        slots, ts, axes = self._first(
            starts, ways, t_max, mask, skip_inside, raycasting.CLOSEST, threads
        )
        normals = np.zeros_like(starts)
        rows = np.flatnonzero(axes != INSIDE)
        normals[rows, axes[rows]] = -np.sign(ways[rows, axes[rows]])
        return RayHits(self._to_handles(slots), ts, normals)

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
        starts, ways = self._rays(origins, directions)
        slots, _, _ = self._first(starts, ways, t_max, mask, skip_inside, raycasting.ANY, threads)
        return np.asarray(slots >= 0)

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
        starts, ways = self._rays(origins, directions)
        offsets, slots, ts, _ = self._every(starts, ways, t_max, mask, skip_inside)
        return offsets, self._handles[slots], ts

    def _ray(self, origin: ArrayLike, direction: ArrayLike) -> Floats:
        ray = np.empty((3, self.ndim))
        ray[0] = checks.point('origin', origin, self.ndim)
        ray[1] = checks.point('direction', direction, self.ndim)
        return ray

    def _rays(self, origins: ArrayLike, directions: ArrayLike) -> tuple[Floats, Floats]:
        starts = checks.points('origins', origins, self.ndim)
        return starts, checks.points('directions', directions, self.ndim, len(starts))

    def _hit(self, ray: Floats, slot: int, t: float, axis: int) -> RayHit:
        origin, direction = ray[0], ray[1]
        normal = np.zeros(self.ndim)
        if axis == INSIDE:
            return RayHit(int(self._handles[slot]), t, origin.copy(), normal)
        lo, hi = self._exact_box(slot)
        with np.errstate(over='ignore', invalid='ignore'):
            point = np.clip(np.nan_to_num(origin + t * direction, nan=0.0), lo, hi)
        point[axis] = lo[axis] if direction[axis] > 0.0 else hi[axis]
        normal[axis] = -1.0 if direction[axis] > 0.0 else 1.0
        return RayHit(int(self._handles[slot]), t, point, normal)

    def _exact_box(self, slot: int) -> tuple[Floats, Floats]:
        record = self._tight[slot] if len(self._tight) else self._nodes[2 * slot]
        return record['lo'], record['hi']

    def _first(
        self,
        starts: Floats,
        ways: Floats,
        t_max: ArrayLike,
        mask: ArrayLike,
        skip_inside: bool,
        mode: int,
        threads: int,
    ) -> tuple[Ids, Floats, Ids]:
        count = len(starts)
        reaches, seen = checks.limits('t_max', t_max, count), checks.masks(mask, count)
        slots, ts, axes = np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64)
        rays = starts, ways, reaches, seen, bool(skip_inside)
        snapshot = self._snapshot_for(count)
        if snapshot is None:
            left = np.arange(count)
        else:
            order = self._coherent(snapshot, starts, ways)
            marks = np.empty(count, np.bool_)

            def cast(start: int, stop: int) -> None:
                wide_raycasting.cast_rows(
                    *snapshot,
                    *self._boxes_only()[:2],
                    self._handles,
                    np.empty((3, self.ndim)),
                    *rays,
                    mode == raycasting.ANY,
                    order[start:stop],
                    slots,
                    ts,
                    axes,
                    marks,
                )

            in_threads(cast, count, threads)
            left = np.flatnonzero(marks)

        def work(start: int, stop: int) -> None:
            raycasting.raycast_rows(
                *self._tree(),
                np.empty((3, self.ndim)),
                *rays,
                mode,
                left[start:stop],
                slots,
                ts,
                axes,
            )

        in_threads(work, len(left), threads)
        return slots, ts, axes

    def _snapshot_for(self, count: int) -> wide.Snapshot | None:
        """The wide snapshot of the tree as it is, if the rays since the last change, `count` more
        now, are worth building it.
        """
        with self._lock:
            if self._snapshot_of != self._changes:
                self._snapshot, self._snapshot_of, self._rays_since = None, self._changes, 0
            self._rays_since += count
            if self._snapshot is None and self._rays_since >= max(
                wide.RAYS_PER_BOX * len(self), wide.LEAST_RAYS
            ):
                root = int(self._state[ROOT])
                if len(self) > 1:
                    self._snapshot = wide.take_snapshot(self._nodes, root)
            return self._snapshot

    def _coherent(self, snapshot: wide.Snapshot, starts: Floats, ways: Floats) -> Ids:
        """The order to cast rays in: sorted where a tree larger than the near caches makes
        neighbours share what they load.
        """
        count = len(starts)
        order = np.arange(count)
        if len(self) >= SORT_FROM_BOXES and count >= SORT_FROM_RAYS:
            keys, spare = np.empty(count, np.int64), np.empty(count, np.int64)
            wide_raycasting.coherent_order(
                starts, ways, snapshot.center, snapshot.per_length, keys, order, spare
            )
        return order

    def _every(
        self, starts: Floats, ways: Floats, t_max: ArrayLike, mask: ArrayLike, skip_inside: bool
    ) -> tuple[Ids, Ids, Floats, Ids]:
        count = len(starts)
        reaches, seen = checks.limits('t_max', t_max, count), checks.masks(mask, count)
        offsets = np.zeros(count + 1, np.int64)
        slots, ts, axes = raycasting.raycast_every_row(
            *self._tree(), starts, ways, reaches, seen, bool(skip_inside), offsets
        )
        rays = np.repeat(np.arange(count), np.diff(offsets))
        order = np.lexsort((self._handles[slots], ts, rays))
        slots, ts, axes = slots[order], ts[order], axes[order]
        scratch = np.empty((3, self.ndim))
        raycasting.settle_order(
            self._nodes,
            self._tight,
            self._handles,
            scratch,
            starts,
            ways,
            offsets,
            slots,
            ts,
            axes,
        )
        return offsets, slots, ts, axes

    # ---- boxes and points

    def overlap(self, lo: ArrayLike, hi: ArrayLike, mask: int = ALL) -> Ids:
        """Handles of the boxes that touch the closed box from `lo` to `hi`, shape (ndim,) each;
        ascending.
        """
        low, high = checks.box(lo, hi, self.ndim)
        return self.overlap_many(low[None], high[None], checks.mask(mask))[1]

    def overlap_many(
        self, lo: ArrayLike, hi: ArrayLike, mask: ArrayLike = ALL, threads: int = 1
    ) -> tuple[Ids, Ids]:
        """Overlaps of n query boxes, shape (n, ndim) each: (offsets, ids).

        Those of query i are ``ids[offsets[i]:offsets[i + 1]]``, ascending. Touching counts.
        """
        low, high = checks.boxes(lo, hi, self.ndim)
        count = len(low)
        seen = checks.masks(mask, count)
        queries = np.empty(count, box_dtype(self.ndim))
        queries['lo'], queries['hi'] = low, high
        sizes = np.empty(count, np.int64)

        def work(start: int, stop: int) -> Ids:
            found: Ids = overlapping.overlap_many(
                *self._boxes_only(), queries, seen, start, stop, sizes
            )
            return found

        slots = np.concatenate(in_threads(work, count, threads))
        offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        handles = self._handles[slots]
        order = np.lexsort((handles, np.repeat(np.arange(count), sizes)))
        return offsets, handles[order]

    def overlap_pairs(self, mask: int = ALL) -> Ids:
        """All pairs of touching boxes, shape (m, 2): each once, the smaller handle first,
        sorted.
        """
        slots = np.empty(max(4 * int(self._state[COUNT]), 64), np.int64)
        tree = self._nodes, self._heights, self._tight, int(self._state[ROOT]), checks.mask(mask)
        count = overlapping.overlap_pairs(*tree, slots)
        if count > len(slots):
            slots = np.empty(count, np.int64)
            overlapping.overlap_pairs(*tree, slots)
        slots = slots[:count]
        pairs = np.sort(self._handles[slots].reshape(-1, 2), axis=1)
        return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]

    def nearest(
        self, point: ArrayLike, k: int = 1, max_distance: float = np.inf, mask: int = ALL
    ) -> tuple[Ids, Floats]:
        """The up to k boxes nearest to `point` within `max_distance` (m): (ids, distances),
        nearest first, ties by handle.

        The distance is 0 inside a box, and within 4 roundings of the exact one (see
        `tree.proximity`).
        """
        where = checks.point('point', point, self.ndim)
        ids, distances = self.nearest_many(
            where[None], k, checks.limit('max_distance', max_distance), checks.mask(mask)
        )
        count = int(np.count_nonzero(ids[0] >= 0))
        return ids[0, :count], distances[0, :count]

    def nearest_many(
        self,
        points: ArrayLike,
        k: int = 1,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
    ) -> tuple[Ids, Floats]:
        """`nearest` for n points: arrays of shape (n, k), padded with id -1 and distance inf."""
        where = checks.points('points', points, self.ndim)
        k = checks.whole('k', k, 1)
        count = len(where)
        reaches, seen = (
            checks.limits('max_distance', max_distance, count),
            checks.masks(mask, count),
        )
        slots, distances = np.empty((count, k), np.int64), np.empty((count, k))
        proximity.nearest_many(*self._tree(), where, k, reaches, seen, slots, distances)
        return self._to_handles(slots), distances
