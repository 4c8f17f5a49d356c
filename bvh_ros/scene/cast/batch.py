# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a swept ball may touch, found through the wide snapshot of batches of rays.

A ball of radius r touches a box only where its centre is in the box grown by r, so the ray of its
centre goes through nodes that are as much larger. The first obstacles that it surely touches bound
how far it goes.


What n thin rays meet first among true shapes, found through the wide snapshot of batches.

As a swept ball, see below, a ray goes through nodes that are larger: by what nobody can
tell apart from touching. Who is met is decided as in `query`.


What n swept balls meet first: one kernel, which leaves to `exact_ball.cast_ball` the balls
whose first obstacle only exact arithmetic tells.
"""

import threading
from functools import partial
from typing import Any

import numpy as np

from ...tree.access import (
    ALL32,
    CHANGES,
    FARTHEST_ORIGIN,
    INSIDE,
    NONE,
    NOT_FINITE,
    REFUSED,
    ROOT,
    STACK,
    UINT32,
    DynamicBVH,
    Snapshot,
    View,
    accepted,
    begin_batch,
    child_of,
    end_query,
    in_threads,
    limit32,
    no_snapshot,
    octant_of,
    of_row,
    push_children,
    push_loose,
    seen16,
    set_ray,
    start_ray,
    stream16,
)
from ...tree.compiler import WIDTH, inlined, lean_kernel, stack_array
from ..results import NO_NODE, CastHits
from ..store.columns import Columns
from .arguments import SCRATCH, Asked, Ball, CastWorld, Hits, code_for, scratch_in
from .exact_ball import SMALL, SWEEP_SLACK, Sweep, bracket, cast_ball, find, slack_of
from .query import (
    AT,
    EARLY,
    LATE,
    Course,
    cast,
    course_of,
    doubt_of,
    enter_obstacle,
    enter_thrice,
    first_of,
    no_hit,
    plain,
    touch,
    with_one_more,
    write,
)

# ---- obstacles that a ball may touch, through the snapshot


UNSUITED = -1
PAD = 2.0**-20  # far above the rounding of a float32


def tree_and_snapshot(tree: DynamicBVH, count: int) -> tuple[View, Snapshot]:
    """For batches that cannot do with `ready_snapshot`."""
    view = tree.view()
    return view, tree.snapshot_for(count, view) or no_snapshot(tree.ndim)


@inlined
def find_wide(world, snapshot, way, ball, asked, room):
    """As `exact_ball.find` and `bracket` of the first hit: how many obstacles may be it. way =
    (origin, direction), asked = (mask, skip_inside), room as of `sweep_balls`. UNSUITED:
    the snapshot is not for this ball.
    """
    (origin, direction), (mask, skip_inside) = way, asked
    scratch, hits, times, features = room
    records, stack = stack_array(1, snapshot.record), stack_array(STACK, np.int64)
    record, limits = records[0], stack_array(1, np.float32)
    reach = (ball.radius + ball.slack + doubt_of(scratch.ray, ball.radius)) * snapshot.per_length
    suited = start_ray(record, origin, direction, snapshot.center, snapshot.per_length, 1.0)
    if not (suited and reach < FARTHEST_ORIGIN):
        return np.int64(UNSUITED)
    widen(record, reach)
    limits[0], octant, top = record.limit, octant_of(direction), put_roots(snapshot, stack)
    count, soonest, latest = np.int64(0), np.inf, 1.0
    ts, course = stack_array(3, np.float64), Course(stack_array(3, np.float64), -1.0, False)
    found = ts, stack_array(3, np.int64)
    while top > 0:
        slot, top = next_leaf(snapshot, records, octant, mask, limits, stack, top)
        if slot == NONE or (snapshot.loose > 0 and is_known(world, slot, mask, hits, count)):
            continue
        if course.pace < 0.0:  # many balls meet no leaf
            course = course_of(world, scratch.ray, ball.radius, course.unit)
        enter_thrice(world, slot, scratch.ray, course, ball, scratch.work, found)
        if ts[EARLY] > latest:
            continue
        if count < hits.slots.shape[0]:
            hits.slots[count] = slot
            for i in range(3):
                times[i, count], features[i, count] = ts[i], found[1][i]
        count += 1
        if ts[EARLY] < soonest and not (skip_inside and found[1][EARLY] == INSIDE):
            soonest = ts[EARLY]
            latest = min(ts[LATE] * (1.0 + SWEEP_SLACK) + SMALL, latest)
            record.limit = limits[0] = limit32(latest, record.unit)
    if count > hits.slots.shape[0]:
        return count
    return keep_until(hits.slots, (times, features), count, latest)


@inlined
def widen(record, reach):
    """Let a ray meet boxes as if they were larger by `reach`, in the snapshot's units. Numbers
    that may be as large as reach * slope are rounded once more here, so there is a pad of more
    than that.
    """
    for axis in range(record.slope.shape[0]):
        slope, shift = (
            abs(np.float64(record.slope[axis])),
            abs(np.float64(record.near_shift[axis])),
        )
        more = slope * (reach * (1.0 + PAD) + PAD) + shift * PAD
        record.near_shift[axis] = np.float32(record.near_shift[axis] - more)
        record.far_shift[axis] = np.float32(record.far_shift[axis] + more)


@inlined
def put_roots(snapshot, stack):
    """Put the nodes that every ray visits on the stack; return its top."""
    stack[0] = 0
    return push_loose(snapshot, stack, 1)


@inlined
def next_leaf(snapshot, records, octant, mask, limits, stack, top):
    """(slot of the next leaf that the ray may meet before its limit, or NONE; the new top)."""
    nearest, met = stack_array(WIDTH, np.int32), stack_array(1, np.uint32)
    first = stack_array(1, np.int32)
    first[0] = 0
    while top > 0:
        top -= 1
        if stack[top] >> 32 > limits.view(np.int32)[0]:
            continue
        node = child_of(stack[top])
        if node < 0:
            return ~node, top
        lanes = stream16(snapshot.planes, node, np.uint64(octant), records, first, met, nearest)
        if mask != ALL32:
            lanes = np.uint32(lanes & seen16(snapshot.masks, node * WIDTH, mask))
        top = push_children(snapshot, node, lanes, nearest, stack, top)
    return np.int64(NONE), top


@inlined
def is_known(world, slot, mask, hits, count):
    """Whether a leaf of a snapshot that was patched is to be left out: what it was is removed or
    has another mask now, or it is met twice.
    """
    known = world.nodes[2 * slot].mask & mask == 0
    for j in range(min(count, hits.slots.shape[0])):
        known = known or hits.slots[j] == slot
    return known


@inlined
def keep_until(slots, brackets, count, latest):
    """Forget what is not met until then; return how many are left."""
    kept, (times, features) = np.int64(0), brackets
    for j in range(count):
        if times[EARLY, j] <= latest:
            slots[kept] = slots[j]
            for i in range(3):
                times[i, kept], features[i, kept] = times[i, j], features[i, j]
            kept += 1
    return kept


# ---- thin rays


@lean_kernel
def cast_many(view, snapshot, shapes, node_handles, rays, asked, place, told):
    """Fill in what the rays of the rows [start, stop) meet first; shapes as of `Columns.shapes`,
    rays = (origins, directions, t_max, masks), the last two one for all, or (n,), asked =
    (whether what is called directions are goals, skip_inside), place = (start, stop). Returns 0,
    REFUSED if the tree is changed, or the snapshot is older, or NOT_FINITE if a start or a way is
    not.
    """
    tree, (row, stop), (to_goals, skip_inside) = view.tree, place, asked
    origins, directions, ends, masks = rays
    state, ndim = tree.state, 3 if shapes[1] is None else 2
    scratch = scratch_in(stack_array(SCRATCH, np.float64), ndim)
    direction = stack_array(3, np.float64)
    if not begin_batch(tree, view.version, snapshot):
        return np.int64(REFUSED)
    world = CastWorld(tree.nodes, tree.tight, tree.handles, state[ROOT], *shapes)
    features = stack_array(1, np.int64)
    one = Hits(stack_array(1, np.int64), stack_array(1, np.float64), features)
    while row < stop:
        if not fill_way(origins[row], directions[row], to_goals, 1.0, direction):
            end_query(state)
            return np.int64(NOT_FINITE)
        way = origins[row, :ndim], direction[:ndim]
        t_max, mask = of_row(ends, row), of_row(masks, row)
        question = Asked(t_max, t_max, mask, skip_inside, False)
        set_ray(scratch.ray, way[0], way[1])
        found, suited = 0, False
        if snapshot.size > 0:
            found, suited = find_first(world, snapshot, way, question, scratch, one)
        if not suited:
            found = cast(world, Ball(0.0, 0.0), question, scratch, one, 0)
        told.handles[row], told.t[row] = NO_NODE, np.inf
        for axis in range(3):
            told.points[row, axis], told.normals[row, axis] = 0.0 if found else np.nan, 0.0
        if found:
            touch(world, scratch, 0.0, one, 0, told.points[row], told.normals[row])
            told.handles[row], told.t[row] = node_handles[one.slots[0]], one.ts[0]
            if ndim == 2:
                told.points[row, 2] = origins[row, 2]
        row += 1
    end_query(state)
    return np.int64(0)


@inlined
def find_first(world, snapshot, way, asked, scratch, hits):
    """Write the first hit of a ray, way = (origin, direction): (how many there are, whether it is
    for the snapshot).
    """
    (origin, direction), t_max, mask = way, asked.t_max, asked.mask
    records, stack = stack_array(1, snapshot.record), stack_array(STACK, np.int64)
    record, limits = records[0], stack_array(1, np.float32)
    box, other = no_hit(), no_hit()
    reach = doubt_of(scratch.ray, 0.0) * snapshot.per_length
    suited = start_ray(record, origin, direction, snapshot.center, snapshot.per_length, t_max)
    if not (suited and reach < FARTHEST_ORIGIN):
        return 0, False
    widen(record, reach)
    limits[0], octant, top = record.limit, octant_of(direction), put_roots(snapshot, stack)
    while top > 0:
        slot, top = next_leaf(snapshot, records, octant, mask, limits, stack, top)
        if slot == NONE or (snapshot.loose > 0 and world.nodes[2 * slot].mask & mask == 0):
            continue
        t, feature = enter_obstacle(world, slot, scratch.ray, 0.0, t_max, scratch.work)
        if t == np.inf or (asked.skip_inside and feature == INSIDE):
            continue
        hit = slot, t, np.int64(feature)
        box, other = with_one_more(world, scratch.ray, 0.0, hit, box, other)
        record.limit = limits[0] = limit32(min(box.t, other.t), record.unit)
    first = first_of(world, scratch.ray, 0.0, box, other)
    return (write(first, hits, 0) if first.slot != NONE else 0), True


def first_hits_of_rays(
    tree: DynamicBVH,
    columns: Columns,
    rays: tuple[Any, ...],
    asked: tuple[bool, bool],
    threads: int,
) -> CastHits | None:
    """First hits of n rays, as `cast_many` gets them, asked = (whether what is called directions
    are goals, skip_inside); None if a start or a way is not finite.
    """
    count = len(rays[0])
    parts = np.empty(count, UINT32), np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    # As CastHits(...), which would take one more call of a function of Python's.
    told = tuple.__new__(CastHits, parts)
    shapes, handles = columns.shapes, columns.node_handle
    ready, done = (tree.ready_snapshot() if threads == 1 else None), REFUSED
    if ready is not None:
        view, snapshot = ready
        every = view, snapshot, shapes, handles, rays, asked, (0, count), told
        done = code_for(cast_many, shapes, every)(*every)
    if done == REFUSED:
        now = tree_and_snapshot(tree, count)

        def work(start: int, stop: int) -> int:
            some = *now, shapes, handles, rays, asked, (start, stop), told
            answered: int = code_for(cast_many, shapes, some)(*some)
            return answered

        done = min(in_threads(work, count, threads))
    if done == NOT_FINITE:
        return None
    accepted(done)
    return told


# ---- balls


FEW = 64  # obstacles that a ball may touch before more room is made
TOUCHED = 9  # numbers of each
NEEDS_EXACT = -1  # only exact arithmetic tells


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
def first_in_brackets(world, node_handles, hits, brackets, count, skip_inside):
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
    what the next one may touch, or only exact arithmetic tells what it meets, which is NEEDS_EXACT
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
        first, sure = first_in_brackets(
            world, node_handles, hits, (times, features), count, skip_inside
        )
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
            count = NEEDS_EXACT
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
    """`exact_ball.sweep_ball` for the first hit, through the snapshot if there is one."""
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


def first_hits_of_balls(
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
        if start < stop and wanted == NEEDS_EXACT:
            _answer_exactly(tree, columns, given[4], given[5], told, start)
            start += 1
        elif start < stop:
            kept.touched = np.empty((TOUCHED, wanted))
    return True


def _answer_exactly(
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
