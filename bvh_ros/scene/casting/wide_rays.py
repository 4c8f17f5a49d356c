# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What n thin rays meet first among true shapes, found through the wide snapshot of batches.

As a swept ball, see `wide_sweeps`, a ray goes through nodes that are larger: by what nobody can
tell apart from touching. Who is met is decided as in `casting`.
"""

import numpy as np

from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.nodes import NONE
from ...tree.rays.slab import INSIDE, set_ray
from ...tree.store.turns import REFUSED, accepted, begin_query, end_query
from ...tree.store.workers import in_threads
from ...tree.wide.filtering import FARTHEST_ORIGIN, limit32, octant_of, start_ray
from ...tree.wide.snapshot import no_snapshot
from ..geometry.shapes import along_axes
from ..results import NO_NODE, CastHits
from ..store.columns import Columns
from .arguments import Asked, Ball, Hits, Rays, call, new_scratch, row_by_row, world_in
from .casting import cast, doubt_of, enter_obstacle, first_of, no_hit, touch, with_one_more, write
from .wide_sweeps import WIDE_STACK, next_leaf, put_roots, widen


@lean_kernel
def cast_many(world, through, node_handles, rays, skip_inside, scratch, told):
    """Fill in what rays meet first; through = (the tree's state, version, snapshot). Returns 0, or
    REFUSED if the tree is changed.
    """
    state, version, snapshot = through
    if not begin_query(state, version):
        return np.int64(REFUSED)
    features = stack_array(1, np.int64)
    one = Hits(stack_array(1, np.int64), stack_array(1, np.float64), features)
    for row in range(rays.origins.shape[0]):
        set_ray(scratch.ray, rays.origins[row], rays.directions[row])
        found, suited = 0, False
        if snapshot.size > 0:
            found, suited = find_first(world, snapshot, rays, row, skip_inside, scratch, one)
        if not suited:
            t_max = rays.t_max[row]
            asked = Asked(t_max, t_max, rays.masks[row], skip_inside, False)
            found = cast(world, Ball(0.0, 0.0), asked, scratch, one, 0)
        told.handles[row], told.t[row] = NO_NODE, np.inf
        for axis in range(3):
            told.points[row, axis], told.normals[row, axis] = 0.0 if found else np.nan, 0.0
        if found:
            touch(world, scratch, 0.0, one, 0, told.points[row], told.normals[row])
            told.handles[row], told.t[row] = node_handles[one.slots[0]], one.ts[0]
    end_query(state)
    return np.int64(0)


@inlined
def find_first(world, snapshot, rays, row, skip_inside, scratch, hits):
    """Write the first hit of a ray: (how many there are, whether it is for the snapshot)."""
    origin, direction = rays.origins[row], rays.directions[row]
    t_max, mask = rays.t_max[row], rays.masks[row]
    records, stack = stack_array(1, snapshot.record), stack_array(WIDE_STACK, np.int64)
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
        if t == np.inf or (skip_inside and feature == INSIDE):
            continue
        hit = slot, t, np.int64(feature)
        box, other = with_one_more(world, scratch.ray, 0.0, hit, box, other)
        record.limit = limits[0] = limit32(min(box.t, other.t), record.unit)
    first = first_of(world, scratch.ray, 0.0, box, other)
    return (write(first, hits, 0) if first.slot != NONE else 0), True


def first_of_many(
    tree: DynamicBVH, columns: Columns, rays: Rays, skip_inside: bool, threads: int
) -> CastHits:
    """First hits of n rays."""
    view, count, ndim = tree.view(), len(rays.origins), tree.ndim
    world = world_in(view.tree, columns)
    origins, directions = (along_axes(rows, ndim) for rows in rays[:2])
    flat = row_by_row(rays._replace(origins=origins, directions=directions))
    snapshot = tree.snapshot_for(count, view) or no_snapshot(ndim)
    through = view.tree.state, view.version, snapshot
    told = CastHits(
        *(np.empty(count, np.uint32), np.empty(count)),
        *(np.empty((count, 3)), np.empty((count, 3))),
    )

    def work(start: int, stop: int) -> None:
        some = Rays(*(column[start:stop] for column in flat))
        here = tuple.__new__(CastHits, (column[start:stop] for column in told))
        given = through, columns.node_handle, some, skip_inside, new_scratch(ndim), here
        accepted(call(cast_many, world, *given))

    in_threads(work, count, threads)
    if ndim == 2:
        met = told.handles != NO_NODE
        told.points[met, 2] = rays.origins[met, 2]
    return told
