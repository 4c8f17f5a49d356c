# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first obstacles that many rays, or balls, meet among those that move: they go through what
is swept together, as `tree.motion.sweep`, and `update_first_hit` says how one is met.


RayRows and swept balls at a time, or while it passes, among obstacles that have velocities.

Seen from an obstacle that moves on a straight line, a ray is another ray. So the tree says whose
boxes may be met, and each of these obstacles is asked by the ray that it sees. Among axis-aligned
boxes thin rays are decided by the tree alone, as real arithmetic does.

Who grows, see `store.places`, is met by a ball that is as much larger, as he has grown at the end
of its way: too early rather than too late.


Batches of thin rays among axis-aligned boxes that move: the tree decides, and the kernel that
asks it tells points, too.
"""

import functools
import threading
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    AT_ONCE,
    CLOSEST,
    EVERY,
    FARTHEST_ORIGIN,
    FOUND,
    INSIDE,
    INT64,
    LARGEST,
    LOOSE_NODES,
    MIXED,
    NONE,
    NOTHING,
    RAY_ROWS,
    REFUSED,
    ROOT,
    UINT32,
    RayHits,
    Tree,
    accepted,
    begin_query,
    count_rays,
    end_query,
    entry_points,
    limit32,
    make_scratch,
    of_row,
    rows_of,
    scratch_for,
    set_ray,
    set_swept_box,
    slot_of,
    traverse,
)
from ...tree.compiler import WIDTH, inlined, lean_kernel, prefetch, stack_array
from ...tree.motion.access import (
    AHEAD,
    AS_ARRAYS,
    FEW,
    MOST_WAITING,
    NO_FEW,
    NO_RAYS,
    PLACES,
    UNSUITED,
    WAITING,
    WAITING_SHARE,
    Casts,
    RaysThen,
    Sweep,
    box_of,
    cast_few,
    cast_rows,
    course_of,
    face_met,
    fetch_box,
    locate,
    may_meet,
    no_sweep,
    not_yet,
    start_seen,
    times_of,
    told_once,
)
from ..geometry.shapes import Floats, along_axes
from ..results import NO_NODE, CastHits
from ..store.obstacles import Obstacles
from ..store.places import growths, most_growth
from .arguments import (
    SCRATCH,
    CastWorld,
    Hits,
    RayRows,
    call,
    code_for,
    fill_ways,
    new_scratch,
    scratch_in,
    world_of,
)
from .boxes import RAYS_ON_STACK
from .motion import (
    First,
    HitTable,
    Times,
    Ways,
    ball_reach,
    each_then,
    fetch,
    first_rows,
    reach_of,
    update_first_hit,
    write_first_hit,
)
from .query import Hit, no_hit, widen, write

# ---- through what is swept


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


class StreamScratch(NamedTuple):
    """As `wide_casting.Waiting`, and what each way has met."""

    ray: Any
    records: Any
    lists: Any
    found: Any
    met: Any
    stack: Any
    pairs: Any
    boxes: Any
    """`Hits`, as the first of `motion.update_first_hit`, WAYS_AT_ONCE of them."""
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
    """`motion.first_rows` through a `tree.motion.sweep.Sweep`: ways that are not for it
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
    group = StreamScratch(ray, records, listed, found, met, stack, pairs, boxes, others, marks[4])
    tally[FOUND] = tally[WAITING] = 0
    if alive > 0:
        traverse(snapshot, tree, (MIXED, rows, alive), rays, group, tally, defer_leaf, not_yet)
    flush_deferred(tree, rays, rows, group, tally)
    for place in range(rows.shape[0]):
        if told.hits.slots[rows[place]] != UNSUITED:
            _tell(tree, rays, rows[place], ray, met_by(group, place), told)
    return rows.shape[0] - alive


@inlined
def _tell(tree, rays, i, ray, found, told):
    """Write what a way meets first."""
    moving, given = rays.sweep.moving, (rays.asked, rays.tools)
    thin = _course(ray, rays.ways, i, moving)
    write_first_hit(rays.world, tree, moving, rays.ways, i, *given, thin, found, told)


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
    """What the way at a place has met so far, as of `update_first_hit`."""
    boxes, others = group.boxes, group.others
    box = Hit(boxes.slots[place], boxes.ts[place], boxes.features[place])
    other = Hit(others.slots[place], others.ts[place], others.features[place])
    return box, other, group.stood[place] != 0


@inlined
def defer_leaf(tree, rays, slot, listed, group, tally):
    """As `wide_casting.defer_leaf`."""
    rows, places = listed
    prefetch(rays.sweep.leaves.records, slot, 1)
    for place in places:
        mask = of_row(rays.masks, rows[place])
        if rays.sweep.snapshot.loose > 0 and tree.nodes[2 * slot].mask & mask == 0:
            continue  # it is gone, or has another mask now
        group.pairs[tally[WAITING]] = slot << 32 | place
        tally[WAITING] += 1
        if tally[WAITING] == group.pairs.shape[0]:
            flush_deferred(tree, rays, rows, group, tally)
    return True


@lean_kernel
def flush_deferred(tree, rays, rows, group, tally):
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
        box, other, stood = update_first_hit(rays.world, tree, moving, ways, i, *given)
        write(box, group.boxes, place)
        write(other, group.others, place)
        group.stood[place] = stood
        first = min(box.t, other.t)
        if first < record.best_t:
            record.best_t, record.limit = first, limit32(first, record.unit)
    tally[WAITING] = 0


# ---- rays and balls at a time


_NO_ROOM = np.empty((0, 3))
PAIRS = 1 << 17  # that are looked at in one go


def cast_then(held: Obstacles, rays: RayRows, radii: Floats, skip: bool, times: Times) -> HitTable:
    """All that rays, or balls, meet; `rays` as Scene.raycast_many has them."""
    ndim, count = held.tree.ndim, len(rays.origins)
    require_ends(held, rays)
    flat = rays._replace(
        origins=along_axes(rays.origins, ndim), directions=along_axes(rays.directions, ndim)
    )
    thin = radii == 0.0
    parts = [_plain(held, flat, np.flatnonzero(thin), skip, times)]
    if held.columns.shaped or held.uncertainty or not thin.all():
        parts.append(_shaped(held, flat, radii, skip, times))
    columns: Any = zip(*parts, strict=True)
    met = HitTable(*(np.concatenate(column) for column in columns))
    if ndim == 2:
        met.points[:, 2] = rays.origins[met.rows, 2]
    handles = held.columns.node_handle[met.slots]
    order = np.lexsort((handles, met.ts, met.rows))
    first = len(parts[0].rows)
    _keep_exact_order(order, first)
    return met.take(order) if count else met


def first_then(
    held: Obstacles, sweep: Sweep | None, rays: RayRows, radii: Floats, skip: bool, times: Times
) -> First:
    """First hits of rays, or balls, their columns one for all or (n,); as of `cast_then`. `sweep`:
    what `sweep_for` says, of these and more rays.
    """
    tree, columns, count = held.tree, held.columns, len(rays.origins)
    ndim, grown = tree.ndim, NOTHING
    if held.uncertainty:
        require_ends(held, rays)
        grown = np.atleast_1d(most_growth(held, times.at, times.ends(rays.t_max)))
    flat = along_axes(rays.origins, ndim), along_axes(rays.directions, ndim)
    ways = *flat, rays.t_max, rays.masks, radii, *times, grown
    marks, places = np.empty((2, count), INT64), (np.empty((count, 3)), np.empty((count, 3)))
    hits = Hits(marks[0], np.empty(count), marks[1])
    told = First(hits, np.empty(count, UINT32), *places)
    asked, handles = (skip, held.uncertainty), columns.node_handle
    motion = _motion_of(held)
    if sweep is None:
        world, given = (
            world_of(tree, columns),
            (Ways(*ways), asked, handles, new_scratch(ndim), told),
        )
        spans = partial(times_of, times.at, times.pace, rays.t_max)
        moments = not times.pace.any()

        def ask(*arrays: Any) -> Any:
            return call(first_rows, world, *arrays, *given)

        motion.ask(tree, spans, ask, moments)
    else:
        view, shapes = tree.view(), columns.shapes
        now = sweep._replace(moving=motion.known(view, 0.0, 0.0))
        found = marks, hits.ts, told.handles, *places
        tools = handles, lists_for(sweep.snapshot.depth)
        every = shapes, view.tree, now, ways, asked, tools, found, AS_ARRAYS, _NO_ROOM
        if accepted(code_for(first_swept, shapes, every)(*every)):
            _tell_others(held, (rays, radii, skip, times), told)
    if tree.ndim == 2:
        met = told.handles != NO_NODE
        told.points[met, 2] = rays.origins[met, 2]
    return told


def few_then(
    held: Obstacles,
    sweep: Sweep,
    rays: tuple[Any, ...],
    radii: Floats,
    skip: bool,
    when: tuple[Any, Any],
    to_goals: bool,
) -> CastHits | None:
    """`first_then` in a solid scene through what is swept already, with as little Python as can
    be; else as `few_first`.
    """
    tree: Any = held.tree
    count, columns = len(rays[0]), held.columns
    at, pace, when = told_once(when)
    ways = *rays, radii, at, pace, NOTHING
    marks, room = kept.marks, kept.ways if to_goals else _NO_ROOM
    if count > AT_HAND:
        marks, room = np.empty((2, count), INT64), np.empty((count if to_goals else 0, 3))
    ts, points, normals = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    handles = np.empty(count, UINT32)
    told = marks, ts, handles, points, normals
    tools = columns.node_handle, lists_for(sweep.snapshot.depth)
    asked, shapes = (skip, held.uncertainty), columns.shapes
    every = shapes, tree._storage.tree, sweep, ways, asked, tools, told, when, room
    if code_for(first_swept, shapes, every)(*every) != 0:
        return None
    return tuple.__new__(CastHits, (handles, ts, points, normals))


def sweep_for(held: Obstacles, rays: RayRows, times: Times) -> Sweep | None:
    """What is swept for the rays of a batch, if that pays."""
    span, every = times_of(*times, rays.t_max)
    if not every or not len(rays.origins):
        return None
    tree = held.tree
    found: Sweep | None = _motion_of(held).swept_for(tree, tree.view(), len(rays.origins), span)
    return found


def _tell_others(held: Obstacles, asked: tuple[Any, ...], told: First) -> None:
    """Fill in the rows of ways that are not for a sweep; asked = what `first_then` is told."""
    (rays, radii, skip, times), count = asked, len(told.handles)
    others = np.flatnonzero(told.hits.slots == UNSUITED)
    some, when = rows_of(rays, count, others), rows_of(times, count, others)
    balls = radii[others] if len(radii) == count else radii
    found = first_then(held, None, some, balls, skip, when)
    for column, part in zip((*told.hits, *told[1:]), (*found.hits, *found[1:]), strict=True):
        column[others] = part


def require_ends(held: Obstacles, rays: RayRows) -> None:
    """ValueError if a ray has no end, where obstacles grow."""
    if held.uncertainty and np.isinf(rays.t_max).any():
        row = np.flatnonzero(np.isinf(rays.t_max))[0]
        raise ValueError(f't_max must end the way where obstacles grow: row {row} has none')


def reaches(held: Obstacles, rays: RayRows, radii: Floats, times: Times) -> Floats:
    """By how much rays may pass boxes of obstacles that their balls touch, (n,)."""
    axes = np.abs(rays.origins[:, : held.tree.ndim]).T
    largest = functools.reduce(np.maximum, axes)  # `max` of short rows takes ten times as long
    growth = most_growth(held, times.at, times.ends(rays.t_max))
    return np.asarray(ball_reach(radii, largest) + growth)


def _motion_of(held: Obstacles) -> Any:
    return held.tree.motion


def _keep_exact_order(order: NDArray[np.int64], first: int) -> None:
    """The first so many hits are in exact order, which their t, as doubles, may not tell: they
    keep it in the places that are theirs.
    """
    order[order < first] = np.arange(first)


def _plain(
    held: Obstacles, rays: RayRows, rows: NDArray[np.int64], skip: bool, times: Times
) -> HitTable:
    """Thin rays of these rows against axis-aligned boxes, decided exactly."""
    some = RayRows(*(np.ascontiguousarray(column[rows]) for column in rays))
    asked = some.t_max, some.masks, times.at[rows], times.pace[rows], skip, EVERY
    casts = Casts(some.origins, some.origins, some.directions, *asked)
    offsets, handles, found, places = _motion_of(held).every(held.tree, casts)
    slots = held.tree.slots(handles)
    of = np.repeat(rows, np.diff(offsets))
    ends = times.ends(rays.t_max)
    grown = growths(held, slots, times.at[of], ends[of])
    plain = np.flatnonzero(~held.columns.geometry['shaped'][slots] & (grown == 0.0))
    points, normals = (np.zeros((len(slots), 3)) for _ in range(2))
    points[:, : held.tree.ndim], normals[:, : held.tree.ndim] = places
    return HitTable(of, slots, found.ts, points, normals).take(plain)


def _casts(held: Obstacles, rays: RayRows, radii: Floats, times: Times) -> Casts:
    """What rays may meet: every box that balls touch with what has grown in it."""
    more = reaches(held, rays, radii, times)[:, None]
    with np.errstate(over='ignore'):  # as far as there are doubles
        low, high = rays.origins - more, rays.origins + more
    ways = np.maximum(low, -LARGEST), np.minimum(high, LARGEST), rays.directions, rays.t_max
    return Casts(*ways, rays.masks, *times, False, EVERY)


def _shaped(held: Obstacles, rays: RayRows, radii: Floats, skip: bool, times: Times) -> HitTable:
    """Balls against all obstacles, thin rays against those that are no axis-aligned boxes."""
    ends, casts = times.ends(rays.t_max), _casts(held, rays, radii, times)
    offsets, handles, _, _ = _motion_of(held).every(held.tree, casts)
    slots, rows = held.tree.slots(handles), np.repeat(np.arange(len(radii)), np.diff(offsets))
    grown = growths(held, slots, times.at[rows], ends[rows])
    wanted = held.columns.geometry['shaped'][slots] | (radii[rows] + grown > 0.0)
    slots, rows, parts = slots[wanted], rows[wanted], []
    for begin in range(0, max(len(rows), 1), PAIRS):
        some = slice(begin, begin + PAIRS)
        parts.append(_of_pairs(held, rays, radii, skip, times, rows[some], slots[some]))
    columns: Any = zip(*parts, strict=True)
    return HitTable(*(np.concatenate(column) for column in columns))


def _of_pairs(
    held: Obstacles,
    rays: RayRows,
    radii: Floats,
    skip: bool,
    times: Times,
    rows: NDArray[np.int64],
    slots: NDArray[np.int64],
) -> HitTable:
    """RayRows, or balls, of some rows, each against one obstacle."""
    count, columns, tree = len(rows), held.columns, held.tree
    some = RayRows(*(column[rows] for column in rays))
    ways = Ways(*some, radii[rows], times.at[rows], times.pace[rows], np.zeros(1))
    hits = Hits(np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64))
    told = First(hits, np.empty(count, UINT32), np.empty((count, 3)), np.empty((count, 3)))
    tools, view = (columns.node_handle, new_scratch(tree.ndim)), tree.view()
    known = _motion_of(held).known(view, 0.0, 0.0)
    given = view.tree, known, ways, slots, (skip, held.uncertainty), tools, told
    call(each_then, world_of(tree, columns), *given)
    met = np.flatnonzero(hits.slots != NONE)
    return HitTable(rows, slots, hits.ts, told.points, told.normals).take(met)


# ---- thin rays among axis-aligned boxes


_NO_IDS = np.empty(0, np.int64)
# What is called directions: those of rays, the goals of the ways, or those of rays whose hits are
# there already, to be described.
ALONG, TO_GOALS, HITS_GIVEN = range(3)


class Told(NamedTuple):
    """Room for what n rays meet: a `RayHits`, and what a scene tells besides."""

    ids: NDArray[np.int64]
    """Empty for RAYS_ON_STACK rays or fewer, if nobody but the kernel is to read them."""
    t: Floats
    normals: Floats
    """Shape (n, ndim)."""
    handles: NDArray[np.uint32]
    points: Floats
    """Shape (n, 3); what is beyond the tree's axes stays as it is where a ray hits."""


def first_boxes(
    held: Obstacles, rays: RayRows, skip: bool, times: Times, threads: int
) -> CastHits:
    """First hits of rays."""
    tree: Any = held.tree
    count, ndim, motion, view = len(rays.origins), tree.ndim, tree.motion, tree.view()
    flat = along_axes(rays.origins, ndim), along_axes(rays.directions, ndim)
    asked = RaysThen(*flat, rays.t_max, rays.masks, skip, CLOSEST, *times, AS_ARRAYS)
    told = Told(
        *(np.empty(count, np.int64), np.empty(count), np.empty((count, ndim))),
        *(np.empty(count, np.uint32), np.empty((count, 3))),
    )
    told.points[:, ndim:] = rays.origins[:, ndim:]
    node_handles = held.columns.node_handle

    def cast(arrays: Tree, sweep: Sweep, some: RaysThen, into: Told) -> int:
        scratch = scratch_for(len(some.origins), ndim, sweep.snapshot.depth)
        done: int = _entry(ndim)(arrays, sweep, some, ALONG, node_handles, scratch, into)
        return done

    sweep = sweep_for(held, rays, times)
    if not motion.answer(tree, (view, sweep), asked, told, threads, cast):
        known = no_sweep(ndim)._replace(moving=motion.known(view, 0.0, 0.0))
        given = asked, HITS_GIVEN, node_handles, scratch_for(0, ndim, 0), told
        _entry(ndim)(view.tree, known, *given)
        tree.check_unchanged(view)
    normals = told.normals
    if ndim == 2:
        normals = np.zeros((count, 3))
        normals[:, :2] = told.normals
    return CastHits(told.handles, told.t, told.points, normals)


def few_first(
    held: Obstacles,
    sweep: Sweep,
    rays: tuple[Any, ...],
    skip: bool,
    when: tuple[Any, Any],
    to_goals: bool,
) -> CastHits | None:
    """`first_boxes` in a tree of three dimensions through what is swept already, with as little
    Python as can be: of few rays, that is most. None where a ray is not for it. rays = (origins,
    directions, t_max, masks), when = (at, pace) of all, or arrays. `to_goals`: what is called
    directions are the goals of the ways.
    """
    tree: Any = held.tree
    count = len(rays[0])
    # As CastHits(...) and so on, which would take more calls of functions of Python's.
    handles, ts, points = np.empty(count, UINT32), np.empty(count), np.empty((count, 3))
    normals, node_handles = np.empty((count, 3)), held.columns.node_handle
    hits = tuple.__new__(CastHits, (handles, ts, points, normals))
    if count < FEW and type(when[0]) is float:
        few = rays, skip, when, to_goals, node_handles, hits
        return hits if _few_entry(3)(tree._storage.tree, sweep, *few) == 0 else None
    asked = tuple.__new__(RaysThen, (*rays, skip, CLOSEST, *told_once(when)))
    ids = _NO_IDS if count <= RAYS_ON_STACK else np.empty(count, INT64)
    told = tuple.__new__(Told, (ids, ts, normals, handles, points))
    scratch = scratch_for(count, 3, sweep.snapshot.depth)
    given = asked, int(to_goals), node_handles, scratch, told
    return hits if _entry(3)(tree._storage.tree, sweep, *given) == 0 else None


@lean_kernel
def cast_few_and_describe(tree, sweep, rays, skip_inside, when, to_goals, node_handles, hits):
    """As `cast_and_describe`, of fewer rays than FEW, see `few_casting.cast_few`."""
    (origins, directions, t_max, masks), ids = rays, stack_array(FEW, np.int64)
    if to_goals:
        directions = hits.points
        if fill_ways(origins, rays[1], directions) >= 0:
            return np.int64(1)
    told = Told(ids[: origins.shape[0]], hits.t, hits.normals, hits.handles, hits.points)
    found = RayHits(told.ids, told.t, told.normals)
    some = origins, directions, t_max, masks
    done = cast_few(tree, sweep, some, skip_inside, CLOSEST, when, found)
    if done == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = when
        asked = RaysThen(*some, skip_inside, CLOSEST, at, pace, when)
        describe(tree, sweep.moving, asked, node_handles, told)
    return done


@lean_kernel
def cast_and_describe(tree, sweep, asked, what, node_handles, scratch, told):
    """First hits of rays in one call; returns as `wide_casting.cast_rows`, 1 where a way is not
    finite.
    """
    directions, ids, done = asked.directions, told.ids, np.int64(0)
    if what == TO_GOALS:
        directions = told.points
        if fill_ways(asked.origins, asked.directions, directions) >= 0:
            return np.int64(1)
    if ids.shape[0] == 0:
        ids = stack_array(RAYS_ON_STACK, np.int64)[: asked.origins.shape[0]]
    rays = RaysThen(
        *(asked.origins, directions, asked.t_max, asked.masks, asked.skip_inside, asked.mode),
        *(asked.at, asked.pace, asked.when),
    )
    hits = Told(ids, told.t, told.normals, told.handles, told.points)
    if what != HITS_GIVEN:
        done = cast_rows(tree, sweep, rays, scratch, RayHits(ids, told.t, told.normals))
    if done == 0:
        describe(tree, sweep.moving, rays, node_handles, hits)
    return done


@inlined
def describe(tree, moving, rays, node_handles, told):
    """Fill in what is told of hits; directions and points may be the same memory."""
    ray, ndim = stack_array((RAY_ROWS, 3), np.float64), told.normals.shape[1]
    at, pace = rays.at, rays.pace
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = rays.when
    count = rays.origins.shape[0]
    for i in range(count):
        if i + AHEAD < count and told.ids[i + AHEAD] >= 0:
            fetch_box(tree, moving, slot_of(told.ids[i + AHEAD]))
        point, face = told.points[i], INSIDE
        if told.ids[i] < 0:
            told.handles[i] = NO_NODE
            for k in range(3):
                point[k] = np.nan
            continue
        for k in range(ndim):
            if told.normals[i, k] != 0.0:
                face = 2 * k + (told.normals[i, k] > 0.0)
        slot = slot_of(told.ids[i])
        told.handles[i] = node_handles[slot]
        set_ray(ray, rays.origins[i], rays.directions[i])
        course = course_of(ray, of_row(at, i), of_row(pace, i), moving)
        box = box_of(tree, moving, slot)
        face = face_met(box, course, of_row(rays.t_max, i), told.t[i], np.int64(face))
        locate(box, course, told.t[i], face, point, told.normals[i])


_ROWS = np.empty((0, 3))
_TOLD = Told(_NO_IDS, np.empty(0), _ROWS, np.empty(0, np.uint32), _ROWS)
_few_entry = entry_points(
    *(cast_few_and_describe, no_sweep, NO_FEW, False, AS_ARRAYS, False),
    *(_NO_IDS, CastHits(np.empty(0, np.uint32), np.empty(0), _ROWS, _ROWS)),
)
_entry = entry_points(
    *(cast_and_describe, no_sweep, NO_RAYS, ALONG, _NO_IDS),
    *(lambda ndim: make_scratch(0, ndim, 0), _TOLD),
)
