# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bounds of boxes made sound before they reach a kernel, see `checks`."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import Floats, finite, point, points, unless_refused
from .jit.compiling import kernel


@kernel
def _first_reversed(lo, hi):
    for i in range(lo.shape[0]):
        for j in range(lo.shape[1]):
            if lo[i, j] > hi[i, j]:
                return i
    return -1


def boxes(
    lo: ArrayLike, hi: ArrayLike, ndim: int, count: int | None = None
) -> tuple[Floats, Floats]:
    """Rows of boxes: finite, lo <= hi on every axis."""
    low = points('lo', lo, ndim, count)
    high = points('hi', hi, ndim, len(low))
    row = _first_reversed(low, high)
    if row >= 0:
        raise ValueError(
            f'lo must not exceed hi: row {row} has lo {low[row].tolist()} '
            f'and hi {high[row].tolist()}'
        )
    return low, high


def box(lo: ArrayLike, hi: ArrayLike, ndim: int) -> tuple[Floats, Floats]:
    """One box: finite, lo <= hi on every axis."""
    low, high = point('lo', lo, ndim), point('hi', hi, ndim)
    if not (low <= high).all():
        raise ValueError(f'lo must not exceed hi: lo is {low.tolist()} and hi is {high.tolist()}')
    return low, high


def is_pair(value: Any) -> bool:
    """Whether it may be a box, as (lo, hi), rather than a point."""
    if type(value) is np.ndarray:
        return value.ndim == 2
    return (
        type(value) in (list, tuple)
        and len(value) == 2
        and (type(value[0]) in (list, tuple) or getattr(value[0], 'ndim', 0) == 1)
    )


def pair(name: str, value: ArrayLike, ndim: int) -> tuple[Floats, Floats]:
    """A box as (lo, hi), finite, lo <= hi."""
    array = unless_refused(name, value, (2, ndim))
    if array.shape != (2, ndim):
        raise ValueError(f'{name} must have shape ({ndim},) or (2, {ndim}), not {array.shape}')
    finite(name, array)
    low, high = array
    if not (low <= high).all():
        raise ValueError(f'{name} must not have lo {low.tolist()} beyond hi {high.tolist()}')
    return low, high


def no_box(lo: ArrayLike, hi: ArrayLike, ndim: int) -> ValueError:
    """What is raised where a kernel says that these are no box."""
    box(lo, hi, ndim)
    return ValueError('lo and hi were changed while they were read')
