# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether boxes are within a distance of others, as real arithmetic decides."""

from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


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
