# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions that other queries answer in part, and comparisons of doubles decide."""

import numpy as np
from numpy.typing import ArrayLike

from .. import box_checks, checks, handle_checks
from ..introspection import Introspection
from ..nodes import ALL, NONE
from ..store.arrays import Floats, Ids
from .box_queries import BoxQueries
from .within import boxes_within

LARGEST = np.finfo(np.float64).max


class Predicates(BoxQueries, Introspection):
    """What lies in a box or ball, which boxes of two trees touch, and where rays leave boxes."""

    def contains(self, lo: ArrayLike, hi: ArrayLike, mask: int = ALL) -> Ids:
        """Handles of the boxes that lie in the closed box from `lo` to `hi`, shape (ndim,) each,
        with all of their corners; ascending.
        """
        low, high = box_checks.box(lo, hi, self.ndim)
        view = self.view()
        handles = self.overlap(low, high, mask)
        lower, upper = self.boxes(handles)
        self.check_unchanged(view)
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
        view = self.view()
        offsets, handles = self.overlap_many(low, high, mask, threads)
        lo, hi = self.boxes(handles)
        self.check_unchanged(view)
        of = np.repeat(np.arange(len(centres)), np.diff(offsets))
        with np.errstate(over='ignore', invalid='ignore'):
            near = boxes_within(lo, hi, centres[of], centres[of], radii[of])
        kept = np.bincount(of[near], minlength=len(centres))
        return np.concatenate(([0], np.cumsum(kept))), handles[near]

    def pairs_with(self, other: 'Predicates', mask: int = ALL) -> Ids:
        """All pairs of a box of this tree and one of another that touch, shape (m, 2): handles of
        this, handles of that; sorted. `mask`: only boxes with ``box_mask & mask != 0`` are seen.
        """
        if not isinstance(other, Predicates) or other.ndim != self.ndim:
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
        starts = checks.points('origins', origins, self.ndim)
        ways = checks.points('directions', directions, self.ndim, len(starts))
        handles = handle_checks.numbers('ids', ids)
        if handles.shape != (len(starts),):
            raise ValueError(f'ids must have shape ({len(starts)},), not {handles.shape}')
        met = np.flatnonzero(handles != NONE)
        lo, hi = self.boxes(handles[met])
        start, way = starts[met], ways[met]
        with np.errstate(all='ignore'):
            planes = np.where(way > 0.0, hi, lo)
            times, halves = (planes - start) / way, (planes * 0.5 - start * 0.5) / way * 2.0
        times = np.where(np.isfinite(planes - start), times, halves)
        found = np.full(len(starts), np.nan)
        found[met] = np.where(way == 0.0, np.inf, times).min(axis=1)
        return found
