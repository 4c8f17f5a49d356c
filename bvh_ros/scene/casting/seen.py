# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When rays and swept balls go, and what they meet."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.jit.compiling import entry_point, lean_kernel
from ...tree.motion.bounds import LONGEST
from ...tree.rays.raycasting import of_row
from ..geometry.shapes import Floats
from ..store.obstacles import EXACT
from ..store.registry import Slots


class Met(NamedTuple):
    """Hits, by ray and in the order in which they are met."""

    rows: Slots
    slots: Slots
    ts: Floats
    points: Floats
    """Shape (m, 3)."""
    normals: Floats

    def take(self, which: NDArray[np.int64]) -> 'Met':
        """Some of them."""
        columns: Any = (column[which] for column in self)
        return Met(*columns)


class Times(NamedTuple):
    """When rays start, s, and how many seconds pass a unit of t; shape (n,) each."""

    at: Floats
    pace: Floats

    def ends(self, t_max: Floats) -> Floats:
        """When rays end, s; inf where they never do."""
        with np.errstate(over='ignore', invalid='ignore'):
            return np.where(self.pace > 0.0, self.at + self.pace * t_max, self.at)


@lean_kernel
def fill_times(at, until, t_max, epoch, within, starts, paces):
    """Write `Times` of rays, shape (n,) each, that go from `at` to `until`, (n,) or one for all,
    ns, and end at t_max; return (whether each is within (first, last) ns and ends, the first time,
    the last). `epoch`: the ns of time 0, less than EXACT from both of `within`.
    """
    first, last = np.inf, -np.inf
    for i in range(starts.shape[0]):
        begin, end = of_row(at, i), of_row(until, i)
        if not (within[0] <= begin <= end <= within[1]) or end - begin >= EXACT:
            return False, first, last
        starts[i], paces[i] = (begin - epoch) / 1e9, (end - begin) / 1e9
        stop = starts[i] if paces[i] == 0.0 else starts[i] + of_row(t_max, i) * paces[i]
        if not abs(stop) < LONGEST:
            return False, first, last
        first, last = min(first, starts[i]), max(last, stop)
    return True, first, last


@functools.cache
def times_entry() -> Callable[..., Any]:
    """The machine code of `fill_times`."""
    at, row = np.empty(0, np.int64), np.empty(0)
    return entry_point(fill_times, at, at, row, 0, (0, 0), row, row)
