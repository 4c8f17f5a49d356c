# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What touches a box, which boxes touch each other, what a box meets on its way, and which boxes
are nearest to a point.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..nodes import ALL, COUNT, NONE, ROOT, aligned_empty, box_dtype
from ..rays import boxcasting, ray_hits
from ..rays.slab import RAY_ROWS
from ..results import RayHit
from ..store.arrays import Arrays, Floats, Ids
from ..store.turns import IS_CHANGED
from ..store.workers import in_threads
from . import nearest, nearest_packets, ordering, overlapping, pairs

# Batches of points dense enough for eight neighbours to share their way: as many points a box, and
# at least so many points. Chosen, not tuned: at 1/10 eight at a time was slower than one by one.
PACKETS_PER_BOX, LEAST_PACKETS = 1 / 4, 64


class BoxQueries(Arrays):
    """What touches, what comes to touch, and what is near."""

    def overlap(self, lo: ArrayLike, hi: ArrayLike, mask: int = ALL) -> Ids:
        """Handles of the boxes that touch the closed box from `lo` to `hi`, shape (ndim,) each;
        ascending.
        """
        low, high = checks.box(lo, hi, self.ndim)
        return self._touching(low[None], high[None], checks.masks(checks.mask(mask), 1), 1)[1]

    def overlap_many(
        self, lo: ArrayLike, hi: ArrayLike, mask: ArrayLike = ALL, threads: int = 1
    ) -> tuple[Ids, Ids]:
        """Overlaps of n query boxes, shape (n, ndim) each: (offsets, ids).

        Those of query i are ``ids[offsets[i]:offsets[i + 1]]``, ascending. Touching counts.
        """
        low, high = checks.boxes(lo, hi, self.ndim)
        return self._touching(low, high, checks.masks(mask, len(low)), threads)

    def _touching(
        self, low: Floats, high: Floats, seen: NDArray[np.uint32], threads: int
    ) -> tuple[Ids, Ids]:
        """`overlap_many` of good input."""
        count = len(low)
        queries = np.empty(count, box_dtype(self.ndim))
        queries['lo'], queries['hi'] = low, high
        sizes = np.empty(count, np.int64)
        view = self.view()

        def work(start: int, stop: int) -> Ids:
            return overlapping.overlap_many(view, queries, seen, start, stop, sizes)

        handles = np.concatenate(in_threads(work, count, threads))
        offsets = np.zeros(count + 1, np.int64)
        np.cumsum(sizes, out=offsets[1:])
        if count == 1:
            return offsets, np.sort(handles)
        order = np.lexsort((handles, np.repeat(np.arange(count), sizes)))
        return offsets, handles[order]

    def overlap_pairs(self, mask: int = ALL) -> Ids:
        """All pairs of touching boxes, shape (m, 2): each once, the smaller handle first,
        sorted.
        """
        seen = checks.mask(mask)
        view = self.view()
        boxes = view[3].item(COUNT)
        packed = aligned_empty(pairs.blocks_needed(boxes), pairs.block_dtype(self.ndim))
        top = pairs.pack(*view, seen, packed)
        if top == pairs.REFUSED:
            raise RuntimeError(IS_CHANGED)
        if top == NONE:
            return np.empty((0, 2), np.int64)
        slots = np.empty(max(4 * boxes, 64), np.int64)
        count = pairs.touching_pairs(packed, top, slots)
        if count > len(slots):
            slots = np.empty(count, np.int64)
            pairs.touching_pairs(packed, top, slots)
        one, other = view[2][slots[:count].reshape(-1, 2).T]
        self.check_unchanged(view)
        smaller, larger = np.minimum(one, other), np.maximum(one, other)
        order = np.lexsort((larger, smaller))
        return np.column_stack((smaller[order], larger[order]))

    def boxcast(
        self, lo: ArrayLike, hi: ArrayLike, translation: ArrayLike, mask: int = ALL
    ) -> RayHit | None:
        """Return the first box that the box from `lo` to `hi` touches while it moves by
        `translation`.

        Parameters
        ----------
        lo, hi : array_like, shape (ndim,)
            The swept box where it starts; it is closed and does not turn. A point is a ray.
        translation : array_like, shape (ndim,)
            How far it goes, m. Zero asks what the box touches where it is.
        mask : int
            Only boxes with ``box_mask & mask != 0`` are seen.

        Returns
        -------
        RayHit or None
            `t` is the share of the translation until they touch, from 0 to 1; touching at the very
            end counts. `normal` is that of the face of the other box that is met, zero where they
            touch at the start. `point` is, of all points in which the two then touch, the closest
            to the swept box's centre; it lies in the other box, on that face. Whether they touch,
            and which box is first, is decided exactly, ties by the smaller handle.

        Raises
        ------
        ValueError
            If an argument has the wrong shape or is not finite, or `lo` exceeds `hi`.

        Examples
        --------
        >>> from bvh_ros import DynamicBVH
        >>> tree = DynamicBVH(ndim=2)
        >>> wall = tree.insert([4, -1], [5, 1])
        >>> hit = tree.boxcast([-1, 0], [1, 2], [6, 0])
        >>> hit.id == wall, hit.t, hit.point.tolist(), hit.normal.tolist()
        (True, 0.5, [4.0, 1.0], [-1.0, 0.0])
        """
        low, high = checks.box(lo, hi, self.ndim)
        way = checks.point('translation', translation, self.ndim)
        ray, place = np.empty((RAY_ROWS, self.ndim)), np.empty((2, self.ndim))
        handle, t = boxcasting.boxcast(
            *self.view()[:4], low, high, way, checks.mask(mask), ray, place
        )
        if handle == ray_hits.REFUSED:
            raise RuntimeError(IS_CHANGED)
        return None if handle < 0 else RayHit(int(handle), t, place[0], place[1])

    def nearest(
        self, point: ArrayLike, k: int = 1, max_distance: float = np.inf, mask: int = ALL
    ) -> tuple[Ids, Floats]:
        """The up to k boxes nearest to `point` within `max_distance` (m): (ids, distances),
        nearest first, ties by handle.

        The distance is 0 inside a box, and within 4 roundings of the exact one (see
        `tree.proximity`).
        """
        where = checks.point('point', point, self.ndim)
        k = min(checks.capacity('k', k), max(len(self), 1))
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
        k = checks.capacity('k', k)
        count = len(where)
        reaches, seen = (
            checks.limits('max_distance', max_distance, count),
            checks.masks(mask, count),
        )
        ids, distances = np.empty((count, k), np.int64), np.empty((count, k))
        asked = k, reaches, seen, ids, distances
        view = self.view()
        boxes = view[3].item(COUNT)
        if boxes and count >= max(PACKETS_PER_BOX * boxes, LEAST_PACKETS):
            keys, order, spare = np.empty((3, count), np.int64)
            root = view[0][view[3].item(ROOT)]
            ordering.neighbour_order(where, root['lo'], root['hi'], keys, order, spare)
            answered = nearest_packets.nearest_packets(*view, where, order, *asked)
        else:
            answered = nearest.nearest_many(*view, where, *asked)
        if not answered:
            raise RuntimeError(IS_CHANGED)
        return ids, distances
