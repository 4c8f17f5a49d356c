# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first obstacle that a ray, or ball, meets among those that move: one walk through the tree,
nearest first. `moving` says what is met, and how; nobody may come to rest meanwhile.
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import prefetch, stack_array
from ...tree.jit.moving_sides import FRONTS
from ...tree.motion.bounds import OUTSIDE, begin_asking, covers, moments_of, set_fronts
from ...tree.motion.casting import descend, locate
from ...tree.motion.meeting import Course, box_of, is_before, meet
from ...tree.motion.wide_casting import UNSUITED, may_meet
from ...tree.moving import LARGEST
from ...tree.nodes import DEEPEST, NONE, ROOT
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import INSIDE, PAD, RAY_ROWS, TINY, set_ray, set_swept_box
from ...tree.store.turns import REFUSED, begin_query, count_rays, end_query
from ...tree.wide.filtering import FARTHEST_ORIGIN, limit32, octant_of, start_ray
from ...tree.wide.ray_stacks import STACK
from ..results import NO_NODE
from .arguments import CastWorld, Hits, fill_ways
from .casting import Best, enter_obstacle, no_hit, plain, touch
from .frame import COORDINATES, FRAME_SLACK
from .wide_sweeps import next_leaf, put_roots, widen


class Ways(NamedTuple):
    """n rays, or balls that go along them."""

    origins: Any
    directions: Any
    t_max: Any
    """One for all, or (n,), as all that follows."""
    masks: Any
    radii: Any
    at: Any
    """s; empty, as `pace`, if `first_swept` is told when."""
    pace: Any
    """How many seconds a unit of t takes."""
    grown: Any
    """What no obstacle has grown by more, m."""


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
    """Fill in a row for each way; asked = (skip inside, m/s by which obstacles that move grow).
    Returns 0; or OUTSIDE or REFUSED.
    """
    return _rows(world, tree, moving, None, ways, asked, (node_handles, scratch), told)


@lean_kernel
def first_swept(shapes, tree, sweep, ways, asked, tools, told, when, room):
    """`first_rows` through a `tree.motion.sweeping.Sweep`: ways that are not for it become
    UNSUITED. Returns how many; 1 if one is not finite. shapes as of `Columns.shapes`, ways what a
    `Ways` holds, tools = (node_handles, scratch), told = (slots and features, (2, n) or more, ts,
    handles, points, normals), when = (at, pace) of all if the ways tell no times. With `room`,
    (n, 3) or more, what is called directions are the goals of the ways, which are written there.
    """
    origins, directions, t_max, masks, radii, at, pace, grown = ways
    marks, ts, handles, points, normals = told
    found = First(Hits(marks[0], ts, marks[1]), handles, points, normals)
    if room.shape[0] > 0 and fill_ways(origins, directions, room) >= 0:
        return np.int64(1)
    directions = room if room.shape[0] > 0 else directions
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = when
    every = Ways(origins, directions, t_max, masks, radii, at, pace, grown)
    world = CastWorld(tree.nodes, tree.tight, tree.handles, tree.state[ROOT], *shapes)
    return _rows(world, tree, sweep.moving, sweep, every, asked, tools, found)


@lean_kernel
def _rows(world, tree, moving, sweep, ways, asked, tools, told):
    why, ndim, suited = np.int64(0), ways.origins.shape[1], True
    if sweep is None:
        why = begin_asking(tree, moving, moments_of(ways.pace, ways.origins.shape[0]))
    elif not begin_query(tree.state, moving.version):
        why = np.int64(REFUSED)
    if why != 0:
        return why
    ray, (node_handles, scratch) = stack_array((RAY_ROWS, 3), np.float64), tools
    for i in range(ways.origins.shape[0]):
        thin = Course(ray, of_row(ways.at, i), of_row(ways.pace, i), moving.nanoseconds)
        set_swept_box(ray, ways.origins[i], ways.origins[i], ways.directions[i])
        if sweep is None:
            if covers(moving, thin.at, thin.pace, of_row(ways.t_max, i)) == 0:
                why = np.int64(OUTSIDE)
                break
            box, other = walk(world, tree, moving, ways, i, asked, tools, thin)
        else:
            suited, box, other = walk_wide(world, tree, moving, sweep, ways, i, asked, tools, thin)
        by_box = other.slot == NONE or box.t < other.t
        if box.slot != NONE and box.t == other.t:
            by_box = node_handles[box.slot] < node_handles[other.slot]
        if not suited:
            told.hits.slots[i] = UNSUITED
            why += 1
        elif box.slot == NONE or not by_box:
            place = write_first(other, i, node_handles, told)
            if other.slot != NONE:
                _tell(world, tree, moving, ways, i, asked, (scratch, other), told, place)
        else:
            place = write_first(box, i, node_handles, told)
            there = box_of(tree, moving, box.slot)
            locate(there, thin, box.t, box.feature, place[0][:ndim], place[1][:ndim])
    if sweep is not None:
        count_rays(tree.state, ways.origins.shape[0], 0)
    end_query(tree.state)
    return why


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
def walk(world, tree, moving, ways, i, asked, tools, thin):
    """The first hits of a way, (box, other), each a `Best`: through the tree's nodes."""
    at, pace, t_max, mask = thin.at, thin.pace, of_row(ways.t_max, i), of_row(ways.masks, i)
    nodes, ndim, more = moving.nodes, ways.origins.shape[1], reach_of(ways, i)
    corners = stack_array((2, 3), np.float64)
    for axis in range(ndim):
        corners[0, axis] = ways.origins[i, axis] - more
        corners[1, axis] = ways.origins[i, axis] + more
    fronts = stack_array(FRONTS, np.float64)
    set_fronts(fronts, moving, corners[0], corners[1], ways.directions[i])
    box, other = no_hit(), no_hit()
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
        slot, found = np.int64(node >> 1), (box, other)
        box, other = look_at(world, tree, moving, ways, i, asked, tools, thin, slot, found)
        limit = min(limit, box.t, other.t)
    return box, other


@inlined
def walk_wide(world, tree, moving, sweep, ways, i, asked, tools, thin):
    """`walk` through what is swept: (whether the way is for it, box, other)."""
    snapshot, leaves, more = sweep.snapshot, sweep.leaves, reach_of(ways, i)
    origin, direction, t_max = ways.origins[i], ways.directions[i], of_row(ways.t_max, i)
    records, stack = stack_array(1, snapshot.record), stack_array(STACK, np.int64)
    record, limits = records[0], stack_array(1, np.float32)
    box, other, reach = no_hit(), no_hit(), more * snapshot.per_length
    suited = start_ray(record, origin, direction, snapshot.center, snapshot.per_length, t_max)
    if not (suited and reach < FARTHEST_ORIGIN):
        return False, box, other
    widen(record, reach)
    limits[0], octant = record.limit, octant_of(direction)
    limit, mask = t_max, of_row(ways.masks, i)
    top = put_roots(snapshot, stack)
    while top > 0:
        slot, top = next_leaf(snapshot, records, octant, mask, limits, stack, top)
        if slot == NONE or (snapshot.loose > 0 and tree.nodes[2 * slot].mask & mask == 0):
            continue
        fetch(tree, moving, world.geometry, world.footprints, slot)
        since = thin.at - leaves.start
        if not may_meet(*(leaves.records, slot, origin, direction, since, thin.pace, limit, more)):
            continue
        found = box, other
        box, other = look_at(world, tree, moving, ways, i, asked, tools, thin, slot, found)
        if min(box.t, other.t) < limit:
            limit = min(box.t, other.t)
            record.limit = limits[0] = limit32(limit, record.unit)
    return True, box, other


@inlined
def fetch(tree, moving, geometry, footprints, slot):
    """Ask for the memory of what `look_at` reads of most obstacles."""
    prefetch(moving.kept, slot, 1)
    prefetch(tree.handles, slot, 1)
    if geometry is not None:
        prefetch(geometry[0], slot, 2)
    if footprints is not None:
        prefetch(footprints[0], slot, 2)


@inlined
def look_at(world, tree, moving, ways, i, asked, tools, thin, slot, found):
    """The first hits of a way, found = (box, other), after one more obstacle is looked at."""
    (box, other), (node_handles, scratch), t_max = found, tools, of_row(ways.t_max, i)
    there = box_of(tree, moving, slot)
    grown = growth_of(there, asked[1], thin.at, thin.pace, t_max)
    radius = of_row(ways.radii, i) + grown
    if radius == 0.0 and plain(world.geometry, world.footprints, slot):
        hit, t, face = meet(there, thin, t_max)
        if hit and not (asked[0] and face == INSIDE):
            was = box.slot, box.t, box.feature
            if was[0] == NONE or is_before(tree, moving, thin, (slot, t, face), was):
                box = Best(slot, t, face)
    else:
        see(ways, i, there, scratch.ray)
        t, feature = enter_obstacle(world, slot, scratch.ray, radius, t_max, scratch.work)
        if t < np.inf and not (asked[0] and feature == INSIDE):
            nearer = t < other.t
            if t == other.t:
                nearer = node_handles[slot] < node_handles[other.slot]
            if nearer:
                other = Best(slot, t, np.int64(feature))
    return box, other


@inlined
def growth_of(box, rate, at, pace, t_max):
    """By how much an obstacle has grown at most on the way, as `places.growths`."""
    _, _, velocity, reference = box
    moves, end = False, (at + pace * t_max if pace > 0.0 else at)
    for axis in range(velocity.shape[0]):
        moves |= velocity[axis] != 0.0
    if rate == 0.0 or not moves:
        return 0.0
    return min(rate * max(abs(at - reference), abs(end - reference)), LARGEST)


@inlined
def see(ways, i, box, ray):
    """Write the ray as an obstacle sees it that moves."""
    _, _, velocity, reference = box
    seen = stack_array((2, 3), np.float64)
    ndim, since = ways.origins.shape[1], of_row(ways.at, i) - reference
    for axis in range(ndim):
        seen[0, axis] = ways.origins[i, axis] - velocity[axis] * since
        seen[1, axis] = ways.directions[i, axis] - velocity[axis] * of_row(ways.pace, i)
    set_ray(ray, seen[0, :ndim], seen[1, :ndim])


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
    (scratch, best), (point, normal), hits = found, place, told.hits
    at, pace = of_row(ways.at, i), of_row(ways.pace, i)
    box = box_of(tree, moving, best.slot)
    grown = growth_of(box, asked[1], at, pace, of_row(ways.t_max, i))
    see(ways, i, box, scratch.ray)
    touch(world, scratch, of_row(ways.radii, i) + grown, hits, i, point, normal)
    then = at - box[3] + best.t * pace
    for axis in range(box[2].shape[0]):
        point[axis] += box[2][axis] * then
    for axis in range(3):
        point[axis] += normal[axis] * grown
    if grown > 0.0 and best.t == 0.0:
        leave_surface(ways.origins[i], point, normal)


@lean_kernel
def leave_surface(centre, point, normal):
    """As `seen.grow`: who begins within what has grown meets it there, without a normal."""
    out = 0.0
    for axis in range(centre.shape[0]):
        out += (centre[axis] - point[axis]) * normal[axis]
    if out <= 0.0:
        for axis in range(centre.shape[0]):
            point[axis], normal[axis] = centre[axis], 0.0
