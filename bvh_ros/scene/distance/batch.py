# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of overlaps, of what is nearest, and of clearances."""

import threading
from functools import partial
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    BOOL,
    CHANGES,
    INT64,
    IS_CHANGED,
    NONE,
    NOT_FINITE,
    UINT32,
    OpenTree,
    View,
    begin_query,
    boxes_within,
    checks,
    end_query,
    in_threads,
    is_finite,
    nearest,
    of_row,
    order_of,
)
from ...tree.access import COUNT as COUNTED
from ...tree.compiler import entry_point, inlined, lean_kernel, stack_array
from ..names import Slots
from ..results import NO_NODE, BoxHits, require_few
from ..shapes.hull import NO_HULLS, Hulls, of_one_type
from ..shapes.shape import FINE, Floats, along_axes
from ..store import Bodies, Columns, ScratchPool
from . import narrow_phase
from .narrow_phase import box_gap, gap
from .penetration import signed_distance_of_shapes
from .query import (
    FAULTY,
    FOUND,
    NARROW,
    NO_GIVEN,
    REFUSED,
    ROUNDED,
    Found,
    QueryRows,
    QueryShape,
    Scratch,
    begin_shaped,
    found_in,
    make_row,
    nearest_kernel,
    number_of,
    overlap_kernel,
    with_records,
)

# ---- Batches of overlap queries and of queries for the nearest: row by row the kernels of one.

# Whether distances have a sign: None, not False, so that kernels without it do not have its code.
Signed: TypeAlias = Literal[True] | None

ANY, COUNT, FIRST, ALL, HITS = range(5)  # what is wanted of each row
OPEN = -1  # only exact arithmetic decides
FEW = 64  # handles that there is room for at first
WANTED = {'any': ANY, 'count': COUNT, 'first': FIRST, 'all': ALL, 'hits': HITS}


class Answers(NamedTuple):
    """What overlap queries find: of each row, if it is wanted."""

    touched: Any
    """(n,) whether there is any, if that is all that is wanted."""
    numbers: Any
    """(n,) how many there are; where ALL are wanted (n + 1,), offsets of theirs."""
    handles: Any
    """(n,) of the first, NO_NODE without any; where ALL are wanted those of all hits, row
    after row."""
    distances: Any
    """(n,) of the first, inf without any."""
    points: Any
    """The same, (n, 3), NaN without any."""


NO_HANDLES = np.empty(0, np.uint32)
NOT_WANTED = np.empty(0, BOOL), np.empty(0, INT64), NO_HANDLES, np.empty(0), np.empty((0, 3))


def room_for(count: int, wanted: int) -> tuple[Any, ...]:
    """Room for what is wanted of so many rows, plain `Answers`."""
    touched, numbers, handles, distances, points = NOT_WANTED
    if wanted == ANY:
        touched = np.empty(count, BOOL)
    elif wanted == COUNT:
        numbers = np.empty(count, INT64)
    elif wanted == FIRST:
        handles = np.empty(count, UINT32)
    elif wanted == ALL:
        numbers, handles = np.empty(count + 1, INT64), np.empty(FEW, UINT32)
        numbers[0] = 0
    else:
        numbers, handles = np.empty(count, INT64), np.empty(count, UINT32)
        distances, points = np.empty(count), np.empty((count, 3))
    return touched, numbers, handles, distances, points


class Points(NamedTuple):
    """n points."""

    points: Any
    """(n, 3)"""
    reaches: Any
    """The largest distance, one for all or (n,)."""
    masks: Any
    """One for all, or (n,)."""
    order: Any
    """In which they are answered, (n,); empty: as they stand."""


class Near(NamedTuple):
    """What is nearest to n points, k a row."""

    handles: Any
    distances: Any
    points: Any


@lean_kernel
def overlap_rows(view, bodies, rows, wanted, place, node_handles, memory, answers):
    """Answer the rows [start, stop) of `QueryRows` by `Answers`, both as plain tuples; place =
    (start, stop, handles before these rows). Returns (rows done, room wanted in `memory`, handles
    written, pairs compared, those of them that took more digits, version of the tree): fewer rows
    than there are where there is no room for the next one, or it is OPEN, which stands for the
    room; REFUSED if the tree is changed, FAULTY or NARROW if a row is.
    """
    tree, (row, stop, before), enough = view.tree, place, wanted == ANY
    found, (records, _, tolerances, masks, _) = found_in(memory), rows
    handles = answers[2]
    written, compared, more, needed = 0, 0, 0, 0
    own, box = stack_array(1, records), stack_array((2, 3), np.float64)
    if not begin_query(tree.state, view.version):
        return REFUSED, 0, 0, 0, 0, 0
    version = tree.state[CHANGES]
    while row < stop:
        record, bounds, fault = make_row(rows, row, own, box)
        aligned, height = not record[0].shaped, record[0].position[2]
        if fault != FINE or (bodies is None and not aligned):
            row = FAULTY if fault != FINE else NARROW
            break
        tolerance, mask = of_row(tolerances, row), of_row(masks, row)
        query = QueryShape(record, bounds, aligned, tolerance, height)
        count, doubtful, pairs, digits = overlap_kernel(
            tree, bodies, query, mask, enough, node_handles, found
        )
        compared, more, needed = compared + pairs, more + digits, count
        if count > found.slots.shape[0]:
            break
        if wanted == ALL and written + count > handles.shape[0]:
            break
        if doubtful > 0 and (not enough or count == doubtful):
            needed = OPEN
            break
        written = write_row(node_handles, found, count, wanted, answers, row, before, written)
        row += 1
    end_query(tree.state)
    return row, needed, written, compared, more, version


@inlined
def write_row(node_handles, found, count, wanted, answers, row, before, written):
    """Write what is wanted of a row; return how many handles are written, with those of rows
    before it, behind `before` others.
    """
    touched, numbers, handles, _, _ = answers
    if wanted == ANY:
        touched[row] = count > 0
    elif wanted == ALL:
        for i in range(count):
            handles[written + i] = node_handles[found.slots[found.order[i]]]
        written += count
        numbers[row + 1] = before + written
    if wanted in (FIRST, HITS):
        write_first(node_handles, found, count, wanted, answers, row)
    if wanted in (COUNT, HITS):
        numbers[row] = count
    return written


@inlined
def write_first(node_handles, found, count, wanted, answers, row):
    """Write the first."""
    first, (_, _, handles, distances, points) = found.order[0], answers
    handles[row] = node_handles[found.slots[first]] if count > 0 else NO_NODE
    if wanted == HITS:
        distances[row] = found.distances[first] if count > 0 else np.inf
        for axis in range(3):
            points[row, axis] = found.points[first, axis] if count > 0 else np.nan


@lean_kernel
def nearest_rows(view, bodies, points, options, place, node_handles, memory, near):
    """Fill in the rows [start, stop) of `near`; options = (k, whether an obstacle may stand at two
    places, see slicing.py, `Signed`), place = (start, stop). Returns (rows done, room wanted in
    `memory`) as `overlap_rows`; NOT_FINITE rows if a point is not.
    """
    (k, twice, signed), found = options, found_in(memory)
    tree, (done, stop), everybody = view.tree, place, view.tree.state[COUNTED]
    in_order = bodies is None and signed is None and not twice  # as the tree has them
    if not begin_query(tree.state, view.version):
        return -1, 0
    wanted = 0
    while done < stop:
        row = points.order[done] if points.order.shape[0] > 0 else done
        reach, mask = of_row(points.reaches, row), of_row(points.masks, row)
        point, limit = points.points[row], max(reach * ROUNDED, reach)
        if not is_finite(point, point):
            end_query(tree.state)
            return NOT_FINITE, 0
        wanted, filled = min(k if in_order else k + 1, everybody + 1), 0
        while wanted <= found.slots.shape[0]:
            question = (wanted, limit, mask)
            count = nearest_kernel(tree, bodies, point, question, signed, node_handles, found)
            filled = keep(found, count, (k, reach, twice), node_handles, near, row)
            if (
                in_order
                or count < wanted
                or (
                    filled == k
                    and found.bounds[count - 1] > max(near.distances[row, k - 1], 0.0) * ROUNDED
                )
            ):
                break
            wanted = min(wanted * 4, everybody + 1)
        if wanted > found.slots.shape[0]:
            break
        pad(near, row, filled)
        done += 1
    end_query(tree.state)
    return done, wanted


@lean_kernel
def keep(found, count, options, node_handles, near, row):
    """Write the first k that are within reach to a row of `near`; return how many there are."""
    k, reach, twice = options
    filled = 0
    for i in range(count):
        place = found.order[i]
        handle, repeated = node_handles[found.slots[place]], False
        if filled == k or not found.distances[place] <= reach:
            break
        if twice:
            for j in range(filled):
                repeated = repeated or near.handles[row, j] == handle
        if repeated:
            continue
        near.handles[row, filled], near.distances[row, filled] = handle, found.distances[place]
        for axis in range(3):
            near.points[row, filled, axis] = found.points[place, axis]
        filled += 1
    return filled


@inlined
def pad(near, row, filled):
    """Write that there is nothing more."""
    for j in range(filled, near.handles.shape[1]):
        near.handles[row, j], near.distances[row, j] = NO_NODE, np.inf
        near.points[row, j] = np.nan


def bodies_of(columns: Columns, hulls: Hulls | None) -> Bodies:
    """What the narrow phase reads of a scene, and of the meshes of queries."""
    if hulls is None:
        return columns.bodies
    mine, theirs = of_one_type(columns.hulls or NO_HULLS, hulls)
    return columns.bodies._replace(hulls=mine, query_hulls=theirs)


class RowKernel:
    """A kernel of this module as machine code, one for boxes alone, one for all shapes, one for
    meshes too.
    """

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._codes: dict[type | None, Any] = {}

    def call(self, given: tuple[Any, ...]) -> Any:
        """Call it with (view, bodies or None, ...); RuntimeError if the tree is changed
        meanwhile.
        """
        bodies = given[1]
        variant = None if bodies is None else type(bodies[2])
        code = self._codes.get(variant)
        if code is None:
            code = self._codes[variant] = entry_point(self._kernel, *given)
        counted = code(*given)
        if counted[0] == REFUSED:
            raise RuntimeError(IS_CHANGED)
        return counted


# ---- Which obstacles touch a query shape, and which touch each other.


class Part(NamedTuple):
    """What became of the rows [start, stop)."""

    reason: int
    """Why there is no answer, or 0."""
    start: int
    stop: int
    handles: list[NDArray[np.uint32]]
    """Of all hits, in parts."""
    compared: int
    more: int


class Overlaps:
    """Overlap queries of one scene."""

    def __init__(self, tree: OpenTree, columns: Columns) -> None:
        self._tree = tree
        self._columns = columns
        self.spare = ScratchPool(Scratch)
        self._entries: dict[type | None, Any] = {}
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
        """`find` of n shapes, plain `QueryRows`: what is `wanted` (see `WANTED`) of each,
        as `Scene.overlap_many` returns it; None if a row that is `given` is not legal.
        """
        columns, count, done = self._columns, number_of(rows), 0
        narrow, results = columns.shaped > 0 or begin_shaped(rows), room_for(count, wanted)
        parts: list[NDArray[np.uint32]] = []
        if threads == 1:  # without what others take: a fifth of a call of a row
            view, bodies = self._tree.latest(), bodies_of(columns, hulls) if narrow else None
            scratch, handles = self.spare.take(), columns.node_handle
            every = view, bodies, rows, wanted, (0, count, 0), handles, scratch.memory, results
            done, _, written, compared, more, version = self._rows(every)
            self.spare.give(scratch)
            if compared and done >= 0:
                columns.pairs_compared += compared
                columns.pairs_in_more_digits += more
            if wanted == ALL and done >= 0:
                parts.append(results[2][:written])
        if done < count or threads > 1:
            view = View(view.tree, version) if done > 0 else self._tree.view()
            some = wanted, threads, narrow, max(done, 0)
            others = self._work_on(view, hulls, rows, some, Answers(*results))
            if others is None:
                return None
            parts += others
        if columns.shadows and wanted in (COUNT, HITS):
            every = self.answer(rows, hulls, ALL, threads)
            return as_wanted(results, parts, wanted, True, every)
        return as_wanted(results, parts, wanted, columns.shadows > 0)

    def _work_on(
        self,
        view: View,
        hulls: Hulls | None,
        rows: tuple[Any, ...],
        options: tuple[int, int, bool, int],
        results: Answers,
    ) -> list[NDArray[np.uint32]] | None:
        """Answer the rows from `first` on, options = (wanted, threads, whether some need a narrow
        phase, first); return the handles of hits in parts, None if a row that is `given` is not
        legal.
        """
        wanted, threads, narrow, first = options
        bodies = bodies_of(self._columns, hulls) if narrow else None
        count = number_of(rows)
        parts: list[NDArray[np.uint32]] = []
        work = partial(self._work, view, bodies, rows, wanted, results)
        for done in in_threads(work, count, threads) if first == 0 else [work(first, count)]:
            if done.reason == NARROW:  # a kernel that comes to a row that is shaped begins anew
                return self._work_on(view, hulls, rows, (wanted, threads, True, first), results)
            if done.reason == FAULTY:
                return None
            self._columns.pairs_compared += done.compared
            self._columns.pairs_in_more_digits += done.more
            if wanted == ALL and done.start > 0:
                results.numbers[done.start + 1 : done.stop + 1] += results.numbers[done.start]
            parts += done.handles
        return parts

    def _work(
        self,
        view: View,
        bodies: Any,
        rows: tuple[Any, ...],
        wanted: int,
        results: Answers,
        start: int,
        stop: int,
    ) -> Part:
        """Answer the rows [start, stop), if no reason prevents it."""
        parts: list[NDArray[np.uint32]] = []
        begin, total, compared, more, room, legal = start, 0, 0, 0, FEW, None
        scratch = self.spare.take()
        while start < stop:
            memory, answers = scratch.memory, results
            if wanted == ALL:
                answers = results._replace(handles=np.empty(room, UINT32))
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
                parts.append(self._answer_exactly(legal, bodies, wanted, results, start))
                total += len(parts[-1])
                start += 1
                if wanted == ALL:
                    results.numbers[start] = total
                continue
            room = max(2 * room, needed)
            if needed * FOUND > len(memory):
                scratch.make_room(needed)
        self.spare.give(scratch)
        return Part(0, begin, stop, parts, compared, more)

    def _answer_exactly(
        self, rows: QueryRows, bodies: Any, wanted: int, results: Answers, row: int
    ) -> NDArray[np.uint32]:
        """Answer a row that is open, by `find`; return the handles."""
        hulls = None if bodies is None else bodies.query_hulls
        scratch, order = self.find(rows.one(row), hulls, rows.mask(row), None)
        found = scratch.found
        handles = self._columns.node_handle[found.slots[order]].astype(np.uint32)
        touching, first = len(order), order[0] if order else 0
        if wanted == ANY:
            results.touched[row] = touching > 0
        if wanted in (COUNT, HITS):
            results.numbers[row] = touching
        if wanted in (FIRST, HITS):
            results.handles[row] = handles[0] if touching else NO_NODE
        if wanted == HITS:
            results.distances[row] = found.distances[first] if touching else np.inf
            results.points[row] = found.points[first] if touching else np.nan
        self.spare.give(scratch)
        return handles

    def _fill(
        self, scratch: Scratch, bodies: Bodies | None, query: QueryShape, mask: np.uint32
    ) -> tuple[int, int]:
        """Call the kernel until there is room for what it finds; how many there are, and how many
        of them are doubtful.
        """
        columns, variant = self._columns, None if bodies is None else type(bodies.hulls)
        while True:
            found = scratch.found
            options = bodies, query, mask, False
            given = self._tree.view().tree, *options, columns.node_handle, found
            entry = self._entries.get(variant)
            if entry is None:
                entry = self._entries[variant] = entry_point(overlap_kernel, *given)
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
    results: tuple[Any, ...],
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
        touching = parts[0] if len(parts) == 1 else np.concatenate((NO_HANDLES, *parts))
        return _once(results[1], touching) if shadows else (results[1], touching)
    if every is not None:
        results[1][:] = np.diff(every[0])
    if wanted == HITS:
        return tuple.__new__(BoxHits, (results[2], results[1], *results[3:]))
    return results[wanted]


def _once(offsets: Slots, handles: NDArray[np.uint32]) -> Any:
    """(offsets, node handles) with each obstacle once a row."""
    count = len(offsets) - 1
    of = np.repeat(np.arange(count), np.diff(offsets))
    first = np.sort(np.unique(np.stack((of, handles)), axis=1, return_index=True)[1])
    np.cumsum(np.bincount(of[first], minlength=count), out=offsets[1:])
    return offsets, handles[first]


def find_pairs(tree: OpenTree, columns: Columns, mask: int) -> Slots:
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


# ---- Which obstacles are nearest to a point, by their true shapes.
#
# No shape is nearer than its box. So the tree gives the nearest boxes, ever more of them, until
# the next box is farther than the k-th nearest shape among them.

MORE = 4
# From so many points on their order counts: as they stand 10,000 points take 1.2 times as long.
MANY, NO_ORDER = 1000, np.empty(0, np.int64)


class Nearness:
    """Queries of one scene for what is nearest."""

    def __init__(self, tree: OpenTree, columns: Columns) -> None:
        self._tree = tree
        self._columns = columns
        self.spare = ScratchPool(Scratch)
        self._entries: dict[tuple[type | None, Signed], Any] = {}
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
        # Some more: mostly they show at once that no other is nearer.
        boxes = k if in_order else k + MORE
        while True:
            boxes = min(boxes, everybody + 1)
            if boxes > len(scratch.found.slots):
                scratch.make_room(boxes)
            found = scratch.found
            count = self._fill(point, (boxes, reach, mask), signed, found)
            distances = found.distances[:count].tolist()
            order = [row for row in found.order[:count].tolist() if distances[row] <= max_distance]
            order = self._different(found, order)[:k]
            if (
                in_order
                or count < boxes
                or (
                    len(order) == k
                    and found.bounds.item(count - 1) > max(distances[order[-1]], 0.0) * ROUNDED
                )
            ):
                return scratch, order
            boxes *= MORE

    def _fill(
        self, point: Floats, options: tuple[int, float, np.uint32], signed: Signed, found: Found
    ) -> int:
        columns = self._columns
        bodies = bodies_of(columns, columns.hulls) if columns.shaped else None
        variant = None if bodies is None else type(bodies.hulls)
        given = self._tree.view().tree, bodies, point, options, signed, columns.node_handle, found
        entry = self._entries.get((variant, signed))
        if entry is None:
            entry = self._entries[variant, signed] = entry_point(nearest_kernel, *given)
        count: int = entry(*given)
        if count == REFUSED:
            raise RuntimeError(IS_CHANGED)
        return count

    def order_of(self, points: Floats) -> NDArray[np.int64]:
        """An order of many points in which neighbours load the same nodes."""
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
        options = k, columns.shadows > 0, signed
        if threads == 1:  # without what others take
            scratch, start = self.spare.take(), 0
            memory = scratch.memory
            if k * FOUND < len(memory):
                every = (
                    view,
                    bodies,
                    points,
                    options,
                    (0, count),
                    columns.node_handle,
                    memory,
                    near,
                )
                start = self._rows[signed](every)[0]
            self.spare.give(scratch)
            if start == count:
                return near
        given = view, bodies, points, options, near
        done = in_threads(partial(self._work, *given), count, threads)
        return near if all(done) else None

    def _work(
        self,
        view: View,
        bodies: Any,
        points: Points,
        options: tuple[int, bool, Signed],
        near: Near,
        start: int,
        stop: int,
    ) -> bool:
        """Answer the rows [start, stop); whether all points are finite."""
        (k, _, signed), everybody = options, view.tree.state.item(COUNTED)
        wanted, kernel, scratch = min(k, everybody) + 1, self._rows[signed], self.spare.take()
        handles = self._columns.node_handle
        while start < stop:
            if wanted > len(scratch.found.slots):
                scratch.make_room(wanted)
            some = points, options, (start, stop), handles, scratch.memory, near
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


# ---- How far shapes are from the nearest obstacle, by their true shapes.
#
# No two shapes are nearer than their boxes. So the tree gives the nearest boxes, ever more of
# them, until the next box is farther than the nearest shape among them.

ROUNDED_GAP = 1.0 + 2.0**-40  # no computed distance is off by as much
MORE_BOXES = 4
FEW_BOXES = 32  # boxes that there is room for at first


class Neighbours(NamedTuple):
    """The obstacles nearest to n shapes."""

    slots: Any
    """(n,) NONE where there is none; empty where the caller needs none."""
    distances: Any
    points: Any
    """(n, 3): the shape's."""
    other_points: Any
    """(n, 3): the obstacle's."""
    handles: Any
    """(n,) uint32 node handles of the obstacles, NO_NODE where there is none."""


NO_SLOTS = np.empty(0, INT64)


def room_for_neighbours(count: int, slots: NDArray[np.int64] = NO_SLOTS) -> Neighbours:
    """Room for so many rows."""
    distances, handles = np.empty(count), np.empty(count, UINT32)
    # As Neighbours(...), which would take one more call of a function of Python's.
    parts = slots, distances, np.empty((count, 3)), np.empty((count, 3)), handles
    return tuple.__new__(Neighbours, parts)


class Room(NamedTuple):
    """For the boxes that the tree gives."""

    slots: Any
    bounds: Any


@lean_kernel
def clearance_rows(view, bodies, rows, options, place, node_handles, room, results):
    """Fill in the rows [start, stop) of `results`; rows as of `QueryRows`, options = (reaches, the
    node handle that is not looked at, `Signed`), place = (start, stop). Returns
    (rows done, room wanted, version of the tree): fewer than there are where there is no room,
    REFUSED if the tree is changed, FAULTY if a shape is not legal.
    """
    (reaches, besides, signed), (records, _, _, masks, _) = options, rows
    tree, (row, stop) = view.tree, place
    if not begin_query(tree.state, view.version):
        return REFUSED, 0, 0
    version, everybody = tree.state[CHANGES], tree.state[COUNTED]
    wanted, own, box = 0, stack_array(1, records), stack_array((2, 3), np.float64)
    while row < stop:
        record, bounds, fault = make_row(rows, row, own, box)
        if fault != FINE:
            row = FAULTY
            break
        write_none(results, row)
        reach, wanted, looked = of_row(reaches, row), min(2, everybody + 1), 0
        while wanted <= room.slots.shape[0]:
            low, high = bounds[0], bounds[1]
            limit, mask = max(reach * ROUNDED_GAP, reach), of_row(masks, row)
            count = nearest(tree, low, high, wanted, limit, mask, room.slots, room.bounds)
            fresh = room.slots[looked:count]
            options_of = reach, besides, signed
            look_at(bodies, record[0], row, options_of, node_handles, fresh, results)
            distance = max(results.distances[row], 0.0)
            if count < wanted or room.bounds[count - 1] > distance * ROUNDED_GAP:
                break
            looked, wanted = count, min(wanted * MORE_BOXES, everybody + 1)
        if wanted > room.slots.shape[0]:
            break
        row += 1
    end_query(tree.state)
    return row, wanted, version


@lean_kernel
def apart(one, other, bodies, signed, points):
    """Distance of a shape from an obstacle; minus the depth, if it is `signed`."""
    planar = bodies.footprints is not None
    if one.shaped or other.shaped:
        distance = gap(one, bodies.query_hulls, other, bodies.hulls, planar, points)
    else:
        distance = box_gap(one, other, 2 if planar else 3, points)
    if signed is not None:
        distance = signed_distance_of_shapes(one, other, bodies, distance, points)
    return distance


@lean_kernel
def look_at(bodies, one, row, options, node_handles, slots, results):
    """Keep the nearest of some obstacles, if it is nearer than what is there; ties by handle."""
    (reach, besides, signed), points = options, stack_array((2, 3), np.float64)
    for i in range(slots.shape[0]):
        slot = slots[i]
        if node_handles[slot] != besides:
            distance = apart(one, bodies.shapes[slot], bodies, signed, points)
            if bodies.footprints is not None:
                points[0, 2] = points[1, 2] = one.position[2]
            keep_nearer(node_handles, (slot, distance, reach), points, results, row)


@inlined
def write_none(results, row):
    """Write that there is none."""
    results.handles[row], results.distances[row] = NO_NODE, np.inf
    if results.slots.shape[0] > 0:
        results.slots[row] = NONE
    for axis in range(3):
        results.points[row, axis] = results.other_points[row, axis] = np.nan


@inlined
def keep_nearer(node_handles, found, points, results, row):
    """Keep an obstacle, found = (slot, distance, reach), and points (2, 3), if it is nearer than
    what is there; ties by handle.
    """
    slot, distance, reach = found
    if distance > reach or distance > results.distances[row]:
        return
    handle, best = node_handles[slot], np.int64(results.handles[row])  # NO_NODE is the last one
    if distance == results.distances[row] and best < handle:
        return
    results.distances[row], results.handles[row] = distance, handle
    if results.slots.shape[0] > 0:
        results.slots[row] = slot
    for axis in range(3):
        results.points[row, axis], results.other_points[row, axis] = (
            points[0, axis],
            points[1, axis],
        )


class Memory(threading.local):
    """Room of a thread: to make it takes a tenth of a call of one row."""

    def __init__(self) -> None:
        self.room = Room(np.empty(FEW_BOXES, INT64), np.empty(FEW_BOXES))


class Clearances:
    """Distances in one scene."""

    def __init__(self, tree: OpenTree, columns: Columns) -> None:
        self._tree = tree
        self._columns = columns
        self._memory = Memory()
        kinds: tuple[Signed, ...] = (None, True)
        self._kernels = {signed: RowKernel(clearance_rows).call for signed in kinds}

    def find_rows(
        self,
        rows: tuple[Any, ...],
        hulls: Hulls | None,
        options: tuple[Floats, int, Signed],
        threads: int,
        slots: NDArray[np.int64] = NO_SLOTS,
    ) -> Neighbours | None:
        """The obstacles nearest to n shapes, plain `QueryRows`, ties by handle.

        options = (reaches, the node handle that is left out, whether distances have a sign),
        `slots`: room for theirs. None if a row that is `given` is not legal.
        """
        columns, count = self._columns, number_of(rows)
        bodies, results, begun = bodies_of(columns, hulls), room_for_neighbours(count, slots), 0
        view = self._tree.latest() if threads == 1 else self._tree.view()
        if threads == 1:  # without what others take
            room, handles = self._memory.room, columns.node_handle
            every = view, bodies, rows, options, (0, count), handles, room, results
            begun, _, version = self._kernels[options[2]](every)
            if begun == count:
                return results
            if begun == FAULTY:
                return None
            view = View(view.tree, version)
        work = partial(self._work, view, bodies, rows, options, results)
        done = [work(begun, count)] if threads == 1 else in_threads(work, count, threads)
        return results if all(done) else None

    def _work(
        self,
        view: View,
        bodies: Any,
        rows: tuple[Any, ...],
        options: tuple[Any, ...],
        results: Neighbours,
        start: int,
        stop: int,
    ) -> bool:
        """Fill in the rows [start, stop); whether all are legal."""
        wanted, kernel, handles = FEW_BOXES, self._kernels[options[2]], self._columns.node_handle
        while start < stop:
            room = Room(np.empty(wanted, INT64), np.empty(wanted))
            given = view, bodies, rows, options, (start, stop), handles, room, results
            start, wanted, _ = kernel(given)
            if start == FAULTY:
                return False
        return True

    def nearest_other(self, slot: int, signed: Signed) -> Neighbours:
        """What is nearest to the obstacle of a slot."""
        records, handle = self._columns.geometry[slot : slot + 1], self._columns.node_handle[slot]
        lo, hi = self._tree.boxes(self._columns.tree_handle[slot : slot + 1])
        bounds = np.zeros((1, 2, 3))
        bounds[0, 0, : lo.shape[1]], bounds[0, 1, : lo.shape[1]] = lo, hi
        rows = records, bounds, checks.NOTHING, checks.EVERYTHING, NO_GIVEN
        options = checks.FOREVER, int(handle), signed
        found = self.find_rows(rows, self._columns.hulls, options, 1, np.empty(1, INT64))
        assert found is not None
        return found
