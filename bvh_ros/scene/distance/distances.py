# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps, what is nearest, and clearances of a scene: how the kernels of `batch` are called."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    INT64,
    IS_CHANGED,
    NONE,
    UINT32,
    View,
    boxes_within,
    in_threads,
    order_of,
)
from ...tree.compiler import entry_point
from ..names import Slots
from ..results import NO_NODE, BoxHits, SceneHit, require_few
from ..shapes.hull import NO_HULLS, Hulls, of_one_type
from ..shapes.shape import Floats, along_axes
from ..store import Bodies, Columns, Obstacles, ScratchPool
from .batch import (
    ALL,
    ANY,
    COUNT,
    FEW,
    FIRST,
    HITS,
    NO_HANDLES,
    OPEN,
    Near,
    Neighbours,
    Points,
    Signed,
    clearance_rows,
    corners,
    nearest_rows,
    overlap_rows,
    room_for,
    room_for_near,
    room_for_neighbours,
)
from .query import (
    FAULTY,
    FOUND,
    NARROW,
    REFUSED,
    Found,
    QueryRows,
    QueryShape,
    begin_shaped,
    found_in,
    overlap_kernel,
    with_records,
)

# From so many points on their order counts: as they stand 10,000 points take 1.2 times as long.
MANY, NO_ORDER = 1000, np.empty(0, INT64)
SOME_MORE = 4  # boxes for one point: mostly they show at once that no other is nearer
# Questions, which are multiples of this, and what else the types of arguments depend on.
KINDS = 4
OVERLAPS, NEAREST, CLEARANCES = 0, KINDS, 2 * KINDS
SIGNED, IN_PACKETS = 1, 2


class Batch(NamedTuple):
    """Rows for a kernel."""

    question: int
    """OVERLAPS, NEAREST or CLEARANCES, and SIGNED or IN_PACKETS."""
    rows: Any
    options: tuple[Any, ...]
    results: Any
    hulls: Hulls | None
    """The meshes of the rows."""
    narrow: bool
    """Whether some shapes are more than axis-aligned boxes."""
    at: Any
    """s, one for all or (n,); None: as the obstacles are."""


class Part(NamedTuple):
    """What the rows [start, stop) touch."""

    start: int
    stop: int
    handles: list[NDArray[np.uint32]]
    """Of all hits, in parts."""
    compared: int
    more: int


class Scratch:
    """Room that kernels write to, see `ScratchPool`. And what they read of one query, as making
    arrays of one row would take longer than most queries.
    """

    def __init__(self) -> None:
        self.limits, self.masks, self.point = np.empty(1), np.empty(1, UINT32), np.empty((1, 3))
        self.points = Points(self.point, self.limits, self.masks, NO_ORDER)
        self.near = room_for_near(1, 1)
        self.make_room(FEW)

    def make_room(self, count: int) -> None:
        """Have room for at least so many rows."""
        self.memory = np.empty(FOUND * 2 * count)
        self.found: Found = found_in.py_func(self.memory)

    def have_room(self, count: int) -> None:
        """`make_room` if there is less."""
        if count > len(self.found.slots):
            self.make_room(count)


class Distances:
    """Overlaps and distances in one scene, among obstacles as they are."""

    kernels: tuple[Any, ...] = overlap_rows, nearest_rows, clearance_rows
    scratch: type[Scratch] = Scratch

    def __init__(self, store: Obstacles) -> None:
        self._store = store
        self._tree, self._columns = store.tree, store.columns
        pool = ScratchPool(self.scratch)
        self._take, self._give = pool.take, pool.give
        self._codes: dict[tuple[Any, ...], Any] = {}

    # ---- one query

    def find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, most: int | None, at: Any
    ) -> list[SceneHit]:
        """The obstacles whose distance from the query's shape is at most its tolerance, in order
        of their distances from its centre, ties by handle. TooManyHitsError if they are more than
        `most`.
        """
        scratch, rows = self._find(query, hulls, mask, at)
        if self._columns.shadows:
            rows = self._different(scratch.found, rows)
        if most is not None:
            require_few(len(rows), most)
        hits = self._store.hits(scratch.found, rows) if rows else []
        self._give(scratch)
        return hits

    def _find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, at: Any
    ) -> tuple[Scratch, list[int]]:
        """What is known of them until that is given back, and their rows."""
        columns, scratch = self._columns, self._take()
        bodies = bodies_of(columns, hulls) if columns.shaped or not query.aligned else None
        variant = (None if bodies is None else type(bodies.hulls),)
        while True:
            found = scratch.found
            options = bodies, query, mask, False
            given = self._tree.view().tree, *options, columns.node_handle, found
            code = self._codes.get(variant)
            if code is None:
                code = self._codes[variant] = entry_point(overlap_kernel, *given)
            count, doubtful, compared, more = code(*given)
            if count == REFUSED:
                raise RuntimeError(IS_CHANGED)
            if compared:
                columns.pairs_compared += compared
                columns.pairs_in_more_digits += more
            if count <= len(found.slots):
                break
            scratch.make_room(count)
        order = found.order[:count].tolist()
        if doubtful:
            sure = ~found.doubtful
            order = [i for i in order if sure[i] or self._holds(query, found.slots[i])]
        return scratch, order

    def _holds(self, query: QueryShape, slot: np.int64) -> bool:
        """Whether an axis-aligned box in doubt is within the tolerance, as real arithmetic
        decides.
        """
        ndim = self._tree.ndim
        lo, hi = corners(self._columns.geometry[slot : slot + 1])
        lower, upper = query.bounds[:, :ndim]
        return bool(boxes_within(lo[:, :ndim], hi[:, :ndim], lower, upper, query.tolerance)[0])

    def find_nearest(
        self, point: Floats, k: int, limits: tuple[float, np.uint32], signed: Signed, at: Any
    ) -> list[SceneHit]:
        """Up to k obstacles nearest to a point, limits = (max_distance, mask), nearest first, ties
        by handle.
        """
        scratch, done, count = self._take(), 0, 0
        scratch.point[0] = point
        scratch.limits[0], scratch.masks[0] = limits
        if k > FEW:  # not more room than for all
            k = min(k, max(len(self._tree), 1))
        if scratch.near[0].shape[1] != k:
            scratch.near = room_for_near(1, k)
        batch = self._near_batch(scratch.points, k, signed, scratch.near, at, SOME_MORE)
        while not done:
            done, wanted, count, _ = self._ask(self._tree.latest(), scratch, batch, 0, 1)
            if not done:
                scratch.have_room(wanted)
        found, reach = scratch.found, limits[0]
        distances = found.distances[:count].tolist()
        rows = [row for row in found.order[:count].tolist() if distances[row] <= reach]
        if self._columns.shadows:
            rows = self._different(found, rows)
        hits = self._store.hits(found, rows[:k])
        self._give(scratch)
        return hits

    def _different(self, found: Found, rows: list[int]) -> list[int]:
        """The first row of each obstacle: one may stand at two places, see slicing.py."""
        handles = self._columns.node_handle[found.slots[rows]].tolist()
        first: dict[int, int] = {}
        for handle, row in zip(handles, rows, strict=True):
            first.setdefault(handle, row)
        return list(first.values())

    # ---- batches

    def touching(
        self,
        rows: tuple[Any, ...],
        count: int,
        hulls: Hulls | None,
        wanted: int,
        threads: int,
        at: Any,
    ) -> Any:
        """`find` of so many shapes, plain `QueryRows`: what is `wanted` (see `WANTED`) of each,
        as `Scene.overlap_many` returns it; None if a row that is `given` is not legal.
        """
        columns, tree, done = self._columns, self._tree, 0
        narrow = columns.shaped > 0 or at is not None or begin_shaped(rows)
        results = room_for(count, wanted)
        batch = OVERLAPS, rows, (wanted, 0), results, hulls, narrow, at
        parts: list[NDArray[np.uint32]] = []
        view = tree.latest() if threads == 1 else tree.view()
        if threads == 1:  # without what others take: a fifth of a call of a row
            scratch = self._take()
            done, _, written, compared, more, version = self._ask(view, scratch, batch, 0, count)
            self._give(scratch)
            if compared:
                columns.pairs_compared += compared
                columns.pairs_in_more_digits += more
            if wanted == ALL:
                parts.append(results[2][:written])
            if done < count:
                view = View(view.tree, version)
            elif wanted < ALL and not columns.shadows:
                return results[wanted]
        if done < count or threads > 1:
            work = partial(self._touching, view, Batch(*batch))
            for part in [work(done, count)] if threads == 1 else in_threads(work, count, threads):
                if part is None:
                    return None
                columns.pairs_compared += part.compared
                columns.pairs_in_more_digits += part.more
                if wanted == ALL and part.start > 0:
                    results[1][part.start + 1 : part.stop + 1] += results[1][part.start]
                parts += part.handles
        every = None
        if columns.shadows and wanted in (COUNT, HITS):
            every = self.touching(rows, count, hulls, ALL, threads, at)
        return as_wanted(results, parts, wanted, columns.shadows > 0, every)

    def _touching(self, view: View, batch: Batch, start: int, stop: int) -> Part | None:
        """Answer the rows [start, stop) of OVERLAPS; None if one is not legal."""
        (wanted, _), results, legal = batch.options, batch.results, None
        parts: list[NDArray[np.uint32]] = []
        begin, total, compared, more, room = start, 0, 0, 0, FEW
        scratch = self._take()
        while start < stop:
            if wanted == ALL:
                results = *results[:2], np.empty(room, UINT32), *results[3:]
            batch = batch._replace(options=(wanted, total), results=results)
            start, needed, written, pairs, digits, _ = self._ask(view, scratch, batch, start, stop)
            compared, more, total = compared + pairs, more + digits, total + written
            if written:
                parts.append(results[2][:written])
            if needed == FAULTY:
                return None
            if needed == NARROW:
                batch = batch._replace(narrow=True)
            elif needed == OPEN:
                legal = legal or with_records(QueryRows(*batch.rows))
                parts.append(self._answer_exactly(legal, batch, wanted, start))
                total += len(parts[-1])
                start += 1
                if wanted == ALL:
                    results[1][start] = total
            else:
                room = max(2 * room, needed)
                scratch.have_room(needed)
        self._give(scratch)
        return Part(begin, stop, parts, compared, more)

    def _answer_exactly(
        self, rows: QueryRows, batch: Batch, wanted: int, row: int
    ) -> NDArray[np.uint32]:
        """Answer a row that is open, by `find`; return the handles."""
        scratch, order = self._find(rows.one(row), batch.hulls, rows.mask(row), batch.at)
        found, (touched, numbers, first_handles, distances, points) = scratch.found, batch.results
        handles = self._columns.node_handle[found.slots[order]].astype(np.uint32)
        touching, first = len(order), order[0] if order else 0
        if wanted == ANY:
            touched[row] = touching > 0
        if wanted in (COUNT, HITS):
            numbers[row] = touching
        if wanted in (FIRST, HITS):
            first_handles[row] = handles[0] if touching else NO_NODE
        if wanted == HITS:
            distances[row] = found.distances[first] if touching else np.inf
            points[row] = found.points[first] if touching else np.nan
        self._give(scratch)
        return handles

    def nearest(
        self, points: Points, k: int, signed: Signed, threads: int, at: Any
    ) -> Near | None:
        """The k obstacles nearest to each of n points, as `find_nearest` has them; None if one is
        not finite.
        """
        count, begin = len(points[0]), None
        if count >= MANY:
            points, begin = self._look_ahead(points, k, signed, at)
        near = room_for_near(count, k)
        batch = self._near_batch(points, k, signed, near, at)
        return near if self._answer(batch, count, threads, begin) else None

    def _look_ahead(self, points: Points, k: int, signed: Signed, at: Any) -> tuple[Points, Any]:
        """Points with what packets find of them, and `begin` of `_answer`; None without."""
        return points, None

    def _near_batch(
        self, points: Points, k: int, signed: Signed, near: Near, at: Any, some_more: int = 1
    ) -> Any:
        """The `Batch` of NEAREST, as a plain tuple; `some_more`: boxes that are looked at with the
        k nearest, where these are not all in order.
        """
        columns, question = self._columns, NEAREST
        narrow, twice = columns.shaped > 0, columns.shadows > 0
        if signed is not None:
            question += SIGNED
        elif not (narrow or twice or (at is not None and self._store.uncertainty > 0.0)):
            some_more = 0
        if points[4] is not None:
            question += IN_PACKETS
        return question, points, (k, some_more, twice, signed), near, None, narrow, at

    def order_of(self, points: Floats) -> NDArray[np.int64]:
        """An order of many points in which neighbours load the same nodes."""
        return order_of(self._tree.view().tree, along_axes(points, self._tree.ndim))

    def clearances(
        self,
        rows: tuple[Any, ...],
        count: int,
        hulls: Hulls | None,
        options: tuple[Floats, int, Signed],
        threads: int,
        at: Any,
    ) -> Neighbours | None:
        """The obstacles nearest to so many shapes, plain `QueryRows`, ties by handle.

        options = (reaches, the slot of the obstacle that is the only row, which the kernel fills
        in, or NONE, whether distances have a sign). None if a row that is `given` is not legal.
        """
        reaches, itself, signed = options
        results, alike = room_for_neighbours(count, itself != NONE), False
        if at is not None and itself == NONE:
            alike = not (self._columns.shaped or self._store.uncertainty)
        question = CLEARANCES if signed is None else CLEARANCES + SIGNED
        batch = question, rows, (reaches, itself, signed, alike), results, hulls, True, at
        return results if self._answer(batch, count, threads) else None

    # ---- kernels

    def _answer(self, batch: Any, count: int, threads: int, begin: Any = None) -> bool:
        """Fill in the results of a `Batch`, as a plain tuple; whether all rows are legal.
        begin(start, stop) is called before some of them.
        """
        view, done = self._tree.latest(), 0
        if threads == 1 and begin is None:  # without what others take
            scratch = self._take()
            answered = self._ask(view, scratch, batch, 0, count)
            done = answered[0]
            self._give(scratch)
            if done == count:
                return True
            view = View(view.tree, answered[-1])
        else:
            view = self._tree.view()
        work = partial(self._fill, view, batch, begin)
        legal = all([work(done, count)] if threads == 1 else in_threads(work, count, threads))
        if begin is not None:
            self._tree.check_unchanged(view)
        return legal

    def _fill(self, view: View, batch: Any, begin: Any, start: int, stop: int) -> bool:
        """Fill in the rows [start, stop)."""
        if begin is not None:
            begin(start, stop)
        scratch = self._take()
        while start < stop:
            start, wanted = self._ask(view, scratch, batch, start, stop)[:2]
            if wanted == FAULTY:
                return False
            scratch.have_room(wanted)
        self._give(scratch)
        return True

    def _ask(self, view: View, scratch: Scratch, batch: Any, start: int, stop: int) -> Any:
        """Call the kernel of a `Batch`; RuntimeError if the tree is changed meanwhile."""
        question, rows, options, results, hulls, narrow, _ = batch
        columns, bodies, variant = self._columns, None, None
        if narrow:
            bodies = columns.bodies if hulls is None else bodies_of(columns, hulls)
            variant = type(bodies[2])
        place, handles, memory = (start, stop), columns.node_handle, scratch.memory
        given = view, bodies, handles, memory, rows, place, options, results
        code = self._codes.get((question, variant))
        if code is None:
            code = self._compile(question, variant, *given)
        done = code(*given)
        if done[0] < 0:
            raise RuntimeError(IS_CHANGED)
        return done

    def _compile(self, question: int, variant: Any, *given: Any) -> Any:
        code = entry_point(self.kernels[question // KINDS], *given)
        self._codes[question, variant] = code
        return code


def bodies_of(columns: Columns, hulls: Hulls | None) -> Bodies:
    """What the narrow phase reads of a scene, and of the meshes of queries."""
    if hulls is None:
        return columns.bodies
    mine, theirs = of_one_type(columns.hulls or NO_HULLS, hulls)
    return columns.bodies._replace(hulls=mine, query_hulls=theirs)


def as_wanted(
    results: tuple[Any, ...],
    parts: list[NDArray[np.uint32]],
    wanted: int,
    shadows: bool,
    every: Any,
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
