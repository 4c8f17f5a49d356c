# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances at a time, among obstacles that have velocities.

The tree says whose boxes are there at the time, as real arithmetic does; who is more than an
axis-aligned box, or is asked by more than one, is then compared where it stands. Scenes without
velocities need none of this.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.jit.compiling import lean_kernel
from ...tree.rays.raycasting import of_row
from ..geometry.shapes import Floats, along_axes
from ..results import NO_NODE
from ..store.mesh_store import Hulls
from ..store.obstacles import Obstacles
from ..store.places import NOBODY, at_rest, boxes_at, seen, ways_in_space
from ..store.registry import Slots
from . import clearance
from .clearance import Neighbours
from .narrow_phase import near
from .query_rows import QueryRows
from .query_shape import LARGEST
from .sinking import sink_in_obstacle
from .touching import ROUNDED, Bodies, Found, look_at
from .touching_rows import Near, Points, Signed, bodies_of

MORE = 4
PAIRS = 1 << 17  # that are looked at in one go


class Pairs(NamedTuple):
    """Rows of queries, and obstacles that each may concern."""

    rows: NDArray[np.int64]
    slots: Slots

    def take(self, which: NDArray[Any]) -> 'Pairs':
        """Some of them."""
        return Pairs(self.rows[which], self.slots[which])


class Touched(NamedTuple):
    """What n queries touch, by row and in the order in which it is told."""

    pairs: Pairs
    found: Found


@lean_kernel
def touch_pairs(bodies, queries, rows, touches, found):
    """Fill in which pairs touch, those besides that `touches` is sure of, and how each lies to the
    centre of its query.
    """
    planar = bodies.footprints is not None
    for i in range(rows.shape[0]):
        solid, shape = queries.records[rows[i]], bodies.shapes[i]
        found.slots[i] = i
        if not touches[i]:
            reach = of_row(queries.tolerances, rows[i])
            touches[i], _ = near(shape, bodies.hulls, solid, bodies.query_hulls, reach, planar)
        if touches[i]:
            look_at(shape, bodies.footprints, bodies.hulls, solid.position, found, i)


@lean_kernel
def lie_pairs(bodies, points, rows, signed, found):
    """Fill in how the obstacles of pairs lie to their points."""
    for i in range(rows.shape[0]):
        point, shape = points[rows[i]], bodies.shapes[i]
        found.slots[i], found.points[i, 2] = i, point[2]
        look_at(shape, bodies.footprints, bodies.hulls, point, found, i)
        if signed is not None:
            sink_in_obstacle(shape, bodies, point, found, i)


def touching_then(
    held: Obstacles, queries: QueryRows, hulls: Hulls | None, heights: Floats, at: Floats
) -> Touched:
    """What n query shapes touch at times (n,), each obstacle once a row, nearest to the centre
    first, ties by node handle. In a planar scene points are at the `heights`.
    """
    reach = np.broadcast_to(queries.tolerances, len(at))[:, None]
    lo, hi = (along_axes(np.ascontiguousarray(c), held.tree.ndim) for c in _sides(queries.bounds))
    with np.errstate(over='ignore'):
        lower, upper = np.nextafter(lo - reach, -np.inf), np.nextafter(hi + reach, np.inf)
    lo = np.where(reach > 0.0, np.maximum(lower, -LARGEST), lo)
    hi = np.where(reach > 0.0, np.minimum(upper, LARGEST), hi)
    masks = np.broadcast_to(queries.masks, len(at))
    offsets, handles = held.tree.overlap_many(lo, hi, np.ascontiguousarray(masks), at=at)
    rows = np.repeat(np.arange(len(at)), np.diff(offsets))
    still = at_rest(held, at.max(initial=-np.inf))
    pairs = _with_resting(
        Pairs(rows, held.tree.slots(handles)), still, (lo, hi), masks, (held, at)
    )
    found = room(len(pairs.rows))
    sure = ~(held.columns.geometry['shaped'][pairs.slots] | queries.records['shaped'][pairs.rows])
    sure &= reach[pairs.rows, 0] == 0.0
    bodies = _placed(held, pairs, at, hulls)
    touch_pairs(bodies, queries, pairs.rows, sure, found)
    held.columns.pairs_compared += len(sure)
    if held.planar:
        found.points[:, 2] = heights[pairs.rows]
    return _in_order(held, pairs, found, np.flatnonzero(sure))


def nearest_then(
    held: Obstacles, asked: Points, k: int, signed: Signed, at: Floats
) -> tuple[Near, Slots]:
    """The k obstacles nearest to n points at times (n,), and their slots (n, k)."""
    count = len(at)
    near_by = Near(
        *(np.full((count, k), NO_NODE, np.uint32), np.full((count, k), np.inf)),
        *(np.full((count, k, 3), np.nan), np.zeros((count, k, 3))),
    )
    slots = np.full((count, k), -1, np.int64)
    still, everybody = at_rest(held, at.max(initial=-np.inf)), len(held.tree)
    wanted, left = min(k + MORE, everybody + 1), np.arange(count)
    while len(left):
        step = max(PAIRS // (wanted + len(still)), 1)
        open_rows = []
        for begin in range(0, len(left), step):
            rows = left[begin : begin + step]
            settled = _look(held, asked, (k, wanted, signed), (rows, at, still), (near_by, slots))
            open_rows.append(rows[~settled])
        left, wanted = np.concatenate(open_rows), min(wanted * 4, everybody + 1)
    return near_by, slots


def _look(
    held: Obstacles,
    asked: Points,
    want: tuple[int, int, Signed],
    when: tuple[Slots, Floats, Slots],
    told: tuple[Near, Slots],
) -> NDArray[np.bool_]:
    """Ask the tree for some boxes nearest to some points; fill in their rows, and return which of
    them are settled: no other box can be nearer.
    """
    (k, wanted, signed), (rows, at, still) = want, when
    points = asked.points[rows]
    reaches = np.broadcast_to(asked.reaches, len(asked.points))[rows]
    masks = np.broadcast_to(asked.masks, len(asked.points))[rows]
    limits = np.maximum(reaches * ROUNDED, reaches)
    flat = along_axes(points, held.tree.ndim)
    ids, gaps = held.tree.nearest_many(flat, wanted, limits, masks, at=at[rows])
    known = ids.ravel() >= 0
    pairs = Pairs(
        np.repeat(np.arange(len(rows)), wanted)[known], held.tree.slots(ids.ravel()[known])
    )
    pairs = _with_resting(pairs, still, None, masks, (held, at[rows]))
    found = room(len(pairs.rows))
    lie_pairs(_placed(held, pairs, at[rows], None), points, pairs.rows, signed, found)
    close = np.flatnonzero(found.distances <= reaches[pairs.rows])
    kept, found = _in_order(held, pairs, found, close)
    first = np.searchsorted(kept.rows, np.arange(len(rows)))
    place = np.arange(len(kept.rows)) - first[kept.rows]
    some = place < k
    target = rows[kept.rows[some]], place[some]
    near_by, slots = told
    near_by.handles[target] = held.columns.node_handle[kept.slots[some]]
    near_by.distances[target], near_by.points[target] = found.distances[some], found.points[some]
    near_by.normals[target], slots[target] = found.normals[some], kept.slots[some]
    farthest = np.maximum(near_by.distances[rows, k - 1], 0.0)
    return np.asarray((ids[:, -1] < 0) | (gaps[:, -1] > farthest * ROUNDED))


def clearances_then(
    held: Obstacles,
    queries: QueryRows,
    hulls: Hulls | None,
    asked: tuple[Floats, int, Signed],
    at: Floats,
) -> Neighbours:
    """The obstacles nearest to n shapes at times (n,); asked as in `clearance.find_rows`."""
    reaches, besides, signed = asked
    count, ndim, everybody = len(at), held.tree.ndim, len(held.tree)
    told = Neighbours(np.empty(count, np.int64), np.empty(count), np.empty((count, 2, 3)))
    still = at_rest(held, at.max(initial=-np.inf))
    lows, highs = (along_axes(side, ndim) for side in _sides(queries.bounds))
    for row in range(count):
        reach = reaches.item(row if len(reaches) > 1 else 0)
        limit, wanted, mask = max(reach * clearance.ROUNDED, reach), 2, queries.mask(row)
        while True:
            wanted = min(wanted, everybody + 1)
            ids, gaps = held.tree.nearest(
                np.stack((lows[row], highs[row])), wanted, limit, int(mask), at=float(at[row])
            )
            pairs = Pairs(np.zeros(len(ids), np.int64), held.tree.slots(ids))
            pairs = _with_resting(pairs, still, None, np.full(1, mask), (held, at[row : row + 1]))
            told.slots[row], told.distances[row], told.points[row] = -1, np.inf, np.nan
            clearance.look_at(
                _placed(held, pairs, at[row : row + 1], hulls),
                *(queries, row, (reach, besides), signed),
                *(held.columns.node_handle[pairs.slots], np.arange(len(pairs.slots)), told),
            )
            distance = max(told.distances.item(row), 0.0)
            if len(ids) < wanted or gaps[-1] > distance * clearance.ROUNDED:
                break
            wanted *= MORE
        if told.slots[row] >= 0:
            told.slots[row] = pairs.slots[told.slots[row]]
    return told


def _sides(bounds: Floats) -> tuple[Floats, Floats]:
    return np.ascontiguousarray(bounds[:, 0]), np.ascontiguousarray(bounds[:, 1])


def room(count: int) -> Found:
    """For what is found of so many pairs."""
    return Found(
        *(np.empty(count, np.int64), np.empty(count), np.zeros((count, 3)), np.zeros((count, 3))),
        *(np.empty(0, np.bool_), np.empty(0), np.empty(0, np.int64)),
    )


def _with_resting(
    pairs: Pairs,
    still: Slots,
    boxes: tuple[Floats, Floats] | None,
    masks: NDArray[np.uint32],
    when: tuple[Obstacles, Floats],
) -> Pairs:
    """Pairs with those that are at rest by then where these rest, not where the tree has them; if
    `boxes` (lo, hi) are given, those that touch them.
    """
    if not len(still):
        return pairs
    held, at = when
    resting = np.zeros(len(held.columns.tree_handle), np.bool_)
    resting[still] = True
    rows, slots = [], []
    for row in range(len(at)):
        some = still[seen(held, still, masks[row])]
        if boxes is not None:
            lo, hi = boxes_at(held, some, np.full(len(some), at[row]))
            some = some[((lo <= boxes[1][row]) & (hi >= boxes[0][row])).all(axis=1)]
        rows.append(np.full(len(some), row))
        slots.append(some)
    pairs = pairs.take(~resting[pairs.slots])
    return Pairs(
        np.concatenate((pairs.rows, *rows, NOBODY)), np.concatenate((pairs.slots, *slots, NOBODY))
    )


def _placed(held: Obstacles, pairs: Pairs, at: Floats, hulls: Hulls | None) -> Bodies:
    """The obstacles of pairs, where they are at the times (n,) of their rows."""
    columns, gone = held.columns, ways_in_space(held, pairs.slots, at[pairs.rows])
    bodies = bodies_of(columns, hulls)
    shapes, footprints = columns.geometry[pairs.slots], None
    shapes['position'] += gone
    if columns.footprint is not None:
        footprints = columns.footprint[pairs.slots]
        footprints['centre'] += gone[:, :2]
    return bodies._replace(shapes=shapes, footprints=footprints)


def _in_order(held: Obstacles, pairs: Pairs, found: Found, some: NDArray[np.int64]) -> Touched:
    """Some of the pairs by row, distance and node handle; each obstacle once a row."""
    handles = held.columns.node_handle[pairs.slots[some]]
    some = some[np.lexsort((handles, found.distances[some], pairs.rows[some]))]
    if held.columns.shadows:
        keys = np.stack((pairs.rows[some], held.columns.node_handle[pairs.slots[some]]))
        some = some[np.sort(np.unique(keys, axis=1, return_index=True)[1])]
    columns: Any = (c[some] if len(c) else c for c in found)
    return Touched(pairs.take(some), Found(*columns))
