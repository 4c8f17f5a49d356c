# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What n swept balls meet first: one kernel, which leaves to `ball_casting.cast_ball` the balls
whose first obstacle only exact arithmetic tells.
"""

import threading
from functools import partial
from typing import Any

import numpy as np

from ...tree.checks import UINT32
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.nodes import CHANGES, NONE, ROOT, View
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import INSIDE, set_ray
from ...tree.store.turns import NOT_FINITE, REFUSED, accepted, end_query
from ...tree.store.workers import in_threads
from ...tree.wide.snapshot import begin_batch
from ..results import NO_NODE, CastHits
from ..store.columns import Columns
from .arguments import SCRATCH, Ball, CastWorld, Hits, code_for, scratch_in
from .ball_casting import Sweep, bracket, cast_ball, find, slack_of
from .casting import AT, EARLY, LATE, course_of, plain, touch
from .wide_sweeps import UNSUITED, find_wide, tree_and_snapshot

FEW = 64  # obstacles that a ball may touch before more room is made
TOUCHED = 9  # numbers of each
OPEN = -1  # only exact arithmetic tells


class Kept(threading.local):
    """Scratch of a thread."""

    def __init__(self) -> None:
        self.touched = np.empty((TOUCHED, FEW))
        """What a ball may touch, see `room_in`."""


kept = Kept()


@inlined
def room_in(touched):
    """Room for what a ball may touch in one array, TOUCHED rows: hits, times and features."""
    hits = Hits(touched[0].view(np.int64), touched[1], touched[2].view(np.int64))
    return hits, touched[3:6], touched[6:9].view(np.int64)


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
def sweep_balls(view, snapshot, shapes, node_handles, balls, asked, place, touched, told):
    """Fill in what the balls of the rows [start, stop) meet; shapes as of `Columns.shapes`, balls
    = (origins, directions, t_max, masks, radii), the last three one for all, or (n,), asked =
    (whether what is called directions are goals, skip_inside), place = (start, stop). Returns
    (rows done, room wanted, version of the tree): fewer than there are where there is no room for
    what the next one may touch, or only exact arithmetic tells what it meets, which is OPEN
    instead of the room; REFUSED if the tree is changed, or the snapshot is older, NOT_FINITE if a
    start or a way is not. What every ball goes through is inlined: to hand all these arrays over
    takes a third of a ball's time.
    """
    tree, (row, stop), (to_goals, skip_inside) = view.tree, place, asked
    origins, directions, ends, masks, radii = balls
    state, ndim, count = tree.state, 3 if shapes[1] is None else 2, 0
    scratch = scratch_in(stack_array(SCRATCH, np.float64), ndim)
    direction, room = stack_array(3, np.float64), (scratch, *room_in(touched))
    _, hits, times, features = room
    if not begin_batch(tree, view.version, snapshot):
        return REFUSED, 0, 0
    version = state[CHANGES]
    world = CastWorld(tree.nodes, tree.tight, tree.handles, state[ROOT], *shapes)
    while row < stop:
        origin, t_max = origins[row], of_row(ends, row)
        if not fill_way(origin, directions[row], to_goals, t_max, direction):
            row = NOT_FINITE
            break
        way = origin[:ndim], direction[:ndim]
        ball = Ball(of_row(radii, row), 0.0)
        set_ray(scratch.ray, way[0], way[1])
        count = may_touch(world, snapshot, way, ball, (of_row(masks, row), skip_inside), room)
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
    return row, count, version


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
    tree: DynamicBVH,
    columns: Columns,
    balls: tuple[Any, ...],
    asked: tuple[bool, bool],
    threads: int,
) -> CastHits | None:
    """First hits of n balls, as `sweep_balls` gets them, asked = (whether what is called
    directions are goals, skip_inside); None if a start or a way is not finite.
    """
    count, shapes, begun = len(balls[0]), columns.shapes, 0
    parts = np.empty(count, UINT32), np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    # As CastHits(...), which would take one more call of a function of Python's.
    told = tuple.__new__(CastHits, parts)
    handles = columns.node_handle
    ready = tree.ready_snapshot() if threads == 1 else None
    view, snapshot = ready or tree_and_snapshot(tree, count)
    if threads == 1:  # without what others take: a tenth of a call of a row
        room, place = kept.touched, (0, count)
        every = view, snapshot, shapes, handles, balls, asked, place, room, told
        begun, _, version = code_for(sweep_balls, shapes, every)(*every)
        if begun == count:
            return told
        if begun < 0:
            begun, (view, snapshot) = 0, tree_and_snapshot(tree, count)
        else:
            view = View(view.tree, version)
    work = partial(_work, tree, columns, (view, snapshot, shapes, handles, balls, asked), told)
    done = [work(begun, count)] if threads == 1 else in_threads(work, count, threads)
    return told if all(done) else None


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
        some = *given, (start, stop), kept.touched, told
        start, wanted, _ = code_for(sweep_balls, given[2], some)(*some)
        if start == NOT_FINITE:
            return False
        accepted(start)
        if start < stop and wanted == OPEN:
            _tell_open_one(tree, columns, given[4], given[5], told, start)
            start += 1
        elif start < stop:
            kept.touched = np.empty((TOUCHED, wanted))
    return True


def _tell_open_one(
    tree: DynamicBVH,
    columns: Columns,
    balls: tuple[Any, ...],
    asked: tuple[bool, bool],
    told: CastHits,
    row: int,
) -> None:
    """Fill in what exact arithmetic tells of a row, which says that nothing is met."""
    to_goals, skip_inside = asked
    origin, way = balls[0][row], balls[1][row]
    t_max, mask, radius = (column[row if len(column) > 1 else 0] for column in balls[2:])
    way = way - origin if to_goals else way * t_max
    one = Sweep(origin, way, radius.item(), mask, skip_inside, False)
    for slot, t, point, normal in cast_ball(tree, columns, one):
        told.handles[row] = columns.node_handle[slot]
        told.t[row], told.points[row], told.normals[row] = t * t_max, point, normal
        if tree.ndim == 2:
            told.points[row, 2] = origin[2]
