# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays and balls at a time, or while it passes.

Where it pays, rays go through a snapshot that is swept for their span of time
(`tree.motion.sweep`): in streams. Rays that the sweep does not serve go through the nodes of
the tree, one by one (`motion.cast_rows_at`). There are two kernels for the streams: `stream_rays`
decides as `motion.meet_obstacle`; thin rays among axis-aligned boxes are the tree's own
(`stream_boxes`), and are described here.
"""

import functools
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    AT_ONCE,
    CLOSEST,
    FARTHEST_ORIGIN,
    FOUND,
    INSIDE,
    LOOSE_NODES,
    MIXED,
    NONE,
    NOTHING,
    RAY_ROWS,
    REFUSED,
    UINT32,
    RayHits,
    accepted,
    begin_query,
    count_rays,
    defer_leaves,
    end_query,
    entry_points,
    fetch_nothing,
    in_threads,
    limit32,
    make_scratch,
    of_row,
    rows_of,
    scratch_for,
    set_ray,
    slot_of,
    traverse,
    visit_nothing,
    widen,
)
from ...tree.compiler import WIDTH, entry_point, inlined, lean_kernel, prefetch, stack_array
from ...tree.motion.access import (
    AHEAD,
    AS_ARRAYS,
    FEW,
    LONGEST,
    MOST_WAITING,
    NO_FEW,
    NO_RAYS,
    PLACES,
    UNSUITED,
    WAITING,
    WAITING_SHARE,
    Sweep,
    TimedRays,
    box_of,
    cast_few,
    cast_rows,
    course_of,
    face_met,
    fetch_box,
    locate,
    may_meet,
    no_sweep,
    split_times,
    start_in_drift_frame,
    times_of,
)
from ..results import NO_NODE, CastHits, cast_hits, joined_hits
from ..shapes.shape import along_axes
from ..store import EXACT, Obstacles, most_growth
from .arguments import (
    SCRATCH,
    THIN,
    Hits,
    Rays,
    code_for,
    fill_directions,
    refuse_infinite,
    scratch_in,
)
from .batch import RowHits
from .motion import (
    BOXES_ONLY,
    NO_ROOM,
    Cast,
    CasterAt,
    FirstHits,
    TimedBalls,
    cast_of,
    cast_rows_at,
    course_of_row,
    fetch,
    reach_of,
    room_for_rows,
    update_first_hit,
    write_first_hit,
)
from .query import Hit, no_hit, write

RAYS_AT_ONCE = 1024  # go together at most
_MET = RAYS_AT_ONCE + AT_ONCE
LEAST_WAITING = 16  # more than of the tree's own rays: hits are decided in many steps
_NO_IDS, _ROW, _ROWS = np.empty(0, np.int64), np.empty(0), np.empty((0, 3))


# ---- times


class Times(NamedTuple):
    """When rays start, s, how many seconds pass a unit of t, and the span that holds all rays."""

    at: Any
    """A number for all rays, as the pace; or both (1,) or (n,)."""
    pace: Any
    first: float
    last: float
    bounded: bool
    """Whether there can be bounds for all rays."""


@lean_kernel
def fill_times(at, until, t_max, epoch, within, starts, paces):
    """Write the times of rays, shape (n,) each, that go from `at` to `until`, (n,) or one for all,
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


# ---- streams of rays and balls past obstacles of any shape


class StreamRays(NamedTuple):
    """What `traverse` reads of rays, and what their hits need."""

    masks: Any
    mode: Any
    cast: Cast
    sweep: Any


class StreamScratch(NamedTuple):
    """What `traverse` works in, and what each ray has hit."""

    ray: Any
    records: Any
    lists: Any
    found: Any
    hit_lanes: Any
    stack: Any
    pairs: Any
    """Slot of a leaf, and in the lower half the place of the ray that may meet it: deferred."""
    boxes: Any
    """`Hits`, of each ray as of `FirstHits`."""
    others: Any
    stopped: Any


class Memory(threading.local):
    """Memory of a thread, which kernels write before they read it."""

    def __init__(self) -> None:
        self.lists, self.depth = np.empty(0, np.int32), -1


memory = Memory()


def lists_for(depth: int) -> NDArray[np.int32]:
    """Room for lists of rays that go together, and the stack of them, through a snapshot of so
    many levels.
    """
    if depth > memory.depth:
        size = 3 * (WIDTH * depth + LOOSE_NODES) + RAYS_AT_ONCE * (1 + WIDTH * depth) + AT_ONCE
        memory.lists, memory.depth = np.empty(size, np.int32), depth
    return memory.lists


@lean_kernel
def stream_rays(shapes, tree, sweep, rays, when, goals, node_handles, lists, hits):
    """`motion.cast_rows_at` through a `Sweep`; rays that it does not serve are UNSUITED. Returns
    how many; 1 if one is not finite; REFUSED if the tree is not what was swept. lists as of
    `lists_for`; when = (at, pace) of all if the rays have no times. With `goals`, (n, 3), the
    directions are the goals of the rays; the kernel writes the directions there.
    """
    directions, at, pace = rays.directions, rays.at, rays.pace
    if goals.shape[0] > 0:
        directions = goals
        if fill_directions(rays.origins, rays.directions, goals) >= 0:
            return np.int64(1)
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = when
    if not begin_query(tree.state, sweep.moving.version):
        return np.int64(REFUSED)
    every = TimedBalls(
        *(rays.origins, directions, rays.t_max, rays.masks, rays.radii, at, pace),
        *(rays.grown, rays.rate, rays.skip_inside),
    )
    count, unsuited = rays.origins.shape[0], np.int64(0)
    scratch = scratch_in(stack_array(SCRATCH, np.float64), rays.origins.shape[1])
    cast = cast_of(shapes, tree, sweep.moving, every, node_handles, scratch)
    stream = StreamRays(rays.masks, CLOSEST, cast, sweep)
    for start in range(0, count, RAYS_AT_ONCE):
        unsuited += _cast_group(stream, start, min(count, start + RAYS_AT_ONCE), lists, hits)
    count_rays(tree.state, count, 0)
    end_query(tree.state)
    return unsuited


@inlined
def _cast_group(stream, start, stop, lists, hits):
    """Answer the rays of some rows; return how many are not suited."""
    cast, snapshot, tally = stream.cast, stream.sweep.snapshot, stack_array(PLACES, np.int64)
    nodes = WIDTH * snapshot.depth + LOOSE_NODES
    marks = stack_array((6, RAYS_AT_ONCE), np.int64)
    ts = stack_array((2, RAYS_AT_ONCE), np.float64)
    found, hit_lanes = stack_array(RAYS_AT_ONCE, np.int32), stack_array(_MET, np.uint32)
    rows, listed = marks[5][: stop - start], lists[3 * nodes :]
    stack = lists[: 3 * nodes].reshape(nodes, 3)
    boxes, others = Hits(marks[0], ts[0], marks[1]), Hits(marks[2], ts[1], marks[3])
    records, alive = stack_array(RAYS_AT_ONCE, snapshot.record), 0
    for place in range(rows.shape[0]):
        row = start + place
        rows[place], marks[4][place] = row, 0
        write(no_hit(), boxes, place)
        write(no_hit(), others, place)
        reach, record = reach_of(cast.rays, row) * snapshot.per_length, records[place]
        suited = start_in_drift_frame(record, snapshot, stream.sweep.leaves, cast.rays, row)
        suited &= reach < FARTHEST_ORIGIN
        hits.slots[row] = NONE if suited else UNSUITED
        if suited:
            widen(record, reach)
            listed[alive] = place
            alive += 1
    most = min(max(LEAST_WAITING, alive // WAITING_SHARE), MOST_WAITING)
    pairs, ray = stack_array(MOST_WAITING, np.int64)[:most], stack_array((RAY_ROWS, 3), np.float64)
    group = StreamScratch(
        ray, records, listed, found, hit_lanes, stack, pairs, boxes, others, marks[4]
    )
    tally[FOUND] = tally[WAITING] = 0
    if alive > 0:
        which = MIXED, rows, alive
        traverse(
            snapshot,
            cast.tree,
            which,
            stream,
            group,
            tally,
            take_leaves,
            fetch_nothing,
            visit_nothing,
        )
    flush_deferred(cast.tree, stream, rows, group, tally)
    for place in range(rows.shape[0]):
        row = rows[place]
        if hits.slots[row] != UNSUITED:
            course = course_of_row(cast.rays, row, cast.moving, ray)
            write_first_hit(cast, row, course, first_hits_at(group, place), hits)
    return rows.shape[0] - alive


@inlined
def first_hits_at(group, place):
    """The `FirstHits` of the ray at a place."""
    boxes, others = group.boxes, group.others
    box = Hit(boxes.slots[place], boxes.ts[place], boxes.features[place])
    other = Hit(others.slots[place], others.ts[place], others.features[place])
    return FirstHits(box, other, group.stopped[place] != 0)


@inlined
def take_leaves(snapshot, tree, node, listed, stream, group, tally, hit_lanes):
    return defer_leaves(snapshot, tree, node, listed, stream, group, tally, hit_lanes, defer_leaf)


@inlined
def defer_leaf(tree, stream, slot, rows, place, group, tally):
    """Let a ray wait that may meet a leaf; prefetch its memory."""
    prefetch(stream.sweep.leaves.records, slot, 1)
    mask = of_row(stream.masks, rows[place])
    if stream.sweep.snapshot.loose > 0 and tree.nodes[2 * slot].mask & mask == 0:
        return  # it was removed, or has another mask now
    group.pairs[tally[WAITING]] = slot << 32 | np.int64(place)
    tally[WAITING] += 1
    if tally[WAITING] == group.pairs.shape[0]:
        flush_deferred(tree, stream, rows, group, tally)


@lean_kernel
def flush_deferred(tree, stream, rows, group, tally):
    """Decide the deferred pairs: whether the obstacle is the first that the ray meets."""
    cast, pairs, leaves, near = stream.cast, group.pairs, stream.sweep.leaves, 0
    rays, world = cast.rays, cast.world
    for j in range(tally[WAITING]):
        pair = pairs[j]
        slot, place = pair >> 32, pair & 0xFFFFFFFF
        i, limit = rows[place], group.records[place].best_t
        since, pace = of_row(rays.at, i) - leaves.start, of_row(rays.pace, i)
        segment, more = (rays.origins[i], rays.directions[i]), reach_of(rays, i)
        pairs[near] = pair
        if may_meet(leaves.records, slot, *segment, since, pace, limit, more):
            fetch(tree, cast.moving, world.geometry, world.footprints, slot)
            near += 1
    ray = stack_array((RAY_ROWS, 3), np.float64)
    for j in range(near):
        slot, place = pairs[j] >> 32, pairs[j] & 0xFFFFFFFF
        i, before, record = rows[place], first_hits_at(group, place), group.records[place]
        course = course_of_row(rays, i, cast.moving, ray)
        first, t = update_first_hit(CasterAt(cast, i, course), 0, slot, before)
        write(first.box, group.boxes, place)
        write(first.other, group.others, place)
        group.stopped[place] = first.stopped
        if t < record.best_t:
            record.best_t, record.limit = t, limit32(t, record.unit)
    tally[WAITING] = 0


# ---- streams of thin rays past axis-aligned boxes: the tree's own


@lean_kernel
def stream_boxes(tree, sweep, rays, to_goals, node_handles, scratch, hits):
    """First hits of `TimedRays` in one call, as `RowHits` with the ids of the tree for slots,
    whose normals have as many axes as the tree. Returns how many rays are UNSUITED; 1 where a ray
    is not finite, or REFUSED. `to_goals`: the directions are the goals of the rays.
    """
    directions, ids = rays.directions, hits.slots
    if to_goals:
        directions = hits.points
        if fill_directions(rays.origins, rays.directions, directions) >= 0:
            return np.int64(1)
    some = TimedRays(
        *(rays.origins, directions, rays.t_max, rays.masks, rays.skip_inside, rays.mode),
        *(rays.at, rays.pace, rays.when),
    )
    done = cast_rows(tree, sweep, some, scratch, RayHits(ids, hits.t, hits.normals))
    if done >= 0:
        describe(tree, sweep.moving, some, node_handles, ids, hits)
    return done


@lean_kernel
def stream_few_boxes(tree, sweep, rays, skip_inside, when, to_goals, node_handles, hits):
    """As `stream_boxes`, of fewer rays than FEW, rays = (origins, directions, t_max, masks), that
    share their times, when = (at, pace): one by one.
    """
    (origins, directions, t_max, masks), ids = rays, stack_array(FEW, np.int64)
    if to_goals:
        directions = hits.points
        if fill_directions(origins, rays[1], directions) >= 0:
            return np.int64(1)
    ids, some = ids[: origins.shape[0]], (origins, directions, t_max, masks)
    found = RayHits(ids, hits.t, hits.normals)
    done = cast_few(tree, sweep, some, skip_inside, CLOSEST, when, found)
    if done == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = when
        query = TimedRays(*some, skip_inside, CLOSEST, at, pace, when)
        describe(tree, sweep.moving, query, node_handles, ids, hits)
    return done


@inlined
def describe(tree, moving, rays, node_handles, ids, hits):
    """Fill in the node handles and points of hits; directions and points may be the same
    memory.
    """
    ray, ndim = stack_array((RAY_ROWS, 3), np.float64), hits.normals.shape[1]
    at, pace = rays.at, rays.pace
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = rays.when
    count = rays.origins.shape[0]
    for i in range(count):
        if i + AHEAD < count and ids[i + AHEAD] >= 0:
            fetch_box(tree, moving, slot_of(ids[i + AHEAD]))
        point, face = hits.points[i], INSIDE
        if ids[i] < 0:
            hits.handles[i] = NO_NODE
            for k in range(3):
                point[k] = np.nan
            continue
        for k in range(ndim):
            if hits.normals[i, k] != 0.0:
                face = 2 * k + (hits.normals[i, k] > 0.0)
        slot = slot_of(ids[i])
        hits.handles[i] = node_handles[slot]
        set_ray(ray, rays.origins[i], rays.directions[i])
        course = course_of(ray, of_row(at, i), of_row(pace, i), moving)
        box = box_of(tree, moving, slot)
        face = face_met(box, course, of_row(rays.t_max, i), hits.t[i], np.int64(face))
        locate(box, course, hits.t[i], face, point, hits.normals[i])


# ---- a batch


def first_hits(store: Obstacles, rays: Rays, times: Times, threads: int) -> CastHits:
    """First hits of n rays, or balls."""
    tree: Any = store.tree
    count, motion, view = len(rays.origins), tree.motion, tree.view()
    boxes = rays.radii is THIN and not (store.columns.shaped or store.uncertainty)
    alike = type(times.at) is float
    if threads == 1 and boxes and alike and not store.planar:
        sweep = motion.few_sweep(count)
        if sweep is not None:
            hits = _few_boxes(store, view.tree, sweep, rays, times)
            if hits is not None:
                return hits
    if store.planar or not (rays.radii is THIN or rays.to_goals):
        refuse_infinite(rays)  # of others a kernel looks
    if store.uncertainty and np.isinf(rays.t_max).any():
        row = np.flatnonzero(np.isinf(rays.t_max))[0]
        raise ValueError(f't_max must end the path where obstacles grow: row {row} has no end')
    sweep = None
    if times.bounded and count:
        sweep = motion.ready_sweep(view.tree, count, times.first, times.last)
        if sweep is None or sweep.moving.version != view.version:
            sweep = motion.swept_for(tree, view, count, (times.first, times.last))
    if threads == 1:
        return _some_hits(store, view, sweep, rays, times, boxes)
    work = functools.partial(_part_of_hits, store, view, sweep, rays, times, boxes)
    parts = in_threads(work, count, threads, 1 if sweep is None else 2 * RAYS_AT_ONCE)
    return parts[0] if len(parts) == 1 else joined_hits(parts)


def _part_of_hits(
    store: Obstacles,
    view: Any,
    sweep: Sweep | None,
    rays: Rays,
    times: Times,
    boxes: bool,
    start: int,
    stop: int,
) -> CastHits:
    """First hits of the rows [start, stop)."""
    part, when = (rows_of(rows, len(rays.origins), slice(start, stop)) for rows in (rays, times))
    return _some_hits(store, view, sweep, part, when, boxes)


def _few_boxes(
    store: Obstacles, arrays: Any, sweep: Sweep, rays: Rays, times: Times
) -> CastHits | None:
    """Hits of few thin rays in three dimensions; None where the sweep does not serve them."""
    count = len(rays.origins)
    parts = np.empty(count, UINT32), np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    # As CastHits(...), which would take one more call of a function of Python's.
    hits = tuple.__new__(CastHits, parts)
    given = rays.skip_inside, (times.at, times.pace), rays.to_goals, store.columns.node_handle
    done = _few_entry(3)(arrays, sweep, rays[:4], *given, hits)
    return hits if done == 0 else None


def _some_hits(
    store: Obstacles, view: Any, sweep: Sweep | None, rays: Rays, times: Times, boxes: bool
) -> CastHits:
    """First hits of some rows; `boxes`: of thin rays that the tree decides."""
    count, planar, given = len(rays.origins), store.planar, rays
    if planar:
        directions = rays.directions - rays.origins if rays.to_goals else rays.directions
        axes = along_axes(rays.origins, 2), along_axes(directions, 2)
        rays = rays._replace(origins=axes[0], directions=axes[1], to_goals=False)
    if sweep is None:
        refuse_infinite(given)
        hits = _by_nodes(store, rays, times, boxes)
    else:
        hits = room_for_rows(count, BOXES_ONLY if boxes else store.columns.shapes)
        stream = _stream_boxes if boxes else _stream_shapes
        if accepted(stream(store, view.tree, sweep, rays, times, hits)):
            refuse_infinite(given)
            rows = np.flatnonzero(hits.slots == UNSUITED)
            some, when = rows_of(rays, count, rows), rows_of(times, count, rows)
            others = _by_nodes(store, some, when, boxes)
            for column, part in zip(hits, others, strict=True):
                if column is not None:
                    column[rows] = part
    if planar:
        hit = hits.handles != NO_NODE
        hits.points[hit, 2] = given.origins[hit, 2]
    return cast_hits(hits[1:5], hits.triangles)


def _stream_boxes(
    store: Obstacles, arrays: Any, sweep: Sweep, rays: Rays, times: Times, hits: RowHits
) -> int:
    """Call `stream_boxes`."""
    count, ndim = rays.origins.shape
    parts = *rays[:4], rays.skip_inside, CLOSEST, *split_times((times.at, times.pace))
    query, room = tuple.__new__(TimedRays, parts), scratch_for(count, ndim, sweep.snapshot.depth)
    flat = hits if ndim == 3 else hits._replace(normals=np.empty((count, 2)))
    given = query, rays.to_goals, store.columns.node_handle, room, flat
    done: int = _boxes_entry(ndim)(arrays, sweep, *given)
    if ndim == 2:
        hits.normals[:, :2], hits.normals[:, 2] = flat.normals, 0.0
    return done


def _stream_shapes(
    store: Obstacles, arrays: Any, sweep: Sweep, rays: Rays, times: Times, hits: RowHits
) -> int:
    """Call `stream_rays`."""
    shapes, handles = store.columns.shapes, store.columns.node_handle
    at, pace, when = split_times((times.at, times.pace))
    goals = np.empty(rays.origins.shape) if rays.to_goals else _ROWS
    query = _timed(store, rays, at, pace, times)
    lists = lists_for(sweep.snapshot.depth)
    given = shapes, arrays, sweep, query, when, goals, handles, lists, hits
    done: int = code_for(stream_rays, shapes, given)(*given)
    return done


def _by_nodes(store: Obstacles, rays: Rays, times: Times, boxes: bool) -> RowHits:
    """First hits of rays through the nodes of the tree."""
    count, motion = len(rays.origins), store.tree.motion
    at, pace = np.atleast_1d(times.at), np.atleast_1d(times.pace)
    if rays.to_goals:
        rays = rays._replace(directions=rays.directions - rays.origins)
    shapes = BOXES_ONLY if boxes else store.columns.shapes
    hits = room_for_rows(count, shapes)
    handles = store.columns.node_handle
    query = _timed(store, rays, at, pace, times)

    def ask(arrays: Any, moving: Any) -> Any:
        given = shapes, arrays, moving, query, handles, NO_ROOM, hits
        return code_for(cast_rows_at, shapes, given, store.tree.ndim)(*given)

    spans = functools.partial(times_of, at, pace, rays.t_max)
    motion.ask(store.tree, spans, ask, not pace.any())  # type: ignore[union-attr]
    return hits


def _timed(store: Obstacles, rays: Rays, at: Any, pace: Any, times: Times) -> TimedBalls:
    """The rays as kernels read them; at and pace as `split_times` has them."""
    grown = NOTHING
    if store.uncertainty:
        begin, rate = np.atleast_1d(times.at), np.atleast_1d(times.pace)
        with np.errstate(over='ignore', invalid='ignore'):
            ends = np.where(rate > 0.0, begin + rate * rays.t_max, begin)
        grown = np.atleast_1d(most_growth(store, begin, ends))
    parts = *rays[:5], at, pace, grown, store.uncertainty, rays.skip_inside
    return tuple.__new__(TimedBalls, parts)


_few_entry = entry_points(
    *(stream_few_boxes, no_sweep, NO_FEW, False, AS_ARRAYS, False),
    *(_NO_IDS, CastHits(np.empty(0, np.uint32), _ROW, _ROWS, _ROWS)),
)
_boxes_entry = entry_points(
    *(stream_boxes, no_sweep, NO_RAYS, False, _NO_IDS, lambda ndim: make_scratch(0, ndim, 0)),
    RowHits(_NO_IDS, np.empty(0, np.uint32), _ROW, _ROWS, _ROWS, None),
)
