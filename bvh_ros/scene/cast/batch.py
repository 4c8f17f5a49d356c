# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first hits of n rays, or balls, among true shapes: one kernel for all rows, or one.

Rows go through the wide snapshot of batches where there is one, else through the tree. The kernel
leaves a ball to `exact_ball.in_exact_order` where only exact arithmetic decides which obstacle is
first, or where several are wanted.
"""

import threading
from collections.abc import Iterable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    CHANGES,
    NONE,
    NOT_FINITE,
    REFUSED,
    ROOT,
    UINT32,
    OpenTree,
    Snapshot,
    View,
    accepted,
    begin_batch,
    end_query,
    in_threads,
    no_snapshot,
    of_row,
    set_ray,
)
from ...tree.compiler import address_of, called_at, inlined, lean_kernel, stack_array
from ..results import CastHits, cast_hits, require_few
from ..shapes.shape import Floats
from ..store import Columns
from .arguments import (
    SCRATCH,
    THIN,
    BoxHit,
    CastWorld,
    Rays,
    Sweep,
    code_for,
    room_for_triangles,
    scratch_in,
    too_long,
    triangles_in,
)
from .exact_ball import in_exact_order
from .query import (
    AT,
    Candidates,
    Caster,
    Hit,
    Query,
    drop_late,
    fill_segment,
    first_candidate,
    first_of,
    hits_met,
    no_hit,
    slack_of,
    write_row,
)

FEW = 64  # obstacles that a ball may touch before more room is made
MANY = 64  # rays, among meshes of many triangles: they go together


class Memory(threading.local):
    """Scratch of a thread, for `Candidates`: kernels alone read it, since a question that a signal
    handler asks meanwhile writes there, too.
    """

    def __init__(self) -> None:
        self.rows = np.empty((7, FEW))


memory = Memory()


class RowHits(NamedTuple):
    """`CastHits`, and the slots of the obstacles."""

    slots: Any
    """(n,); NONE where the segment is free; or (0,) where the caller does not need them."""
    handles: Any
    t: Any
    points: Any
    normals: Any
    triangles: Any
    """As of `room_for_triangles`."""


NO_SLOTS = np.empty(0, np.int64)


@inlined
def candidates_in(rows):
    """Room for `Candidates` in one array."""
    return Candidates(rows[0].view(np.int64), rows[1:4], rows[4:7].view(np.int64))


@lean_kernel
def cast_rows(view, snapshot, shapes, node_handles, rays, place, memory, hits):
    """Fill in the first hits of the rows [start, stop) = place; shapes as of `Columns.shapes`,
    hits are `RowHits`, memory as of `candidates_in`. Returns (rows done, `wanted`, version of the
    tree). Fewer rows than there are where the next one is not done, as `cast_row` says of it;
    REFUSED if the tree is changed, or the snapshot is older; NOT_FINITE if a ray is not.

    What every ball goes through is inlined: to hand all these arrays over takes a third of a
    ball's time.
    """
    tree, (row, stop) = view.tree, place
    ndim, wanted = 3 if shapes[1] is None else 2, np.int64(0)
    scratch = scratch_in(stack_array(SCRATCH, np.float64), ndim)
    direction = stack_array(3, np.float64)
    if not begin_batch(tree, view.version, snapshot):
        return REFUSED, wanted, 0
    version = tree.state[CHANGES]
    world = CastWorld(tree.nodes, tree.tight, tree.handles, tree.state[ROOT], *shapes)
    while row < stop:
        radius, t_max = of_row(rays.radii, row), of_row(rays.t_max, row)
        length, limit = (t_max, 1.0) if radius > 0.0 else (1.0, t_max)
        origin = rays.origins[row]
        if not fill_segment(origin, rays.directions[row], rays.to_goals, length, direction):
            row = NOT_FINITE
            break
        segment = origin[:ndim], direction[:ndim]
        set_ray(scratch.ray, *segment)
        mask, patched = of_row(rays.masks, row), snapshot.loose > 0
        query = Query(radius, 0.0, limit, mask, rays.skip_inside, rays.every, patched)
        hit, wanted = cast_row(world, snapshot, node_handles, segment, query, scratch, memory)
        if wanted > 0:
            break
        write_row(world, scratch, node_handles, radius, hit, length, row, hits)
        if ndim == 2 and hit.slot != NONE:
            hits.points[row, 2] = origin[2]
        if wanted < 0:
            break
        row += 1
    end_query(tree.state)
    return row, wanted, version


@inlined
def cast_row(world, snapshot, node_handles, segment, query, scratch, memory):
    """(The first hit of a ray or ball, `wanted`): 0; or the room that its candidates want; or,
    where only exact arithmetic decides between them, or all are wanted, minus the number of those
    that are in the memory.
    """
    room, slack = candidates_in(memory), 0.0
    if query.radius > 0.0:
        slack = slack_of(world, scratch.ray, query.radius)
    caster = Caster(world, Query(query.radius, slack, *query[2:]), scratch)
    found = hits_met(caster, snapshot, segment, room)
    if query.radius == 0.0 and not query.every:
        return first_of(caster, found), np.int64(0)
    count = drop_late(room, found) if query.radius > 0.0 else found.count
    if count > room.slots.shape[0]:
        return no_hit(), count
    if query.radius == 0.0:
        return no_hit(), -count
    first, sure = first_candidate(world, node_handles, room, count, query.skip_inside)
    if not sure or (query.every and count > 1):
        return no_hit(), -count
    if first == NONE:
        return no_hit(), np.int64(0)
    hit = Hit(room.slots[first], room.times[AT, first], room.features[AT, first])
    return hit, np.int64(0)


called_rows = called_at(cast_rows)


@lean_kernel
def cast_segment(address, view, snapshot, shapes, node_handles, ends, ball, memory, place):
    """`cast_rows`, at its address, of one row, ends = (start, goal), ball = (radius, mask,
    skip_inside, every): (slot, t), and its point and normal as the rows of `place`; where there
    are meshes, its triangle, too. Instead of a slot NONE, NOT_FINITE, REFUSED, or UNDECIDED, with
    `wanted` for t.
    """
    (start, goal), (radius, mask, skip_inside, every) = ends, ball
    masks, slots = stack_array(1, np.uint32), stack_array(1, np.int64)
    t_max, radii = stack_array(1, np.float64), stack_array(1, np.float64)
    t_max[0], masks[0], radii[0] = 1.0, mask, radius
    segment, ts = (start.reshape(1, 3), goal.reshape(1, 3)), stack_array(1, np.float64)
    rays = Rays(*segment, t_max, masks, radii, True, skip_inside, every)
    triangles = triangles_in(shapes, place[2:])
    hits = RowHits(slots, stack_array(1, np.uint32), ts, place[:1], place[1:2], triangles)
    row = np.int64(0), np.int64(1)
    given = view, snapshot, shapes, node_handles, rays, row, memory, hits
    done, wanted, _ = called_rows(address, given)
    if done < 0:
        return np.int64(done), np.inf
    if done == 0:
        return np.int64(UNDECIDED), float(wanted)
    return slots[0], ts[0]


UNDECIDED = -9  # no slot, nor NONE, NOT_FINITE or REFUSED


def tree_and_snapshot(tree: OpenTree, count: int) -> tuple[View, Snapshot]:
    """For batches that cannot do with `ready_snapshot`."""
    view = tree.view()
    return view, tree.snapshot_for(count, view) or no_snapshot(tree.ndim)


def first_of_one(
    tree: OpenTree,
    columns: Columns,
    ends: tuple[Floats, Floats],
    ball: tuple[float, np.uint32, bool],
) -> BoxHit | None:
    """The first hit of a thin ray, or ball, ends = (start, goal), shape (3,) each, ball = (radius,
    mask, skip_inside).
    """
    slot, t, place = _cast_one(tree, columns, ends, (*ball, False), memory.rows)
    if slot == UNDECIDED:  # once more, in room that no other question has
        start, goal = ends
        for hit in hits_in_order(tree, columns, goal, Sweep(start, goal - start, *ball, False)):
            return hit
        return None
    if slot == NONE:
        return None
    if len(place) == 2:
        return slot, t, place[0], place[1]
    return slot, t, place[0], place[1], place[2]  # numpy takes a microsecond for *place


def hits_in_order(
    tree: OpenTree, columns: Columns, goal: Floats, sweep: Sweep, most: int | None = None
) -> Iterable[BoxHit]:
    """The first obstacle that a ray or ball meets up to a goal (3,), or all in order, ties by
    handle; TooManyHitsError if it may touch more than `most`.
    """
    wanted, ends = FEW, (sweep.origin, goal)
    while wanted > 0:
        room = np.empty((7, wanted))
        slot, t, place = _cast_one(tree, columns, ends, sweep[2:], room)
        wanted = int(t) if slot == UNDECIDED else 0
    require_few(-wanted if slot == UNDECIDED else int(slot != NONE), most)
    if slot == UNDECIDED:
        return in_exact_order(tree, columns, sweep, _found(room, -wanted))
    return () if slot == NONE else ((slot, t, *place),)


def _cast_one(
    tree: OpenTree,
    columns: Columns,
    ends: tuple[Floats, Floats],
    ball: tuple[Any, ...],
    room: Floats,
) -> tuple[int, float, Floats]:
    """(slot, t, place) as `cast_segment` says, which takes ends, ball and room."""
    shapes, handles = columns.shapes, columns.node_handle
    place = np.empty((columns.rows_of_hit, 3))
    view, snapshot = tree.ready_snapshot() or (tree.view(), no_snapshot(tree.ndim))
    given = view, snapshot, shapes, handles, ends, ball, room, place
    code = code_for(cast_segment, shapes, given, calls=_address_of_rows)
    slot, t = code(*given)
    if slot == REFUSED:
        given = tree.view(), no_snapshot(tree.ndim), *given[2:]
        slot, t = code(*given)
        accepted(slot if slot == REFUSED else 0)
    if slot == NOT_FINITE:
        raise too_long(*ends)
    return slot, t, place


def _address_of_rows(
    view: View, snapshot: Snapshot, shapes: Any, node_handles: Any, *_: object
) -> int:
    """Where `cast_segment` finds `cast_rows`."""
    row = np.empty((0, 3))
    rays = Rays(row, row, np.empty(0), np.empty(0, UINT32), THIN, True, False, False)
    triangles = room_for_triangles(shapes, 0)
    hits = RowHits(NO_SLOTS, np.empty(0, UINT32), np.empty(0), row, row, triangles)
    given = view, snapshot, shapes, node_handles, rays, (0, 0), memory.rows, hits
    return address_of(cast_rows, *given)


def _found(room: Any, count: int) -> Candidates:
    """So many of those that a kernel has written."""
    rows = room[:, :count]
    return Candidates(rows[0].view(np.int64), rows[1:4], rows[4:7].view(np.int64))


def kernel_for(columns: Columns, rays: Rays, count: int, rows: Floats) -> tuple[Any, Any]:
    """The kernel that answers so many rays, and what it works in: mostly rows of `Memory`."""
    depth = columns.meshes.depth
    if rays.radii is not THIN or count < MANY or not depth or columns.shapes[0] is None:
        return cast_rows, rows
    from .mesh_batch import cast_together, room_for

    return cast_together, room_for(depth)


def first_hits(tree: OpenTree, columns: Columns, rays: Rays, threads: int = 1) -> CastHits | None:
    """First hits of n rays, or balls; None if a ray is not finite."""
    count, shapes, begun = len(rays.origins), columns.shapes, 0
    parts = np.empty(count, UINT32), np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    # As RowHits(...), which would take one more call of a function of Python's.
    triangles = None if columns.rows_of_hit == 2 else np.empty((count, 3))
    hits = tuple.__new__(RowHits, (NO_SLOTS, *parts, triangles))
    ready = tree.ready_snapshot() if threads == 1 else None
    view, snapshot = ready or tree_and_snapshot(tree, count)
    handles = columns.node_handle
    if threads == 1:  # without what others take: a tenth of a call of a row
        kernel, room = kernel_for(columns, rays, count, memory.rows)
        every = view, snapshot, shapes, handles, rays, (0, count), room, hits
        begun, _, version = code_for(kernel, shapes, every)(*every)
        if begun == count:
            return cast_hits(parts, triangles)
        if begun < 0:
            begun, (view, snapshot) = 0, tree_and_snapshot(tree, count)
        else:
            view = View(view.tree, version)
    work = partial(_work, tree, columns, (view, snapshot, shapes, handles, rays), hits)
    done = [work(begun, count)] if threads == 1 else in_threads(work, count, threads)
    return cast_hits(parts, triangles) if all(done) else None


def _work(
    tree: OpenTree, columns: Columns, given: tuple[Any, ...], hits: RowHits, start: int, stop: int
) -> bool:
    """Fill in the rows [start, stop); whether all rays are finite."""
    rays: Rays = given[4]
    rows = np.empty((7, FEW))
    while start < stop:
        kernel, room = kernel_for(columns, rays, stop - start, rows)
        some = *given, (start, stop), room, hits
        start, wanted, _ = code_for(kernel, columns.shapes, some)(*some)
        if start == NOT_FINITE:
            return False
        accepted(start)
        if start < stop and wanted < 0:
            _answer_exactly(tree, columns, rays, hits, start, _found(room, -wanted))
            start += 1
        elif start < stop:
            rows = np.empty((7, wanted))
    return True


def _answer_exactly(
    tree: OpenTree, columns: Columns, rays: Rays, hits: RowHits, row: int, found: Candidates
) -> None:
    """Fill in the exact hit of a row, which says that there is none."""
    origin, direction = rays.origins[row], rays.directions[row]
    t_max, mask, radius = (
        column[row if len(column) > 1 else 0] for column in (rays.t_max, rays.masks, rays.radii)
    )
    direction = direction - origin if rays.to_goals else direction * t_max
    sweep = Sweep(origin, direction, radius.item(), mask, rays.skip_inside, False)
    for slot, t, point, normal, *_ in in_exact_order(tree, columns, sweep, found):
        hits.handles[row] = columns.node_handle[slot]
        hits.t[row], hits.points[row], hits.normals[row] = t * t_max, point, normal
