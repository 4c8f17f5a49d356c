# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One ray, or one swept ball, among true shapes: which leaves it may meet, and which hits count.

`walk` leads to the leaves, nearest first, through the wide snapshot of batches, or the nodes of
the tree. It hands every leaf to a visitor, which says how far the walk has to go on. That is
`visit`:

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
from ..results import NO_NODE
from ..shapes.footprint import ROUND
from ..shapes.shape import LARGE, SMALL, Floats
from .arguments import (
    SCRATCH,
    BoxHit,
    CastWorld,
    Hits,
    call,
    clear_triangle,
    room_for_triangles,
    scratch_in,
    triangle_of,
)
from .contact import contact, enter_shape
from .footprint import enter_footprint, touch_footprint
from .shapes import COORDINATES, FRAME_SLACK, RayAndBox, enter_rounded_boxes, point_along, time_of

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
    """Room for the obstacles that a ball may touch, or a thin ray meets."""

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
def enter_obstacle(world, slot, ray, doubt, radius, t_max, work):
    """(t, feature) at which a ray, radius 0, or a ball meets an obstacle; t inf if never. `doubt`
    as of `RayAndBox`.
    """
    lo, hi = leaf_box(world.nodes, world.tight, 2 * slot)
    pair = RayAndBox(ray, lo, hi, doubt)
    return enter_any(world.geometry, world.footprints, slot, pair, radius, t_max, work)


@inlined
def enter_any(geometry, footprints, slot, pair, radius, t_max, work):
    t, feature = np.inf, np.int64(INSIDE)
    if geometry is not None:
        t, feature = enter_shape(geometry[0][slot], geometry[1], pair, radius, t_max, work)
    if footprints is not None:
        t, feature = enter_footprint(footprints[0][slot], footprints[1], pair, radius, t_max, work)
    return t, feature


@inlined
def touch(world, scratch, doubt, radius, hit, point, normal, triangle):
    """Fill in where a ray or ball meets an obstacle, the outward normal there, and the triangle, a
    row of `room_for_triangles`, or None. `doubt` as of `RayAndBox`.
    """
    lo, hi = leaf_box(world.nodes, world.tight, 2 * hit.slot)
    pair, out = RayAndBox(scratch.ray, lo, hi, doubt), (point, normal)
    at, work = (hit.t, hit.feature), scratch.work
    touch_any(world.geometry, world.footprints, hit.slot, pair, at, radius, work, out, triangle)


@inlined
def touch_any(geometry, footprints, slot, pair, hit, radius, work, out, triangle):
    point, normal = out
    if geometry is not None:
        contact(geometry[0][slot], geometry[1], pair, hit, radius, work, point, normal, triangle)
    if footprints is not None:
        touch_footprint(footprints[0][slot], footprints[1], pair, hit, radius, work, point, normal)


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
            ts[i], features[i] = enter_obstacle(world, slot, ray, 0.0, radii[i], 1.0, work)


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


# ---- visitors: (what is found so far, the t up to which the walk goes on) after one more leaf


@inlined
def visit_first(caster, slot, first):
    """The first hits of a thin ray, as of `no_hits`."""
    (world, query, scratch), (box, other) = caster, first
    t, feature = enter_obstacle(world, slot, scratch.ray, 0.0, 0.0, query.t_max, scratch.work)
    if t < np.inf and not (query.skip_inside and feature == INSIDE):
        hit = Hit(slot, t, np.int64(feature))
        if is_plain_box(world.geometry, world.footprints, slot):
            box = hit if precedes(world, scratch.ray, hit, box) else box
        else:
            other = hit if precedes(world, scratch.ray, hit, other) else other
    return (box, other), min(box.t, other.t, query.t_max)


@lean_kernel
def visit_every(caster, room, slot, count):
    """How many hits of a thin ray there are; those that fit are in the rows AT of `room`, in no
    order.
    """
    world, query, scratch = caster
    t, feature = enter_obstacle(world, slot, scratch.ray, 0.0, 0.0, query.t_max, scratch.work)
    if t < np.inf and not (query.skip_inside and feature == INSIDE):
        hits = Hits(room.slots, room.times[AT], room.features[AT])
        write(Hit(slot, t, np.int64(feature)), hits, count)
        count += 1
    return count


@inlined
def write(hit, hits, place):
    """Write a hit if there is room."""
    if place < hits.slots.shape[0]:
        hits.slots[place], hits.ts[place], hits.features[place] = hit


class Found(NamedTuple):
    """What a ray or ball has met so far."""

    first: Any
    """Of a thin ray, as of `no_hits`."""
    count: Any
    """How many `Candidates` there are, which may be more than fit."""
    soonest: Any
    """When a larger ball touches the first of them."""
    latest: Any
    """By then the ball has surely touched one, or the ray ends."""
    path: Any
    """Of the ball."""


@inlined
def visit_candidate(caster, room, slot, found):
    """What a ball has met: `room` is filled in."""
    (world, query, scratch), (first, count, soonest, latest, path) = caster, found
    if path.pace < 0.0:  # many balls meet no leaf
        path = ball_path(world, scratch.ray, query.radius, path.unit)
    ts, features = stack_array(3, np.float64), stack_array(3, np.int64)
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
    return Found(first, count, soonest, latest, path)


@inlined
def visit(caster, room, slot, found):
    """The `Found` of any query; `room` are `Candidates`. A patched snapshot may hold an obstacle
    twice, which matters where they are counted.
    """
    query, (first, count, soonest, latest, path) = caster.query, found
    if query.radius == 0.0 and not query.every:
        first, t = visit_first(caster, slot, first)
        return Found(first, count, soonest, latest, path), t
    if query.patched:
        for j in range(min(count, room.slots.shape[0])):
            if room.slots[j] == slot:
                return found, latest
    if query.radius == 0.0:
        count = visit_every(caster, room, slot, count)
        return Found(first, count, soonest, latest, path), latest
    found = visit_candidate(caster, room, slot, found)
    return found, found.latest


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
def walk(caster, snapshot, segment, room, found, visit):
    """`walk_nodes` of a ray or ball at rest, segment = (origin, direction), or this through the
    snapshot, if there is one that the ray is suited to. It is one loop for both, since the
    compiler copies the visitor, and with it all shapes, to where it is called.
    """
    (world, query, scratch), (origin, direction) = caster, segment
    nodes, root, reach = world.nodes, world.root, reach_of(query, scratch.ray)
    records, place = stack_array(1, snapshot.record), stack_array(1, np.int32)
    entries, record = stack_array(STACK, np.int64), records[0]
    stack = Stack(stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64))
    scale, wide, limit, top = np.int64(0), False, np.inf, 0
    suited = snapshot.size > 0
    if suited:
        units, grown = (snapshot.center, snapshot.per_length), reach * snapshot.per_length
        suited = start_ray(record, origin, direction, *units, query.t_max)
        suited = suited and grown < FARTHEST_ORIGIN
        widen(record, grown)
    if not suited and root != NONE:
        grow(nodes[root], reach, scratch.box)
        scale, wide = prepare_ray(scratch.ray, scratch.box[0], scratch.box[1])
        limit = traversal_distance(query.t_max, scale)
    path = GrownPath(scratch.ray, scratch.box, query.mask, wide, reach)
    place[0], entries[0] = 0, 0
    if suited:
        top = push_loose(snapshot, entries, 1)
    else:
        top = push_root(nodes, root, path, limit, stack, enter_grown)
    while top > 0:
        if suited:
            slot, top = next_wide_leaf(snapshot, records, place, query.mask, entries, top)
            # What was written since is removed, or has another mask now.
            if snapshot.loose > 0 and slot != NONE and nodes[2 * slot].mask & query.mask == 0:
                continue
        else:
            leaf, top = next_leaf(nodes, path, limit, stack, top, enter_grown)
            slot = leaf >> 1  # NONE of NONE
        if slot == NONE:
            break
        found, t = visit(caster, room, np.int64(slot), found)
        if suited:
            record.limit = limit32(t, record.unit)
        else:
            limit = traversal_distance(t, scale)
    return found


# ---- the answers of one ray


@inlined
def hits_met(caster, snapshot, segment, room):
    """The `Found` of a query."""
    path = BallPath(stack_array(3, np.float64), -1.0, False)
    nothing = Found(no_hits(), np.int64(0), np.inf, caster.query.t_max, path)
    return walk(caster, snapshot, segment, room, nothing, visit)


@inlined
def first_of(caster, found):
    """The first `Hit` of a thin ray."""
    box, other = found.first
    return box if precedes(caster.world, caster.scratch.ray, box, other) else other


@lean_kernel
def drop_late(room, found):
    """Keep the candidates that a ball may touch before it surely touches one; return how many,
    which may be more than fit.
    """
    if found.count > room.slots.shape[0]:
        return found.count
    count = np.int64(0)
    for j in range(found.count):
        if room.times[EARLY, j] <= found.latest:
            room.slots[count] = room.slots[j]
            for i in range(3):
                room.times[i, count] = room.times[i, j]
                room.features[i, count] = room.features[i, j]
            count += 1
    return count


@inlined
def lengths_in_play(ray, radius, lo, hi):
    """The sum L of `exact_ball`, for boxes between two corners."""
    extent, length = radius, 0.0
    for axis in range(ray.shape[1]):
        above = abs(hi[axis] - ray[ORIGIN, axis])
        below = abs(lo[axis] - ray[ORIGIN, axis])
        extent += max(above, below)
        length += abs(ray[DIRECTION, axis])
    return extent + min(length, extent)


@lean_kernel
def slack_of(world, ray, radius):
    """By how much a larger ball is surely early, and a smaller one late."""
    if world.root == NONE:
        return 0.0
    here = world.nodes[world.root]
    total = lengths_in_play(ray, radius, here.lo, here.hi)
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
        touch(world, scratch, 0.0, radius, hit, hits.points[row], hits.normals[row], triangle)
        hits.handles[row], hits.t[row] = node_handles[hit.slot], hit.t * length


# ---- where hits are


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
        touch(world, scratch, 0.0, radius, hit, points[j], normals[j], triangle)


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
