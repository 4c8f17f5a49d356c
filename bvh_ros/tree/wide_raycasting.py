# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays through the wide snapshot: filtered in float32, decided in float64.

What passes the filter of `wide_filter` is decided in float64 by `quick_decision`, and where that
cannot tell, by `slab.meets`, as everywhere. The order in which boxes are looked at, which
`ray_streams` makes up, has no part in the answer.
"""

import numpy as np

from .compiling import inlined, lean_kernel
from .machine import WIDTH, prefetch, stack_array
from .nodes import ALL, NONE, leaf_box
from .ray_hits import of_row
from .ray_streams import (
    COUNT,
    FREE,
    LISTS,
    NODE,
    RAYS_AT_ONCE,
    START,
    child_lists,
    farthest_first,
    sort_by_octant,
)
from .raycasting import is_before
from .slab import (
    DIRECTION,
    EXACT,
    INSIDE,
    INVERSE,
    ORIGIN,
    PAD,
    TINY,
    aim,
    meets,
    near_plane,
    plane_distance,
)
from .wide_filter import NOWHERE, limit32, start_ray
from .wide_lanes import seen16, stream16

MISSES, MEETS, ASK = range(3)

ALL32 = np.uint32(ALL)
OCTANTS = 8  # of two dimensions, four are empty
LINES_OF_PLANES = 6  # of three dimensions


@inlined
def quick_decision(lo, hi, ray, best_t):
    """Decide where rounding cannot matter: (verdict, t, axis).

    MISSES: surely not met, or surely after best_t. MEETS: surely met, and before best_t. ASK:
    `meets` must tell. t has an error of three roundings, and `axis` is one entered then: of two
    that are entered at almost the same time it may be the other, which `settle_axis` finds out
    where it matters. Distances neither overflow nor have an infinite inverse here.
    """
    entry, leave = 0.0, best_t
    entered = INSIDE
    for axis in range(lo.shape[0]):
        inverse = ray[INVERSE, axis]
        at_lo = (lo[axis] - ray[ORIGIN, axis]) * inverse
        at_hi = (hi[axis] - ray[ORIGIN, axis]) * inverse
        near, far = (at_lo, at_hi) if inverse > 0.0 else (at_hi, at_lo)
        if near > entry:
            entry, entered = near, axis
        leave = far if far < leave else leave
    if entry > leave * PAD + TINY:
        return MISSES, entry, entered
    if entered != INSIDE and entry * PAD + TINY < leave:
        return MEETS, entry, entered
    return ASK, entry, entered


@lean_kernel
def settle_axis(lo, hi, ray, t_max, t, entered):
    """The axis on which a ray that meets the box enters it last, exactly; likely `entered`."""
    for axis in range(lo.shape[0]):
        if axis != entered and ray[DIRECTION, axis] != 0.0:
            near = (near_plane(lo, hi, ray, axis) - ray[ORIGIN, axis]) * ray[INVERSE, axis]
            if near * PAD + TINY >= t:
                return np.int64(meets(lo, hi, ray, t_max)[2])
    return np.int64(entered)


@inlined
def is_better(nodes, tight, handles, ray, t_max, skip_inside, slot, best, best_t, best_axis):
    """Whether a leaf is hit before the best so far: (better, about t, axis)."""
    lo, hi = leaf_box(nodes, tight, 2 * slot)
    verdict, t, axis = quick_decision(lo, hi, ray, best_t)
    if verdict != ASK:
        return verdict == MEETS, t, axis
    met, t, axis = meets(lo, hi, ray, t_max)
    if not met or (skip_inside and axis == INSIDE):
        return False, t, axis
    if best == NONE:
        return True, t, axis
    best_lo, best_hi = leaf_box(nodes, tight, 2 * best)
    best_axis = settle_axis(best_lo, best_hi, ray, t_max, best_t, best_axis)
    better = is_before(nodes, tight, handles, ray, slot, t, axis, best, best_t, best_axis)
    return better, t, axis


@inlined
def aim_inverse(ray, origin, direction):
    """Write all rows of a ray that is suited."""
    aim(ray, origin, direction)
    for axis in range(origin.shape[0]):
        ray[INVERSE, axis] = 1.0 / direction[axis]


@inlined
def visit_leaf(
    nodes,
    tight,
    handles,
    slot,
    rays,
    rows,
    lists,
    start,
    count,
    ray,
    origins,
    directions,
    t_max,
    skip_inside,
    any_hit,
):
    """See for each ray of lists[start:start + count] whether the leaf is its best hit. `ray` is
    scratch.
    """
    for i in range(start, start + count):
        state, row = rays[lists[i]], rows[lists[i]]
        if any_hit and state.slot != NONE:
            continue
        aim_inverse(ray, origins[row], directions[row])
        better, t, axis = is_better(
            nodes,
            tight,
            handles,
            ray,
            of_row(t_max, row),
            skip_inside,
            slot,
            np.int64(state.slot),
            state.best_t,
            np.int64(state.axis),
        )
        state.exact |= ray[EXACT, 0] != 0.0
        if better:
            state.slot, state.best_t, state.axis = slot, t, axis
            state.limit = NOWHERE if any_hit else limit32(t, state.unit)


@inlined
def hide(wide_masks, node, masks, rows, lists, start, count, hits):
    """Take from `hits` what a ray's mask does not see; return what any ray still meets."""
    met = np.uint32(0)
    for i in range(count):
        mask = of_row(masks, rows[lists[start + i]])
        hits[i] &= seen16(wide_masks, node * WIDTH, mask)
        met |= hits[i]
    return met


@inlined
def traverse(
    planes,
    kids,
    wide_masks,
    nodes,
    tight,
    handles,
    octant,
    rays,
    rows,
    lists,
    alive,
    hits,
    stack,
    ray,
    origins,
    directions,
    t_max,
    masks,
    skip_inside,
    any_hit,
):
    """Find the best hits of the rays lists[:alive], all of one octant, and write them to `rays`."""
    nearest, ends = stack_array(WIDTH, np.int32), stack_array(LISTS, np.uint64)
    keys = stack_array(WIDTH, np.int64)
    all_seen = masks.shape[0] == 1 and masks[0] == ALL32
    stack[0, NODE], stack[0, START], stack[0, COUNT], stack[0, FREE] = 0, 0, alive, alive
    top = 1 if alive > 0 else 0
    while top > 0:
        top -= 1
        node, start = np.int64(stack[top, NODE]), np.int64(stack[top, START])
        count, free = np.int64(stack[top, COUNT]), np.int64(stack[top, FREE])
        if node < 0:
            visit_leaf(
                nodes,
                tight,
                handles,
                ~node,
                rays,
                rows,
                lists,
                start,
                count,
                ray,
                origins,
                directions,
                t_max,
                skip_inside,
                any_hit,
            )
            continue
        met = stream16(planes, node, octant, rays, lists, start, count, hits, nearest)
        if not all_seen:
            met = hide(wide_masks, node, masks, rows, lists, start, count, hits)
        first, step = start, 0  # the list of a single ray serves all children
        ends[:WIDTH] = np.uint64(start + 1)
        if count > 1:
            child_lists(lists, start, count, free, hits, ends)
            first, step = free, count
            free += LISTS * count
        for i in range(farthest_first(met, nearest, keys)):
            lane = keys[i] & (WIDTH - 1)
            child, begin = kids[node * WIDTH + lane], first + lane * step
            fetch_ahead(planes, kids, nodes, tight, np.int64(child))
            stack[top, NODE], stack[top, START] = child, begin
            stack[top, COUNT], stack[top, FREE] = np.int64(ends[lane]) - begin, free
            top += 1


@inlined
def fetch_ahead(planes, kids, nodes, tight, child):
    """Ask for the memory of a child that will be visited soon."""
    if child >= 0:
        prefetch(planes, child * (2 * nodes[0].lo.shape[0] * WIDTH), LINES_OF_PLANES)
        prefetch(kids, child * WIDTH, 1)
    elif tight.shape[0] > 0:
        prefetch(tight, ~child, 1)
    else:
        prefetch(nodes, 2 * ~child, 1)


@lean_kernel
def cast_rows(
    planes,
    kids,
    wide_masks,
    center,
    per_length,
    nodes,
    tight,
    handles,
    ray,
    rows,
    rays,
    lists,
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
    """
    exact, begin = np.int64(0), 0
    rows = rows[: stop - start]
    ends = stack_array(OCTANTS, np.int64)
    sort_by_octant(directions, start, rows, ends)
    for octant in range(OCTANTS):
        while begin < ends[octant]:
            count = min(ends[octant] - begin, RAYS_AT_ONCE)
            group = rows[begin : begin + count]
            begin += count
            alive = 0
            for i in range(count):
                row = group[i]
                suited = start_ray(
                    rays[i], origins[row], directions[row], center, per_length, of_row(t_max, row)
                )
                left_over[row] = not suited
                lists[alive] = i
                alive += suited
                write_miss(row, any_hit, ids, ts, normals)
            traverse(
                planes,
                kids,
                wide_masks,
                nodes,
                tight,
                handles,
                octant,
                rays,
                group,
                lists,
                alive,
                hits,
                stack,
                ray,
                origins,
                directions,
                t_max,
                masks,
                skip_inside,
                any_hit,
            )
            exact += write_hits(
                nodes,
                tight,
                handles,
                rays,
                group,
                lists,
                ray,
                origins,
                directions,
                t_max,
                any_hit,
                ids,
                ts,
                normals,
            )
    return exact


@inlined
def write_miss(row, any_hit, ids, ts, normals):
    """The answer of a ray that hits nothing."""
    ids[row] = NONE
    if not any_hit:
        ts[row] = np.inf
        for axis in range(normals.shape[1]):
            normals[row, axis] = 0.0


@lean_kernel
def write_hits(
    nodes,
    tight,
    handles,
    rays,
    rows,
    lists,
    ray,
    origins,
    directions,
    t_max,
    any_hit,
    ids,
    ts,
    normals,
):
    """Write the answers of the rays that hit; return how many took exact arithmetic."""
    exact, found = np.int64(0), 0
    for i in range(rows.shape[0]):
        exact += rays[i].exact
        lists[found] = i
        found += rays[i].slot != NONE
    for i in lists[:found]:
        state, row = rays[i], rows[i]
        slot, axis = np.int64(state.slot), np.int64(state.axis)
        if any_hit:
            ids[row] = slot
            continue
        t = 0.0
        if axis != INSIDE:
            lo, hi = leaf_box(nodes, tight, 2 * slot)
            aim_inverse(ray, origins[row], directions[row])
            axis = settle_axis(lo, hi, ray, of_row(t_max, row), state.best_t, axis)
            exact += ray[EXACT, 0] != 0.0 and not state.exact
            plane = near_plane(lo, hi, ray, axis)
            t = plane_distance(plane, ray[ORIGIN, axis], ray[DIRECTION, axis])
            normals[row, axis] = -1.0 if ray[DIRECTION, axis] > 0.0 else 1.0
        ids[row], ts[row] = handles[slot], t
    return exact
