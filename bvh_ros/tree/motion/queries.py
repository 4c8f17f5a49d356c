# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and nearest boxes at a time: bounds that hold for the time, and the kernels. Input is
checked by the tree's methods of the same names.
"""

from typing import Any

import numpy as np

from .. import checks
from ..query.nearest import PointQueries
from ..store.turns import NOT_FINITE
from . import nearest, overlap
from .entries import MotionRays
from .nearest import Bounded
from .state import rows_were_changed, span_of, times_of

STILL = np.zeros(1)


class MotionQueries(MotionRays):
    """Queries of moving boxes."""

    overlap, nearest = overlap, nearest

    def ask_one(self, tree: Any, kernel: Any, at: Any, *arguments: Any) -> int:
        """What a kernel of one query returns, with bounds that hold for its time: a count, or
        NOT_FINITE.
        """
        if type(at) is not float:
            at = checks.moment('at', at)
        moving = self.bounds
        while True:
            count: int = kernel(tree._settled().tree, moving, at, *arguments)
            if count >= 0:
                return count
            if count == NOT_FINITE:
                checks.moment('at', at)
                return count
            moving = self.others(tree, moving, count, span_of(at, 0.0, 0.0))

    def ask_rows(self, tree: Any, kernel: Any, at: Any, count: int, *arguments: Any) -> Any:
        """The same of a batch, at a time or at a time a row: what the kernel returns if it is no
        negative number, or NOT_FINITE.
        """
        times, moving = checks.times('at', at, count), self.bounds
        while True:
            found = kernel(tree._settled().tree, moving, times, *arguments)
            if isinstance(found, tuple) or found >= 0:
                return found
            if found == NOT_FINITE:
                checks.moments('at', at, count)
                return found
            moving = self.others(tree, moving, found, times_of(times, STILL, STILL)[0])

    def bound_many(self, tree: Any, at: Any, points: PointQueries, bounded: Bounded) -> None:
        """Fill in the boxes whose bounds are nearest to the rows of `order`, for callers that
        decide by other distances.
        """
        kernel, squares = nearest.bounds_entry(tree.ndim), np.empty(bounded.slots.shape)
        if self.ask_rows(tree, kernel, at, len(points.points), points, bounded, squares) < 0:
            raise rows_were_changed()
