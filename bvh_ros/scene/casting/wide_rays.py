# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What n thin rays meet first among true shapes, found through the wide snapshot of batches.

As a swept ball, see `wide_sweeps`, a ray goes through nodes that are larger: by what nobody can
tell apart from touching. Who is met is decided as in `casting`.
"""

from typing import Any

import numpy as np

from ...tree.checks import UINT32
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.nodes import NONE, ROOT
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import INSIDE, set_ray
from ...tree.store.turns import NOT_FINITE, REFUSED, accepted, end_query
from ...tree.store.workers import in_threads
from ...tree.wide.filtering import FARTHEST_ORIGIN, limit32, octant_of, start_ray
from ...tree.wide.ray_stacks import STACK
from ...tree.wide.snapshot import begin_batch
from ..results import NO_NODE, CastHits
from ..store.columns import Columns
from .arguments import SCRATCH, Asked, Ball, CastWorld, Hits, code_for, scratch_in
from .casting import cast, doubt_of, enter_obstacle, first_of, no_hit, touch, with_one_more, write
from .sweeping import fill_way
from .wide_sweeps import next_leaf, put_roots, tree_and_snapshot, widen


@lean_kernel
def cast_many(view, snapshot, shapes, node_handles, rays, asked, place, told):
    """Fill in what the rays of the rows [start, stop) meet first; shapes as of `Columns.shapes`,
    rays = (origins, directions, t_max, masks), the last two one for all, or (n,), asked =
    (whether what is called directions are goals, skip_inside), place = (start, stop). Returns 0,
    REFUSED if the tree is changed, or the snapshot is older, or NOT_FINITE if a start or a way is
    not.
    """
    tree, (row, stop), (to_goals, skip_inside) = view.tree, place, asked
    origins, directions, ends, masks = rays
    state, ndim = tree.state, 3 if shapes[1] is None else 2
    scratch = scratch_in(stack_array(SCRATCH, np.float64), ndim)
    direction = stack_array(3, np.float64)
    if not begin_batch(tree, view.version, snapshot):
        return np.int64(REFUSED)
    world = CastWorld(tree.nodes, tree.tight, tree.handles, state[ROOT], *shapes)
    features = stack_array(1, np.int64)
    one = Hits(stack_array(1, np.int64), stack_array(1, np.float64), features)
    while row < stop:
        if not fill_way(origins[row], directions[row], to_goals, 1.0, direction):
            end_query(state)
            return np.int64(NOT_FINITE)
        way = origins[row, :ndim], direction[:ndim]
        t_max, mask = of_row(ends, row), of_row(masks, row)
        question = Asked(t_max, t_max, mask, skip_inside, False)
        set_ray(scratch.ray, way[0], way[1])
        found, suited = 0, False
        if snapshot.size > 0:
            found, suited = find_first(world, snapshot, way, question, scratch, one)
        if not suited:
            found = cast(world, Ball(0.0, 0.0), question, scratch, one, 0)
        told.handles[row], told.t[row] = NO_NODE, np.inf
        for axis in range(3):
            told.points[row, axis], told.normals[row, axis] = 0.0 if found else np.nan, 0.0
        if found:
            touch(world, scratch, 0.0, one, 0, told.points[row], told.normals[row])
            told.handles[row], told.t[row] = node_handles[one.slots[0]], one.ts[0]
            if ndim == 2:
                told.points[row, 2] = origins[row, 2]
        row += 1
    end_query(state)
    return np.int64(0)


@inlined
def find_first(world, snapshot, way, asked, scratch, hits):
    """Write the first hit of a ray, way = (origin, direction): (how many there are, whether it is
    for the snapshot).
    """
    (origin, direction), t_max, mask = way, asked.t_max, asked.mask
    records, stack = stack_array(1, snapshot.record), stack_array(STACK, np.int64)
    record, limits = records[0], stack_array(1, np.float32)
    box, other = no_hit(), no_hit()
    reach = doubt_of(scratch.ray, 0.0) * snapshot.per_length
    suited = start_ray(record, origin, direction, snapshot.center, snapshot.per_length, t_max)
    if not (suited and reach < FARTHEST_ORIGIN):
        return 0, False
    widen(record, reach)
    limits[0], octant, top = record.limit, octant_of(direction), put_roots(snapshot, stack)
    while top > 0:
        slot, top = next_leaf(snapshot, records, octant, mask, limits, stack, top)
        if slot == NONE or (snapshot.loose > 0 and world.nodes[2 * slot].mask & mask == 0):
            continue
        t, feature = enter_obstacle(world, slot, scratch.ray, 0.0, t_max, scratch.work)
        if t == np.inf or (asked.skip_inside and feature == INSIDE):
            continue
        hit = slot, t, np.int64(feature)
        box, other = with_one_more(world, scratch.ray, 0.0, hit, box, other)
        record.limit = limits[0] = limit32(min(box.t, other.t), record.unit)
    first = first_of(world, scratch.ray, 0.0, box, other)
    return (write(first, hits, 0) if first.slot != NONE else 0), True


def first_of_many(
    tree: DynamicBVH,
    columns: Columns,
    rays: tuple[Any, ...],
    asked: tuple[bool, bool],
    threads: int,
) -> CastHits | None:
    """First hits of n rays, as `cast_many` gets them, asked = (whether what is called directions
    are goals, skip_inside); None if a start or a way is not finite.
    """
    count = len(rays[0])
    parts = np.empty(count, UINT32), np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    # As CastHits(...), which would take one more call of a function of Python's.
    told = tuple.__new__(CastHits, parts)
    shapes, handles = columns.shapes, columns.node_handle
    ready, done = (tree.ready_snapshot() if threads == 1 else None), REFUSED
    if ready is not None:
        view, snapshot = ready
        every = view, snapshot, shapes, handles, rays, asked, (0, count), told
        done = code_for(cast_many, shapes, every)(*every)
    if done == REFUSED:
        now = tree_and_snapshot(tree, count)

        def work(start: int, stop: int) -> int:
            some = *now, shapes, handles, rays, asked, (start, stop), told
            answered: int = code_for(cast_many, shapes, some)(*some)
            return answered

        done = min(in_threads(work, count, threads))
    if done == NOT_FINITE:
        return None
    accepted(done)
    return told
