# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps, pairs, swept boxes, nearest boxes. Each method checks its input and calls a kernel."""

import functools
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..checks import INT64
from ..introspection import Introspection
from ..nodes import ALL, COUNT, NONE, aligned_empty
from ..results import RayHit
from ..store.arrays import Floats, Ids
from ..store.turns import IS_CHANGED, NOT_FINITE, REFUSED, accepted
from ..timed import NOW
from . import nearest, overlap, pairs
from .ray import CLOSEST, boxcast_entry


def lengths(vectors: Floats) -> Floats:
    """Euclidean lengths of rows.

    Scaled by a power of two, so that squares neither overflow nor vanish.
    """
    exponent = np.frexp(np.abs(vectors).max(axis=1, initial=0.0))[1]
    scaled = np.ldexp(vectors, -exponent[:, None])
    result: Floats = np.ldexp(np.sqrt((scaled * scaled).sum(axis=1)), exponent)
    return result


def boxes_within(
    lo: Floats, hi: Floats, query_lo: Floats, query_hi: Floats, tolerance: ArrayLike
) -> NDArray[np.bool_]:
    """Whether axis-aligned boxes, shape (n, ndim), are within the tolerance of another one, or
    each of its own, of shape (ndim,) or (n, ndim); `tolerance` is one for all or (n,).
    """
    distances = lengths(np.maximum(np.maximum(lo - query_hi, query_lo - hi), 0.0))
    reach = np.broadcast_to(np.asarray(tolerance, np.float64), distances.shape)
    near: NDArray[np.bool_] = distances <= reach
    # A gap is rounded once, the length a few times: only next to the tolerance may that decide.
    close = np.flatnonzero(np.abs(distances - reach) <= 2.0**-49 * reach)
    others = (np.broadcast_to(side, lo.shape)[close] for side in (query_lo, query_hi))
    gaps, reach = _exact_gaps(lo[close], hi[close], *others), reach[close]
    axes = (gaps[:, 0] > 0.0).sum(axis=1)
    # Along one axis: a sum that rounds to the tolerance is larger if its second part is positive.
    first, rest = gaps.sum(axis=2).T
    near[close] = (first < reach) | ((first == reach) & (rest <= 0.0))
    slanted = close[axes > 1]
    if len(slanted):  # voxels that far away are many, but their gaps few
        table = np.column_stack((gaps[axes > 1].reshape(len(slanted), -1), reach[axes > 1]))
        known, of = np.unique(table, axis=0, return_inverse=True)
        squares = (
            sum((Fraction(a) + Fraction(b)) ** 2 for a, b in row)
            for row in known[:, :-1].reshape(len(known), 2, -1).transpose(0, 2, 1).tolist()
        )
        limits = known[:, -1].tolist()
        closer = [
            square <= Fraction(limit) ** 2 for square, limit in zip(squares, limits, strict=True)
        ]
        near[slanted] = np.array(closer)[of.ravel()]
    return near


def _exact_gaps(lo: Floats, hi: Floats, query_lo: Floats, query_hi: Floats) -> Floats:
    """The gaps (n, 2, ndim) between boxes and another along each axis, unrounded: each is the sum
    of two doubles, the second below the last digit of the first (Knuth's TwoSum).
    """
    above, below = lo - query_hi, query_lo - hi
    a = np.where(above > 0.0, lo, query_lo)
    b = np.where(above > 0.0, query_hi, hi)
    gap = np.maximum(np.maximum(above, below), 0.0)
    part = gap - a
    lost = (a - (gap - part)) + (-b - part)
    return np.stack((gap, np.where(gap > 0.0, lost, 0.0)), axis=1)


FEW_NEAREST = 64  # a larger k makes no more room than for all boxes
LARGEST = np.finfo(np.float64).max


class BoxQueries(Introspection):
    """Overlaps, pairs, swept boxes and nearest boxes, and what follows from these."""

    def overlap(
        self, lo: ArrayLike, hi: ArrayLike, mask: int = ALL, at: float | None = NOW
    ) -> Ids:
        """Handles of the boxes that touch the closed box from `lo` to `hi`, shape (ndim,) each;
        ascending. `at`: when, s, of boxes that have velocities.
        """
        ndim, found = self._ndim, np.empty(overlap.FEW, np.int64)
        low, high = checks.vector('lo', lo, ndim), checks.vector('hi', hi, ndim)
        bits = checks.mask(mask)
        motion = self._motion
        if at is None or (motion is None and at is not NOW):
            motion = self._motion_at(at)
        kernel = (overlap if motion is None else motion.overlap).one_entry(ndim)
        while True:
            if motion is None:
                count = kernel(self._settled().tree, low, high, bits, found)
            else:
                count = motion.ask_one(self, kernel, at, low, high, bits, found)
            if 0 <= count <= len(found):
                break
            _refuse(count, low, high, ndim)
            found = np.empty(count, np.int64)
        handles = found[:count]
        if count > 1:
            handles.sort()
        return handles

    def overlap_many(
        self,
        lo: ArrayLike,
        hi: ArrayLike,
        mask: ArrayLike = ALL,
        threads: int = 1,
        at: ArrayLike | None = NOW,
    ) -> tuple[Ids, Ids]:
        """Overlaps of n query boxes, shape (n, ndim) each: (offsets, ids).

        Those of query i are ``ids[offsets[i]:offsets[i + 1]]``, ascending. Touching counts. `at`:
        when, s, of boxes that have velocities; one for all or of shape (n,).
        """
        ndim = self._ndim
        low = checks.rows('lo', lo, ndim)
        count = len(low)
        high, masks = checks.rows('hi', hi, ndim, count), checks.masks_or_one(mask, count)
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        motion = self._motion
        if at is None or (motion is None and at is not NOW):
            motion = self._motion_at(at, count=count)
        kernel = (overlap if motion is None else motion.overlap).rows_entry(ndim)
        # As Queries(...), which would take one more call of a Python function.
        queries = tuple.__new__(overlap.Queries, (low, high, masks))
        ask = functools.partial(overlap.overlap_many, kernel, queries, threads)
        if motion is None:
            found = ask(*self._view())
        else:
            found = motion.ask_rows(self, ask, at, count)
        if isinstance(found, tuple):
            return found
        if found == NOT_FINITE:
            checks.boxes(low, high, ndim)
            raise checks.were_changed()
        raise RuntimeError(IS_CHANGED)

    def overlap_pairs(self, mask: int = ALL) -> Ids:
        """All pairs of touching boxes, shape (m, 2): each once, the smaller handle first,
        sorted.
        """
        ndim, bits = self._ndim, checks.mask(mask)
        view = self._view()
        boxes = view.tree.state.item(COUNT)
        packed = aligned_empty(pairs.blocks_needed(boxes), pairs.block_dtype(ndim))
        top = pairs.pack_entry(ndim)(*view, bits, packed)
        if top == REFUSED:
            raise RuntimeError(IS_CHANGED)
        if top == NONE:
            return np.empty((0, 2), np.int64)
        slots = np.empty(max(4 * boxes, 64), np.int64)
        find = pairs.pairs_entry(ndim)
        count = find(packed, top, slots)
        if count > len(slots):
            slots = np.empty(count, np.int64)
            find(packed, top, slots)
        one, other = view.tree.handles[slots[:count].reshape(-1, 2).T]
        self._check_unchanged(view)
        smaller, larger = np.minimum(one, other), np.maximum(one, other)
        order = np.lexsort((larger, smaller))
        return np.column_stack((smaller[order], larger[order]))

    def boxcast(
        self,
        lo: ArrayLike,
        hi: ArrayLike,
        translation: ArrayLike,
        mask: int = ALL,
        at: float | None = NOW,
        pace: float = NOW,
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
            Only boxes with ``box_mask & mask != 0`` count.
        at, pace : float
            Of boxes that have velocities: when it starts, and how long it takes, s.

        Returns
        -------
        RayHit or None
            `t` is the share of the translation until they touch, from 0 to 1; touching at the very
            end counts. `normal` is that of the face of the other box that is hit, zero where they
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
        ndim = self._ndim
        low, high = checks.vector('lo', lo, ndim), checks.vector('hi', hi, ndim)
        translation, place = checks.vector('translation', translation, ndim), np.empty((2, ndim))
        bits = checks.mask(mask)
        motion = self._motion
        if at is None or (motion is None and not at is pace is NOW):
            motion = self._motion_at(at, pace)
        if motion is not None:
            query = 1.0, bits, False, CLOSEST
            handle, t = motion.cast(self, (low, high, translation), query, (at, pace), place)
        else:
            handle, t = boxcast_entry(ndim)(
                self._settled().tree, low, high, translation, bits, place
            )
        if handle >= 0:
            return RayHit(handle, t, place[0], place[1])
        if handle == NOT_FINITE:
            checks.point('translation', translation, ndim)
        if handle != NONE:
            _refuse(handle, low, high, ndim)
        return None

    def nearest(
        self,
        point: ArrayLike,
        k: int = 1,
        max_distance: float = np.inf,
        mask: int = ALL,
        at: float | None = NOW,
    ) -> tuple[Ids, Floats]:
        """The up to k boxes nearest to `point` within `max_distance` (m): (ids, distances),
        nearest first, ties by handle.

        `point` has shape (ndim,), or is the box (lo, hi) of shape (2, ndim). The distance is 0
        inside a box, and within 4 roundings of the exact one (see `boxes.nearest`). `at`: when, s,
        of boxes that have velocities.
        """
        ndim = self._ndim
        if checks.is_pair(point):
            low, high = checks.pair('point', point, ndim)
        else:
            low = high = checks.vector('point', point, ndim)
        k = checks.capacity('k', k)
        if k > FEW_NEAREST:  # not more room than for all
            k = min(k, max(len(self), 1))
        limit, bits = checks.limit('max_distance', max_distance), checks.mask(mask)
        motion = self._motion
        if at is None or (motion is None and at is not NOW):
            motion = self._motion_at(at)
        ids, distances = np.empty(k, np.int64), np.empty(k)
        kernel = (nearest if motion is None else motion.nearest).one_entry(ndim)
        if motion is None:
            count = kernel(self._settled().tree, low, high, k, limit, bits, ids, distances)
        else:
            count = motion.ask_one(self, kernel, at, low, high, k, limit, bits, ids, distances)
        if count == k:
            return ids, distances
        if count == NOT_FINITE:
            checks.point('point', low, ndim)
        if count < 0:
            raise RuntimeError(IS_CHANGED)
        return ids[:count], distances[:count]

    def nearest_many(
        self,
        points: ArrayLike,
        k: int = 1,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        at: ArrayLike | None = NOW,
    ) -> tuple[Ids, Floats]:
        """`nearest` for n points: arrays of shape (n, k), padded with id -1 and distance inf."""
        ndim = self._ndim
        where, k = checks.rows('points', points, ndim), checks.capacity('k', k)
        count = len(where)
        motion = self._motion
        if at is None or (motion is None and at is not NOW):
            motion = self._motion_at(at, count=count)
        reaches = checks.limits_or_one('max_distance', max_distance, count)
        masks, order = checks.masks_or_one(mask, count), nearest.NO_ORDER
        kernels = nearest if motion is None else motion.nearest
        kernel = kernels.rows_entry(ndim)
        if count >= nearest.FEW:
            checks.finite('points', where)
            tree = self._settled().tree
            dense = nearest.are_dense(count, tree.state.item(COUNT))
            if dense or count >= nearest.MANY:
                order = nearest.order_of(tree, where)
            if dense and len(order):  # none: another thread empties or rebuilds the tree
                kernel = kernels.packets_entry(ndim)
        # As PointQueries(...), which would take one more call of a Python function.
        queries = tuple.__new__(nearest.PointQueries, (where, k, reaches, masks, order))
        ids, distances = np.empty((count, k), INT64), np.empty((count, k))
        if motion is None:
            done = kernel(*self._view(), queries, ids, distances)
        else:
            done = motion.ask_rows(self, kernel, at, count, queries, ids, distances)
        if done == NOT_FINITE:
            checks.finite('points', where)
        accepted(done)
        return ids, distances

    # ---- answered by the queries above, and by comparisons of doubles

    def contains(self, lo: ArrayLike, hi: ArrayLike, mask: int = ALL) -> Ids:
        """Handles of the boxes that lie in the closed box from `lo` to `hi`, shape (ndim,) each,
        with all of their corners; ascending.
        """
        low, high = checks.box(lo, hi, self.ndim)
        view = self._view()
        handles = self.overlap(low, high, mask)
        lower, upper = self.boxes(handles)
        self._check_unchanged(view)
        return handles[((low <= lower) & (upper <= high)).all(axis=1)]

    def query_ball(
        self, points: ArrayLike, r: ArrayLike, mask: ArrayLike = ALL, threads: int = 1
    ) -> tuple[Ids, Ids]:
        """Boxes that a ball touches, n times: (offsets, ids).

        Those of ball i are ``ids[offsets[i]:offsets[i + 1]]``, ascending. Whether a box is within
        the radius is decided exactly.

        Parameters
        ----------
        points : array_like, shape (n, ndim)
            Centres.
        r : float, or array_like of shape (n,)
            Radii, m; finite.
        mask : one for all balls, or array_like of shape (n,)
        threads : int
            The balls are shared among so many threads.
        """
        centres = checks.points('points', points, self.ndim)
        radii = checks.limits('r', r, len(centres))
        if np.isinf(radii).any():
            raise ValueError(f'r must be finite: row {np.argmax(np.isinf(radii))} is inf')
        with np.errstate(over='ignore'):
            grown = np.nextafter(radii, np.inf)[:, None]
            low = np.maximum(np.nextafter(centres - grown, -np.inf), -LARGEST)
            high = np.minimum(np.nextafter(centres + grown, np.inf), LARGEST)
        view = self._view()
        offsets, handles = self.overlap_many(low, high, mask, threads)
        lo, hi = self.boxes(handles)
        self._check_unchanged(view)
        of = np.repeat(np.arange(len(centres)), np.diff(offsets))
        with np.errstate(over='ignore', invalid='ignore'):
            near = boxes_within(lo, hi, centres[of], centres[of], radii[of])
        counts = np.bincount(of[near], minlength=len(centres))
        return np.concatenate(([0], np.cumsum(counts))), handles[near]

    def pairs_with(self, other: 'BoxQueries', mask: int = ALL) -> Ids:
        """All pairs of a box of this tree and one of another that touch, shape (m, 2): handles of
        this, handles of that; sorted. `mask`: only boxes with ``box_mask & mask != 0`` count.
        """
        if not isinstance(other, BoxQueries) or other.ndim != self.ndim:
            raise ValueError(f'other must be a tree of {self.ndim} dimensions')
        theirs = other.ids()
        theirs = theirs[(other.masks(theirs) & checks.mask(mask)) != 0]
        offsets, ours = self.overlap_many(*other.boxes(theirs), mask)
        pairs = np.column_stack((ours, np.repeat(theirs, np.diff(offsets))))
        return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]

    def exits(self, origins: ArrayLike, directions: ArrayLike, ids: ArrayLike) -> Floats:
        """Where n rays leave boxes that they meet: t_exit, shape (n,), within 2 ulp.

        Parameters
        ----------
        origins, directions : array_like, shape (n, ndim)
            As in `raycast_many`; of `raycast_all_many` each as often as it has hits.
        ids : array_like, shape (n,)
            The box of each ray, or -1.

        Returns
        -------
        (n,) float64
            In units of the directions, whatever `t_max` was; inf for a zero direction, and where
            it exceeds the largest double; NaN where the id is -1.
        """
        given = checks.RAY_ARGUMENTS, origins, directions, self.ndim
        starts, rays = checks.points_of_both(*given)
        handles = checks.numbers('ids', ids)
        if handles.shape != (len(starts),):
            raise ValueError(f'ids must have shape ({len(starts)},), not {handles.shape}')
        rows = np.flatnonzero(handles != NONE)
        lo, hi = self.boxes(handles[rows])
        start, direction = starts[rows], rays[rows]
        with np.errstate(all='ignore'):
            planes = np.where(direction > 0.0, hi, lo)
            times = (planes - start) / direction
            halves = (planes * 0.5 - start * 0.5) / direction * 2.0
        times = np.where(np.isfinite(planes - start), times, halves)
        exits = np.full(len(starts), np.nan)
        exits[rows] = np.where(direction == 0.0, np.inf, times).min(axis=1)
        return exits


def _refuse(reason: int, low: Floats, high: Floats, ndim: int) -> None:
    """Raise what a query of one box was refused for, if it was."""
    if reason == NOT_FINITE:
        checks.box(low, high, ndim)
    if reason < 0:
        raise RuntimeError(IS_CHANGED)
