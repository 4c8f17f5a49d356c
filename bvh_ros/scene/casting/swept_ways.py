# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first obstacles that many rays, or balls, meet among those that move: they go through what
is swept together, as `tree.motion.wide_casting`, and `legs` says how an obstacle is met.
"""

import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.int32x8 import AT_ONCE
from ...tree.jit.intrinsics import WIDTH, prefetch, stack_array
from ...tree.motion.meeting import course_of
from ...tree.motion.rounded import may_meet
from ...tree.motion.starting import start_seen
from ...tree.motion.wide_casting import (
    MOST_WAITING,
    PLACES,
    UNSUITED,
    WAITING,
    WAITING_SHARE,
    not_yet,
)
from ...tree.nodes import NONE, ROOT
from ...tree.rays.raycasting import CLOSEST, of_row
from ...tree.rays.slab import RAY_ROWS, set_swept_box
from ...tree.store.turns import REFUSED, begin_query, count_rays, end_query
from ...tree.wide.filtering import FARTHEST_ORIGIN, limit32
from ...tree.wide.ray_streams import FOUND
from ...tree.wide.raycasting import MIXED, traverse
from ...tree.wide.snapshot import LOOSE_NODES
from .arguments import SCRATCH, CastWorld, Hits, fill_ways, scratch_in
from .casting import Best, no_hit, write
from .first_moving import First, tell_first
from .legs import fetch, look_at
from .walks import Ways, reach_of
from .wide_sweeps import widen

WAYS_AT_ONCE = 1024  # go together at most
_MET = WAYS_AT_ONCE + AT_ONCE
LEAST_WAITING = 16  # more than in `wide_casting`: who is met is decided in many steps
AT_HAND = 64  # rows of a batch that there is room for


class SweptWays(NamedTuple):
    """What `traverse` asks of rays, and what else there is to know when an obstacle is met."""

    masks: Any
    mode: Any
    ways: Any
    world: Any
    sweep: Any
    asked: Any
    tools: Any


class Together(NamedTuple):
    """As `wide_casting.Waiting`, and what each way has met."""

    ray: Any
    records: Any
    lists: Any
    found: Any
    met: Any
    stack: Any
    pairs: Any
    boxes: Any
    """`Hits`, as the first of `legs.look_at`, WAYS_AT_ONCE of them."""
    others: Any
    stood: Any


class Kept(threading.local):
    """Memory of a thread, which kernels write before they read it."""

    def __init__(self) -> None:
        self.marks, self.ways = np.empty((2, AT_HAND), np.int64), np.empty((AT_HAND, 3))
        """Slots and features of hits, and ways, that a kernel alone is to read."""
        self.lists, self.depth = np.empty(0, np.int32), -1


kept = Kept()


def lists_for(depth: int) -> NDArray[np.int32]:
    """Room for lists of ways that go together, and the stack of them, through a snapshot of so
    many levels, see `ray_streams`.
    """
    if depth > kept.depth:
        size = 3 * (WIDTH * depth + LOOSE_NODES) + WAYS_AT_ONCE * (1 + WIDTH * depth) + AT_ONCE
        kept.lists, kept.depth = np.empty(size, np.int32), depth
    return kept.lists


@lean_kernel
def first_swept(shapes, tree, sweep, ways, asked, tools, told, when, goals):
    """`first_moving.first_rows` through a `tree.motion.sweeping.Sweep`: ways that are not for it
    become UNSUITED. Returns how many; 1 if one is not finite; REFUSED if the tree is not what was
    swept. shapes as of `Columns.shapes`, ways what a `Ways` holds, tools = (node_handles, what
    `lists_for` says), told = (slots and features, (2, n) or more, ts, handles, points, normals),
    when = (at, pace) of all if the ways tell no times. With `goals`, (n, 3) or more, what is
    called directions are the goals of the ways, which are written there.
    """
    origins, directions, t_max, masks, radii, at, pace, grown = ways
    node_handles, lists = tools
    marks, ts, handles, points, normals = told
    found = First(Hits(marks[0], ts, marks[1]), handles, points, normals)
    if goals.shape[0] > 0 and fill_ways(origins, directions, goals) >= 0:
        return np.int64(1)
    directions = goals if goals.shape[0] > 0 else directions
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = when
    if not begin_query(tree.state, sweep.moving.version):
        return np.int64(REFUSED)
    every = Ways(origins, directions, t_max, masks, radii, at, pace, grown)
    world = CastWorld(tree.nodes, tree.tight, tree.handles, tree.state[ROOT], *shapes)
    scratch = scratch_in(stack_array(SCRATCH, np.float64), origins.shape[1])
    rays = SweptWays(masks, CLOSEST, every, world, sweep, asked, (node_handles, scratch))
    count, unsuited = origins.shape[0], np.int64(0)
    for start in range(0, count, WAYS_AT_ONCE):
        some = start, min(count, start + WAYS_AT_ONCE)
        unsuited += _cast_group(tree, rays, some, lists, found)
    count_rays(tree.state, count, 0)
    end_query(tree.state)
    return unsuited


@inlined
def _cast_group(tree, rays, some, lists, told):
    """Answer the ways of some rows; return how many are not suited."""
    (start, stop), tally = some, stack_array(PLACES, np.int64)
    ways, snapshot = rays.ways, rays.sweep.snapshot
    nodes = WIDTH * snapshot.depth + LOOSE_NODES
    marks = stack_array((6, WAYS_AT_ONCE), np.int64)
    ts = stack_array((2, WAYS_AT_ONCE), np.float64)
    found, met = stack_array(WAYS_AT_ONCE, np.int32), stack_array(_MET, np.uint32)
    rows, listed = marks[5][: stop - start], lists[3 * nodes :]
    stack = lists[: 3 * nodes].reshape(nodes, 3)
    boxes, others = Hits(marks[0], ts[0], marks[1]), Hits(marks[2], ts[1], marks[3])
    records = stack_array(WAYS_AT_ONCE, snapshot.record)
    for place in range(rows.shape[0]):
        rows[place], marks[4][place] = start + place, 0
        write(no_hit(), boxes, place)
        write(no_hit(), others, place)
    alive = _start_group(ways, rays.sweep, rows, records, listed, told.hits.slots)
    most = min(max(LEAST_WAITING, alive // WAITING_SHARE), MOST_WAITING)
    pairs, ray = stack_array(MOST_WAITING, np.int64)[:most], stack_array((RAY_ROWS, 3), np.float64)
    group = Together(ray, records, listed, found, met, stack, pairs, boxes, others, marks[4])
    tally[FOUND] = tally[WAITING] = 0
    if alive > 0:
        traverse(snapshot, tree, (MIXED, rows, alive), rays, group, tally, let_wait, not_yet)
    look_at_waiting(tree, rays, rows, group, tally)
    for place in range(rows.shape[0]):
        if told.hits.slots[rows[place]] != UNSUITED:
            _tell(tree, rays, rows[place], ray, met_by(group, place), told)
    return rows.shape[0] - alive


@inlined
def _tell(tree, rays, i, ray, found, told):
    """Write what a way meets first."""
    moving, given = rays.sweep.moving, (rays.asked, rays.tools)
    thin = _course(ray, rays.ways, i, moving)
    tell_first(rays.world, tree, moving, rays.ways, i, *given, thin, found, told)


@inlined
def _start_group(ways, sweep, rows, records, listed, slots):
    """As `motion.starting.start_group`, for ways that may pass the boxes of whom they meet; who is
    not suited is UNSUITED in `slots`.
    """
    alive, snapshot = 0, sweep.snapshot
    for place in range(rows.shape[0]):
        row, record = rows[place], records[place]
        reach = reach_of(ways, row) * snapshot.per_length
        suited = start_seen(record, snapshot, sweep.leaves, ways, row) & (reach < FARTHEST_ORIGIN)
        slots[row] = NONE if suited else UNSUITED
        if suited:
            widen(record, reach)
            listed[alive] = place
            alive += 1
    return alive


@inlined
def _course(ray, ways, i, moving):
    """That of a way."""
    set_swept_box(ray, ways.origins[i], ways.origins[i], ways.directions[i])
    return course_of(ray, of_row(ways.at, i), of_row(ways.pace, i), moving)


@inlined
def met_by(group, place):
    """What the way at a place has met so far, as of `look_at`."""
    boxes, others = group.boxes, group.others
    box = Best(boxes.slots[place], boxes.ts[place], boxes.features[place])
    other = Best(others.slots[place], others.ts[place], others.features[place])
    return box, other, group.stood[place] != 0


@inlined
def let_wait(tree, rays, slot, listed, group, tally):
    """As `wide_casting.let_wait`."""
    rows, places = listed
    prefetch(rays.sweep.leaves.records, slot, 1)
    for place in places:
        mask = of_row(rays.masks, rows[place])
        if rays.sweep.snapshot.loose > 0 and tree.nodes[2 * slot].mask & mask == 0:
            continue  # it is gone, or has another mask now
        group.pairs[tally[WAITING]] = slot << 32 | place
        tally[WAITING] += 1
        if tally[WAITING] == group.pairs.shape[0]:
            look_at_waiting(tree, rays, rows, group, tally)
    return True


@lean_kernel
def look_at_waiting(tree, rays, rows, group, tally):
    """See of the pairs that wait whether the obstacle is the first that the way meets."""
    pairs, ways, leaves, moving = group.pairs, rays.ways, rays.sweep.leaves, rays.sweep.moving
    kept = 0
    for j in range(tally[WAITING]):
        pair = pairs[j]
        slot, place = pair >> 32, pair & 0xFFFFFFFF
        i, limit = rows[place], group.records[place].best_t
        since, pace = of_row(ways.at, i) - leaves.start, of_row(ways.pace, i)
        way, more = (ways.origins[i], ways.directions[i]), reach_of(ways, i)
        pairs[kept] = pair
        if may_meet(leaves.records, slot, *way, since, pace, limit, more):
            fetch(tree, moving, rays.world.geometry, rays.world.footprints, slot)
            kept += 1
    ray = stack_array((RAY_ROWS, 3), np.float64)
    for j in range(kept):
        slot, place = pairs[j] >> 32, pairs[j] & 0xFFFFFFFF
        i, found, record = rows[place], met_by(group, place), group.records[place]
        given = rays.asked, rays.tools, _course(ray, ways, i, moving), slot, found
        box, other, stood = look_at(rays.world, tree, moving, ways, i, *given)
        write(box, group.boxes, place)
        write(other, group.others, place)
        group.stood[place] = stood
        first = min(box.t, other.t)
        if first < record.best_t:
            record.best_t, record.limit = first, limit32(first, record.unit)
    tally[WAITING] = 0
