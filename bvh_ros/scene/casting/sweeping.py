# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What n swept balls meet first: one kernel, which leaves to `ball_casting.cast_ball` the balls
whose first obstacle only exact arithmetic tells.
"""

import threading
from typing import Any, NamedTuple

import numpy as np

from ...tree.checks import BOOL, UINT32
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.nodes import NONE
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import INSIDE, set_ray
from ...tree.store.turns import accepted, begin_query, end_query
from ...tree.store.workers import in_threads
from ...tree.wide.snapshot import no_snapshot
from ..geometry.shapes import along_axes
from ..results import NO_NODE, CastHits
from ..store.columns import Columns
from .arguments import Ball, Hits, call, every_row, new_scratch, world_of
from .ball_casting import Sweep, bracket, cast_ball, find, slack_of
from .casting import AT, EARLY, LATE, course_of, plain, touch
from .wide_sweeps import UNSUITED, find_wide

FEW = 64  # obstacles that a ball may touch before more room is made


class Balls(NamedTuple):
    """n balls, each swept along a segment."""

    origins: Any
    """(n, 3), or (n, ndim) for the kernel."""
    directions: Any
    radii: Any
    """One for all, or (n,)."""
    masks: Any
    """The same."""


class Told(NamedTuple):
    """What is told of each row."""

    handles: Any
    ts: Any
    points: Any
    normals: Any
    open: Any
    """Whether only exact arithmetic tells."""


class Kept(threading.local):
    """Scratch for one ball, and room for what it may touch, of a thread."""

    def __init__(self) -> None:
        self._rooms: dict[int, tuple[Any, ...]] = {}

    def of(self, ndim: int) -> tuple[Any, ...]:
        """In so many dimensions."""
        return self._rooms.get(ndim) or self.make(ndim, FEW)

    def make(self, ndim: int, count: int) -> tuple[Any, ...]:
        """Room for so many."""
        hits = Hits(np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64))
        times = np.empty((3, count)), np.empty((3, count), np.int64)
        room = self._rooms[ndim] = new_scratch(ndim), hits, *times
        return room


_kept = Kept()


@inlined
def comes_before(times, node_handles, slots, one, other):
    if times[one] != times[other]:
        return times[one] < times[other]
    return node_handles[slots[one]] < node_handles[slots[other]]


@inlined
def first_of(world, node_handles, hits, brackets, count, skip_inside):
    """(which of `count` possible hits is first, NONE without any; whether that is sure)."""
    times, features = brackets
    first = np.int64(NONE)
    for j in range(count):
        inside = features[LATE, j] == INSIDE
        if features[EARLY, j] == INSIDE and not inside:
            return np.int64(NONE), False
        if skip_inside and inside:
            continue
        if first == NONE or comes_before(times[AT], node_handles, hits.slots, j, first):
            first = np.int64(j)
    if first == NONE:
        return first, True
    slot, latest = hits.slots[first], times[LATE, first]
    for j in range(count):
        other = hits.slots[j]
        if j == first:
            if np.isinf(latest):
                return first, False
        elif features[LATE, j] == INSIDE and (skip_inside or features[LATE, first] == INSIDE):
            # Tied at zero; but an obstacle may stand at two places, see slicing.py.
            if not skip_inside and node_handles[other] == node_handles[slot]:
                return first, False
        elif times[EARLY, j] <= latest and (
            plain(world.geometry, world.footprints, slot)
            or plain(world.geometry, world.footprints, other)
            or node_handles[other] == node_handles[slot]
        ):
            return first, False
    return first, True


@lean_kernel
def sweep_balls(world, through, node_handles, balls, skip_inside, place, room, told):
    """Fill in what the balls of the rows [start, stop) meet; through = (the tree's state, version,
    snapshot), place = (start, stop). Returns (rows done, room wanted): fewer than there are where
    there is no room for what the next one may touch, negative if the tree is changed; and how many
    of them are open. What every ball goes through is inlined: to hand all these arrays over takes
    a third of a ball's time.
    """
    (state, version, snapshot), (start, stop) = through, place
    scratch, hits, times, features = room
    if not begin_query(state, version):
        return -1, 0, 0
    count, row, unsure = 0, start, 0
    while row < stop:
        way = balls.origins[row], balls.directions[row]
        ball = Ball(of_row(balls.radii, row), 0.0)
        set_ray(scratch.ray, way[0], way[1])
        count = may_touch(
            world, snapshot, way, ball, (of_row(balls.masks, row), skip_inside), room
        )
        if count > hits.slots.shape[0]:
            break
        first, sure = first_of(world, node_handles, hits, (times, features), count, skip_inside)
        met = sure and first != NONE
        told.open[row], unsure = not sure, unsure + (not sure)
        told.handles[row], told.ts[row] = NO_NODE, np.inf
        for axis in range(3):
            told.points[row, axis], told.normals[row, axis] = 0.0 if met else np.nan, 0.0
        if met:
            hits.ts[first], hits.features[first] = times[AT, first], features[AT, first]
            touch(world, scratch, ball.radius, hits, first, told.points[row], told.normals[row])
            told.handles[row] = node_handles[hits.slots[first]]
            told.ts[row] = times[AT, first]
        row += 1
    end_query(state)
    return row, count, unsure


@inlined
def may_touch(world, snapshot, way, ball, asked, room):
    """`ball_casting.sweep_ball` for the first hit, through the snapshot if there is one."""
    mask, skip_inside = asked
    scratch, hits, times, features = room
    if world.root == NONE:
        return 0
    larger = Ball(ball.radius, slack_of(world, scratch.ray, ball.radius))
    count = np.int64(UNSUITED)
    if snapshot.size > 0:
        count = find_wide(world, snapshot, way, larger, asked, room)
    if count == UNSUITED:
        count = find(world, larger, mask, skip_inside, False, scratch, hits)
        if count <= hits.slots.shape[0]:
            some = times[:, :count], features[:, :count]
            course = course_of(world, scratch.ray, ball.radius, stack_array(3, np.float64))
            bracket(world, larger, course, scratch, hits.slots, some)
    return count


def tell_open_ones(
    tree: DynamicBVH, columns: Columns, balls: Balls, skip_inside: bool, told: Told
) -> None:
    """Fill in what exact arithmetic tells."""
    radii, masks = (every_row(column, len(told.open)) for column in balls[2:])
    for row in np.flatnonzero(told.open).tolist():
        way = balls.origins[row], balls.directions[row]
        one = Sweep(*way, radii.item(row), masks[row], skip_inside, False)
        for slot, t, point, normal in cast_ball(tree, columns, one):
            told.handles[row] = columns.node_handle[slot]
            told.ts[row], told.points[row], told.normals[row] = t, point, normal


def first_of_many(
    tree: DynamicBVH, columns: Columns, balls: Balls, skip_inside: bool, threads: int
) -> CastHits:
    """First hits of n balls."""
    world, count, ndim, view = world_of(tree, columns), len(balls.origins), tree.ndim, tree.view()
    origins, directions = (along_axes(rows, ndim) for rows in balls[:2])
    flat = tuple.__new__(Balls, (origins, directions, balls.radii, balls.masks))
    snapshot = tree.snapshot_for(count, view) or no_snapshot(ndim)
    through = view.tree.state, view.version, snapshot
    columns_told = np.empty(count, UINT32), np.empty(count), np.empty((count, 3))
    more = np.empty((count, 3)), np.empty(count, BOOL)
    told = tuple.__new__(Told, (*columns_told, *more))

    def work(start: int, stop: int) -> int:
        unsure = 0
        while start < stop:
            room = _kept.of(ndim)
            given = through, columns.node_handle, flat, skip_inside, (start, stop), room, told
            start, wanted, more = call(sweep_balls, world, *given)
            accepted(start)
            if start < stop:
                _kept.make(ndim, wanted)
            unsure += more
        return unsure

    if sum(in_threads(work, count, threads)):
        tell_open_ones(tree, columns, flat, skip_inside, told)
    if ndim == 2:
        met = told.handles != NO_NODE
        told.points[met, 2] = balls.origins[met, 2]
    return tuple.__new__(CastHits, told[:4])
