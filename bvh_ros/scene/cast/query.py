# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One ray, or one swept ball, among true shapes: which leaves it may meet, and which hits count.

Two walks lead to the leaves, nearest first: `walk_tree` through the nodes of the tree, and
`walk_snapshot` through the wide snapshot of batches. Each hands every leaf to a visitor, which
says how far the walk has to go on:

    visit_first      the first hit of a thin ray
    visit_every      all hits of a thin ray
    visit_candidate  the obstacles that a ball may touch first, or at all, see `exact_ball`

A ball of radius r touches an obstacle only where its centre is in the obstacle's box grown by r.
So the walk grows every node by r, and by what rounding cannot tell apart from touching.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    DEEPEST,
    DIRECTION,
    FARTHEST_ORIGIN,
    INSIDE,
    NONE,
    ORIGIN,
    STACK,
    OpenTree,
    Stack,
    compare_hits,
    intersect_node,
    leaf_box,
    limit32,
    next_leaf,
    next_wide_leaf,
    prepare_ray,
    push_loose,
    push_root,
    set_ray,
    start_ray,
    traversal_distance,
    widen,
)
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..results import NO_NODE, require_few
from ..shapes.footprint import ROUND
from ..shapes.shape import LARGE, SMALL, Floats
from ..store import Columns
from .arguments import (
    SCRATCH,
    BoxHit,
    CastWorld,
    Hits,
    Sweep,
    call,
    clear_triangle,
    room_for_triangles,
    scratch_in,
    triangle_of,
    world_of,
)
from .contact import contact, enter_shape
from .footprint import enter_footprint, touch_footprint
from .shapes import (
    COORDINATES,
    FRAME_SLACK,
    RayAndBox,
    enter_rounded_boxes,
    point_along,
    radius_of,
    time_of,
)

EARLY, AT, LATE = range(3)  # rows: of a ball that is larger, of itself, of a smaller one
SWEEP_SLACK = 2.0**-46
HUGE, MINUTE = 1e140, 1e-140  # beyond, squares leave the doubles: nothing is sure


class Query(NamedTuple):
    """One ray or ball; its origin and direction are in the scratch."""

    radius: Any
    """0 for a thin ray."""
    slack: Any
    """A ball larger by this is surely early among axis-aligned boxes, a smaller one late."""
    t_max: Any
    mask: Any
    skip_inside: Any
    every: Any
    """All hits, not only the first."""
    patched: Any
    """Whether a leaf may be visited twice: in a snapshot that was patched."""


class Caster(NamedTuple):
    """One ray or ball at rest, as visitors see it."""

    world: Any
    query: Any
    scratch: Any


class Hit(NamedTuple):
    """A hit; slot NONE without any."""

    slot: Any
    t: Any
    feature: Any


class Candidates(NamedTuple):
    """Room for the obstacles that a ball may touch."""

    slots: Any
    """(n,)"""
    times: Any
    """(3, n): rows EARLY, AT and LATE."""
    features: Any
    """The same."""


class BallPath(NamedTuple):
    """The path of a ball where no length needs a scale, see `shapes`: the same for all boxes."""

    unit: Any
    """(3,)"""
    pace: Any
    """Negative before it is computed."""
    simple: Any
    """Whether no length needs a scale."""


# ---- one obstacle


@inlined
def is_plain_box(geometry, footprints, slot):
    """Whether an obstacle is an axis-aligned box."""
    if geometry is not None:
        return not geometry[0][slot].shaped
    if footprints is not None:
        return not footprints[0][slot].shaped
    return True


@inlined
def enter_obstacle(world, slot, ray, radius, t_max, work):
    """(t, feature) at which a ray, or a ball swept along it, meets an obstacle; t inf if never.
    The radius of a ray is None.
    """
    lo, hi = leaf_box(world.nodes, world.tight, 2 * slot)
    pair = RayAndBox(ray, lo, hi)
    return enter_any(world.geometry, world.footprints, slot, pair, radius, t_max, work)


@inlined
def enter_any(geometry, footprints, slot, pair, radius, t_max, work):
    t, feature = np.inf, np.int64(INSIDE)
    if geometry is not None:
        t, feature = enter_shape(geometry[0][slot], geometry[1], pair, radius, t_max, work)
    if footprints is not None:
        ball = radius_of(radius)
        t, feature = enter_footprint(footprints[0][slot], footprints[1], pair, ball, t_max, work)
    return t, feature


@inlined
def touch(world, scratch, radius, hit, point, normal, triangle):
    """Fill in where a ray or ball meets an obstacle, the outward normal there, and the triangle, a
    row of `room_for_triangles`, or None.
    """
    lo, hi = leaf_box(world.nodes, world.tight, 2 * hit.slot)
    pair, out = RayAndBox(scratch.ray, lo, hi), (point, normal)
    at, work = (hit.t, hit.feature), scratch.work
    touch_any(world.geometry, world.footprints, hit.slot, pair, at, radius, work, out, triangle)


@inlined
def touch_any(geometry, footprints, slot, pair, hit, radius, work, out, triangle):
    point, normal = out
    if geometry is not None:
        contact(geometry[0][slot], geometry[1], pair, hit, radius, work, point, normal, triangle)
    if footprints is not None:
        ball = radius_of(radius)
        touch_footprint(footprints[0][slot], footprints[1], pair, hit, ball, work, point, normal)


@inlined
def ball_path(world, ray, radius, unit):
    """The `BallPath` of a ray; `unit` is filled in."""
    largest, here = radius, world.nodes[world.root]
    for axis in range(ray.shape[1]):
        largest = max(largest, abs(ray[ORIGIN, axis]), abs(here.lo[axis]), abs(here.hi[axis]))
    pace = point_along(ray, 1.0, unit[: ray.shape[1]])
    return BallPath(unit, pace, radius > SMALL and largest < LARGE)


@lean_kernel
def enter_thrice(world, slot, ray, path, query, work, found):
    """When a ball that is larger by its slack, the ball itself and a smaller one meet an obstacle
    up to t = 1, to the rows EARLY, AT and LATE of `found`, (ts, features). They differ only for
    axis-aligned boxes.
    """
    ts, features = found
    is_plain = is_plain_box(world.geometry, world.footprints, slot)
    slack = query.slack if is_plain else 0.0
    radii = stack_array(3, np.float64)
    radii[EARLY], radii[AT], radii[LATE] = query.radius + slack, query.radius, query.radius - slack
    if is_plain and world.geometry is not None and path.simple:
        lo, hi = leaf_box(world.nodes, world.tight, 2 * slot)
        enter_rounded_boxes(ray[ORIGIN], path.unit, lo, hi, radii, path.pace, found)
        for i in range(3):
            ts[i] = time_of(ts[i], path.pace, 1.0)
        return
    for i in range(3):
        ts[i], features[i] = np.inf, np.int64(ROUND)
        if i > 0 and not is_plain:
            ts[i], features[i] = ts[0], features[0]
        elif radii[i] > 0.0:
            ts[i], features[i] = enter_obstacle(world, slot, ray, radii[i], 1.0, work)


# ---- which of two hits is the first


@inlined
def no_hit():
    return Hit(np.int64(NONE), np.inf, np.int64(INSIDE))


@inlined
def no_hits():
    """The first hits before any: one of axis-aligned boxes and one of other shapes. Each kind is
    compared by itself: exactly, a box may be before another though its t is not, with a shape
    between.
    """
    return no_hit(), no_hit()


@inlined
def precedes(world, ray, hit, other):
    """Whether a hit of a thin ray comes before another; ties by handle. Between axis-aligned boxes
    as real arithmetic says.
    """
    if hit.slot == NONE or other.slot == NONE:
        return hit.slot != NONE
    order = -1 if hit.t < other.t else (1 if hit.t > other.t else 0)
    if is_plain_box(world.geometry, world.footprints, hit.slot) and is_plain_box(
        world.geometry, world.footprints, other.slot
    ):
        lo, hi = leaf_box(world.nodes, world.tight, 2 * hit.slot)
        other_lo, other_hi = leaf_box(world.nodes, world.tight, 2 * other.slot)
        one, another = (hit.t, hit.feature), (other.t, other.feature)
        order = compare_hits(ray, lo, hi, one, other_lo, other_hi, another)
    return order < 0 or (order == 0 and world.handles[hit.slot] < world.handles[other.slot])


# ---- visitors: (the hits so far, the t up to which the walk goes on) after one more leaf


@inlined
def visit_first(caster, room, slot, first):
    """The first hits of a thin ray, as of `no_hits`."""
    (world, query, scratch), (box, other) = caster, first
    t, feature = enter_obstacle(world, slot, scratch.ray, None, query.t_max, scratch.work)
    if t < np.inf and not (query.skip_inside and feature == INSIDE):
        hit = Hit(slot, t, np.int64(feature))
        if is_plain_box(world.geometry, world.footprints, slot):
            box = hit if precedes(world, scratch.ray, hit, box) else box
        else:
            other = hit if precedes(world, scratch.ray, hit, other) else other
    return (box, other), min(box.t, other.t, query.t_max)


@inlined
def visit_every(caster, room, slot, count):
    """How many hits of a thin ray there are; those that `room`, `Hits`, has place for are written
    there, in no order.
    """
    world, query, scratch = caster
    t, feature = enter_obstacle(world, slot, scratch.ray, None, query.t_max, scratch.work)
    if t < np.inf and not (query.skip_inside and feature == INSIDE):
        write(Hit(slot, t, np.int64(feature)), room, count)
        count += 1
    return count, query.t_max


@inlined
def write(hit, hits, place):
    """Write a hit if there is room."""
    if place < hits.slots.shape[0]:
        hits.slots[place], hits.ts[place], hits.features[place] = hit


class Reached(NamedTuple):
    """The candidates of a ball so far."""

    count: Any
    soonest: Any
    """When the larger ball touches the first of them."""
    latest: Any
    """By then the ball has surely touched one."""
    path: Any


@inlined
def visit_candidate(caster, room, slot, reached):
    """The `Reached` of a ball; `room` are `Candidates`."""
    (world, query, scratch), (count, soonest, latest, path) = caster, reached
    if path.pace < 0.0:  # many balls meet no leaf
        path = ball_path(world, scratch.ray, query.radius, path.unit)
    ts, features = stack_array(3, np.float64), stack_array(3, np.int64)
    is_repeated = False
    if query.patched:
        for j in range(min(count, room.slots.shape[0])):
            is_repeated |= room.slots[j] == slot
    if not is_repeated:
        enter_thrice(world, slot, scratch.ray, path, query, scratch.work, (ts, features))
        if ts[EARLY] <= latest:
            if count < room.slots.shape[0]:
                room.slots[count] = slot
                for i in range(3):
                    room.times[i, count], room.features[i, count] = ts[i], features[i]
            count += 1
            inside = query.skip_inside and features[EARLY] == INSIDE
            if not query.every and ts[EARLY] < soonest and not inside:
                soonest = ts[EARLY]
                latest = min(ts[LATE] * (1.0 + SWEEP_SLACK) + MINUTE, latest)
    return Reached(count, soonest, latest, path), latest


# ---- walks


@lean_kernel
def doubt_of(ray, radius):
    """By how much a ray may pass a shape's box and yet touch the shape, within its frame's slack:
    the ray's own share. That of the shape is in its box.
    """
    largest = 0.0
    for axis in range(ray.shape[1]):
        largest = max(largest, abs(ray[ORIGIN, axis]))
    return FRAME_SLACK * radius + (FRAME_SLACK + COORDINATES) * largest


@inlined
def reach_of(query, ray):
    """By how much nodes are grown for a ray or ball."""
    return query.radius + query.slack + doubt_of(ray, query.radius)


@inlined
def grow(node, radius, box):
    """A node's box grown by the radius on all sides, rounded outwards."""
    for axis in range(node.lo.shape[0]):
        box[0, axis], box[1, axis] = node.lo[axis], node.hi[axis]
        if radius > 0.0:
            box[0, axis] -= radius
            box[1, axis] += radius
            box[0, axis] -= abs(box[0, axis]) * 2.0**-52
            box[1, axis] += abs(box[1, axis]) * 2.0**-52


class GrownPath(NamedTuple):
    """A ray or ball among the nodes of the tree."""

    ray: Any
    box: Any
    """Scratch, (2, ndim)."""
    mask: Any
    wide: Any
    """See `prepare_ray`."""
    reach: Any
    """By how much nodes are grown."""


@inlined
def enter_grown(nodes, node, path, limit):
    """Where a ray may enter a node that is grown."""
    if nodes[node].mask & path.mask == 0:
        return np.inf
    grow(nodes[node], path.reach, path.box)
    return intersect_node(path.box[0], path.box[1], path.ray, limit, path.wide)


@inlined
def walk_nodes(nodes, root, path, scale, t_max, enter, caster, room, found, visit):
    """Hand the leaves that a path may reach by t_max to a visitor; return what it found, `found`
    at first. `enter` is as of `next_leaf`, in units of 2**scale; visit(caster, room, slot, found)
    returns what is found now, and the t up to which the walk goes on.
    """
    limit = traversal_distance(t_max, scale)
    stack = Stack(stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64))
    top = push_root(nodes, root, path, limit, stack, enter)
    while top > 0:
        leaf, top = next_leaf(nodes, path, limit, stack, top, enter)
        if leaf == NONE:
            break
        found, t = visit(caster, room, leaf >> 1, found)
        limit = traversal_distance(t, scale)
    return found


@inlined
def walk_tree(caster, room, found, visit):
    """`walk_nodes` of a ray or ball at rest."""
    (world, query, scratch), scale, wide = caster, np.int64(0), False
    nodes, root, bounds, reach = world.nodes, world.root, scratch.box, reach_of(query, scratch.ray)
    if root != NONE:
        grow(nodes[root], reach, bounds)
        scale, wide = prepare_ray(scratch.ray, bounds[0], bounds[1])
    path = GrownPath(scratch.ray, bounds, query.mask, wide, reach)
    return walk_nodes(
        nodes, root, path, scale, query.t_max, enter_grown, caster, room, found, visit
    )


@inlined
def walk_snapshot(caster, snapshot, segment, room, found, visit):
    """`walk_tree` through the snapshot, segment = (origin, direction): (what the visitor found,
    whether the ray is suited to the snapshot).
    """
    (world, query, scratch), (origin, direction) = caster, segment
    records, stack = stack_array(1, snapshot.record), stack_array(STACK, np.int64)
    record, place = records[0], stack_array(1, np.int32)
    reach, top = reach_of(query, scratch.ray) * snapshot.per_length, 0
    units = snapshot.center, snapshot.per_length
    suited = start_ray(record, origin, direction, *units, query.t_max) and reach < FARTHEST_ORIGIN
    place[0] = 0
    if suited:
        widen(record, reach)
        stack[0] = 0
        top = push_loose(snapshot, stack, 1)
    while top > 0:
        slot, top = next_wide_leaf(snapshot, records, place, query.mask, stack, top)
        # What was written since is removed, or has another mask now.
        if slot == NONE or (snapshot.loose > 0 and world.nodes[2 * slot].mask & query.mask == 0):
            continue
        found, t = visit(caster, room, slot, found)
        record.limit = limit32(t, record.unit)
    return found, suited


@inlined
def walk(caster, snapshot, segment, room, nothing, visit):
    """What a visitor finds for a ray, by the snapshot if the ray is suited to it. `snapshot`: None
    if there never is one.
    """
    if snapshot is None:
        return walk_tree(caster, room, nothing, visit)
    if snapshot.size > 0:
        found, suited = walk_snapshot(caster, snapshot, segment, room, nothing, visit)
        if suited:
            return found
    return walk_tree(caster, room, nothing, visit)


# ---- the answers of one ray


@inlined
def first_hit(caster, snapshot, segment):
    """The first `Hit` of a thin ray."""
    box, other = walk(caster, snapshot, segment, 0, no_hits(), visit_first)
    return box if precedes(caster.world, caster.scratch.ray, box, other) else other


@inlined
def candidates(caster, snapshot, segment, room):
    """Fill `room` with the obstacles that a ball may touch first, or at all if the query is for
    every hit; return how many there are, which may be more than fit.
    """
    unit = stack_array(3, np.float64)
    nothing = Reached(np.int64(0), np.inf, 1.0, BallPath(unit, -1.0, False))
    reached = walk(caster, snapshot, segment, room, nothing, visit_candidate)
    if reached.count > room.slots.shape[0]:
        return reached.count
    count = np.int64(0)
    for j in range(reached.count):
        if room.times[EARLY, j] <= reached.latest:
            room.slots[count] = room.slots[j]
            for i in range(3):
                room.times[i, count] = room.times[i, j]
                room.features[i, count] = room.features[i, j]
            count += 1
    return count


@lean_kernel
def slack_of(world, ray, radius):
    """By how much a larger ball is surely early, and a smaller one late."""
    if world.root == NONE:
        return 0.0
    here, extent, length = world.nodes[world.root], radius, 0.0
    for axis in range(ray.shape[1]):
        above = abs(here.hi[axis] - ray[ORIGIN, axis])
        below = abs(here.lo[axis] - ray[ORIGIN, axis])
        extent += max(above, below)
        length += abs(ray[DIRECTION, axis])
    total = extent + min(length, extent)
    return SWEEP_SLACK * total if MINUTE < total < HUGE else np.inf


@inlined
def comes_before(times, node_handles, slots, one, other):
    if times[one] != times[other]:
        return times[one] < times[other]
    return node_handles[slots[one]] < node_handles[slots[other]]


@inlined
def first_candidate(world, node_handles, found, count, skip_inside):
    """(which of `count` `Candidates` is touched first, NONE without any; whether that is sure)."""
    slots, times, features = found
    first = np.int64(NONE)
    for j in range(count):
        inside = features[LATE, j] == INSIDE
        if features[EARLY, j] == INSIDE and not inside:
            return np.int64(NONE), False
        if skip_inside and inside:
            continue
        if first == NONE or comes_before(times[AT], node_handles, slots, j, first):
            first = np.int64(j)
    if first == NONE:
        return first, True
    slot, latest = slots[first], times[LATE, first]
    for j in range(count):
        other = slots[j]
        if j == first:
            if np.isinf(latest):
                return first, False
        elif features[LATE, j] == INSIDE and (skip_inside or features[LATE, first] == INSIDE):
            # Tied at zero; but an obstacle may stand at two places, see slicing.py.
            if not skip_inside and node_handles[other] == node_handles[slot]:
                return first, False
        elif times[EARLY, j] <= latest and (
            is_plain_box(world.geometry, world.footprints, slot)
            or is_plain_box(world.geometry, world.footprints, other)
            or node_handles[other] == node_handles[slot]
        ):
            return first, False
    return first, True


@inlined
def fill_segment(start, end, to_goal, length, direction):
    """Fill in a direction (3,), given by its goal, or by a direction and its length; return
    whether it and its start are finite.
    """
    finite = True
    for axis in range(3):
        direction[axis] = end[axis] - start[axis] if to_goal else end[axis] * length
        finite &= np.isfinite(direction[axis]) and np.isfinite(start[axis])
    return finite


@inlined
def write_row(world, scratch, node_handles, radius, hit, length, row, hits):
    """Write the first hit of a row, t times `length`, to `batch.RowHits`."""
    is_hit = hit.slot != NONE
    if hits.slots.shape[0] > 0:
        hits.slots[row] = hit.slot
    hits.handles[row], hits.t[row] = NO_NODE, np.inf
    for axis in range(3):
        hits.points[row, axis], hits.normals[row, axis] = 0.0 if is_hit else np.nan, 0.0
    triangle = triangle_of(hits.triangles, row)
    if not is_hit:
        clear_triangle(triangle)
    else:
        touch(world, scratch, radius, hit, hits.points[row], hits.normals[row], triangle)
        hits.handles[row], hits.t[row] = node_handles[hit.slot], hit.t * length


# ---- all hits of one ray


@lean_kernel
def every_hit(world, segment, query, hits):
    """Write all hits of a thin ray, segment = (origin, direction), to `Hits`, in no order; return
    how many there are, which may be more than fit.
    """
    scratch = scratch_in(stack_array(SCRATCH, np.float64), segment[0].shape[0])
    set_ray(scratch.ray, *segment)
    return walk_tree(Caster(world, query, scratch), hits, np.int64(0), visit_every)


@lean_kernel
def touch_rows(world, segment, radius, hits, points, normals, triangles):
    """Fill in where hits of a thin ray, or ball, meet their obstacles, the normals there, and the
    triangles, of `room_for_triangles`.
    """
    scratch = scratch_in(stack_array(SCRATCH, np.float64), segment[0].shape[0])
    set_ray(scratch.ray, *segment)
    for j in range(hits.slots.shape[0]):
        hit = Hit(hits.slots[j], hits.ts[j], hits.features[j])
        triangle = triangle_of(triangles, j)
        touch(world, scratch, radius, hit, points[j], normals[j], triangle)


def cast_every(
    tree: OpenTree, columns: Columns, sweep: Sweep, most: int | None = None
) -> Iterable[BoxHit]:
    """All hits of a thin ray, nearest first, ties by handle; TooManyHitsError if there are more
    than `most`.
    """
    world, count, room = world_of(tree, columns), 16, 0
    segment = sweep.origin[: tree.ndim], sweep.direction[: tree.ndim]
    query = Query(0.0, 0.0, 1.0, sweep.mask, sweep.skip_inside, True, False)
    while count > room:
        room = count
        hits = Hits(np.empty(room, np.int64), np.empty(room), np.empty(room, np.int64))
        count = call(every_hit, world, segment, query, hits)
    require_few(count, most)
    order = np.lexsort((columns.node_handle[hits.slots[:count]], hits.ts[:count]))
    hits = Hits(*(column[order] for column in hits))
    return described(world, segment, 0.0, hits, sweep.origin)


def described(
    world: CastWorld, segment: tuple[Floats, Floats], radius: float, hits: Hits, origin: Floats
) -> Iterable[BoxHit]:
    """Hits of a thin ray, or ball, from an origin (3,), and where they are."""
    count = len(hits.slots)
    points, normals = np.zeros((count, 3)), np.zeros((count, 3))
    triangles = room_for_triangles((world.geometry, world.footprints), count)
    call(touch_rows, world, segment, radius, hits, points, normals, triangles)
    if world.footprints is not None:
        points[:, 2] = origin[2]
    columns = hits.slots.tolist(), hits.ts.tolist(), points, normals
    return zip(*columns, *(() if triangles is None else (triangles,)), strict=True)
