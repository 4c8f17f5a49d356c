# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The methods of a tree that cast rays. Each checks its input and calls one kernel."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..batch.single import few_entry
from ..batch.snapshot import Snapshot
from ..batch.streams import RAYS_AT_ONCE, cast_entry, scratch_for
from ..checks import INT64
from ..nodes import ALL, COUNT, NONE, Tree, View
from ..results import RayHit, RayHits
from ..store.arrays import Floats, Ids
from ..store.turns import ANY_VERSION, IS_CHANGED, NOT_FINITE, REFUSED, accepted, in_threads
from ..timed import NOW, Timed
from .ray import (
    ANY,
    CLOSEST,
    EVERY,
    LARGE_BATCH,
    Rays,
    count_entry,
    every_hit,
    locate_entry,
    one_entry,
    room_for_rays,
    rows_entry,
    rows_of,
)

# Smaller batches go through the snapshot ray by ray. Measured with other rays in each batch, with
# AVX-512 and AVX2 alike: in lists, segments of 1 and 5 m and rays of a scan take 0.97 to 1.03
# times as long for 64, 0.85 to 0.96 times for 128, 0.77 to 0.9 times for 256.
FEW_TOGETHER = 72
# Rays from anywhere are the farther apart, the more boxes there are: in lists they take as long
# for 80 among 1,000, for 200 among 10,000, for 370 among 30,000, for 1,500 among 100,000, for
# 3,000 among more.
BOXES_A_RAY, FEW_RAYS = 64, 3000


def answer_rays(
    tree: Tree, version: int, snapshot: Snapshot | None, rays: Rays, hits: RayHits
) -> int:
    """Answer rays: how many took exact arithmetic, or why not."""
    ndim = rays.origins.shape[1]
    done: int
    if snapshot is None:
        done = rows_entry(ndim)(tree, version, rays, hits)
    elif are_few(rays.origins, rays.t_max, tree):
        done = few_entry(ndim)(tree, version, snapshot, tuple(rays), hits)
    else:
        done = cast_in_lists(tree, version, snapshot, rays, hits)
    return done


def cast_in_lists(tree: Tree, version: int, snapshot: Snapshot, rays: Rays, hits: RayHits) -> int:
    """The same, of rays that are not few."""
    count, ndim = rays.origins.shape
    scratch = scratch_for(count, ndim, snapshot.depth)
    done: int = cast_entry(ndim)(tree, version, snapshot, rays, scratch, hits)
    return done


def are_few(origins: Floats, t_max: Floats, tree: Tree) -> bool:
    """Whether rays go through the snapshot one by one."""
    count = len(origins)
    return count < FEW_RAYS and (
        count < FEW_TOGETHER
        or (
            count < tree.state.item(COUNT) // BOXES_A_RAY
            and t_max.item(0) == np.inf
            and not is_scan(origins)
        )
    )


def is_scan(origins: NDArray[np.float64]) -> bool:
    """Whether rays seem to come from one place."""
    first = origins[0].tolist()
    return origins[-1].tolist() == first == origins[len(origins) // 2].tolist()


class RayAsking(Timed):
    """What the methods about rays share."""

    def _cast(
        self,
        origin: ArrayLike,
        direction: ArrayLike,
        t_max: float,
        mask: int,
        skip_inside: bool,
        mode: int,
        at: float | None,
        pace: float,
    ) -> tuple[int, float, Floats] | None:
        """One ray, with as little Python as can be: (handle, t, point and normal as rows)."""
        ndim = self._ndim
        origin = checks.vector('origin', origin, ndim)
        direction = checks.vector('direction', direction, ndim)
        place, skip = np.empty((2, ndim)), checks.flag('skip_inside', skip_inside)
        limit, bits = checks.limit('t_max', t_max), checks.mask(mask)
        motion = self._motion
        if at is None or (motion is None and not at is pace is NOW):
            motion = self._motion_at(at, pace)
        if motion is not None:
            swept, options = (origin, origin, direction), (limit, bits, skip, mode)
            handle, t = motion.cast(self, swept, options, (at, pace), place)
        else:
            handle, t = one_entry(ndim)(
                self._settled().tree, origin, direction, limit, bits, skip, mode, place
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
        locate_entry(self._ndim)(tree, origin, direction, slot, t, axis, place)
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
        at: Any,
        pace: Any,
    ) -> RayHits:
        """First hits, or of any hits no more than ids, in one pass over the memory: what is
        copied, checked or written apart costs a fifth of a ray among 1,000 boxes.
        """
        ndim = self._ndim
        origins, directions = checks.both(checks.RAY_ARGUMENTS, origins, directions, ndim)
        count = len(origins)
        t_max = checks.limits_or_one('t_max', t_max, count)
        masks = checks.masks_or_one(mask, count)
        if skip_inside is not False:
            skip_inside = checks.flag('skip_inside', skip_inside)
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        motion = self._motion
        if at is None or (motion is None and not at is pace is NOW):
            motion = self._motion_at(at, pace, count)
        if motion is not None:
            some = origins, directions, t_max, masks
            return motion.first_many(self, some, skip_inside, mode, (at, pace), threads)
        rays_given = origins, directions, t_max, masks, skip_inside, mode, threads == 1
        return self._first_hits(rays_given, threads)

    def _few_rays(self, rays: Rays) -> bool:
        """Whether rays are so few that they go through the snapshot one by one."""
        return are_few(rays.origins, rays.t_max, self._storage.tree)

    def _ready_snapshot(self) -> tuple[View, Snapshot] | None:
        """The tree and its snapshot, if there is one and nothing was added to it. Whether the tree
        was written to since, kernels see.
        """
        storage, (_, _, snapshot, tree) = self._storage, self._wide
        if tree is not storage.tree or storage.heirs or snapshot is None or snapshot.loose:
            return None
        return storage.latest, snapshot

    def _first_hits(self, rays_given: tuple[Any, ...], threads: int) -> RayHits:
        """`raycast_many` of good input, what a `Rays` holds, of boxes at rest. Rays are counted
        only by one thread.
        """
        origins, _, t_max, _, _, mode, _ = rays_given
        count, ndim = len(origins), self._ndim
        if mode != CLOSEST or count >= LARGE_BATCH:
            hits = room_for_rays(count, ndim, mode)
        else:
            parts = np.empty(count, INT64), np.empty(count), np.empty((count, ndim))
            hits = tuple.__new__(RayHits, parts)
        storage, (_, _, snapshot, tree) = self._storage, self._wide
        # As `_ready_snapshot`, which would take one more call of a function of Python's.
        if threads == 1 and tree is storage.tree and not (storage.heirs or snapshot is None):
            done = REFUSED
            if snapshot.loose:
                pass
            elif are_few(origins, t_max, tree):
                done = few_entry(ndim)(tree, ANY_VERSION, snapshot, rays_given, hits)
            else:
                rays = tuple.__new__(Rays, rays_given)
                done = cast_in_lists(tree, ANY_VERSION, snapshot, rays, hits)
            if done >= 0:
                return hits
        # As Rays(...), which would take one more call of a function of Python's.
        view, rays = self._view(), tuple.__new__(Rays, rays_given)
        snapshot = self._snapshot_for(count, view)
        if threads == 1:
            exact = answer_rays(*view, snapshot, rays, hits)
        else:
            exact = self._cast_in_threads(view, snapshot, rays, hits, threads)
        if exact == NOT_FINITE:
            checks.finite('origins', rays.origins)
            checks.finite('directions', rays.directions)
        accepted(exact)
        return hits

    def _cast_in_threads(
        self, view: View, snapshot: Snapshot | None, rays: Rays, hits: RayHits, threads: int
    ) -> int:
        """How many took exact arithmetic, or why none is counted."""
        count = len(rays.origins)

        def work(start: int, stop: int) -> int:
            part = (rows_of(table, count, slice(start, stop)) for table in (rays, hits))
            return answer_rays(*view, snapshot, *part)

        done = in_threads(work, count, threads, 2 * RAYS_AT_ONCE if snapshot else 1)
        exact: int = min(done) if min(done) < 0 else sum(done)
        # Once all are answered: of what is refused none counts.
        if exact >= 0:
            count_entry(self._ndim)(view.tree, count, exact)
        return exact


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
            Of boxes that have velocities: when the ray starts (a float in s, or an int in ns), and
            how much later it is a unit of t, s. So `t` is when and where a body that moves along
            it meets the first box.

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
        mode = CLOSEST
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
        limit, bits = checks.limit('t_max', t_max), checks.mask(mask)
        motion = self._motion_at(at, pace)
        if motion is not None:
            some = origin[None], direction[None], limit, bits, skip_inside
            every = motion.every_ray(self, some, (at, pace))
            rows = zip(every.ids.tolist(), every.found.ts.tolist(), *every.places, strict=True)
            return [RayHit(*row) for row in rows]
        view, skip = self._view(), checks.flag('skip_inside', skip_inside)
        options = np.array([limit]), np.array([bits]), skip, EVERY, True
        rays = origin[None], direction[None], *options
        _, end, columns = every_hit(view, rays, False)
        hits = [
            self._hit(view, origin, direction, *row)
            for row in zip(*(column[:end].tolist() for column in columns), strict=True)
        ]
        self._check_unchanged(view)
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
        options = t_max, mask, skip_inside, ANY, at, pace
        return self._cast(origin, direction, *options) is not None

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
            One of them may be (ndim,): the same for all rays.
        t_max, mask, at, pace : one for all rays, or array_like of shape (n,)
        threads : int
            The rays are shared among so many threads; the answer does not depend on it.

        Raises
        ------
        ValueError
            As `raycast`; the message names the first bad row.
        """
        mode = CLOSEST
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
        mode = ANY
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
        origins, directions = checks.both(checks.RAY_ARGUMENTS, origins, directions, ndim)
        motion = self._motion
        if motion is not None or not at is pace is NOW:
            motion = self._motion_at(at, pace, len(origins))
        if motion is not None:
            path = (
                checks.points('origins', origins, ndim),
                checks.points('directions', directions, ndim),
            )
            some = *path, t_max, mask, skip_inside
            every = motion.every_ray(self, some, (at, pace))
            return every.offsets, every.ids, every.found.ts
        count = len(origins)
        limits, masks, skip = checks.FOREVER, checks.EVERYTHING, skip_inside
        if t_max is not np.inf:
            limits = checks.limits_or_one('t_max', t_max, count)
        if mask is not ALL:
            masks = checks.masks_or_one(mask, count)
        if skip is not False:
            skip = checks.flag('skip_inside', skip)
        rays = origins, directions, limits, masks, skip, EVERY, True
        offsets, end, (ids, ts, _) = every_hit(self._latest(), rays, True)
        return offsets, ids[:end], ts[:end]
