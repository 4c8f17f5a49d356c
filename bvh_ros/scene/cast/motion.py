# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When rays and swept balls go, and what they meet.

One obstacle that moves, as a ray or ball meets it: while it goes, and where it comes to rest,
from then on. Axis-aligned boxes are decided exactly; others are seen as if they stood.


Ways past obstacles that move, nearest first, through the tree's nodes.

The first obstacle that a ray, or ball, meets among those that move: `cast_moving` says whom it may
meet, `update_first_hit` how one is met.


One ray, or swept ball, among obstacles that have velocities.

The answers are those of `moving.first_then`. Here arrays of one row are kept, as making them would
take longer than the question.
"""

import functools
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    CLOSEST,
    DEEPEST,
    INSIDE,
    LARGEST,
    NONE,
    NOT_FINITE,
    PAD,
    RAY_ROWS,
    TINY,
    end_query,
    entry_points,
    of_row,
    set_ray,
    set_swept_box,
    slot_of,
)
from ...tree.compiler import entry_point, inlined, lean_kernel, prefetch, stack_array
from ...tree.motion.access import (
    FRONTS,
    LONGEST,
    OUTSIDE,
    begin_asking,
    box_of,
    cast_one,
    course_of,
    covers,
    descend,
    elapsed,
    is_before,
    locate,
    meet_box,
    moments_of,
    moves,
    no_motion,
    set_fronts,
    span_of,
    times_of,
)
from ..geometry.shapes import Floats
from ..results import NO_NODE
from ..store.obstacles import EXACT, Obstacles
from ..store.places import most_growth
from ..store.registry import Slots
from ..store.spare import Spare
from .arguments import BoxHit, Hits, call, new_scratch, too_long, world_of
from .boxes import way_between
from .query import Hit, enter_obstacle, is_plain_box, no_hit, touch
from .shapes import COORDINATES, FRAME_SLACK

# ---- times, and hits in order


class HitTable(NamedTuple):
    """Hits, by ray and in the order in which they are met."""

    rows: Slots
    slots: Slots
    ts: Floats
    points: Floats
    """Shape (m, 3)."""
    normals: Floats

    def take(self, which: NDArray[np.int64]) -> 'HitTable':
        """Some of them."""
        columns: Any = (column[which] for column in self)
        return HitTable(*columns)


class Times(NamedTuple):
    """When rays start, s, and how many seconds pass a unit of t; shape (n,) each."""

    at: Floats
    pace: Floats

    def ends(self, t_max: Floats) -> Floats:
        """When rays end, s; inf where they never do."""
        with np.errstate(over='ignore', invalid='ignore'):
            return np.where(self.pace > 0.0, self.at + self.pace * t_max, self.at)


@lean_kernel
def fill_times(at, until, t_max, epoch, within, starts, paces):
    """Write `Times` of rays, shape (n,) each, that go from `at` to `until`, (n,) or one for all,
    ns, and end at t_max; return (whether each is within (first, last) ns and ends, the first time,
    the last). `epoch`: the ns of time 0, less than EXACT from both of `within`.
    """
    first, last = np.inf, -np.inf
    for i in range(starts.shape[0]):
        begin, end = of_row(at, i), of_row(until, i)
        if not (within[0] <= begin <= end <= within[1]) or end - begin >= EXACT:
            return False, first, last
        starts[i], paces[i] = (begin - epoch) / 1e9, (end - begin) / 1e9
        stop = starts[i] if paces[i] == 0.0 else starts[i] + of_row(t_max, i) * paces[i]
        if not abs(stop) < LONGEST:
            return False, first, last
        first, last = min(first, starts[i]), max(last, stop)
    return True, first, last


@functools.cache
def times_entry() -> Callable[..., Any]:
    """The machine code of `fill_times`."""
    at, row = np.empty(0, np.int64), np.empty(0)
    return entry_point(fill_times, at, at, row, 0, (0, 0), row, row)


# ---- one obstacle


HALF_A_NANOSECOND = 0.5e-9  # scenes tell whole ones, and less apart are but rounded otherwise
NEAR = 2.0**-40  # of the t at which time is up: what is computed is not off by as much


@inlined
def radius_of(ways, i, box, rate):
    """Of the ball of a way, with what an obstacle has grown at most."""
    at, pace, t_max = of_row(ways.at, i), of_row(ways.pace, i), of_row(ways.t_max, i)
    return of_row(ways.radii, i) + growth_of(box, rate, at, pace, t_max)


@inlined
def update_first_hit(world, tree, moving, ways, i, asked, tools, thin, slot, found):
    """The first hits of a way, found = (box, other, whether that stood), after one more obstacle
    is looked at; asked = (skip inside, m/s by which obstacles that move grow).
    """
    (box, other, stood), (node_handles, scratch), t_max = found, tools, of_row(ways.t_max, i)
    (skip, rate), there = asked, box_of(tree, moving, slot)
    radius = radius_of(ways, i, there, rate)
    if radius == 0.0 and is_plain_box(world.geometry, world.footprints, slot):
        hit, t, face = meet_box(there, thin, t_max)
        if hit and not (skip and face == INSIDE):
            was = box.slot, box.t, box.feature
            if was[0] == NONE or is_before(tree, moving, thin, (slot, t, face), was):
                box = Hit(slot, t, face)
    else:
        t, feature, stands = _enter(world, ways, i, there, radius, skip, scratch, thin, slot)
        nearer = t < other.t
        if t < np.inf and t == other.t:
            nearer = node_handles[slot] < node_handles[other.slot]
        if nearer:
            other, stood = Hit(slot, t, np.int64(feature)), stands
    return box, other, stood


@inlined
def _enter(world, ways, i, box, radius, skip, scratch, thin, slot):
    """Where a way meets an obstacle first: (t, inf if nowhere, feature, whether it stood)."""
    t, feature, t_max, left = np.inf, np.int64(INSIDE), of_row(ways.t_max, i), thin.left
    until, stands = _time_left(box, thin), False
    if until >= 0.0:
        ray_in_obstacle_frame(ways, i, box, thin.nanoseconds, scratch.ray)
        end = min(t_max, until * (1.0 + NEAR))
        t, feature = enter_obstacle(world, slot, scratch.ray, radius, end, scratch.work)
    inside = t < np.inf and feature == INSIDE
    if until < np.inf and not (inside or t < until * (1.0 - NEAR)):
        ray_in_stopped_frame(ways, i, box, left, scratch.ray)
        later, where = enter_obstacle(world, slot, scratch.ray, radius, t_max, scratch.work)
        stands = later < t
        if until >= 0.0:
            stands &= where != INSIDE and later >= until * (1.0 - NEAR)
        if stands:
            t, feature = later, where
            inside = where == INSIDE
    return np.inf if skip and inside else t, feature, stands


@inlined
def _time_left(box, course):
    """The t at which an obstacle comes to rest; negative if it stands from the start, at the very
    nanosecond, too; inf if it does not meanwhile.
    """
    if course.left == np.inf or not moves(box):
        return np.inf
    time = course.left - elapsed(course.at, box[3], course.nanoseconds)[0]
    if time < HALF_A_NANOSECOND:
        return -1.0
    return time / course.pace if course.pace > 0.0 else np.inf


@inlined
def growth_of(box, rate, at, pace, t_max):
    """By how much an obstacle has grown at most on the way, as `places.growths`."""
    reference, end = box[3], (at + pace * t_max if pace > 0.0 else at)
    if rate == 0.0 or not moves(box):
        return 0.0
    return min(rate * max(abs(at - reference), abs(end - reference)), LARGEST)


@inlined
def ray_in_obstacle_frame(ways, i, box, nanoseconds, ray):
    """Write the ray as an obstacle sees it that moves."""
    _, _, velocity, reference = box
    seen, ndim = stack_array((2, 3), np.float64), ways.origins.shape[1]
    since, _ = elapsed(of_row(ways.at, i), reference, nanoseconds)
    for axis in range(ndim):
        seen[0, axis] = ways.origins[i, axis] - velocity[axis] * since
        seen[1, axis] = ways.directions[i, axis] - velocity[axis] * of_row(ways.pace, i)
    set_ray(ray, seen[0, :ndim], seen[1, :ndim])


@inlined
def ray_in_stopped_frame(ways, i, box, left, ray):
    """The same of one that has come to rest."""
    seen, ndim = stack_array(3, np.float64), ways.origins.shape[1]
    for axis in range(ndim):
        seen[axis] = ways.origins[i, axis] - box[2][axis] * left
    set_ray(ray, seen[:ndim], ways.directions[i])


@inlined
def fetch(tree, moving, geometry, footprints, slot):
    """Ask for the memory of what `update_first_hit` reads of most obstacles."""
    prefetch(moving.kept, slot, 1)
    prefetch(tree.handles, slot, 1)
    if geometry is not None:
        prefetch(geometry[0], slot, 2)
    if footprints is not None:
        prefetch(footprints[0], slot, 2)


# ---- through the nodes of the tree


class Ways(NamedTuple):
    """n rays, or balls that go along them."""

    origins: Any
    directions: Any
    t_max: Any
    """One for all, or (n,), as all that follows."""
    masks: Any
    radii: Any
    at: Any
    """s; empty, as `pace`, if `motion_batch.first_swept` is told when."""
    pace: Any
    """How many seconds a unit of t takes."""
    grown: Any
    """What no obstacle has grown by more, m."""


def ball_reach(radius: Any, largest: Any) -> Any:
    """By how much a ray may pass the box of an obstacle that its ball touches; `largest` of the
    coordinates of its origin.
    """
    return radius * (1.0 + FRAME_SLACK) + (FRAME_SLACK + COORDINATES) * largest


_ball_reach = inlined(ball_reach)


@inlined
def reach_of(ways, i):
    """The same of a row, and of what has grown."""
    largest = 0.0
    for axis in range(ways.origins.shape[1]):
        largest = max(largest, abs(ways.origins[i, axis]))
    return _ball_reach(of_row(ways.radii, i), largest) + of_row(ways.grown, i)


@inlined
def nothing():
    """What `update_first_hit` has found at first."""
    return no_hit(), no_hit(), False


@inlined
def cast_moving(world, tree, moving, ways, i, asked, tools, thin):
    """The first hits of a way, as of `update_first_hit`: through the tree's nodes."""
    at, pace, t_max, mask = thin.at, thin.pace, of_row(ways.t_max, i), of_row(ways.masks, i)
    nodes, fronts = moving.nodes, stack_array(FRONTS, np.float64)
    _set_way(fronts, moving, ways, i, reach_of(ways, i))
    found = nothing()
    stack, entries = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64)
    stack[0], entries[0], top = world.root, 0.0, (0 if world.root == NONE else 1)
    bounded, limit = covers(moving, at, pace, t_max) > 0, t_max
    while top > 0:
        top -= 1
        if entries[top] > limit * PAD + TINY or nodes[stack[top]].mask & mask == 0:
            continue
        waiting = stack, entries, top
        node, top = descend(nodes, fronts, bounded, (at - moving.start, pace, limit), waiting)
        if node == NONE or nodes[node].mask & mask == 0:
            continue
        slot = np.int64(node >> 1)
        found = update_first_hit(world, tree, moving, ways, i, asked, tools, thin, slot, found)
        limit = min(limit, found[0].t, found[1].t)
    return found


@inlined
def _set_way(fronts, moving, ways, i, more):
    """`set_fronts` of what goes along a way, by so much larger."""
    corners = stack_array((2, 3), np.float64)
    for axis in range(ways.origins.shape[1]):
        corners[0, axis] = ways.origins[i, axis] - more
        corners[1, axis] = ways.origins[i, axis] + more
    set_fronts(fronts, moving, corners[0], corners[1], ways.directions[i])


# ---- the first hits of many rays


class First(NamedTuple):
    """What they meet."""

    hits: Any
    """`Hits`, (n,); NONE where the way is free."""
    handles: Any
    """(n,) uint32; NO_NODE where the way is free."""
    points: Any
    normals: Any
    """(n, 3)"""


@lean_kernel
def first_rows(world, tree, moving, ways, asked, node_handles, scratch, told):
    """Fill in a row for each way; asked as of `update_first_hit`. Returns 0, OUTSIDE or
    REFUSED.
    """
    why = begin_asking(tree, moving, moments_of(ways.pace, ways.origins.shape[0]))
    if why != 0:
        return why
    ray, tools = stack_array((RAY_ROWS, 3), np.float64), (node_handles, scratch)
    for i in range(ways.origins.shape[0]):
        thin = course_of(ray, of_row(ways.at, i), of_row(ways.pace, i), moving)
        if covers(moving, thin.at, thin.pace, of_row(ways.t_max, i)) == 0:
            why = np.int64(OUTSIDE)
            break
        set_swept_box(ray, ways.origins[i], ways.origins[i], ways.directions[i])
        found = cast_moving(world, tree, moving, ways, i, asked, tools, thin)
        write_first_hit(world, tree, moving, ways, i, asked, tools, thin, found, told)
    end_query(tree.state)
    return why


@lean_kernel
def each_then(world, tree, moving, ways, slots, asked, tools, told):
    """Fill in a row for each way and the obstacle of `slots` that it may meet."""
    ray = stack_array((RAY_ROWS, 3), np.float64)
    for i in range(slots.shape[0]):
        thin = course_of(ray, of_row(ways.at, i), of_row(ways.pace, i), moving)
        set_swept_box(ray, ways.origins[i], ways.origins[i], ways.directions[i])
        slot = slots[i]
        found = update_first_hit(world, tree, moving, ways, i, asked, tools, thin, slot, nothing())
        write_first_hit(world, tree, moving, ways, i, asked, tools, thin, found, told)


@inlined
def write_first_hit(world, tree, moving, ways, i, asked, tools, thin, found, told):
    """Write which of two hits is the first, found = (box, other, whether that stood), and where it
    is.
    """
    (box, other, stood), (node_handles, scratch), ndim = found, tools, ways.origins.shape[1]
    by_box = other.slot == NONE or box.t < other.t
    if box.slot != NONE and box.t == other.t:
        by_box = node_handles[box.slot] < node_handles[other.slot]
    if box.slot == NONE or not by_box:
        place = write_first(other, i, node_handles, told)
        if other.slot != NONE:
            met = scratch, other, stood
            _tell(world, tree, moving, ways, i, asked, met, told, place)
    else:
        place = write_first(box, i, node_handles, told)
        there, (point, normal) = box_of(tree, moving, box.slot), place
        locate(there, thin, box.t, box.feature, point[:ndim], normal[:ndim])


@inlined
def write_first(best, i, node_handles, told):
    """Fill in what is met in a row, NONE if nothing is; where that is, (point, normal), is still
    to be told.
    """
    hits, point, normal = told.hits, told.points[i], told.normals[i]
    hits.slots[i], hits.ts[i], hits.features[i] = best.slot, best.t, best.feature
    met = best.slot != NONE
    told.handles[i] = node_handles[best.slot] if met else NO_NODE
    for axis in range(3):
        point[axis], normal[axis] = 0.0 if met else np.nan, 0.0
    return point, normal


@lean_kernel
def _tell(world, tree, moving, ways, i, asked, found, told, place):
    """Write where an obstacle is met."""
    (scratch, best, stood), (point, normal) = found, place
    at, pace = of_row(ways.at, i), of_row(ways.pace, i)
    box = box_of(tree, moving, best.slot)
    grown = growth_of(box, asked[1], at, pace, of_row(ways.t_max, i))
    then = elapsed(at, box[3], moving.nanoseconds)[0] + best.t * pace
    ray_in_obstacle_frame(ways, i, box, moving.nanoseconds, scratch.ray)
    if stood:
        ray_in_stopped_frame(ways, i, box, moving.left, scratch.ray)
        then = moving.left
    touch(world, scratch, of_row(ways.radii, i) + grown, best, point, normal)
    for axis in range(box[2].shape[0]):
        point[axis] += box[2][axis] * then
    for axis in range(3):
        point[axis] += normal[axis] * grown
    if grown > 0.0 and best.t == 0.0:
        leave_surface(ways.origins[i], point, normal)


@lean_kernel
def leave_surface(centre, point, normal):
    """As `growth_of`: who begins within what has grown meets it there, without a normal."""
    out = 0.0
    for axis in range(centre.shape[0]):
        out += (centre[axis] - point[axis]) * normal[axis]
    if out <= 0.0:
        for axis in range(centre.shape[0]):
            point[axis], normal[axis] = centre[axis], 0.0


# ---- one ray


Way = tuple[Floats, Floats, float]  # origin, direction, radius
When = tuple[float, float]  # at, pace


@lean_kernel
def first_between_then(tree, moving, start, goal, when, mask, skip_inside, place):
    """The first box from `start` to `goal`, when = (at, pace): (slot, t), and its point and normal
    as the rows of `place`; instead of a slot what `cast_one` says.
    """
    way, ndim = stack_array(3, np.float64), moving.kept[0].velocity.shape[0]
    if not way_between(start, goal, way, place):
        return np.int64(NOT_FINITE), np.inf
    swept = start[:ndim], start[:ndim], way[:ndim]
    asked = 1.0, mask, skip_inside, CLOSEST
    handle, t = cast_one(tree, moving, swept, asked, when, place)
    return (slot_of(handle) if handle >= 0 else np.int64(handle)), t


_POINT = np.empty(3)
_first_entry = entry_points(
    *(first_between_then, no_motion, _POINT, _POINT, (0.0, 0.0), np.uint32(0), False),
    np.empty((2, 3)),
)


class _Room:
    """Room for one way, see `spare`."""

    def __init__(self, ndim: int) -> None:
        self.ways = Ways(
            *(np.empty((1, ndim)), np.empty((1, ndim)), np.ones(1), np.empty(1, np.uint32)),
            *(np.empty(1), np.empty(1), np.empty(1), np.empty(1)),
        )
        self.hits = Hits(np.empty(1, np.int64), np.empty(1), np.empty(1, np.int64))
        self.handles = np.empty(1, np.uint32)
        self.scratch = new_scratch(ndim)


class OneWay:
    """Asks for one way at a time."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._tree: Any = held.tree
        self._spare = Spare(partial(_Room, held.tree.ndim))
        self._first = _first_entry(held.tree.ndim)

    def first_box(
        self, start: Floats, goal: Floats, mask: np.uint32, skip: bool, when: When
    ) -> BoxHit | None:
        """The first axis-aligned box from `start` to `goal`, shape (3,) each: the tree decides."""
        tree, place = self._tree, np.empty((2, 3))
        asked = start, goal, when, mask, skip, place
        motion, moment = tree._motion, when[1] == 0.0
        moving = motion.bounds if moment else motion.moving
        slot, t = self._first(tree._settled().tree, moving, *asked)
        while slot < NONE:
            if slot == NOT_FINITE:
                raise too_long(start, goal)
            moving = motion.others(tree, moving, slot, span_of(*when, 1.0), moment)
            slot, t = self._first(tree._settled().tree, moving, *asked)
        return None if slot == NONE else (slot, t, place[0], place[1])

    def first_shape(self, way: Way, mask: np.uint32, skip: bool, when: When) -> BoxHit | None:
        """The first obstacle of any shape."""
        held, tree, room = self._held, self._tree, self._spare.take()
        (origin, direction, radius), (at, pace) = way, when
        ways, hits, ndim = room.ways, room.hits, tree.ndim
        ways.origins[0], ways.directions[0] = origin[:ndim], direction[:ndim]
        ways.masks[0], ways.radii[0], ways.at[0], ways.pace[0] = mask, radius, at, pace
        ways.grown[0] = 0.0
        if held.uncertainty:
            ways.grown[0] = np.max(most_growth(held, ways.at, ways.at + pace))
        told = First(hits, room.handles, np.empty((1, 3)), np.empty((1, 3)))
        given = ways, (skip, held.uncertainty), held.columns.node_handle, room.scratch, told
        world, motion = world_of(tree, held.columns), tree.motion
        spans: Any = partial(times_of, ways.at, ways.pace, ways.t_max)

        def ask(*arrays: Any) -> Any:
            return call(first_rows, world, *arrays, *given)

        motion.ask(tree, spans, ask, pace == 0.0)
        if ndim == 2:
            told.points[0, 2] = origin[2]
        slot, t, point, normal = (
            hits.slots.item(0),
            hits.ts.item(0),
            told.points[0],
            told.normals[0],
        )
        self._spare.give(room)
        return None if slot == NONE else (slot, t, point, normal)
