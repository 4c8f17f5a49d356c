# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How rays reach the kernels: those of boxes at rest, or of boxes that move."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import checks
from ..checks import INT64
from ..nodes import View
from ..results import RayHit, RayHits
from ..store.arrays import Floats
from ..store.turns import ANY_VERSION, IS_CHANGED, NOT_FINITE, REFUSED, accepted
from ..store.workers import in_threads
from ..timed import NOW, Timed
from ..wide.few_rays import few_entry
from ..wide.ray_streams import RAYS_AT_ONCE
from ..wide.snapshot import Snapshot
from . import ray_batches, ray_hits
from .ray_batches import LARGE, rows_of
from .raycasting import CLOSEST, Rays


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
        limit, seen = checks.limit('t_max', t_max), checks.mask(mask)
        motion = self._motion
        if at is None or (motion is None and not at is pace is NOW):
            motion = self._motion_at(at, pace)
        if motion is not None:
            swept, asked = (origin, origin, direction), (limit, seen, skip, mode)
            handle, t = motion.cast(self, swept, asked, (at, pace), place)
        else:
            handle, t = ray_hits.one_entry(ndim)(
                self._settled().tree, origin, direction, limit, seen, skip, mode, place
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
        at: Any,
        pace: Any,
    ) -> RayHits:
        """First hits, or of any hits no more than ids, in one pass over the memory: what is
        copied, checked or written apart costs a fifth of a ray among 1,000 boxes.
        """
        ndim = self._ndim
        origins, directions = checks.both(checks.WAYS, origins, directions, ndim)
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
        asked = origins, directions, t_max, masks, skip_inside, mode, threads == 1
        return self.first_hits(asked, threads)

    def few_rays(self, rays: Rays) -> bool:
        """Whether rays are so few that they go through the snapshot one by one."""
        return ray_batches.are_few(rays.origins, rays.t_max, self._storage.tree)

    def ready_snapshot(self) -> tuple[View, Snapshot] | None:
        """The tree and its snapshot, if there is one and nothing was added to it. Whether the tree
        was written to since, kernels see.
        """
        storage, (_, _, snapshot, tree) = self._storage, self._wide
        if tree is not storage.tree or storage.heirs or snapshot is None or snapshot.loose:
            return None
        return storage.latest, snapshot

    def first_hits(self, asked: tuple[Any, ...], threads: int) -> RayHits:
        """`raycast_many` of good input, what a `Rays` holds, of boxes at rest; rays are counted
        where they are asked for by one thread.
        """
        origins, _, t_max, _, _, mode, _ = asked
        count, ndim = len(origins), self._ndim
        if mode != CLOSEST or count >= LARGE:
            hits = ray_batches.room_for(count, ndim, mode)
        else:
            parts = np.empty(count, INT64), np.empty(count), np.empty((count, ndim))
            hits = tuple.__new__(RayHits, parts)
        storage, (_, _, snapshot, tree) = self._storage, self._wide
        # As `ready_snapshot`, which would take one more call of a function of Python's.
        if threads == 1 and tree is storage.tree and not (storage.heirs or snapshot is None):
            done = REFUSED
            if snapshot.loose:
                pass
            elif ray_batches.are_few(origins, t_max, tree):
                done = few_entry(ndim)(tree, ANY_VERSION, snapshot, asked, hits)
            else:
                rays = tuple.__new__(Rays, asked)
                done = ray_batches.cast_in_lists(tree, ANY_VERSION, snapshot, rays, hits)
            if done >= 0:
                return hits
        # As Rays(...), which would take one more call of a function of Python's.
        view, rays = self.view(), tuple.__new__(Rays, asked)
        snapshot = self.snapshot_for(count, view)
        if threads == 1:
            exact = ray_batches.cast(*view, snapshot, rays, hits)
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
            return ray_batches.cast(*view, snapshot, *part)

        done = in_threads(work, count, threads, 2 * RAYS_AT_ONCE if snapshot else 1)
        exact: int = min(done) if min(done) < 0 else sum(done)
        # Once all are answered: of what is refused none counts.
        if exact >= 0:
            ray_hits.count_entry(self._ndim)(view.tree, count, exact)
        return exact
