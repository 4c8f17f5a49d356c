# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What n swept balls meet first: one kernel, which leaves to `ball_casting.cast_ball` the balls
whose first obstacle only exact arithmetic tells.
"""

import threading
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...tree.checks import UINT32
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.nodes import NONE, ROOT
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import INSIDE, set_ray
from ...tree.store.turns import NOT_FINITE, REFUSED, accepted, begin_query, end_query
from ...tree.store.workers import in_threads
from ...tree.wide.snapshot import no_snapshot
from ..results import NO_NODE, CastHits
from ..store.columns import Columns
from .arguments import Ball, CastWorld, Hits, code_for, new_scratch, shapes_in
from .ball_casting import Sweep, bracket, cast_ball, find, slack_of
from .casting import AT, EARLY, LATE, course_of, plain, touch
from .wide_sweeps import UNSUITED, find_wide

FEW = 64  # obstacles that a ball may touch before more room is made
OPEN = -1  # only exact arithmetic tells


class Balls(NamedTuple):
    """n balls, each swept along a segment."""

    origins: Any
    """(n, 3)"""
    directions: Any
    radii: Any
    """One for all, or (n,)."""
    t_max: Any
    """The same: where the way ends, if it is not given by a goal."""
    masks: Any
    """The same."""


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


kept = Kept()


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
def sweep_balls(view, snapshot, shapes, node_handles, balls, asked, place, room, told):
    """Fill in what the balls of the rows [start, stop) meet; shapes as of `shapes_in`, asked =
    (whether what is called directions are goals, skip_inside), place = (start, stop). Returns
    (rows done, room wanted): fewer than there are where there is no room for what the next one may
    touch, or only exact arithmetic tells what it meets, which is OPEN instead of the room; REFUSED
    if the tree is changed, NOT_FINITE if a start or a way is not. What every ball goes through is
    inlined: to hand all these arrays over takes a third of a ball's time.
    """
    (tree, version), (row, stop), (to_goals, skip_inside) = view, place, asked
    state = tree.state
    scratch, hits, times, features = room
    ndim, count, direction = scratch.ray.shape[1], 0, stack_array(3, np.float64)
    if not begin_query(state, version):
        return REFUSED, 0
    world = CastWorld(tree.nodes, tree.tight, tree.handles, state[ROOT], *shapes)
    while row < stop:
        origin, t_max = balls.origins[row], of_row(balls.t_max, row)
        if not fill_way(origin, balls.directions[row], to_goals, t_max, direction):
            row = NOT_FINITE
            break
        way = origin[:ndim], direction[:ndim]
        ball = Ball(of_row(balls.radii, row), 0.0)
        set_ray(scratch.ray, way[0], way[1])
        count = may_touch(
            world, snapshot, way, ball, (of_row(balls.masks, row), skip_inside), room
        )
        if count > hits.slots.shape[0]:
            break
        first, sure = first_of(world, node_handles, hits, (times, features), count, skip_inside)
        met = sure and first != NONE
        told.handles[row], told.t[row] = NO_NODE, np.inf
        for axis in range(3):
            told.points[row, axis], told.normals[row, axis] = 0.0 if met else np.nan, 0.0
        if met:
            hits.ts[first], hits.features[first] = times[AT, first], features[AT, first]
            touch(world, scratch, ball.radius, hits, first, told.points[row], told.normals[row])
            told.handles[row] = node_handles[hits.slots[first]]
            told.t[row] = times[AT, first] * t_max
            if ndim == 2:
                told.points[row, 2] = origin[2]
        if not sure:
            count = OPEN
            break
        row += 1
    end_query(state)
    return row, count


@inlined
def fill_way(start, end, to_goal, t_max, way):
    """Fill in a way (3,), given by its goal, or by a direction and where it ends; return whether
    it and its start are finite.
    """
    finite = True
    for axis in range(3):
        way[axis] = end[axis] - start[axis] if to_goal else end[axis] * t_max
        finite &= np.isfinite(way[axis]) and np.isfinite(start[axis])
    return finite


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


def first_of_many(
    tree: DynamicBVH, columns: Columns, balls: Balls, asked: tuple[bool, bool], threads: int
) -> CastHits | None:
    """First hits of n balls, asked = (whether what is called directions are goals, skip_inside);
    None if a start or a way is not finite.
    """
    view, count, shapes = tree.view(), len(balls.origins), shapes_in(columns)
    ndim = 3 if shapes[1] is None else 2
    snapshot = tree.snapshot_for(count, view) or no_snapshot(ndim)
    parts = np.empty(count, UINT32), np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    # As CastHits(...), which would take one more call of a function of Python's.
    told = tuple.__new__(CastHits, parts)
    given = view, snapshot, shapes, columns.node_handle, balls, asked
    if threads == 1:  # without what others take: a tenth of a call of a row
        every = *given, (0, count), kept.of(ndim), told
        start, _ = code_for(sweep_balls, shapes, every)(*every)
        if start == count or (start >= 0 and _work(tree, columns, given, told, start, count)):
            return told
    work = partial(_work, tree, columns, given, told)
    return told if all(in_threads(work, count, threads)) else None


def _work(
    tree: DynamicBVH,
    columns: Columns,
    given: tuple[Any, ...],
    told: CastHits,
    start: int,
    stop: int,
) -> bool:
    """Fill in the rows [start, stop); whether all ways are finite."""
    while start < stop:
        some = *given, (start, stop), kept.of(tree.ndim), told
        start, wanted = code_for(sweep_balls, given[2], some)(*some)
        if start == NOT_FINITE:
            return False
        accepted(start)
        if start < stop and wanted == OPEN:
            _tell_open_one(tree, columns, given[4], given[5], told, start)
            start += 1
        elif start < stop:
            kept.make(tree.ndim, wanted)
    return True


def _tell_open_one(
    tree: DynamicBVH,
    columns: Columns,
    balls: Balls,
    asked: tuple[bool, bool],
    told: CastHits,
    row: int,
) -> None:
    """Fill in what exact arithmetic tells of a row, which says that nothing is met."""
    to_goals, skip_inside = asked
    origin, way = balls.origins[row], balls.directions[row]
    radius, t_max, mask = (column[row if len(column) > 1 else 0] for column in balls[2:])
    way = way - origin if to_goals else way * t_max
    one = Sweep(origin, way, radius.item(), mask, skip_inside, False)
    for slot, t, point, normal in cast_ball(tree, columns, one):
        told.handles[row] = columns.node_handle[slot]
        told.t[row], told.points[row], told.normals[row] = t * t_max, point, normal
        if tree.ndim == 2:
            told.points[row, 2] = origin[2]
