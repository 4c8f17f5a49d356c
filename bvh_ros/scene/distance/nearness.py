# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles are nearest to a point, by their true shapes.

No shape is nearer than its box. So the tree is asked for the nearest boxes, ever more of them,
until the next box is farther than the k-th nearest shape among those it has named.
"""

from typing import Any

import numpy as np

from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import entry_point
from ...tree.store.turns import IS_CHANGED
from ..geometry.shapes import Floats
from ..store.columns import Columns
from .touching import REFUSED, Bodies, Found, Scratch, nearest_boxes, nearest_shapes

ROUNDED = 1.0 + 2.0**-48  # no computed distance is off by as much
MORE = 4


class Nearness:
    """Queries of one scene for what is nearest."""

    def __init__(self, tree: DynamicBVH, columns: Columns) -> None:
        self._tree = tree
        self._columns = columns
        self._scratch = Scratch()
        self._entries: dict[bool | None, Any] = {}

    def find(
        self, point: Floats, k: int, max_distance: float, mask: np.uint32
    ) -> tuple[Found, list[int]]:
        """Up to k obstacles nearest to a point within a distance: what is known of them until the
        next query of this thread, and their rows, nearest first, ties by handle.
        """
        everybody = len(self._tree)
        reach = max(max_distance * ROUNDED, max_distance)
        asked = k + MORE  # so that most know at once that no other is nearer
        while True:
            asked = min(asked, everybody + 1)
            if asked > len(self._scratch.found.slots):
                self._scratch.make_room(asked)
            count = self._fill(point, (asked, reach, mask))
            found = self._scratch.found
            distances = found.distances[:count].tolist()
            order = [row for row in found.order[:count].tolist() if distances[row] <= max_distance]
            order = self._different(found, order)[:k]
            if count < asked or (
                len(order) == k and found.bounds.item(count - 1) > distances[order[-1]] * ROUNDED
            ):
                return found, order
            asked *= MORE

    def _fill(self, point: Floats, asked: tuple[int, float, np.uint32]) -> int:
        columns = self._columns
        bodies: Any = ()
        kernel, variant, hulls = nearest_boxes, None, None
        if columns.shaped:
            hulls = columns.hulls()
            kernel, variant = nearest_shapes, hulls is not None
            bodies = (Bodies(columns.geometry, columns.footprint, hulls, hulls),)
        found = self._scratch.found
        given = self._tree.view().tree, *bodies, point, asked, columns.node_handle, found
        entry = self._entries.get(variant)
        if entry is None:
            entry = self._entries[variant] = entry_point(kernel, *given)
        count: int = entry(*given)
        if count == REFUSED:
            raise RuntimeError(IS_CHANGED)
        return count

    def _different(self, found: Found, rows: list[int]) -> list[int]:
        """The first row of each obstacle: one may stand at two places, see slicing.py."""
        if not self._columns.shadows:
            return rows
        handles = self._columns.node_handle[found.slots[rows]].tolist()
        first: dict[int, int] = {}
        for handle, row in zip(handles, rows, strict=True):
            first.setdefault(handle, row)
        return list(first.values())
