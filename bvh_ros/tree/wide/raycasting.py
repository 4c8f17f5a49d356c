# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays through the wide snapshot: filtered in float32 by `filtering`, in lists as in
`ray_streams`; what passes is decided by `best_hit`.
"""

import numpy as np

from ..jit.compiling import inlined, lean_kernel
from ..jit.float32x16 import seen16, stream16
from ..jit.intrinsics import WIDTH, prefetch, stack_array
from ..nodes import ALL, NONE, leaf_box
from ..rays.ray_hits import of_row
from ..rays.slab import (
    DIRECTION,
    EXACT,
    INSIDE,
    INVERSE,
    ORIGIN,
    near_plane,
    plane_distance,
    set_ray,
)
from ..store.turns import begin_query, end_query
from .best_hit import exact_entry_axis, is_better
from .filtering import NOWHERE, limit32, start_ray
from .ray_streams import (
    COUNT,
    FREE,
    LISTS,
    NODE,
    RAYS_AT_ONCE,
    RAYS_SORTED,
    START,
    child_lists,
    farthest_first,
    sort_by_octant,
)

ALL32 = np.uint32(ALL)
OCTANTS = 8  # of two dimensions, four are empty
LINES_OF_PLANES = 6  # of a wide node of three dimensions
FOUND, DECIDED_EXACTLY = range(2)  # what is counted


@lean_kernel
def cast_rows(
    planes,
    children,
    wide_masks,
    center,
    per_length,
    nodes,
    tight,
    handles,
    state,
    version,
    ray,
    octants,
    rows,
    rays,
    lists,
    found,
    hits,
    stack,
    origins,
    directions,
    t_max,
    masks,
    skip_inside,
    any_hit,
    start,
    stop,
    ids,
    ts,
    normals,
    left_over,
):
    """First hits of the rays [start, stop), or of any hit no more than an id; those not suited are
    marked in `left_over`, some of which may not be finite. From `ray` to `stack`: a `Scratch`.
    Returns how many took exact arithmetic, negative if the tree is changed meanwhile.
    """
    if not begin_query(state, version):
        return np.int64(-1)
    boxes, scratch = (nodes, tight, handles), (ray, lists, found, hits, stack)
    asked = origins, directions, t_max, masks, skip_inside, any_hit
    tally, ends = stack_array(2, np.int64), stack_array(OCTANTS, np.int64)
    tally[DECIDED_EXACTLY] = 0
    ids[start:stop], ts[start:stop], normals[start:stop] = NONE, np.inf, 0.0
    answers = ids, ts, normals, left_over
    for first in range(start, stop, RAYS_SORTED):
        batch = rows[: min(stop - first, RAYS_SORTED)]
        sort_by_octant(directions, first, octants, batch, ends)
        begin = 0
        for octant in range(OCTANTS):
            wide = planes, children, wide_masks, center, per_length, octant
            while begin < ends[octant]:
                end = min(ends[octant], begin + RAYS_AT_ONCE)
                cast_group(wide, boxes, rays, batch[begin:end], scratch, asked, tally, answers)
                begin = end
    end_query(state)
    return tally[DECIDED_EXACTLY]


@inlined
def cast_group(wide, boxes, rays, rows, scratch, asked, tally, answers):
    """Answer the rays of `rows`, all of one octant."""
    _, _, _, center, per_length, _ = wide
    _, lists, _, _, _ = scratch
    origins, directions, t_max, _, _, _ = asked
    _, _, _, left_over = answers
    alive = 0
    for i in range(rows.shape[0]):
        origin, direction, reach = origins[rows[i]], directions[rows[i]], of_row(t_max, rows[i])
        suited = start_ray(rays[i], origin, direction, center, per_length, reach)
        lists[alive] = i
        alive += suited
        left_over[rows[i]] = not suited
    tally[FOUND] = 0
    if alive > 0:
        traverse(wide, boxes, rays, rows, alive, scratch, asked, tally)
    write_hits(boxes, rays, rows, scratch, asked, tally, answers)


@inlined
def traverse(wide, boxes, rays, rows, alive, scratch, asked, tally):
    """Find the best hits of the rays lists[:alive], all of one octant, and note them in `rays`."""
    planes, children, wide_masks, _, _, octant = wide
    _, lists, _, hits, stack = scratch
    masks = asked[3]
    all_seen = masks.shape[0] == 1 and masks[0] == ALL32
    nearest, ends = stack_array(WIDTH, np.int32), stack_array(LISTS, np.uint64)
    keys = stack_array(WIDTH, np.int64)
    stack[0, NODE], stack[0, START], stack[0, COUNT], stack[0, FREE] = 0, 0, alive, alive
    top = 1
    while top > 0:
        top -= 1
        node, start = np.int64(stack[top, NODE]), np.int64(stack[top, START])
        count, free = np.int64(stack[top, COUNT]), np.int64(stack[top, FREE])
        if node < 0:
            visit_leaf(boxes, ~node, rays, rows, start, count, scratch, asked, tally)
            continue
        met = stream16(planes, node, octant, rays, lists, start, count, hits, nearest)
        if not all_seen:
            met = apply_masks(wide_masks, node, masks, rows, lists, start, count, hits)
        first, step = start, np.int64(0)  # the list of a single ray serves all children
        ends[:WIDTH] = np.uint64(start + 1)
        if count > 1:
            first, step = free, count
            child_lists(lists, start, count, free, hits, ends)
            free += LISTS * count
        for i in range(farthest_first(met, nearest, keys)):
            lane = keys[i] & (WIDTH - 1)
            child, begin = children[node * WIDTH + lane], first + lane * step
            fetch_ahead(planes, children, boxes, np.int64(child))
            stack[top, NODE], stack[top, START] = child, begin
            stack[top, COUNT], stack[top, FREE] = np.int64(ends[lane]) - begin, free
            top += 1


@inlined
def visit_leaf(boxes, slot, rays, rows, start, count, scratch, asked, tally):
    """See for each ray of lists[start:start + count] whether the leaf is its best hit."""
    ray, lists, found, _, _ = scratch
    origins, directions, t_max, _, skip_inside, any_hit = asked
    nodes, tight, handles = boxes
    for i in range(start, start + count):
        state, row = rays[lists[i]], rows[lists[i]]
        if any_hit and state.slot != NONE:
            continue
        set_inverse(ray, origins[row], directions[row])
        t_best, best, best_axis = state.best_t, np.int64(state.slot), np.int64(state.axis)
        reach = of_row(t_max, row)
        better, t, axis = is_better(
            nodes, tight, handles, ray, reach, skip_inside, slot, best, t_best, best_axis
        )
        if ray[EXACT, 0] != 0.0 and not state.exact:
            state.exact = True
            tally[DECIDED_EXACTLY] += 1
        if better:
            if best == NONE:
                found[tally[FOUND]] = lists[i]
                tally[FOUND] += 1
            state.slot, state.best_t, state.axis = slot, t, axis
            state.limit = NOWHERE if any_hit else limit32(t, state.unit)


@inlined
def set_inverse(ray, origin, direction):
    """Write all rows of a ray that is suited."""
    set_ray(ray, origin, direction)
    for axis in range(origin.shape[0]):
        ray[INVERSE, axis] = 1.0 / direction[axis]


@inlined
def apply_masks(wide_masks, node, masks, rows, lists, start, count, hits):
    """Take from `hits` what a ray's mask does not see; return what any ray still meets."""
    met = np.uint32(0)
    for i in range(count):
        mask = of_row(masks, rows[lists[start + i]])
        hits[i] &= seen16(wide_masks, node * WIDTH, mask)
        met |= hits[i]
    return met


@inlined
def fetch_ahead(planes, children, boxes, child):
    """Ask for the memory of a child that will be visited soon."""
    nodes, tight, _ = boxes
    if child >= 0:
        prefetch(planes, child * (2 * nodes[0].lo.shape[0] * WIDTH), LINES_OF_PLANES)
        prefetch(children, child * WIDTH, 1)
    elif tight.shape[0] > 0:
        prefetch(tight, ~child, 1)
    else:
        prefetch(nodes, 2 * ~child, 1)


@inlined
def write_hits(boxes, rays, rows, scratch, asked, tally, answers):
    """Write the answers of the rays that hit anything."""
    nodes, tight, handles = boxes
    ray, _, found, _, _ = scratch
    origins, directions, t_max, _, _, any_hit = asked
    ids, ts, normals, _ = answers
    for i in found[: tally[FOUND]]:
        state, row = rays[i], rows[i]
        slot, axis = np.int64(state.slot), np.int64(state.axis)
        ids[row] = slot if any_hit else handles[slot]
        if any_hit:
            continue
        ts[row] = 0.0
        if axis != INSIDE:
            lo, hi = leaf_box(nodes, tight, 2 * slot)
            set_inverse(ray, origins[row], directions[row])
            axis = exact_entry_axis(lo, hi, ray, of_row(t_max, row), state.best_t, axis)
            tally[DECIDED_EXACTLY] += ray[EXACT, 0] != 0.0 and not state.exact
            plane = near_plane(lo, hi, ray, axis)
            ts[row] = plane_distance(plane, ray[ORIGIN, axis], ray[DIRECTION, axis])
            normals[row, axis] = -1.0 if ray[DIRECTION, axis] > 0.0 else 1.0
