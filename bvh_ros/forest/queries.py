# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Queries of a forest: what a worker does for one part, which rows go to which parts, and how the
answers of several parts become one.

The tree over the parts decides exactly which parts a query meets. Rays and points visit theirs
nearest first, until no part can hold a nearer box. Distances are right within 2 ulp. Hits of two
parts that are as near to each other are compared exactly, in a tree of their two boxes.
"""

from collections.abc import Iterator
from concurrent.futures import Executor, as_completed
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree import RayHits
from ..tree.access import NONE, Floats, Ids, OpenTree, checks, mapped
from .building import ids_file, part_file

# Parts that a process has open: each has a snapshot of its own once enough rays have come.
OPEN_PARTS = 2
# Rows that are answered at once, and rows of one task: these bound the memory of the process that
# asks, and of a worker.
ROWS_AT_ONCE, ROWS_A_TASK = 1 << 20, 1 << 17
# Parts that a point looks up at first; then four times as many, for points that are not done.
FEW_PARTS = 4
# Distances within this factor, and this sum, of each other may be in either order: each is within
# 2 ulp of the exact one, or 4 roundings from a point.
DOUBT = 1.0 + 16 * 2.0**-53
LEAST_DOUBT = 64 * 5e-324

# ---- one part, in the worker


class PartHits(NamedTuple):
    """First hits of rays among the boxes of a part."""

    ids: Ids
    t: Floats
    normals: Floats
    handles: Ids
    """By which the part knows the boxes."""


class Part(NamedTuple):
    """A mapped tree, and the ids of its boxes by slot. Its methods are what a part is asked."""

    tree: OpenTree
    ids: Ids

    def raycast(self, *rays: Any) -> PartHits:
        """First hits."""
        handles, t, normals = self.tree.raycast_many(*rays)
        return PartHits(self._ids_of(handles), t, normals, handles)

    def occluded(self, *rays: Any) -> NDArray[np.bool_]:
        """Whether rays hit."""
        return self.tree.occluded_many(*rays)

    def overlap(self, *boxes: Any) -> tuple[Ids, Ids]:
        """How many boxes each row touches, and the ids of all."""
        offsets, handles = self.tree.overlap_many(*boxes)
        return np.diff(offsets), self._ids_of(handles)

    def nearest(self, points: Any, reach: Any, masks: Any, k: int) -> tuple[Ids, Floats]:
        """Ids and distances of the k boxes nearest to points."""
        handles, distances = self.tree.nearest_many(points, k, reach, masks)
        return self._ids_of(handles), distances

    def boxes(self, handles: Ids) -> tuple[Any, Any]:
        """Corners of boxes."""
        return self.tree.boxes(handles)

    def _ids_of(self, handles: Ids) -> Ids:
        """Ids instead of handles; NONE stays."""
        ids, boxes = np.full(handles.shape, NONE, np.int64), handles != NONE
        ids[boxes] = self.ids[self.tree.slots(handles[boxes])]
        return ids


@lru_cache(maxsize=OPEN_PARTS)
def _open(folder: str, number: int, checksum: int) -> Part:
    """`checksum` tells a part from one that was in this folder before, or came there since."""
    file, ids_path = part_file(Path(folder), number), ids_file(Path(folder), number)
    tree = OpenTree.load(file, mmap=True)
    if mapped.checksum(file) != checksum:
        raise ValueError(f'{file} is of another forest or part')
    ids = mapped.map_array(ids_path, len(tree) + 1)
    if ids[-1] != checksum or tree.slots(tree.ids()).max(initial=-1) >= len(tree):
        raise ValueError(f'{ids_path} is of another part')
    return Part(tree, ids)


def ask_part(folder: str, checksum: int, number: int, query: str, *arguments: Any) -> Any:
    """Answer a question by the method of `Part` of this name."""
    return getattr(_open(folder, number, checksum), query)(*arguments)


# ---- rows and the parts that they meet


class Parts(NamedTuple):
    """The parts of a forest, and the executor that queries them."""

    top: OpenTree
    """The tree over the bounds of the parts, in their order."""
    folder: str
    checksums: list[int]
    executor: Executor | None

    def numbers_of(self, handles: Ids) -> Ids:
        """Numbers of parts, by their handles in the tree over the parts; NONE stays."""
        return np.where(handles == NONE, NONE, np.searchsorted(self.top.ids(), handles))

    def along(self, rays: 'Rays') -> tuple[Ids, Ids, Floats]:
        """Where the parts of each ray begin and end, their numbers, nearest first, and how far
        they are.
        """
        ends, handles, ts = self.top.raycast_all_many(*rays[:4])
        return ends, self.numbers_of(handles), ts

    def ask(
        self, query: str, rows: Ids, parts: Ids, columns: Any, *rest: Any
    ) -> Iterator[tuple[Ids, int, Any]]:
        """Ask row ``rows[i]`` of part ``parts[i]``, all i: (rows, part, answer) as they come.

        `columns`: arrays of arguments, one entry a row; `rest`: arguments of all rows.
        """

        def call(some: Ids, part: int) -> tuple[Any, ...]:
            given = (column[some] for column in columns)
            return self.folder, self.checksums[part], part, query, *given, *rest

        tasks = _tasks(rows, parts)
        if self.executor is None:
            for task in tasks:
                yield *task, ask_part(*call(*task))
            return
        submit = self.executor.submit
        submitted = {submit(ask_part, *call(*task)): (task, False) for task in tasks}
        try:
            while submitted:
                for future in as_completed(list(submitted)):
                    task, is_again = submitted.pop(future)
                    try:
                        answer = future.result()
                    except Exception:
                        if is_again:
                            raise
                        # Dask may lose an answer together with the worker that gave it.
                        submitted[submit(ask_part, *call(*task))] = task, True
                        break  # wait for this one, too
                    yield *task, answer
        finally:  # an error, or an interruption: what was not begun is not wanted any more
            for future in submitted:
                future.cancel()


def _tasks(rows: Ids, parts: Ids) -> Iterator[tuple[Ids, int]]:
    """Rows of one part, not too many."""
    order = np.argsort(parts, kind='stable')
    for group in np.split(order, np.flatnonzero(np.diff(parts[order])) + 1):
        for first in range(0, len(group), ROWS_A_TASK):
            some = group[first : first + ROWS_A_TASK]
            yield rows[some], int(parts[some[0]])


def _pieces(count: int) -> Iterator[slice]:
    """All rows, so many at once; one piece of none where there are none."""
    for start in range(0, max(count, 1), ROWS_AT_ONCE):
        yield slice(start, min(start + ROWS_AT_ONCE, count))


# ---- rays


class Rays(NamedTuple):
    """Rays, checked: a value a row."""

    origins: Floats
    directions: Floats
    t_max: Floats
    masks: NDArray[np.uint32]
    skip_inside: bool
    threads: int

    def some(self, rows: slice) -> 'Rays':
        """Rays of these rows."""
        some = self.origins[rows], self.directions[rows], self.t_max[rows], self.masks[rows]
        return Rays(*some, self.skip_inside, self.threads)


class Hits(NamedTuple):
    """The nearest hit so far of each ray, and where its box is."""

    ids: Ids
    t: Floats
    normals: Floats
    parts: Ids
    handles: Ids

    def put(self, rows: Ids, found: PartHits, which: Ids, part: int) -> None:
        """Replace the hits of some rows by those that a part found."""
        self.parts[rows] = part
        for name in PartHits._fields:
            getattr(self, name)[rows] = getattr(found, name)[which]


def check_rays(
    ndim: int,
    origins: ArrayLike,
    directions: ArrayLike,
    t_max: ArrayLike,
    mask: ArrayLike,
    skip_inside: bool,
    threads: int,
) -> Rays:
    """ValueError as `DynamicBVH.raycast_many`."""
    starts, along = checks.points_of_both(checks.RAY_ARGUMENTS, origins, directions, ndim)
    count = len(starts)
    return Rays(
        starts,
        along,
        checks.limits('t_max', t_max, count),
        checks.masks(mask, count),
        checks.flag('skip_inside', skip_inside),
        checks.whole('threads', threads, 1),
    )


def first_hits(parts: Parts, rays: Rays) -> RayHits:
    """The nearest hit of each ray."""
    count, ndim = rays.origins.shape
    ids, numbers, handles = np.full((3, count), NONE, np.int64)
    best = Hits(ids, np.full(count, np.inf), np.zeros((count, ndim)), numbers, handles)
    for piece in _pieces(count):
        _cast(parts, rays.some(piece), Hits._make(column[piece] for column in best))
    return RayHits(best.ids, best.t, best.normals)


def any_hits(parts: Parts, rays: Rays) -> NDArray[np.bool_]:
    """Whether each ray hits."""
    blocked = np.zeros(len(rays.origins), np.bool_)
    for piece in _pieces(len(rays.origins)):
        some, hit = rays.some(piece), blocked[piece]
        ends, along, _ = parts.along(some)
        at = ends[:-1].copy()
        while len(rows := np.flatnonzero((at < ends[1:]) & ~hit)):
            here = along[at[rows]]
            for row, _, answer in parts.ask('occluded', rows, here, some[:4], *some[4:]):
                hit[row] = answer
            at[rows] += 1
    return blocked


def _cast(parts: Parts, rays: Rays, best: Hits) -> None:
    ends, along, ts = parts.along(rays)
    at = ends[:-1].copy()
    rows = np.flatnonzero(at < ends[1:])
    while len(rows):
        # Nothing farther than the best hit is looked for.
        reach = np.minimum(rays.t_max, _beyond(best.t))
        columns = rays.origins, rays.directions, reach, rays.masks
        for some, part, found in parts.ask('raycast', rows, along[at[rows]], columns, *rays[4:]):
            _merge(parts, rays, best, some, part, found)
        at[rows] += 1
        rows = rows[at[rows] < ends[rows + 1]]
        rows = rows[ts[at[rows]] <= _beyond(best.t[rows])]


def _beyond(t: Floats) -> Floats:
    """A distance that is larger than the exact one of a hit at t, whatever was rounded."""
    with np.errstate(over='ignore'):
        return t * DOUBT + LEAST_DOUBT


def _merge(parts: Parts, rays: Rays, best: Hits, rows: Ids, part: int, found: PartHits) -> None:
    """Take over what a part found where that is nearer, or as near with the smaller id."""
    hit = np.flatnonzero(found.ids != NONE)
    row, t = rows[hit], found.t[hit]
    is_first = best.ids[row] == NONE
    nearer = is_first | (_beyond(t) < best.t[row])
    doubtful = ~nearer & (t <= _beyond(best.t[row]))
    inside = doubtful & ~(best.normals[row].any(axis=1) | found.normals[hit].any(axis=1))
    nearer |= inside & (found.ids[hit] < best.ids[row])
    doubtful &= ~inside
    if doubtful.any():
        some = np.flatnonzero(doubtful)
        nearer[some] = _is_nearer(parts, rays, best, row[some], part, found, hit[some])
    best.put(row[nearer], found, hit[nearer], part)


def _is_nearer(
    parts: Parts, rays: Rays, best: Hits, rows: Ids, part: int, found: PartHits, hit: Ids
) -> NDArray[np.bool_]:
    """Whether what a part found comes before the best so far, exactly."""
    count, ndim = len(rows), rays.origins.shape[1]
    boxes = np.empty((2, 2, count, ndim))  # of the best, of the found; lo, hi
    numbers = np.arange(count)
    for side, of_parts, handles in (
        (0, best.parts[rows], best.handles[rows]),
        (1, np.full(count, part), found.handles[hit]),
    ):
        for some, _, its in parts.ask('boxes', numbers, of_parts, (handles,)):
            boxes[side][:, some] = its
    first = np.empty(count, np.bool_)
    for i, row in enumerate(rows):
        order = (0, 1) if best.ids[row] < found.ids[hit[i]] else (1, 0)
        pair = OpenTree(ndim, capacity=2)
        inserted = [pair.insert(*boxes[side, :, i]) for side in order]
        ray = rays.origins[row], rays.directions[row]
        nearest = pair.raycast_all(*ray, skip_inside=rays.skip_inside)[0]
        first[i] = order[inserted.index(nearest.id)] == 1
    return first


# ---- boxes


def overlaps(
    parts: Parts, lo: Floats, hi: Floats, masks: NDArray[np.uint32], threads: int
) -> tuple[Ids, Ids]:
    """Offsets and ids, ascending in each row."""
    all_rows, all_ids = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for piece in _pieces(len(lo)):
        boxes = lo[piece], hi[piece], masks[piece]
        ends, handles = parts.top.overlap_many(*boxes)
        row = np.repeat(np.arange(len(boxes[0])), np.diff(ends))
        numbers = parts.numbers_of(handles)
        for some, _, (sizes, ids) in parts.ask('overlap', row, numbers, boxes, threads):
            all_rows.append(np.repeat(some, sizes) + piece.start)
            all_ids.append(ids)
    row, ids = np.concatenate(all_rows), np.concatenate(all_ids)
    offsets = np.zeros(len(lo) + 1, np.int64)
    np.cumsum(np.bincount(row, minlength=len(lo)), out=offsets[1:])
    return offsets, ids[np.lexsort((ids, row))]


# ---- points


class Points(NamedTuple):
    """Points, checked: a value a row."""

    places: Floats
    reach: Floats
    masks: NDArray[np.uint32]


class Nearest(NamedTuple):
    """The nearest boxes so far of each point, shape (n, k)."""

    ids: Ids
    distances: Floats


def nearest(parts: Parts, points: Points, k: int) -> tuple[Ids, Floats]:
    """Ids and distances, shape (n, k)."""
    shape = len(points.places), k
    best = Nearest(np.full(shape, NONE, np.int64), np.full(shape, np.inf))
    for piece in _pieces(len(points.places)):
        some = Points._make(column[piece] for column in points)
        _search(parts, some, Nearest._make(column[piece] for column in best))
    return best.ids, best.distances


def _search(parts: Parts, points: Points, best: Nearest) -> None:
    rows, visited, known = np.arange(len(points.places)), 0, FEW_PARTS
    while len(rows) and visited < len(parts.top):
        known = min(known, len(parts.top))
        some = (column[rows] for column in points)
        places, reach, masks = some
        handles, gaps = parts.top.nearest_many(places, known, reach, masks)
        numbers = parts.numbers_of(handles)
        for place in range(visited, known):
            limit = np.minimum(points.reach[rows], best.distances[rows, -1])
            is_open = (numbers[:, place] != NONE) & (gaps[:, place] <= limit * DOUBT)
            rows, numbers, gaps = rows[is_open], numbers[is_open], gaps[is_open]
            _visit(parts, points, rows, numbers[:, place], best)
        visited, known = known, 4 * known


def _visit(parts: Parts, points: Points, rows: Ids, numbers: Ids, best: Nearest) -> None:
    """Ask one part for each of the rows."""
    k = best.ids.shape[1]
    limit = np.minimum(points.reach, best.distances[:, -1])
    columns = points.places, limit, points.masks
    for some, _, (ids, gaps) in parts.ask('nearest', rows, numbers, columns, k):
        every, far = np.hstack((best.ids[some], ids)), np.hstack((best.distances[some], gaps))
        last = np.where(every == NONE, np.iinfo(np.int64).max, every)
        order = np.lexsort((last, far))[:, :k]
        best.ids[some] = np.take_along_axis(every, order, 1)
        best.distances[some] = np.take_along_axis(far, order, 1)
