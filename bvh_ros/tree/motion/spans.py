# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The times of courses, and the spans that hold them."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import time_checks
from ..compiler import entry_point, lean_kernel
from ..rays.raycasting import of_row
from .bounds import LONGEST

Floats = NDArray[np.float64]


def both_times(times: tuple[Any, Any], count: int) -> tuple[Floats, Floats]:
    """`at` and `pace`: each one for all or (n,), finite."""
    at, pace = times
    return time_checks.moments('at', at, count), time_checks.moments('pace', pace, count)


def span_of(at: float, pace: float, t_max: float) -> tuple[float, float]:
    """First and last time of a ray; both now where it is too long for bounds."""
    last = at if pace == 0.0 else at + t_max * pace
    if -LONGEST < at < LONGEST and -LONGEST < last < LONGEST:
        return (at, last) if at <= last else (last, at)
    return 0.0, 0.0


def times_of(at: Floats, pace: Floats, t_max: Floats) -> tuple[tuple[float, float], bool]:
    """`span_of` of all rows for which there can be bounds, and whether that is all rows."""
    first, last, every = _entry()(at, pace, t_max)
    return (first, last), every


@lean_kernel
def span_of_rows(at, pace, t_max):
    """First and last time of all rows for which there can be bounds, (n,) or one for all, and
    whether that is all rows.
    """
    first, last, every = np.inf, -np.inf, True
    counts = at.shape[0], pace.shape[0], t_max.shape[0]
    for i in range(max(counts) if min(counts) > 0 else 0):
        begin, going = of_row(at, i), of_row(pace, i)
        end = begin if going == 0.0 else begin + of_row(t_max, i) * going
        if abs(begin) < LONGEST and abs(end) < LONGEST:
            first, last = min(first, begin, end), max(last, begin, end)
        else:
            every = False
    return (first, last, every) if first <= last else (0.0, 0.0, every)


@functools.cache
def _entry() -> Callable[..., Any]:
    """The machine code of `span_of_rows`."""
    return entry_point(span_of_rows, *(np.empty(0),) * 3)
