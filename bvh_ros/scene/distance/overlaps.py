# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles touch a query shape, and which touch each other."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import IS_CHANGED, UINT32, DynamicBVH, View, boxes_within, in_threads
from ...tree.compiler import entry_point
from ..geometry.shapes import Floats
from ..results import NO_NODE, BoxHits, require_few
from ..store.columns import Bodies, Columns
from ..store.mesh_store import Hulls
from ..store.registry import Slots
from ..store.spare import Spare
from . import narrow_phase
from .query_rows import FAULTY, NARROW, QueryRows, begin_shaped, with_records
from .query_shape import QueryShape
from .touching import FOUND, REFUSED, Scratch, touching
from .touching_rows import (
    ALL,
    ANY,
    COUNT,
    FEW,
    FIRST,
    HITS,
    NOBODY,
    OPEN,
    Answers,
    RowKernel,
    bodies_of,
    overlap_rows,
    room_for,
)


class Part(NamedTuple):
    """What became of the rows [start, stop)."""

    reason: int
    """Why there is no answer, or 0."""
    start: int
    stop: int
    handles: list[NDArray[np.uint32]]
    """Of all that are met, in parts."""
    compared: int
    more: int


class Overlaps:
    """Overlap queries of one scene."""

    def __init__(self, tree: DynamicBVH, columns: Columns) -> None:
        self._tree = tree
        self._columns = columns
        self.spare = Spare(Scratch)
        self._entries: dict[bool | None, Any] = {}
        self._rows = RowKernel(overlap_rows).call

    def find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, most: int | None
    ) -> tuple[Scratch, list[int]]:
        """The obstacles whose distance from the query's shape is at most its tolerance: what is
        known of them until that is given to `spare`, and their rows in order of their distances
        from its centre, ties by handle. TooManyHitsError if they are more than `most`.
        """
        narrow = self._columns.shaped > 0 or not query.aligned
        bodies = bodies_of(self._columns, hulls) if narrow else None
        scratch = self.spare.take()
        count, doubtful = self._fill(scratch, bodies, query, mask)
        found = scratch.found
        order = found.order[:count].tolist()
        if doubtful:
            sure = ~found.doubtful
            order = [i for i in order if sure[i] or self._holds(query, found.slots[i])]
        require_few(len(order), most)
        return scratch, order

    def answer(self, rows: tuple[Any, ...], hulls: Hulls | None, wanted: int, threads: int) -> Any:
        """`find` of n shapes, plain `QueryRows`: what is `wanted` (see `touching_rows`) of each,
        as `Scene.overlap_many` returns it; None if a row that is `given` is not legal.
        """
        columns, count, done = self._columns, len(rows[0]) or len(rows[4][1]), 0
        narrow, told = columns.shaped > 0 or begin_shaped(rows), room_for(count, wanted)
        parts: list[NDArray[np.uint32]] = []
        if threads == 1:  # without what others take: a fifth of a call of a row
            view, bodies = self._tree.latest(), bodies_of(columns, hulls) if narrow else None
            scratch, handles = self.spare.take(), columns.node_handle
            every = view, bodies, rows, wanted, (0, count, 0), handles, scratch.memory, told
            done, _, written, compared, more, version = self._rows(every)
            self.spare.give(scratch)
            if compared and done >= 0:
                columns.pairs_compared += compared
                columns.pairs_in_more_digits += more
            if wanted == ALL and done >= 0:
                parts.append(told[2][:written])
        if done < count or threads > 1:
            view = View(view.tree, version) if done > 0 else self._tree.view()
            some = wanted, threads, narrow, max(done, 0)
            others = self._work_on(view, hulls, rows, some, Answers(*told))
            if others is None:
                return None
            parts += others
        if columns.shadows and wanted in (COUNT, HITS):
            every = self.answer(rows, hulls, ALL, threads)
            return as_wanted(told, parts, wanted, True, every)
        return as_wanted(told, parts, wanted, columns.shadows > 0)

    def _work_on(
        self,
        view: View,
        hulls: Hulls | None,
        rows: tuple[Any, ...],
        asked: tuple[int, int, bool, int],
        told: Answers,
    ) -> list[NDArray[np.uint32]] | None:
        """Answer the rows from `first` on, asked = (wanted, threads, whether some need a narrow
        phase, first); return what handles are met in parts, None if a row that is `given` is not
        legal.
        """
        wanted, threads, narrow, first = asked
        bodies = bodies_of(self._columns, hulls) if narrow else None
        count = len(rows[0]) or len(rows[4][1])
        parts: list[NDArray[np.uint32]] = []
        work = partial(self._work, view, bodies, rows, wanted, told)
        for done in in_threads(work, count, threads) if first == 0 else [work(first, count)]:
            if done.reason == NARROW:  # a kernel that comes to a row that is shaped begins anew
                return self._work_on(view, hulls, rows, (wanted, threads, True, first), told)
            if done.reason == FAULTY:
                return None
            self._columns.pairs_compared += done.compared
            self._columns.pairs_in_more_digits += done.more
            if wanted == ALL and done.start > 0:
                told.numbers[done.start + 1 : done.stop + 1] += told.numbers[done.start]
            parts += done.handles
        return parts

    def _work(
        self,
        view: View,
        bodies: Any,
        rows: tuple[Any, ...],
        wanted: int,
        told: Answers,
        start: int,
        stop: int,
    ) -> Part:
        """Answer the rows [start, stop), if no reason is in the way."""
        parts: list[NDArray[np.uint32]] = []
        begin, total, compared, more, room, legal = start, 0, 0, 0, FEW, None
        scratch = self.spare.take()
        while start < stop:
            memory, answers = scratch.memory, told
            if wanted == ALL:
                answers = told._replace(handles=np.empty(room, UINT32))
            place = start, stop, total
            given = rows, wanted, place, self._columns.node_handle, memory, tuple(answers)
            start, needed, written, pairs, digits, _ = self._rows((view, bodies, *given))
            if start < 0:
                return Part(start, begin, stop, parts, 0, 0)
            compared, more, total = compared + pairs, more + digits, total + written
            if written:
                parts.append(answers.handles[:written])
            if start < stop and needed == OPEN:
                legal = legal or with_records(QueryRows(*rows))
                parts.append(self._tell(legal, bodies, wanted, told, start))
                total += len(parts[-1])
                start += 1
                if wanted == ALL:
                    told.numbers[start] = total
                continue
            room = max(2 * room, needed)
            if needed * FOUND > len(memory):
                scratch.make_room(needed)
        self.spare.give(scratch)
        return Part(0, begin, stop, parts, compared, more)

    def _tell(
        self, rows: QueryRows, bodies: Any, wanted: int, told: Answers, row: int
    ) -> NDArray[np.uint32]:
        """Answer a row that is open, by `find`; return the handles."""
        hulls = None if bodies is None else bodies.query_hulls
        scratch, order = self.find(rows.one(row), hulls, rows.mask(row), None)
        found = scratch.found
        handles = self._columns.node_handle[found.slots[order]].astype(np.uint32)
        met, first = len(order), order[0] if order else 0
        if wanted == ANY:
            told.touched[row] = met > 0
        if wanted in (COUNT, HITS):
            told.numbers[row] = met
        if wanted in (FIRST, HITS):
            told.handles[row] = handles[0] if met else NO_NODE
        if wanted == HITS:
            told.distances[row] = found.distances[first] if met else np.inf
            told.points[row] = found.points[first] if met else np.nan
        self.spare.give(scratch)
        return handles

    def _fill(
        self, scratch: Scratch, bodies: Bodies | None, query: QueryShape, mask: np.uint32
    ) -> tuple[int, int]:
        """Call the kernel until there is room for what it finds; how many there are, and how many
        of them are doubtful.
        """
        columns, variant = self._columns, None if bodies is None else bodies.hulls is not None
        while True:
            found = scratch.found
            asked = bodies, query, mask, False
            given = self._tree.view().tree, *asked, columns.node_handle, found
            entry = self._entries.get(variant)
            if entry is None:
                entry = self._entries[variant] = entry_point(touching, *given)
            count, doubtful, compared, more = entry(*given)
            if count == REFUSED:
                raise RuntimeError(IS_CHANGED)
            if compared:
                columns.pairs_compared += compared
                columns.pairs_in_more_digits += more
            if count <= len(found.slots):
                return count, doubtful
            scratch.make_room(count)

    def _holds(self, query: QueryShape, slot: np.int64) -> bool:
        """Whether an axis-aligned box in doubt is within the tolerance, as real arithmetic
        decides.
        """
        ndim = self._tree.ndim
        lo, hi = corners(self._columns.geometry[slot : slot + 1])
        lower, upper = query.bounds[:, :ndim]
        return bool(boxes_within(lo[:, :ndim], hi[:, :ndim], lower, upper, query.tolerance)[0])


def as_wanted(
    told: tuple[Any, ...],
    parts: list[NDArray[np.uint32]],
    wanted: int,
    shadows: bool,
    every: Any = None,
) -> Any:
    """What a batch returns of plain `Answers`, the handles of ALL in parts. With `shadows` an
    obstacle may stand at two places, see slicing.py: it counts once, as in `every`, what a batch
    returns of which ALL are wanted.
    """
    if wanted == ALL:
        met = parts[0] if len(parts) == 1 else np.concatenate((NOBODY, *parts))
        return _once(told[1], met) if shadows else (told[1], met)
    if every is not None:
        told[1][:] = np.diff(every[0])
    if wanted == HITS:
        return tuple.__new__(BoxHits, (told[2], told[1], *told[3:]))
    return told[wanted]


def _once(offsets: Slots, handles: NDArray[np.uint32]) -> Any:
    """(offsets, node handles) with each obstacle once a row."""
    count = len(offsets) - 1
    of = np.repeat(np.arange(count), np.diff(offsets))
    first = np.sort(np.unique(np.stack((of, handles)), axis=1, return_index=True)[1])
    np.cumsum(np.bincount(of[first], minlength=count), out=offsets[1:])
    return offsets, handles[first]


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
        columns.geometry, columns.hulls, pairs[narrow], planar, found
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
