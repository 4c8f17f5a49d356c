# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and balls at a time, or while it passes, among obstacles that have velocities.

In the frame of an obstacle that moves on a straight line, a ray is another ray. So a ray is
transformed into the frame of each obstacle that it may meet, and decided there as at rest. Thin
rays among axis-aligned boxes are decided by the tree, in the numbers as given: exactly.

Growth of an obstacle, see `store.places`, is added to the radius of the ball: that at the end of
the path, so a hit is too early rather than too late.

`walk_moving` leads through the nodes of the tree, as `query.walk` at rest; `motion_batch` has
the batches. The visitors are those of `query`, too: the first hit, and every hit.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    CLOSEST,
    INSIDE,
    LARGEST,
    NONE,
    NOT_FINITE,
    RAY_ROWS,
    ROOT,
    Found,
    end_query,
    entry_points,
    of_row,
    set_ray,
    set_swept_box,
    slot_of,
    two_product,
    two_sum,
)
from ...tree.access import Hit as TreeHit
from ...tree.compiler import address_of, called_at, inlined, lean_kernel, prefetch, stack_array
from ...tree.motion.access import (
    FRONTS,
    OUTSIDE,
    begin_asking,
    box_of,
    cast_one,
    course_of,
    covers,
    elapsed,
    enter_bounds,
    is_before,
    locate,
    meet_box,
    moments_of,
    moves,
    no_motion,
    path_at,
    set_fronts,
    sort_hits_at,
    span_of,
)
from ..results import NO_NODE, require_few
from ..shapes.footprint import ROUND
from ..shapes.shape import Floats
from ..store import Obstacles, most_growth
from .arguments import (
    SCRATCH,
    BoxHit,
    CastWorld,
    Sweep,
    clear_triangle,
    code_for,
    room_for_triangles,
    scratch_in,
    too_long,
    triangle_of,
    triangles_in,
)
from .batch import RowHits
from .boxes import segment_between
from .exact_ball import merged
from .query import (
    SWEEP_SLACK,
    Hit,
    enter_obstacle,
    is_plain_box,
    lengths_in_play,
    no_hit,
    touch,
    walk_nodes,
)
from .shapes import COORDINATES, FRAME_SLACK

HALF_A_NANOSECOND = 0.5e-9  # scenes have whole ones, and less apart are but rounded otherwise
NEAR = 2.0**-40  # of the t at which an obstacle stops: what is computed is not off by as much
EXACT_BOX, GOING, STOPPED = range(3)  # how a hit was decided: by the tree, in which frame
BOXES_ONLY = None, None  # instead of `Columns.shapes`, where the tree decides all


class TimedBalls(NamedTuple):
    """n rays, or balls, at a time. A column of one row is one for all."""

    origins: Any
    """(n, ndim), as the directions."""
    directions: Any
    t_max: Any
    masks: Any
    radii: Any
    at: Any
    """s"""
    pace: Any
    """How many seconds a unit of t takes."""
    grown: Any
    """No obstacle has grown by more, m."""
    rate: Any
    """By how much obstacles that move grow, m/s: one number."""
    skip_inside: Any


class Cast(NamedTuple):
    """What all rays of a batch share."""

    world: Any
    tree: Any
    moving: Any
    rays: TimedBalls
    node_handles: Any
    scratch: Any


class CasterAt(NamedTuple):
    """One ray or ball at a time, as visitors see it."""

    cast: Cast
    row: Any
    course: Any


class FirstHits(NamedTuple):
    """The first hits of a ray so far."""

    box: Any
    """`Hit` that the tree decides; its feature is a face of the tree's."""
    other: Any
    stopped: Any
    """Whether the obstacle of `other` had come to rest."""


class EveryHit(NamedTuple):
    """All hits of a ray, (n,) each."""

    slots: Any
    ts: Any
    features: Any
    kinds: Any
    """EXACT_BOX, GOING or STOPPED."""


def room_for_every(count: int) -> EveryHit:
    """Room for so many hits."""
    numbers = np.empty((3, count), np.int64)
    return EveryHit(numbers[0], np.empty(count), numbers[1], numbers[2])


NO_ROOM = room_for_every(0)  # where only the first hits are wanted


def room_for_rows(count: int, shapes: tuple[Any, Any]) -> RowHits:
    """Room for the first hits of so many rows."""
    parts = np.empty(count, np.int64), np.empty(count, np.uint32), np.empty(count)
    places = np.empty((count, 3)), np.empty((count, 3))
    # As RowHits(...), which would take one more call of a function of Python's.
    return tuple.__new__(RowHits, (*parts, *places, room_for_triangles(shapes, count)))


NO_ROWS = room_for_rows(0, BOXES_ONLY)  # where all hits of one ray are wanted


class Contact(NamedTuple):
    """How a ray or ball meets an obstacle."""

    hit: Any
    t: Any
    feature: Any
    kind: Any


@inlined
def cast_of(shapes, tree, moving, rays, node_handles, scratch):
    world = CastWorld(tree.nodes, tree.tight, tree.handles, tree.state[ROOT], *shapes)
    return Cast(world, tree, moving, rays, node_handles, scratch)


@inlined
def course_of_row(rays, i, moving, ray):
    """The course of a thin ray; `ray` is filled in."""
    set_swept_box(ray, rays.origins[i], rays.origins[i], rays.directions[i])
    return course_of(ray, of_row(rays.at, i), of_row(rays.pace, i), moving)


# ---- one obstacle


@inlined
def meet_obstacle(cast, i, course, slot):
    """The `Contact` of a ray or ball and an obstacle: while it goes, and where it comes to rest,
    from then on.
    """
    world, rays = cast.world, cast.rays
    box, t_max = box_of(cast.tree, cast.moving, slot), of_row(rays.t_max, i)
    radius = of_row(rays.radii, i) + growth_of(rays, i, box)
    if radius == 0.0 and is_plain_box(world.geometry, world.footprints, slot):
        hit, t, face = meet_box(box, course, t_max)
        return Contact(hit and not (rays.skip_inside and face == INSIDE), t, face, EXACT_BOX)
    t, feature, stops, kind = np.inf, np.int64(INSIDE), _time_left(box, course), GOING
    ray, work = cast.scratch.ray, cast.scratch.work
    if stops >= 0.0:
        doubt = ray_in_obstacle_frame(cast, i, slot, box, radius)
        end = min(t_max, stops * (1.0 + NEAR))
        t, feature = enter_obstacle(world, slot, ray, doubt, radius, end, work)
    inside = t < np.inf and feature == INSIDE
    if stops < np.inf and stops <= t_max and not (inside or t < stops * (1.0 - NEAR)):
        begin = max(stops, 0.0)
        doubt = ray_in_stopped_frame(cast, i, slot, box, radius, begin)
        later, where = enter_obstacle(world, slot, ray, doubt, radius, t_max - begin, work)
        if stops < 0.0:
            inside = later < np.inf and where == INSIDE
        elif where == INSIDE:  # it is touched, where no rounding matters, before it stops
            later, where = (later if t == np.inf else np.inf), np.int64(ROUND)
        if begin + later < t:
            t, feature, kind = min(begin + later, t_max), where, STOPPED
    return Contact(t < np.inf and not (rays.skip_inside and inside), t, np.int64(feature), kind)


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
def growth_of(rays, i, box):
    """By how much an obstacle has grown at most by the end of a ray, as `places.growths`."""
    at, pace, reference = of_row(rays.at, i), of_row(rays.pace, i), box[3]
    if rays.rate == 0.0 or not moves(box):
        return 0.0
    end = at + pace * of_row(rays.t_max, i) if pace > 0.0 else at
    return min(rays.rate * max(abs(at - reference), abs(end - reference)), LARGEST)


@inlined
def ray_in_obstacle_frame(cast, i, slot, box, radius):
    """Write a row's ray in the frame of an obstacle that moves to the scratch; return its doubt,
    see `RayAndBox`.
    """
    since, _ = elapsed(of_row(cast.rays.at, i), box[3], cast.moving.nanoseconds)
    return _ray_seen_from(cast, i, slot, box, (0.0, since, of_row(cast.rays.pace, i)), radius)


@inlined
def ray_in_stopped_frame(cast, i, slot, box, radius, begin):
    """The same for an obstacle that has come to rest, and of the ray from t = `begin` on."""
    return _ray_seen_from(cast, i, slot, box, (begin, cast.moving.left, 0.0), radius)


@inlined
def _ray_seen_from(cast, i, slot, box, when, radius):
    """Write a row's ray as an obstacle sees it, when = (t at which it begins, how many seconds the
    obstacle has gone then, and goes a unit of t); return by how much rounding may move it as seen
    from the obstacle. Of an axis-aligned box, which only a ball meets here, that counts also what
    rounds the closed form, see `exact_ball`.
    """
    rays, (lo, hi, velocity, _), (begin, since, pace) = cast.rays, box, when
    ends, ndim = stack_array((2, 3), np.float64), rays.origins.shape[1]
    ray, world, largest, fastest, slowest = cast.scratch.ray, cast.world, 0.0, 0.0, 0.0
    for axis in range(ndim):
        origin, direction = rays.origins[i, axis], rays.directions[i, axis]
        largest = max(largest, abs(origin), abs(velocity[axis] * since))
        if begin > 0.0:
            origin += begin * direction
            largest = max(largest, abs(begin * direction))
        step = direction - velocity[axis] * pace
        ends[0, axis] = min(max(origin - velocity[axis] * since, -LARGEST), LARGEST)
        ends[1, axis] = min(max(step, -LARGEST), LARGEST)
        fastest, slowest = max(fastest, abs(direction)), max(slowest, abs(step))
    if pace > 0.0 and slowest < CANCELLED * fastest:
        relative_direction(rays.directions[i], velocity, pace, cast.moving.nanoseconds, ends[1])
    set_ray(ray, ends[0, :ndim], ends[1, :ndim])
    doubt = 4.0 * COORDINATES * min(largest, LARGEST)
    if is_plain_box(world.geometry, world.footprints, slot):
        doubt += SWEEP_SLACK * min(lengths_in_play(ray, radius, lo, hi), LARGEST)
    return doubt


CANCELLED = 0.125  # of a direction: rounding may turn what is left of it by more than doubles do


@lean_kernel
def relative_direction(direction, velocity, pace, nanoseconds, out):
    """Write direction - velocity * pace, rounded once, where no product is beyond all doubles."""
    pace, lost = elapsed(pace, 0.0, nanoseconds)
    for axis in range(direction.shape[0]):
        step, error = two_product(velocity[axis], pace)
        total, rest = two_sum(direction[axis], -step)
        step = total + (rest - error - velocity[axis] * lost)
        if abs(step) <= LARGEST:
            out[axis] = step


@inlined
def fetch(tree, moving, geometry, footprints, slot):
    """Prefetch the memory that `meet_obstacle` reads of most obstacles."""
    prefetch(moving.velocities, slot, 1)
    prefetch(tree.handles, slot, 1)
    if geometry is not None:
        prefetch(geometry[0], slot, 2)
    if footprints is not None:
        prefetch(footprints[0], slot, 2)


# ---- visitors: (the hits so far, the t up to which the walk goes on) after one more leaf


@inlined
def no_first_hits():
    return FirstHits(no_hit(), no_hit(), False)


@inlined
def update_first_hit(caster, room, slot, first):
    """The `FirstHits` of a ray."""
    (cast, i, course), (box, other, stopped) = caster, first
    contact = meet_obstacle(cast, i, course, slot)
    if contact.hit and contact.kind == EXACT_BOX:
        hit = TreeHit(slot, contact.t, contact.feature)
        before = TreeHit(box.slot, box.t, box.feature)
        if box.slot == NONE or is_before(cast.tree, cast.moving, course, hit, before):
            box = Hit(slot, contact.t, contact.feature)
    elif contact.hit:
        nearer = contact.t < other.t
        if contact.t == other.t:
            nearer = cast.node_handles[slot] < cast.node_handles[other.slot]
        if nearer:
            other = Hit(slot, contact.t, contact.feature)
            stopped = contact.kind == STOPPED
    return FirstHits(box, other, stopped), min(box.t, other.t, of_row(cast.rays.t_max, i))


@inlined
def add_hit(caster, room, slot, count):
    """How many hits there are; those that `room`, an `EveryHit`, has place for are written."""
    contact = meet_obstacle(caster.cast, caster.row, caster.course, slot)
    if contact.hit and count < room.slots.shape[0]:
        room.slots[count], room.ts[count] = slot, contact.t
        room.features[count], room.kinds[count] = contact.feature, contact.kind
    return count + contact.hit


@inlined
def visit(caster, room, slot, found):
    """(`FirstHits`, how many hits there are): all are counted if there is room for one."""
    first, count = found
    if room.slots.shape[0] == 0:
        first, t = update_first_hit(caster, room, slot, first)
        return (first, count), t
    count = add_hit(caster, room, slot, count)
    return (first, count), of_row(caster.cast.rays.t_max, caster.row)


# ---- the walk


@inlined
def reach_of(rays, i):
    """By how much a ray may pass the box of an obstacle that its ball touches."""
    largest = 0.0
    for axis in range(rays.origins.shape[1]):
        largest = max(largest, abs(rays.origins[i, axis]))
    doubt = (FRAME_SLACK + COORDINATES) * largest
    return of_row(rays.radii, i) * (1.0 + FRAME_SLACK) + doubt + of_row(rays.grown, i)


@inlined
def walk_moving(caster, room):
    """`walk_nodes` of a ray or ball at a time: what `visit` finds."""
    cast, i, course = caster
    rays, moving, fronts = cast.rays, cast.moving, stack_array(FRONTS, np.float64)
    corners, more = stack_array((2, 3), np.float64), reach_of(rays, i)
    for axis in range(rays.origins.shape[1]):
        corners[0, axis] = rays.origins[i, axis] - more
        corners[1, axis] = rays.origins[i, axis] + more
    set_fronts(fronts, moving, corners[0], corners[1], rays.directions[i])
    t_max = of_row(rays.t_max, i)
    path = path_at(cast.tree, moving, course, t_max, of_row(rays.masks, i), fronts)
    root, nothing = cast.world.root, (no_first_hits(), np.int64(0))
    return walk_nodes(
        moving.nodes, root, path, 0, t_max, enter_bounds, caster, room, nothing, visit
    )


# ---- where hits are


@inlined
def write_first_hit(cast, i, course, first, hits):
    """Write the earlier of the `FirstHits`, and where it is, to `RowHits`."""
    box, other, stopped = first
    by_box = other.slot == NONE or box.t < other.t
    if box.slot != NONE and box.t == other.t:
        by_box = cast.node_handles[box.slot] < cast.node_handles[other.slot]
    by_box = by_box and box.slot != NONE
    slot, t = (box.slot, box.t) if by_box else (other.slot, other.t)
    point, normal, is_hit = hits.points[i], hits.normals[i], slot != NONE
    hits.slots[i], hits.t[i] = slot, t
    hits.handles[i] = cast.node_handles[slot] if is_hit else NO_NODE
    for axis in range(3):
        point[axis], normal[axis] = 0.0 if is_hit else np.nan, 0.0
    triangle = triangle_of(hits.triangles, i)
    if is_hit and not by_box:
        _touch_moving(cast, i, other, stopped, point, normal, triangle)
        return
    clear_triangle(triangle)
    if by_box:
        _locate_box(cast, i, course, box, point, normal)


@inlined
def _locate_box(cast, i, course, hit, point, normal):
    """Fill in where a ray hits a box, as the tree decided."""
    ndim, box = cast.rays.origins.shape[1], box_of(cast.tree, cast.moving, hit.slot)
    locate(box, course, hit.t, hit.feature, point[:ndim], normal[:ndim])


@lean_kernel
def _touch_moving(cast, i, hit, stopped, point, normal, triangle):
    """Fill in where a ray hits an obstacle, in its own frame; triangle as of `touch`."""
    rays, moving, scratch = cast.rays, cast.moving, cast.scratch
    box, at = box_of(cast.tree, moving, hit.slot), of_row(rays.at, i)
    grown, center = growth_of(rays, i, box), rays.origins[i]
    radius = of_row(rays.radii, i) + grown
    since = elapsed(at, box[3], moving.nanoseconds)[0] + hit.t * of_row(rays.pace, i)
    if stopped:
        since = moving.left
        doubt = ray_in_stopped_frame(cast, i, hit.slot, box, radius, 0.0)
    else:
        doubt = ray_in_obstacle_frame(cast, i, hit.slot, box, radius)
    touch(cast.world, scratch, doubt, radius, hit, point, normal, triangle)
    for axis in range(box[2].shape[0]):
        point[axis] += box[2][axis] * since
    for axis in range(3):
        point[axis] += normal[axis] * grown
    for axis in range(center.shape[0]):
        if not np.isfinite(point[axis]):  # so far away was the obstacle at its stamp
            point[axis] = center[axis] + hit.t * rays.directions[i, axis]
    if grown > 0.0 and hit.t == 0.0:  # a start within the growth is the point, without a normal
        out = 0.0
        for axis in range(center.shape[0]):
            out += (center[axis] - point[axis]) * normal[axis]
        if out <= 0.0:
            for axis in range(center.shape[0]):
                point[axis], normal[axis] = center[axis], 0.0


# ---- kernels through the nodes of the tree


@lean_kernel
def cast_rows_at(shapes, tree, moving, rays, node_handles, room, hits):
    """Write the first hit of each of the `TimedBalls` to `RowHits`; or, if `room`, an `EveryHit`,
    has rows, all hits of the only one there, in no order. Shapes as of `Columns.shapes`, or
    BOXES_ONLY. Returns how many hits there are of the last row, which may be more than fit, or
    OUTSIDE or REFUSED.
    """
    count = rays.origins.shape[0]
    why = begin_asking(tree, moving, moments_of(rays.pace, count))
    if why != 0:
        return why
    scratch = scratch_in(stack_array(SCRATCH, np.float64), rays.origins.shape[1])
    cast = cast_of(shapes, tree, moving, rays, node_handles, scratch)
    ray = stack_array((RAY_ROWS, 3), np.float64)
    for i in range(count):
        course = course_of_row(rays, i, moving, ray)
        if covers(moving, course.at, course.pace, of_row(rays.t_max, i)) == 0:
            why = np.int64(OUTSIDE)
            break
        first, why = walk_moving(CasterAt(cast, i, course), room)
        if room.slots.shape[0] == 0:
            write_first_hit(cast, i, course, first, hits)
    end_query(tree.state)
    return why


@lean_kernel
def first_box(tree, moving, start, goal, mask, skip_inside, when, place):
    """The first box from `start` to `goal`, when = (at, pace): (slot, t), and its point and normal
    as the rows of `place`; instead of a slot what `cast_one` says.
    """
    direction, ndim = stack_array(3, np.float64), moving.velocities[0].velocity.shape[0]
    if not segment_between(start, goal, direction, place):
        return np.int64(NOT_FINITE), np.inf
    swept, query = (
        (start[:ndim], start[:ndim], direction[:ndim]),
        (1.0, mask, skip_inside, CLOSEST),
    )
    handle, t = cast_one(tree, moving, swept, query, when, place)
    return (slot_of(handle) if handle >= 0 else np.int64(handle)), t


called_rows_at = called_at(cast_rows_at)


@lean_kernel
def first_segment(address, tree, moving, shapes, ends, ball, when, node_handles, place):
    """`cast_rows_at`, at its address, of one row, ends = (start, goal), ball = (radius, mask,
    skip_inside, rate, grown), when = (at, pace): as `first_box`.
    """
    (start, goal), (radius, mask, skip_inside, rate, grown) = ends, ball
    ndim, direction = moving.velocities[0].velocity.shape[0], stack_array(3, np.float64)
    if not segment_between(start, goal, direction, place):
        return np.int64(NOT_FINITE), np.inf
    numbers, masks = stack_array((5, 1), np.float64), stack_array(1, np.uint32)
    numbers[0, 0], numbers[1, 0], numbers[2, 0] = 1.0, radius, grown
    numbers[3, 0], numbers[4, 0], masks[0] = when[0], when[1], mask
    rays = TimedBalls(
        *(start[:ndim].reshape(1, ndim), direction[:ndim].reshape(1, ndim), numbers[0], masks),
        *(numbers[1], numbers[3], numbers[4], numbers[2], rate, skip_inside),
    )
    slots, ts = stack_array(1, np.int64), stack_array(1, np.float64)
    triangles = triangles_in(shapes, place[2:])
    hits = RowHits(slots, stack_array(1, np.uint32), ts, place[:1], place[1:2], triangles)
    none = EveryHit(slots[:0], ts[:0], slots[:0], slots[:0])
    why = called_rows_at(address, (shapes, tree, moving, rays, node_handles, none, hits))
    return (slots[0] if why == 0 else why), ts[0]


@lean_kernel
def describe_every_hit(shapes, tree, moving, rays, boxes, hits, points, normals, triangles):
    """Fill in the points, normals and triangles of hits. The first `boxes` of them are EXACT_BOX,
    sorted by t and handle: bring these into exact order; each t becomes the largest up to it.
    """
    scratch = scratch_in(stack_array(SCRATCH, np.float64), rays.origins.shape[1])
    cast = cast_of(shapes, tree, moving, rays, 0, scratch)
    course = course_of_row(rays, 0, moving, stack_array((RAY_ROWS, 3), np.float64))
    sort_hits_at(tree, moving, course, Found(hits.slots, hits.ts, hits.features), boxes)
    for j in range(hits.slots.shape[0]):
        hit = Hit(hits.slots[j], hits.ts[j], hits.features[j])
        triangle, stopped = triangle_of(triangles, j), hits.kinds[j] == STOPPED
        if j < boxes:
            clear_triangle(triangle)
            _locate_box(cast, 0, course, hit, points[j], normals[j])
        else:
            _touch_moving(cast, 0, hit, stopped, points[j], normals[j], triangle)


# ---- one ray


def first_of_one(
    store: Obstacles,
    ends: tuple[Floats, Floats],
    ball: tuple[float, np.uint32, bool],
    when: tuple[float, float],
) -> BoxHit | None:
    """The first hit of a thin ray, or ball, ends = (start, goal), shape (3,) each, ball = (radius,
    mask, skip_inside), when = (at, pace).
    """
    tree, columns = store.tree, store.columns
    given: tuple[Any, ...]
    if ball[0] == 0.0 and not (columns.shaped or store.uncertainty):
        place = np.empty((2, 3))
        code, given = _box_entry(tree.ndim), (*ends, *ball[1:], when, place)
    else:
        grown, place = 0.0, np.empty((columns.rows_of_hit, 3))
        if store.uncertainty:
            at = np.array([when[0]])
            grown = float(np.max(most_growth(store, at, at + when[1])))
        grown_ball = *ball, store.uncertainty, grown
        given = columns.shapes, ends, grown_ball, when, columns.node_handle, place
        arrays = tree.view().tree, tree.motion.moving  # type: ignore[union-attr]
        given_all = *arrays, *given
        code = code_for(first_segment, columns.shapes, given_all, tree.ndim, _address_of_rows)
    slot, t = tree.motion.ask_path(tree, code, given, *when, 1.0)  # type: ignore[union-attr]
    if slot == NOT_FINITE:
        raise too_long(*ends)
    if tree.ndim == 2:
        place[0, 2] = ends[0][2]
    if slot == NONE:
        return None
    if len(place) == 2:
        return slot, t, place[0], place[1]
    return slot, t, place[0], place[1], place[2]


def _address_of_rows(tree: Any, moving: Any, shapes: Any, *_: Any) -> int:
    """Where `first_segment` finds `cast_rows_at`."""
    row, rows = np.empty(0), np.empty((0, moving.velocities.dtype['velocity'].shape[0]))
    rays = TimedBalls(*(rows, rows, row, np.empty(0, np.uint32), row, row, row, row, 0.0, False))
    handles, hits = np.empty(0, np.int64), room_for_rows(0, shapes)
    return address_of(cast_rows_at, shapes, tree, moving, rays, handles, NO_ROOM, hits)


def cast_every(
    store: Obstacles, sweep: Sweep, when: tuple[float, float], most: int | None = None
) -> Iterable[BoxHit]:
    """All hits of a thin ray, or ball, in order, ties by handle, when = (at, pace);
    TooManyHitsError if there are more than `most`.
    """
    tree, columns, ndim = store.tree, store.columns, store.tree.ndim
    motion: Any = tree.motion
    at, pace, shapes = np.array(when[:1]), np.array(when[1:]), columns.shapes
    segment = sweep.origin[None, :ndim].copy(), sweep.direction[None, :ndim].copy()
    grown = np.zeros(1)
    if store.uncertainty:
        grown = np.atleast_1d(most_growth(store, at, at + pace))
    masks, radii = np.array([sweep.mask]), np.array([sweep.radius])
    parts = np.ones(1), masks, radii, at, pace, grown, store.uncertainty, sweep.skip_inside
    rays, begun, room, count = TimedBalls(*segment, *parts), tree.view(), 0, 16

    def ask(arrays: Any, moving: Any) -> Any:
        given = shapes, arrays, moving, rays, columns.node_handle, hits, unused
        return code_for(cast_rows_at, shapes, given, ndim)(*given)

    unused = NO_ROWS if columns.rows_of_hit == 2 else room_for_rows(0, shapes)
    while count > room:
        room = count
        hits = room_for_every(room)
        span = span_of(*when, 1.0), True
        count = motion.ask(tree, lambda span=span: span, ask, when[1] == 0.0)
    require_few(count, most)
    hits = EveryHit(*(column[:count] for column in hits))
    exact = hits.kinds == EXACT_BOX
    order = np.lexsort((columns.tree_handle[hits.slots], hits.ts, ~exact))
    hits, boxes = EveryHit(*(column[order] for column in hits)), int(exact.sum())
    points, normals = np.zeros((count, 3)), np.zeros((count, 3))
    triangles = room_for_triangles(shapes, count)
    known = motion.known(begun, 0.0, 0.0)
    given = shapes, begun.tree, known, rays, boxes, hits, points, normals, triangles
    code_for(describe_every_hit, shapes, given)(*given)
    tree.check_unchanged(begun)
    if ndim == 2:
        points[:, 2] = sweep.origin[2]
    handles, others = columns.node_handle[hits.slots], boxes + np.arange(count - boxes)
    others = others[np.lexsort((handles[boxes:], hits.ts[boxes:]))]
    order = merged(np.arange(boxes), others, hits.ts, handles)
    found: list[Any] = [hits.slots[order].tolist(), hits.ts[order].tolist()]
    rows = points, normals, *(() if triangles is None else (triangles,))
    return zip(*found, *(column[order] for column in rows), strict=True)


_POINT = np.empty(3)
_box_entry = entry_points(
    first_box, no_motion, _POINT, _POINT, np.uint32(0), False, (0.0, 0.0), np.empty((2, 3))
)
