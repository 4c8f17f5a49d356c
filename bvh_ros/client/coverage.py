# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which regions a box touches, and whether all of it lies in regions."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Box = tuple[Floats, Floats]  # lower and upper corners, (n, 3) m


class Coverage:
    """The regions of several nodes, closed boxes.

    Along each axis their finite faces cut the world into planes and gaps. A cell is a plane or a
    gap of each axis. A region holds all of a cell or nothing. So the number of cells of a box
    that lie in no region is a sum over a table.

    Parameters
    ----------
    lo, hi : ndarray, shape (regions, 3)
        Corners, m; may be infinite.
    """

    def __init__(self, lo: Floats, hi: Floats) -> None:
        self.lo, self.hi = lo, hi
        faces = np.concatenate((lo, hi))
        self._planes = [np.unique(x[np.isfinite(x)]) for x in faces.T]
        unknown = np.ones([2 * len(planes) + 1 for planes in self._planes], np.int64)
        for first, last in zip(self._cells(lo), self._cells(hi), strict=True):
            unknown[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))] = 0
        self._unknown_below = np.zeros([size + 1 for size in unknown.shape], np.int64)
        self._unknown_below[1:, 1:, 1:] = unknown.cumsum(0).cumsum(1).cumsum(2)

    def owners(self, box: Box) -> NDArray[np.bool_]:
        """Return which regions together know all that touches each box, (n, regions): the first
        one that holds all of it; where there is none, all that the box touches.
        """
        lo, hi = box[0][:, None], box[1][:, None]
        whole: Any = ((self.lo <= lo) & (self.hi >= hi)).all(axis=2)
        first = whole & (np.cumsum(whole, axis=1) == 1)
        touched = ((self.lo <= hi) & (self.hi >= lo)).all(axis=2)
        return np.asarray(np.where(whole.any(axis=1)[:, None], first, touched))

    def covers(self, box: Box) -> NDArray[np.bool_]:
        """Whether every point of each box lies in a region, (n,)."""
        ends = self._cells(box[0]), self._cells(box[1]) + 1
        unknown = np.zeros(len(box[0]), np.int64)
        for corner in itertools.product((0, 1), repeat=3):
            sign = -1 if sum(corner) % 2 == 0 else 1
            unknown += (
                sign
                * self._unknown_below[tuple(ends[end][:, axis] for axis, end in enumerate(corner))]
            )
        return unknown == 0

    def holds(self, regions: NDArray[np.int64], places: Floats) -> NDArray[np.bool_]:
        """Whether each place, (n, 3), lies in the region of a number, (n,)."""
        inside = (self.lo[regions] <= places) & (self.hi[regions] >= places)
        return np.asarray(inside.all(axis=1))

    def _cells(self, places: Floats) -> NDArray[np.int64]:
        """Numbers of cells along each axis, (n, 3): planes are odd, gaps are even."""
        cells = np.empty(places.shape, np.int64)
        for axis, planes in enumerate(self._planes):
            below = np.searchsorted(planes, places[:, axis], 'left')
            cells[:, axis] = below + np.searchsorted(planes, places[:, axis], 'right')
        return cells


def grown(box: Box, lengths: Any) -> Box:
    """Boxes that are larger by lengths, (n,) or (n, 3), on both sides; rounded outwards."""
    by = np.asarray(lengths)
    by = by[:, None] if by.ndim == 1 else by
    return -total(-box[0], by), total(box[1], by)


def total(a: Floats, b: Any) -> Floats:
    """a + b, or the next larger double where that is not exact."""
    with np.errstate(over='ignore', invalid='ignore'):
        rounded = a + b
        share = rounded - a
        exact = (a - (rounded - share)) + (b - share) == 0.0  # Knuth, TAOCP 2, 4.2.2, theorem B
        return np.where(exact, rounded, np.nextafter(rounded, np.inf))


def swept(origins: Floats, directions: Floats, t: Floats, radii: Any) -> Box:
    """Bounds of balls that go along ``origins + t * directions``; rounded outwards."""
    lengths = t[:, None]
    with np.errstate(over='ignore', invalid='ignore'):
        moved = np.where(directions == 0.0, 0.0, lengths * directions)
    exact = np.isin(np.abs(directions), (0.0, 1.0)) | np.isin(lengths, (0.0, 1.0))
    most, least = (np.where(exact, moved, np.nextafter(moved, end)) for end in (np.inf, -np.inf))
    lo = np.minimum(origins, -total(-origins, -least))
    return grown((lo, np.maximum(origins, total(origins, most))), radii)
