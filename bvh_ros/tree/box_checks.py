# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bounds of boxes made sound before they reach a kernel, see `checks`."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import Floats, capacity, copied_rows, finite, point, unless_refused
from .compiler import entry_point, lean_kernel
from .nodes import SLOT_MASK


@lean_kernel
def _first_no_box(lo, hi):
    """The first row of lo and hi, (n, ndim) float64, that is not finite or has lo > hi; else -1"""
    low, high = lo.reshape(lo.size), hi.reshape(lo.size)
    # Without a way out of the loop it is one of vectors.
    good = True
    for i in range(low.size):
        good &= (-np.inf < low[i]) & (low[i] <= high[i]) & (high[i] < np.inf)
    if good:
        return -1
    for i in range(lo.shape[0]):
        for j in range(lo.shape[1]):
            if not (-np.inf < lo[i, j] <= hi[i, j] < np.inf):
                return i
    return -1


@functools.cache
def _first_entry() -> Callable[..., Any]:
    """The machine code of `_first_no_box`."""
    return entry_point(_first_no_box, np.empty((0, 3)), np.empty((0, 3)))


def boxes(
    lo: ArrayLike, hi: ArrayLike, ndim: int, count: int | None = None
) -> tuple[Floats, Floats]:
    """Rows of boxes: finite, lo <= hi on every axis."""
    low = copied_rows('lo', lo, ndim, count)
    high = copied_rows('hi', hi, ndim, len(low))
    row = _first_entry()(low, high)
    if row >= 0:
        finite('lo', low)
        finite('hi', high)
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


def few_enough(lo: ArrayLike) -> None:
    """Refuse more boxes than a tree can hold, before they are copied."""
    if isinstance(lo, np.ndarray) and lo.ndim > 1 and len(lo) > SLOT_MASK:
        capacity('the number of rows of lo', max(len(lo), 1))


def no_box(lo: ArrayLike, hi: ArrayLike, ndim: int) -> ValueError:
    """What is raised where a kernel says that these are no box."""
    box(lo, hi, ndim)
    return were_changed()


def were_changed() -> ValueError:
    """What is raised where a kernel was given other numbers than are there now."""
    return ValueError('lo and hi were changed while they were read')
