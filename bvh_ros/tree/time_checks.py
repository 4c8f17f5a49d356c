# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times made sound before they reach a kernel, see `checks`.

A moment is a float in seconds or an integer in nanoseconds, as of `time.time()` and
`time.time_ns()`. A pace is in seconds, of whatever type.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checks import FLOAT64, Floats, first_not_finite, one, only, unless_refused

FIRST_TIME, LAST_TIME = -(1 << 63), (1 << 63) - 1  # what a time in ns can be


def whole_ns(name: str, seconds: Floats) -> NDArray[np.int64]:
    """Times in s as the nearest whole ns."""
    last = LAST_TIME // 10**9
    if not (np.abs(seconds) <= last).all():
        raise ValueError(f'{name} must be finite, and at most {last} s')
    # Of a shorter type the product would be rounded to that type.
    seconds = seconds.astype(np.promote_types(seconds.dtype, np.float64))
    whole = np.floor(seconds)  # the rest is exact, and so small that its product is rounded once
    rest = np.rint((seconds - whole) * 1e9).astype(np.int64)
    return np.asarray(whole.astype(np.int64) * 10**9 + rest)


def _in_seconds(name: str, value: Any, shape: tuple[int, ...]) -> Floats:
    """As `unless_refused`, with integers of a moment brought to seconds."""
    array = unless_refused(name, value, shape)
    if name != 'pace' and array.shape in ((), shape):
        given = np.asarray(value)
        if given.dtype.kind in 'iu':
            return np.asarray(given.astype(np.longdouble) / 10**9, np.float64)
    return array


def moment(name: str, value: Any) -> float:
    """One finite number."""
    number = value if type(value) is float else one(name, _in_seconds(name, value, ()))
    if not math.isfinite(number):
        raise ValueError(f'{name} must be finite, not {number}')
    return number


def times(name: str, value: Any, count: int) -> Floats:
    """As `moments`, but not known to be finite, and the caller's memory where that is of the same
    array type: for kernels that read it and see to that. With no row they see nothing.
    """
    if type(value) is float and count:
        return only(value)
    if (
        type(value) is np.ndarray
        and value.dtype is FLOAT64
        and value.shape == (count,)
        and value.flags.carray
    ):
        return value
    return moments(name, value, count)


def moments(name: str, value: ArrayLike, count: int | None) -> Floats:
    """One for all as shape (1,), or shape (count,); finite. `count` None: only one."""
    if count is None or type(value) is float:
        return np.array([moment(name, value)])
    array = _in_seconds(name, value, (count,))
    if array.ndim == 0:
        return np.array([moment(name, array[()])])
    if array.shape != (count,):
        raise ValueError(f'{name} must be a number or have shape ({count},), not {array.shape}')
    if first_not_finite(array[None]) >= 0:
        bad = np.flatnonzero(~np.isfinite(array))
        raise ValueError(f'{name} must be finite: row {bad[0]} is {array[bad[0]]}')
    return array
