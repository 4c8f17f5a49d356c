# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`sweeps` among obstacles that have velocities."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import Tree, end_query, of_row
from ...tree.compiler import entry_point, inlined, lean_kernel
from ...tree.motion.access import (
    OUTSIDE,
    begin_asking,
    box_of,
    covers,
    elapsed,
    moves,
    overlap_swept_at,
    times_of,
)
from ..shapes.shape import Floats
from ..store import Obstacles, movers
from .moving import QueryTimes, displacement, most_growth
from .sweeps import Drift, ShapeSweeper, answer_rows


class World(NamedTuple):
    """Obstacles that move, for kernels."""

    tree: Tree
    moving: Any
    """`Moving`"""
    times: QueryTimes
    """`at` is when the sweeps start."""
    pace: Floats
    """s a unit of t, one for all or (n,)."""


@inlined
def _touching(world, row, box, span, mask, slots):
    at, pace = of_row(world.times.at, row), of_row(world.pace, row)
    if covers(world.moving, at, pace, 1.0) == 0:
        return np.int64(OUTSIDE)
    (lo, hi, translation), ndim = box, world.moving.velocities[0].velocity.shape[0]
    more = max(most_growth(world.times, at), most_growth(world.times, at + pace))
    for axis in range(ndim):
        lo[axis] -= more
        hi[axis] += more
    times = at + pace * span[0], pace * (span[1] - span[0])
    return overlap_swept_at(
        world.tree, world.moving, times, lo[:ndim], hi[:ndim], translation[:ndim], mask, slots
    )


@inlined
def _drift(world, row, slot, room):
    moving, at, pace = world.moving, of_row(world.times.at, row), of_row(world.pace, row)
    box = box_of(world.tree, moving, slot)
    since, left = elapsed(at, box[3], moving.nanoseconds), moving.left
    for axis in range(box[2].shape[0]):
        room[0, axis] = displacement(box[2][axis], since, left)
        room[1, axis] = box[2][axis] * pace
    stop = max(left - since[0], 0.0) / pace if left < np.inf and pace > 0.0 else np.inf
    growth = world.times.growth if moves(box) else 0.0
    return Drift(room[0], room[1], stop, since[0], pace, growth)


@lean_kernel
def sweep_rows_at(tree, moving, times, pace, bodies, rows, options, handles_of, slots, results):
    """`answer_rows`; OUTSIDE instead of rows if bounds do not hold for a time, REFUSED if the tree
    is changed.
    """
    why = begin_asking(tree, moving, 0)
    if why != 0:
        return why, np.int64(0)
    world = World(tree, moving, times, pace)
    done = answer_rows(world, bodies, rows, options, handles_of, slots, results, _touching, _drift)
    end_query(tree.state)
    return done


ONE = np.ones(1)


class TimedShapeSweeper(ShapeSweeper):
    """Sweeps shapes in one scene, among obstacles that move."""

    def __init__(self, store: Obstacles) -> None:
        super().__init__(store)
        self._entries: dict[type, Any] = {}

    def call(self, given: tuple[Any, ...], *times: Floats) -> tuple[int, int]:
        """(rows done, room wanted) of the kernel; times = (when the sweeps start, s, and how many
        seconds a unit of t takes), each one for all or (n,).
        """
        store, (at, pace) = self._store, times
        tree: Any = store.tree
        ends = movers(store)[1:] if store.uncertainty else (0.0, 0.0)
        query_times = QueryTimes(given[0], store.columns.node_handle, at, store.uncertainty, *ends)
        form = type(given[0].hulls)
        entry = self._entries.get(form)
        if entry is None:
            moving = tree.motion.moving
            entry = entry_point(sweep_rows_at, tree.view().tree, moving, query_times, pace, *given)
            self._entries[form] = entry

        def call(arrays: Tree, moving: Any) -> Any:
            return entry(arrays, moving, query_times, pace, *given)

        spans = partial(times_of, at, pace, ONE)
        done: tuple[int, int] = tree.motion.ask(tree, spans, call, moments=False)
        return done
