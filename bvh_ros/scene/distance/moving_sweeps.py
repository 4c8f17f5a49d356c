# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`sweeps` among obstacles that have velocities."""

from typing import Any, NamedTuple

import numpy as np

from ...tree.access import CHANGES, end_query, of_row
from ...tree.compiler import inlined, lean_kernel
from ...tree.motion.access import (
    OUTSIDE,
    begin_asking,
    box_of,
    covers,
    elapsed,
    moves,
    overlap_swept_at,
)
from ..shapes.shape import Floats
from .moving import QueryTimes, TimedDistances, displacement, most_growth
from .query import found_in
from .sweeps import Drift, ShapeSweeper, answer_sweeps

ONE = np.ones(1)


class World(NamedTuple):
    """Obstacles that move while a body does, for kernels."""

    tree: Any
    moving: Any
    """`Moving`"""
    times: QueryTimes
    """`at` is when the sweeps start."""
    pace: Floats
    """See `Rows`."""


@inlined
def _candidates(world, row, box, span, mask, slots):
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
def sweep_rows_at(tree, moving, times, node_handles, memory, rows, place, options, results):
    """`answer_sweeps`, as `overlap_rows_at`; `times` are those when the sweeps start."""
    why = begin_asking(tree, moving, 0)
    if why != 0:
        return why, np.int64(0), np.int64(0)
    world, slots = World(tree, moving, times, rows.pace), found_in(memory[0]).slots
    bodies = times.bodies
    done = answer_sweeps(
        world, bodies, rows, place, options, node_handles, slots, results, _candidates, _drift
    )
    version = tree.state[CHANGES]
    end_query(tree.state)
    return (*done, version)


class TimedShapeSweeper(ShapeSweeper, TimedDistances):
    """Sweeps shapes in one scene, among obstacles that move."""

    kernels = (sweep_rows_at,)
    moments = False

    def _spans(self, rows: Any) -> tuple[Floats, Floats]:
        return rows.pace, ONE
