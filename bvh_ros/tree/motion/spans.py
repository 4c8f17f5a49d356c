# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The times of courses, and the spans that hold them."""

from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import time_checks
from .bounds import LONGEST

Floats = NDArray[np.float64]


FEW = 32  # rows for which numpy takes longer than Python


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
    if len(at) == len(pace) == len(t_max) == 1:
        going, limit = pace.item(), t_max.item()
        return span_of(at.item(), going, limit), going == 0.0 or limit < inf
    counts = len(at), len(pace), len(t_max)
    if max(counts) <= FEW and 0 not in counts:
        return _times_of_few(max(counts), at, pace, t_max)
    with np.errstate(invalid='ignore', over='ignore'):
        last = np.where(pace == 0.0, at, at + t_max * pace)
        at = np.broadcast_to(at, last.shape)
        good = (np.abs(at) < LONGEST) & (np.abs(last) < LONGEST)
    moments = np.concatenate((at[good], last[good]))
    span = (moments.min(), moments.max()) if len(moments) else (0.0, 0.0)
    return span, bool(good.all())


def _times_of_few(count: int, *columns: Floats) -> tuple[tuple[float, float], bool]:
    """The same of so many rows, at least one."""
    moments: list[float] = []
    every = True
    told = (rows.tolist() * (count // len(rows)) for rows in columns)
    for at, pace, t_max in zip(*told, strict=True):
        last = at if pace == 0.0 else at + t_max * pace
        if -LONGEST < at < LONGEST and -LONGEST < last < LONGEST:
            moments += at, last
        else:
            every = False
    return (min(moments), max(moments)) if moments else (0.0, 0.0), every
