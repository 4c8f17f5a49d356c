# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first hits of many thin rays in a scene with meshes of many triangles.

A ray alone spends most of its time in the tree of a mesh on branches that the processor guesses
wrong, see `tree.batch.streams`. So rays go to the scene's obstacles one by one, but a ray that may
meet such a mesh waits. All that wait for one obstacle then go through its tree together. Each
triangle is decided as for one ray.
"""

import threading
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    CHANGES,
    DIRECTION,
    INSIDE,
    MIXED,
    NONE,
    NOT_FINITE,
    ORIGIN,
    RAY_ROWS,
    REFUSED,
    ROOT,
    begin_batch,
    crossed16,
    end_query,
    fetch_nothing,
    leaves_of,
    limit32,
    make_scratch,
    of_row,
    set_ray,
    start_ray,
    traverse,
    visit_nothing,
    without_lowest,
)
from ...tree.compiler import WIDTH, inlined, lean_kernel, prefetch, stack_array, trailing_zeros
from ..shapes.footprint import FACE
from ..shapes.hull import form_of, surface_of
from ..shapes.mesh import SHELL
from ..shapes.shape import MESH, ldexp
from ..shapes.surface import CLOSE, crosses_first, first_crossing, holds_point
from ..shapes.triangles32 import DEPTHS, LINE, fill_line
from .arguments import SCRATCH, CastWorld, Hits, scratch_in
from .mesh import come_near, into_frame, time_in
from .query import (
    Caster,
    Hit,
    Query,
    fill_segment,
    no_hits,
    precedes,
    visit_first,
    walk,
    write,
    write_row,
)

TOGETHER = 1024  # rays
MOST_WAITING = 4 * TOGETHER
EVERYBODY = np.full(1, 0xFFFFFFFF, np.uint32)


class Room(NamedTuple):
    """What a group of rays is worked on in; kernels alone read it."""

    pairs: Any
    """(MOST_WAITING,) slot of an obstacle, and in the lower half the place of a ray that waits."""
    boxes: Any
    """`Hits`, (TOGETHER,): the first axis-aligned box of each ray, as of `no_hits`."""
    others: Any
    """The same of other shapes."""
    lines: Any
    """(TOGETHER, 2, 3) origins and directions in the frame of the mesh that is looked at."""
    ends: Any
    """(TOGETHER, 3): the exponent of the direction's scale, where the line begins, and how far it
    goes from there, both in units of the direction."""
    axes: Any
    """(TOGETHER,), and (TOGETHER, LINE) `lines32`: see `triangles32.fill_line`."""
    lines32: Any
    deferred: Any
    """(MOST_WAITING,): a triangle, and in the lower half twice the place of a line that may cross
    it, and 1 where it surely does so after its origin."""
    depths: Any
    """(MOST_WAITING,): how far the line goes at least until then, in the snapshot's units."""
    stream: Any
    """`tree.batch.streams.Scratch`."""


def make_room(depth: int) -> Room:
    """For meshes whose snapshots have up to so many levels."""
    marks = np.empty((4, TOGETHER), np.int64)
    times = np.empty((2, TOGETHER))
    return Room(
        np.empty(MOST_WAITING, np.int64),
        Hits(marks[0], times[0], marks[1]),
        Hits(marks[2], times[1], marks[3]),
        np.empty((TOGETHER, 2, 3)),
        np.empty((TOGETHER, 3)),
        np.empty(TOGETHER, np.int64),
        np.empty((TOGETHER, LINE), np.float32),
        np.empty(MOST_WAITING, np.int64),
        np.empty(MOST_WAITING, np.float32),
        make_scratch(TOGETHER, 3, depth),
    )


class Memory(threading.local):
    """Room of a thread."""

    def __init__(self) -> None:
        self.depth, self.room = 0, make_room(0)


_memory = Memory()


def room_for(depth: int) -> Room:
    """`make_room`, or what the thread has."""
    if depth > _memory.depth:
        _memory.depth, _memory.room = depth, make_room(depth)
    return _memory.room


# ---- a ray among the obstacles


class Found(NamedTuple):
    """The state of a ray."""

    box: Any
    other: Any
    waiting: Any
    """How many pairs wait."""


@inlined
def visit_or_wait(caster, waiting, slot, found):
    """`visit_first`, but what may meet a mesh with a snapshot waits, if there is room."""
    world, (pairs, place) = caster.world, waiting
    shape = world.geometry[0][slot]
    if shape.kind == MESH and found.waiting < pairs.shape[0]:
        span = world.geometry[1].spans[shape.mesh]
        if span.wide[0] < span.wide[1]:
            pairs[found.waiting] = slot << 32 | place
            t = min(found.box.t, found.other.t, caster.query.t_max)
            return Found(found.box, found.other, found.waiting + 1), t
    (box, other), t = visit_first(caster, slot, (found.box, found.other))
    return Found(box, other, found.waiting), t


@inlined
def hit_at(hits, place):
    return Hit(hits.slots[place], hits.ts[place], hits.features[place])


@inlined
def sort(pairs, count):
    """Shell sort: mostly they are in order."""
    gap = count // 2
    while gap > 0:
        for i in range(gap, count):
            pair, j = pairs[i], i
            while j >= gap and pairs[j - gap] > pair:
                pairs[j] = pairs[j - gap]
                j -= gap
            pairs[j] = pair
        gap //= 2


# ---- many rays at one mesh


AHEAD = 8  # places from where memory is prefetched to where it is read
WAITING = 0  # in the tally of `take_triangles`: how many triangles lines wait for


class Lines(NamedTuple):
    """What `traverse` reads of rays, and what decides of them."""

    masks: Any
    room: Any
    zero: Any
    """A zero vector."""


@inlined
def take_triangles(wide, surface, node, listed, rays, stream, tally, hit_lanes):
    """For `traverse`: let the lines wait that may cross triangles of a wide node."""
    (_, places), leaves, room = listed, leaves_of(wide, node), rays.room
    depths = stack_array(DEPTHS, np.float32)
    others = np.uint32(hit_lanes & ~leaves)
    if others != hit_lanes:
        for i in range(places.shape[0]):
            k, lanes = places[i], np.uint32(stream.hit_lanes[i] & leaves)
            if lanes == np.uint32(0):
                continue
            lanes &= crossed16(wide.triangles, node, room.axes[k], room.lines32[k], depths)
            record = stream.records[k]
            while lanes != np.uint32(0):
                lane = np.int64(trailing_zeros(lanes))
                lanes = without_lowest(lanes)
                most, least = depths[lane], depths[WIDTH + lane]
                if least > record.limit:
                    continue
                record.limit = min(record.limit, most)
                face, is_sure = ~np.int64(wide.children[node * WIDTH + lane]), most < np.inf
                prefetch(surface.corners, 3 * face, 1)
                room.deferred[tally[WAITING]] = face << 32 | np.int64(k) << 1 | is_sure
                room.depths[tally[WAITING]] = least
                tally[WAITING] += 1
                if tally[WAITING] == room.deferred.shape[0]:
                    decide_deferred(surface, rays, tally)
            stream.hit_lanes[i] = np.uint32(stream.hit_lanes[i] & ~leaves)
    lanes = others
    while lanes != np.uint32(0):
        child = np.int64(wide.children[node * WIDTH + trailing_zeros(lanes)])
        lanes = without_lowest(lanes)
        prefetch(wide.triangles, child * (9 * WIDTH), 9)
    return others


@inlined
def unpack(pair):
    """The triangle, the line's place, and whether it is sure, of `Room.deferred`."""
    return pair >> 32, (pair & 0xFFFFFFFF) >> 1, pair & 1 != 0


@lean_kernel
def decide_deferred(surface, rays, tally):
    """See of the triangles that lines may cross which are the first ones."""
    room = rays.room
    for i in range(tally[WAITING]):
        ahead = room.deferred[min(i + AHEAD, tally[WAITING] - 1)] >> 32
        for number in range(3):
            prefetch(surface.vertices, 3 * np.int64(surface.corners[ahead, number]), 1)
        face, k, is_sure = unpack(room.deferred[i])
        best, line = room.stream.records[k], (room.lines[k, 0], room.lines[k, 1], rays.zero)
        if room.depths[i] > best.limit:
            continue
        before = (best.best_t if best.slot != NONE else np.inf), np.int64(best.slot)
        first, s = crosses_first(surface, line, face, is_sure, room.ends[k, 2], before)
        if first:
            best.slot, best.best_t = face, s
            best.limit = min(best.limit, limit32(s, best.unit))
    tally[WAITING] = 0


@inlined
def take(world, others, place, hit):
    """Keep a hit that is before the other shapes of a ray so far."""
    best = hit_at(others, place)
    before = hit.t < best.t
    if hit.t == best.t and best.slot != NONE:
        before = world.handles[hit.slot] < world.handles[best.slot]
    if before:
        write(hit, others, place)


@inlined
def set_row(rays, row, ray):
    """Write a row as a ray of `slab`."""
    for axis in range(3):
        start, end = rays.origins[row, axis], rays.directions[row, axis]
        ray[ORIGIN, axis] = start
        ray[DIRECTION, axis] = end - start if rays.to_goals else end


@inlined
def take_entry(world, rays, room, k, entry, t_max):
    """`take` where line k enters a triangle: (place, slot of the obstacle, s, row)."""
    place, slot, s, face = entry
    if room.ends[k, 1] + s == 0.0:  # exactly: the triangle holds the ray's origin
        if not rays.skip_inside:
            take(world, room.others, place, Hit(slot, 0.0, np.int64(INSIDE)))
    else:
        t = time_in(room.ends[k, 1] + s, int(room.ends[k, 0]), t_max)
        take(world, room.others, place, Hit(slot, t, FACE + face))


@lean_kernel
def cast_at_mesh(world, rays, start, begin, end, room):
    """Decide the waiting pairs [begin, end), all of one obstacle; place 0 is the row `start`."""
    slot, stream, alive = room.pairs[begin] >> 32, room.stream, 0
    shape, hulls = world.geometry[0][slot], world.geometry[1]
    surface, is_solid = surface_of(hulls, shape), form_of(hulls, shape) != SHELL
    wide, zero = surface.wide, stack_array(3, np.float64)
    given, ray = stack_array((RAY_ROWS, 3), np.float64), stack_array((RAY_ROWS, 3), np.float64)
    tally = stack_array(1, np.int64)
    zero[0] = zero[1] = zero[2] = 0.0
    for j in range(begin, end):
        place, k = room.pairs[j] & 0xFFFFFFFF, j - begin
        row = start + place
        set_row(rays, row, given)
        t_max = of_row(rays.t_max, row)
        exponent, is_still = into_frame(surface.radius, shape, given, ray)
        if is_solid and holds_point(surface, ray[ORIGIN]):
            if not rays.skip_inside:
                take(world, room.others, place, Hit(slot, 0.0, np.int64(INSIDE)))
            continue
        reach = ldexp(t_max, -exponent)
        if is_still:
            ray[DIRECTION, 0], reach = 1.0, 0.0
        first = come_near(surface.radius, ray)
        if not first <= reach:
            continue
        for axis in range(3):
            room.lines[k, 0, axis] = ray[ORIGIN, axis]
            room.lines[k, 1, axis] = ray[DIRECTION, axis]
        room.ends[k, 0], room.ends[k, 1], room.ends[k, 2] = exponent, first, reach - first
        before = min(room.boxes.ts[place], room.others.ts[place])
        near = ldexp(before, -exponent) * (1.0 + CLOSE) - first
        record, units = stream.records[k], (wide.center, wide.per_length)
        limit = min(near, (reach - first) * (1.0 + CLOSE))
        if start_ray(record, ray[ORIGIN], ray[DIRECTION], *units, limit):
            room.axes[k] = fill_line(wide, ray, room.lines32[k])
            stream.lists[alive] = k
            alive += 1
        else:
            s, face = first_crossing(surface, ray, reach - first)
            if face != NONE:
                take_entry(world, rays, room, k, (place, slot, s, face), t_max)
    tally[WAITING] = 0
    if alive == 0:
        return
    lines, group = Lines(EVERYBODY, room, zero), (MIXED, stream.rows, alive)
    traverse(
        wide, surface, group, lines, stream, tally, take_triangles, fetch_nothing, visit_nothing
    )
    decide_deferred(surface, lines, tally)
    for j in range(alive):
        k = stream.lists[j]
        place, best = room.pairs[begin + k] & 0xFFFFFFFF, stream.records[k]
        if best.slot != NONE:
            entry = place, slot, best.best_t, np.int64(best.slot)
            take_entry(world, rays, room, k, entry, of_row(rays.t_max, start + place))


@inlined
def fetch_hit(world, room, k):
    """Prefetch what is written of the first hit that is no box."""
    slot, feature = room.others.slots[k], room.others.features[k]
    if feature >= FACE:
        hulls = world.geometry[1]
        face = hulls.spans[world.geometry[0][slot].mesh].faces[0] + feature - FACE
        prefetch(hulls.normals, 3 * face, 1)
        prefetch(hulls.rows, face, 1)
        prefetch(hulls.corners, 3 * face, 1)


# ---- a batch


@lean_kernel
def decide_waiting(world, rays, start, count, room):
    """Decide so many waiting pairs, obstacle by obstacle."""
    sort(room.pairs, count)
    begin = 0
    while begin < count:
        slot, end = room.pairs[begin] >> 32, begin + 1
        while end < count and room.pairs[end] >> 32 == slot and end - begin < TOGETHER:
            end += 1
        cast_at_mesh(world, rays, start, begin, end, room)
        begin = end


@lean_kernel
def cast_together(view, snapshot, shapes, node_handles, rays, place, room, hits):
    """`batch.cast_rows` of thin rays."""
    tree, (row, stop) = view.tree, place
    scratch = scratch_in(stack_array(SCRATCH, np.float64), 3)
    direction = stack_array(3, np.float64)
    if not begin_batch(tree, view.version, snapshot):
        return REFUSED, np.int64(0), 0
    version = tree.state[CHANGES]
    world = CastWorld(tree.nodes, tree.tight, tree.handles, tree.state[ROOT], *shapes)
    while 0 <= row < stop:
        end, waiting = min(stop, row + TOGETHER), np.int64(0)
        for k in range(end - row):
            origin, goal = rays.origins[row + k], rays.directions[row + k]
            if not fill_segment(origin, goal, rays.to_goals, 1.0, direction):
                end = NOT_FINITE
                break
            set_ray(scratch.ray, origin, direction)
            t_max, mask = of_row(rays.t_max, row + k), of_row(rays.masks, row + k)
            query = Query(0.0, 0.0, t_max, mask, rays.skip_inside, False, snapshot.loose > 0)
            caster, pairs = Caster(world, query, scratch), (room.pairs, k)
            box, other = no_hits()
            nothing = Found(box, other, waiting)
            found = walk(caster, snapshot, (origin, direction), pairs, nothing, visit_or_wait)
            write(found.box, room.boxes, k)
            write(found.other, room.others, k)
            waiting = found.waiting
        if end >= 0:
            decide_waiting(world, rays, row, waiting, room)
            for k in range(end - row):
                set_row(rays, row + k, scratch.ray)
                fetch_hit(world, room, min(k + AHEAD, end - row - 1))
                box, other = hit_at(room.boxes, k), hit_at(room.others, k)
                hit = box if precedes(world, scratch.ray, box, other) else other
                write_row(world, scratch, node_handles, 0.0, hit, 1.0, row + k, hits)
        row = end
    end_query(tree.state)
    return row, np.int64(0), version
