# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The part of the world whose obstacles a scene keeps."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry.shapes import Floats
from .store.registry import Slots
from .store.updating import Rows, Validated

NOBODY = np.empty(0, np.int64)
Region = tuple[NDArray[np.float64], NDArray[np.float64]]  # lo, hi


def as_region(given: tuple[ArrayLike, ArrayLike] | None, ndim: int) -> Region | None:
    """Corners of a box that may be infinite; ValueError if it is none."""
    if given is None:
        return None
    try:
        lo, hi = (np.array(corner, np.float64) for corner in given)
    except (TypeError, ValueError):
        raise ValueError('region must be two corners') from None
    if lo.shape != (ndim,) or hi.shape != (ndim,) or not (lo <= hi).all():
        raise ValueError(f'region must be two corners of {ndim} numbers, the lower one first')
    return lo, hi


def within(
    region: Region | None, valid: Validated, reach: Floats | None
) -> tuple[Rows, Rows, Slots]:
    """New and known obstacles whose bounds touch the region, or are as near to it as their
    `reach`, see `speeds.reach_of`; and slots of those that leave.
    """
    added, known = valid[:2]
    if region is None:
        return added, known, NOBODY
    new, old = _near(region, added, reach), _near(region, known, reach)
    return added.take(new), known.take(old), known.slot[~old]


def _near(region: Region, rows: Rows, reach: Floats | None) -> NDArray[np.bool_]:
    (lo, hi), more = region, 0.0 if reach is None else reach[rows.row]
    return np.asarray(((rows.lo - more <= hi) & (rows.hi + more >= lo)).all(axis=1))
