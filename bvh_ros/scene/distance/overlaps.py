# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles touch a query shape, and which touch each other."""

from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...tree.boxes.within import boxes_within
from ...tree.checks import BOOL, INT64, UINT32
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import entry_point
from ...tree.nodes import View
from ...tree.store.turns import IS_CHANGED
from ...tree.store.workers import in_threads
from ..geometry.shapes import Floats
from ..results import NO_NODE, BoxHits, require_few
from ..store.columns import Columns
from ..store.mesh_store import Hulls
from ..store.registry import Slots
from . import narrow_phase
from .query_rows import FAULTY, NARROW, QueryRows, with_records
from .query_shape import QueryShape
from .touching import REFUSED, Found, Scratch, touching_boxes, touching_shapes
from .touching_rows import (
    ALL,
    ANY,
    COUNT,
    FIRST,
    HITS,
    Answers,
    RowKernel,
    bodies_of,
    overlap_rows,
)

FEW = 64  # handles that there is room for at first
NOBODY = np.empty(0, np.uint32)
NOT_WANTED = NOBODY, np.empty(0), np.empty((0, 3))
TOLD_AS = {ANY: BOOL, COUNT: INT64, FIRST: UINT32}
# Of an answer: why there is none, node handles of all that are met, in parts, and what is
# counted. It has a name, as Python makes an annotation of a function within a function anew at
# each call, in 3 us.
Part: TypeAlias = tuple[int, list[NDArray[np.uint32]], int, int, int]


class Overlaps:
    """Overlap queries of one scene."""

    def __init__(self, tree: DynamicBVH, columns: Columns) -> None:
        self._tree = tree
        self._columns = columns
        self._scratch = Scratch()
        self._entries: dict[bool | None, Any] = {}
        self._rows = RowKernel(overlap_rows)

    def find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, most: int | None
    ) -> tuple[Found, list[int]]:
        """The obstacles whose distance from the query's shape is at most its tolerance: what is
        known of them until the next query of this thread, and their rows in order of their
        distances from its centre, ties by handle. TooManyHitsError if they are more than `most`.
        """
        if self._columns.shaped or not query.aligned:
            count, doubtful = self._fill_shapes(query, hulls, mask)
        else:
            count, doubtful = self._fill(None, touching_boxes, (), query, mask)
        found = self._scratch.found
        order = found.order[:count].tolist()
        if doubtful:
            order = [row for row in order if not found.doubtful[row] or self._holds(query, row)]
        require_few(len(order), most)
        return found, order

    def answer(self, rows: QueryRows, hulls: Hulls | None, wanted: int, threads: int) -> Any:
        """`find` of n shapes: what is `wanted` (see `touching_rows`) of each, as
        `Scene.overlap_many` returns it; None if a row that is `given` is not legal.
        """
        if wanted == ALL:
            return self._every(rows, hulls, threads)
        found_rows = self._find_rows(rows, hulls, wanted, threads)
        if found_rows is None:
            return None
        told, _, unsure = found_rows
        if unsure:
            rows = with_records(rows)
        for row in np.flatnonzero(told.numbers < 0).tolist() if unsure else ():
            found, order = self.find(rows.one(row), hulls, rows.mask(row), None)
            told.numbers[row] = len(order)
            handles = self._columns.node_handle[found.slots[order]]
            if wanted == FIRST:
                told.numbers[row] = handles[0] if len(order) else NO_NODE
            elif wanted == HITS:
                told.handles[row] = handles[0] if len(order) else NO_NODE
                told.distances[row] = found.distances[order[0]] if len(order) else np.inf
                told.points[row] = found.points[order[0]] if len(order) else np.nan
        if wanted in (COUNT, HITS) and self._columns.shadows:
            # Who stands at two places counts once, see slicing.py.
            told.numbers[:] = np.diff(self._every(rows, hulls, threads)[0])
        if wanted == HITS:
            return BoxHits(told.handles, told.numbers, told.distances, told.points)
        return told.numbers.astype(TOLD_AS[wanted], copy=False)

    def _every(self, rows: QueryRows, hulls: Hulls | None, threads: int) -> Any:
        """(offsets, node handles) of all that touch each shape; None as `answer`."""
        found_rows = self._find_rows(rows, hulls, ALL, threads)
        if found_rows is None:
            return None
        told, handles, unsure = found_rows
        count = len(told.numbers)
        offsets = np.zeros(count + 1, np.int64)
        if not (unsure or self._columns.shadows):
            told.numbers.cumsum(out=offsets[1:])
            return offsets, handles
        is_open = told.numbers < 0
        counts = np.where(is_open, ~told.numbers, told.numbers)
        rows, of = with_records(rows), np.repeat(np.arange(count), counts)
        sure, open_rows, each = ~is_open[of], np.flatnonzero(is_open), [NOBODY]
        for row in open_rows.tolist():
            found, order = self.find(rows.one(row), hulls, rows.mask(row), None)
            each.append(self._columns.node_handle[found.slots[order]].astype(np.uint32))
        of = np.concatenate((of[sure], np.repeat(open_rows, [len(found) for found in each[1:]])))
        handles = np.concatenate((handles[sure], *each))
        if self._columns.shadows:
            first = np.sort(np.unique(np.stack((of, handles)), axis=1, return_index=True)[1])
            of, handles = of[first], handles[first]
        np.cumsum(np.bincount(of, minlength=count), out=offsets[1:])
        return offsets, handles[np.argsort(of, kind='stable')]

    def _find_rows(
        self, rows: QueryRows, hulls: Hulls | None, wanted: int, threads: int, narrow: bool = False
    ) -> tuple[Answers, NDArray[np.uint32], int] | None:
        """What is wanted of each row, but of those that are `open`: these are left to `find`; the
        handles of all that are met, row after row, if those are wanted; how many are open. None if
        a row that is `given` is not legal. `narrow`: such a row needs a narrow phase.
        """
        count, columns, view = rows.number(), self._columns, self._tree.view()
        if len(rows.records):
            narrow = bool(rows.records['shaped'].any())
        elif count:  # a kernel that comes to one that is shaped begins anew
            narrow = narrow or rows.begins_shaped()
        hits = count if wanted == HITS else 0
        first = NOT_WANTED
        if hits:
            first = np.empty(hits, np.uint32), np.empty(hits), np.empty((hits, 3))
            first[0][:], first[1][:], first[2][:] = NO_NODE, np.inf, np.nan
        # As Answers(...), which would take one more call of a function of Python's.
        told = tuple.__new__(Answers, (np.empty(count, INT64), *first))
        bodies = bodies_of(columns, hulls) if narrow or columns.shaped else None
        given, unsure = (view, bodies, rows, wanted, told), 0
        if threads == 1 and wanted != ALL:  # without what others take: a third of a call of a row
            asked = rows, wanted, (0, count), columns.node_handle, self._scratch.found, told
            start, _, _, compared, more, unsure = self._rows(view, bodies, asked)
            if start == count:
                if compared:
                    columns.pairs_compared += compared
                    columns.pairs_in_more_digits += more
                return told, NOBODY, unsure
            if start == NARROW:
                return self._find_rows(rows, hulls, wanted, threads, True)
            unsure = 0
        handles: list[NDArray[np.uint32]] = []
        for reason, parts, compared, more, several in in_threads(
            partial(self._work, *given), count, threads
        ):
            if reason == NARROW:
                return self._find_rows(rows, hulls, wanted, threads, True)
            if reason == FAULTY:
                return None
            if compared:
                columns.pairs_compared += compared
                columns.pairs_in_more_digits += more
            handles += parts
            unsure += several
        if len(handles) > 1:
            return told, np.concatenate(handles), unsure
        return told, handles[0] if handles else NOBODY, unsure

    def _work(
        self,
        view: View,
        bodies: Any,
        rows: QueryRows,
        wanted: int,
        told: Answers,
        start: int,
        stop: int,
    ) -> Part:
        """Answer the rows [start, stop), if no reason is in the way."""
        parts: list[NDArray[np.uint32]] = []
        compared, more, unsure, room = 0, 0, 0, FEW
        while start < stop:
            found, answers = self._scratch.found, told
            if wanted == ALL:
                answers = told._replace(handles=np.empty(room, np.uint32))
            given = rows, wanted, (start, stop), self._columns.node_handle, found, answers
            start, needed, written, pairs, digits, several = self._rows(view, bodies, given)
            if start < 0:
                return start, parts, compared, more, unsure
            if written:
                parts.append(answers.handles[:written])
            compared, more, unsure = compared + pairs, more + digits, unsure + several
            room = max(2 * room, needed)
            if needed > len(found.slots):
                self._scratch.make_room(needed)
        return 0, parts, compared, more, unsure

    def _fill_shapes(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32
    ) -> tuple[int, int]:
        columns, bodies = self._columns, bodies_of(self._columns, hulls)
        count, doubtful, compared, more = self._fill(
            bodies.hulls is not None, touching_shapes, (bodies,), query, mask
        )
        columns.pairs_compared += compared
        columns.pairs_in_more_digits += more
        return count, doubtful

    def _fill(
        self, variant: bool | None, kernel: Any, bodies: Any, query: QueryShape, mask: np.uint32
    ) -> Any:
        """Call a kernel of `touching` until there is room for what it finds. `variant` stands for
        the types of what it is given.
        """
        while True:
            found = self._scratch.found
            asked = *bodies, query, mask, False
            given = self._tree.view().tree, *asked, self._columns.node_handle, found
            entry = self._entries.get(variant)
            if entry is None:
                entry = self._entries[variant] = entry_point(kernel, *given)
            counted = entry(*given)
            if counted[0] == REFUSED:
                raise RuntimeError(IS_CHANGED)
            if counted[0] <= len(found.slots):
                return counted
            self._scratch.make_room(counted[0])

    def _holds(self, query: QueryShape, row: int) -> bool:
        """Whether an axis-aligned box in doubt is within the tolerance, as real arithmetic
        decides.
        """
        slot, ndim = self._scratch.found.slots[row], self._tree.ndim
        lo, hi = corners(self._columns.geometry[slot : slot + 1])
        lower, upper = query.bounds[:, :ndim]
        return bool(boxes_within(lo[:, :ndim], hi[:, :ndim], lower, upper, query.tolerance)[0])


def find_pairs(tree: DynamicBVH, columns: Columns, mask: int) -> Slots:
    """Slots (m, 2) of all obstacles that touch each other, the older of a pair first, sorted."""
    pairs = tree.slots(tree.overlap_pairs(mask))
    narrow = columns.geometry['shaped'][pairs].any(axis=1)
    if not narrow.any():
        return pairs
    touches = np.asarray(~narrow)
    found = np.empty(np.count_nonzero(narrow), np.bool_)
    planar = columns.footprint is not None
    columns.pairs_compared += len(found)
    columns.pairs_in_more_digits += narrow_phase.near_pairs(
        columns.geometry, columns.hulls(), pairs[narrow], planar, found
    )
    touches[narrow] = found
    return pairs[touches]


def each_once(columns: Columns, pairs: Slots) -> Slots:
    """Pairs of different obstacles, each once, where one may stand at two places."""
    handles = columns.node_handle[pairs]
    order = np.argsort(handles, axis=1)
    pairs, handles = np.take_along_axis(pairs, order, 1), np.take_along_axis(handles, order, 1)
    row = np.unique(handles, axis=0, return_index=True)[1]
    return pairs[row[handles[row, 0] != handles[row, 1]]]


def corners(records: NDArray[np.void]) -> tuple[Floats, Floats]:
    """Lowest and highest corners of axis-aligned boxes, the same doubles that the tree holds."""
    return records['position'] - records['half'], records['position'] + records['half']
