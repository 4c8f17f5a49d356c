# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles are nearest to a point, by their true shapes.

No shape is nearer than its box. So the tree is asked for the nearest boxes, ever more of them,
until the next box is farther than the k-th nearest shape among those it has named.
"""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    COUNT,
    IS_CHANGED,
    NOT_FINITE,
    UINT32,
    DynamicBVH,
    View,
    in_threads,
    order_of,
)
from ...tree.compiler import entry_point
from ..geometry.shapes import Floats, along_axes
from ..store.columns import Columns
from ..store.spare import Spare
from .touching import FOUND, REFUSED, ROUNDED, Found, Scratch, nearest_to
from .touching_rows import Near, Points, RowKernel, Signed, bodies_of, nearest_rows

MORE = 4
# From so many points on their order counts: as they stand 10,000 points take 1.2 times as long.
MANY, NO_ORDER = 1000, np.empty(0, np.int64)


class Nearness:
    """Queries of one scene for what is nearest."""

    def __init__(self, tree: DynamicBVH, columns: Columns) -> None:
        self._tree = tree
        self._columns = columns
        self.spare = Spare(Scratch)
        self._entries: dict[tuple[bool | None, Signed], Any] = {}
        self._rows = {None: RowKernel(nearest_rows).call, True: RowKernel(nearest_rows).call}

    def find(
        self, point: Floats, k: int, limits: tuple[float, np.uint32], signed: Signed
    ) -> tuple[Scratch, list[int]]:
        """Up to k obstacles nearest to a point, limits = (max_distance, mask): what is known of
        them until that is given to `spare`, and their rows, nearest first, ties by handle.
        """
        scratch, (max_distance, mask) = self.spare.take(), limits
        everybody = len(self._tree)
        reach = max(max_distance * ROUNDED, max_distance)
        in_order = signed is None and not (self._columns.shaped or self._columns.shadows)
        # Some more, so that most know at once that no other is nearer.
        asked = k if in_order else k + MORE
        while True:
            asked = min(asked, everybody + 1)
            if asked > len(scratch.found.slots):
                scratch.make_room(asked)
            found = scratch.found
            count = self._fill(point, (asked, reach, mask), signed, found)
            distances = found.distances[:count].tolist()
            order = [row for row in found.order[:count].tolist() if distances[row] <= max_distance]
            order = self._different(found, order)[:k]
            if (
                in_order
                or count < asked
                or (
                    len(order) == k
                    and found.bounds.item(count - 1) > max(distances[order[-1]], 0.0) * ROUNDED
                )
            ):
                return scratch, order
            asked *= MORE

    def _fill(
        self, point: Floats, asked: tuple[int, float, np.uint32], signed: Signed, found: Found
    ) -> int:
        columns = self._columns
        bodies = bodies_of(columns, columns.hulls) if columns.shaped else None
        variant = None if bodies is None else bodies.hulls is not None
        given = self._tree.view().tree, bodies, point, asked, signed, columns.node_handle, found
        entry = self._entries.get((variant, signed))
        if entry is None:
            entry = self._entries[variant, signed] = entry_point(nearest_to, *given)
        count: int = entry(*given)
        if count == REFUSED:
            raise RuntimeError(IS_CHANGED)
        return count

    def order_of(self, points: Floats) -> NDArray[np.int64]:
        """The order in which many points are asked: neighbours load the same nodes."""
        return order_of(self._tree.view().tree, along_axes(points, self._tree.ndim))

    def find_rows(self, points: Points, k: int, signed: Signed, threads: int) -> Near | None:
        """The k obstacles nearest to each of n points, as `find` has them; None if one is not
        finite.
        """
        count, columns, view = len(points.points), self._columns, self._tree.view()
        bodies = bodies_of(columns, columns.hulls) if columns.shaped else None
        parts = np.empty((count, k), UINT32), np.empty((count, k)), np.empty((count, k, 3))
        # As Near(...), which would take one more call of a function of Python's.
        near = tuple.__new__(Near, parts)
        asked = k, columns.shadows > 0, signed
        if threads == 1:  # without what others take
            scratch, start = self.spare.take(), 0
            memory = scratch.memory
            if k * FOUND < len(memory):
                every = view, bodies, points, asked, (0, count), columns.node_handle, memory, near
                start = self._rows[signed](every)[0]
            self.spare.give(scratch)
            if start == count:
                return near
        given = view, bodies, points, asked, near
        done = in_threads(partial(self._work, *given), count, threads)
        return near if all(done) else None

    def _work(
        self,
        view: View,
        bodies: Any,
        points: Points,
        asked: tuple[int, bool, Signed],
        near: Near,
        start: int,
        stop: int,
    ) -> bool:
        """Answer the rows [start, stop); whether all points are finite."""
        (k, _, signed), everybody = asked, view.tree.state.item(COUNT)
        wanted, kernel, scratch = min(k, everybody) + 1, self._rows[signed], self.spare.take()
        handles = self._columns.node_handle
        while start < stop:
            if wanted > len(scratch.found.slots):
                scratch.make_room(wanted)
            some = points, asked, (start, stop), handles, scratch.memory, near
            start, wanted = kernel((view, bodies, *some))
            if start == NOT_FINITE:
                return False
        self.spare.give(scratch)
        return True

    def _different(self, found: Found, rows: list[int]) -> list[int]:
        """The first row of each obstacle: one may stand at two places, see slicing.py."""
        if not self._columns.shadows:
            return rows
        handles = self._columns.node_handle[found.slots[rows]].tolist()
        first: dict[int, int] = {}
        for handle, row in zip(handles, rows, strict=True):
            first.setdefault(handle, row)
        return list(first.values())
