# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The queries of a tree whose boxes move, but those about rays. Arguments are those of the tree's
methods of the same names, which hand them on.
"""

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import box_checks, checks, time_checks
from ..boxes.nearest_packets import LEAST as PACKETS
from ..boxes.nearest_packets import are_dense
from ..boxes.ordering import order_of
from ..boxes.overlapping import overlap_many
from ..checks import INT64
from ..nodes import ALL, COUNT
from ..store.turns import NOT_FINITE
from . import nearest, nearest_packets, overlapping
from .bounds import LONGEST
from .entries import MotionRays
from .nearest import Near
from .nearest_packets import Bounded
from .state import rows_were_changed, span_of, times_of

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]
STILL = np.zeros(1)
FEW = 64  # boxes that there is room for at first
# From so many points on their order is worth being made.
MANY_POINTS, NO_ORDER = 512, np.empty(0, np.int64)


class MotionQueries(MotionRays):
    """What is asked of moving boxes."""

    def overlap(self, tree: Any, box: tuple[Floats, Floats], mask: np.uint32, at: Any) -> Ids:
        """Handles of what a box touches, ascending."""
        if type(at) is not float:
            at = time_checks.moment('at', at)
        ndim, slots = tree._ndim, np.empty(FEW, np.int64)
        kernel = overlapping.one_entry(ndim)
        moving = self.bounds
        while True:
            count = kernel(tree._settled().tree, moving, box, mask, at, slots)
            if count == NOT_FINITE:
                time_checks.moment('at', at)
                box_checks.box(*box, ndim)
            if 0 <= count <= len(slots):
                handles = slots[:count]
                if count > 1:
                    handles.sort()
                return handles
            if count > 0:
                slots = np.empty(count, np.int64)
            else:
                moving = self.others(tree, moving, count, span_of(at, 0.0, 0.0))

    def nearest(
        self, tree: Any, near: tuple[Floats, Floats, Any, int, float, np.uint32]
    ) -> tuple[Ids, Floats]:
        """`nearest.nearest_one` of (low, high, at, k, reach, mask): (ids, distances)."""
        at, k = near[2], near[3]
        if type(at) is not float:
            at = time_checks.moment('at', at)
            near = *near[:2], at, *near[3:]
        kernel = nearest.one_entry(tree._ndim)
        found, distances, moving = np.empty(k, np.int64), np.empty(k), self.bounds
        while True:
            count = kernel(tree._settled().tree, moving, near, found, distances)
            if count == k:
                return found, distances
            if count == NOT_FINITE:
                time_checks.moment('at', at)
                checks.finite('point', np.array(near[:2]))
            if count >= 0:
                return found[:count], distances[:count]
            moving = self.others(tree, moving, count, span_of(at, 0.0, 0.0))

    def overlap_many(
        self,
        tree: Any,
        boxes: tuple[Floats, Floats],
        masks: NDArray[np.uint32],
        at: Any,
        threads: int,
    ) -> tuple[Ids, Ids] | int:
        """What boxes touch at times: (offsets, handles); NOT_FINITE if one is no box."""
        count, moving = len(boxes[0]), self.bounds
        times = time_checks.times('at', at, count)
        # As QueriesThen(...), which would take one more call of a function of Python's.
        queries = tuple.__new__(overlapping.QueriesThen, (*boxes, masks, times))
        while True:
            arrays = tree._settled().tree, moving
            found = overlap_many(arrays, queries, threads, overlapping.rows_entry)
            if isinstance(found, tuple):
                return found
            if found == NOT_FINITE:
                time_checks.moments('at', at, count)
                return found
            span, _ = times_of(times, STILL, STILL)
            moving = self.others(tree, moving, found, span)

    def nearest_many(
        self, tree: Any, points: Floats, k: int, asked: tuple[Any, Any], at: Any
    ) -> tuple[Ids, Floats]:
        """The nearest to points, asked = (max_distance, mask): (ids, distances)."""
        (reach, mask), count, moving = asked, len(points), self.bounds
        limits, masks, dense, order = checks.FOREVER, checks.EVERYTHING, False, NO_ORDER
        if count >= PACKETS or not (reach is np.inf and mask is ALL and type(at) is float):
            checks.finite('points', points)  # else a kernel looks
            limits = checks.limits_or_one('max_distance', reach, count)
            masks = checks.masks_or_one(mask, count)
            dense = are_dense(count, tree._settled().tree.state.item(COUNT))
        times = time_checks.times('at', at, count)
        if dense:
            times = time_checks.moments('at', at, count)
            dense = bool((np.abs(times) < LONGEST).all())
        kernel = (nearest_packets.entry if dense else nearest.rows_entry)(tree._ndim)
        if dense or count >= MANY_POINTS:
            order = order_of(tree, points)
        # As Near(...), which would take one more call of a function of Python's.
        rows = tuple.__new__(Near, (points, limits, masks, times, k, order))
        found, distances = np.empty((count, k), INT64), np.empty((count, k))
        while True:
            why = kernel(tree._settled().tree, moving, rows, found, distances)
            if why >= 0:
                return found, distances
            if why == NOT_FINITE:
                checks.finite('points', points)
                time_checks.moments('at', at, count)
                raise rows_were_changed()
            moving = self.others(tree, moving, why, times_of(times, STILL, STILL)[0])

    def bound_many(self, tree: Any, rows: Near, bounded: Bounded) -> None:
        """Fill in the boxes whose bounds are nearest to the rows of `order`, see
        `nearest_packets`: for who decides by other distances.
        """
        kernel, squares = nearest_packets.bounds_entry(tree.ndim), np.empty(bounded.slots.shape)
        spans = functools.partial(times_of, rows.at, STILL, STILL)
        self.ask(tree, spans, lambda *arrays: kernel(*arrays, rows, bounded, squares))
