# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays through the wide snapshot: sixteen boxes a vector operation, decided in float64.

What passes the filter of `wide_filter` is decided in float64 by `quick_decision`, and where that
cannot tell, by `slab.meets`, as everywhere.
"""

import numpy as np

from .compiling import inlined, lean_kernel
from .machine import WIDTH, float_bits, stack_array
from .nodes import NONE, leaf_box
from .ray_hits import of_row, write_hit
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
from .wide import DEEPEST_WIDE
from .wide_filter import children_met, fill_ray, filter_axes, limit32, nearest_child

MISSES, MEETS, ASK = range(3)


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
def cast(
    planes,
    kids,
    wide_masks,
    center,
    per_length,
    nodes,
    tight,
    handles,
    ray,
    largest,
    t_max,
    mask,
    skip_inside,
    any_hit,
    stack,
    entries,
):
    """First hit of one ray (or any): (slot, about t, axis); slot NONE where there is none."""
    ndim = nodes[0].lo.shape[0]  # a constant to the compiler, which ray.shape[1] is not
    axes = filter_axes(ray, center, per_length, largest, ndim)
    unit = largest * per_length  # t times this is the distance in the snapshot's units
    best, best_t, best_axis = np.int64(NONE), t_max, np.int64(INSIDE)
    limit = limit32(t_max, unit)
    last = np.int64(float_bits(limit))
    child, top = np.int32(0), 0
    while True:
        if child < 0:
            slot = np.int64(~child)
            better, t, axis = is_better(
                nodes, tight, handles, ray, t_max, skip_inside, slot, best, best_t, best_axis
            )
            if better:
                best, best_t, best_axis = slot, t, axis
                limit = limit32(t, unit)
                last = np.int64(float_bits(limit))
                if any_hit:
                    break
        else:
            hits = children_met(planes, wide_masks, child, axes, limit, mask, entries, ndim)
            if hits != np.uint32(0):
                at = np.int64(child) * WIDTH
                child, top = nearest_child(hits, entries, kids, at, stack, top)
                continue
        while top > 0 and stack[top] >> 32 > last:
            top -= 1
        if top == 0:
            break
        child = np.int32(stack[top])
        top -= 1
    return best, best_t, best_axis


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
    marked in `left_over`, some of which may not be finite. `ray` is scratch.

    In the order given: sorting them first (by octant and cell) makes neighbours share nodes, but
    gathering rays and scattering answers costs more than that saves, measured from 1,000 to
    100,000 boxes.
    """
    ndim = origins.shape[1]
    stack, entries = stack_array(DEEPEST_WIDE, np.int64), stack_array(WIDTH, np.int32)
    exact = np.int64(0)
    for i in range(start, stop):
        aim(ray, origins[i], directions[i])
        suited, largest = fill_ray(ray, center, per_length, ndim)
        left_over[i] = not suited
        if not suited:
            continue
        reach, seen = of_row(t_max, i), of_row(masks, i)
        slot, t, axis = cast(
            planes,
            kids,
            wide_masks,
            center,
            per_length,
            nodes,
            tight,
            handles,
            ray,
            largest,
            reach,
            seen,
            skip_inside,
            any_hit,
            stack,
            entries,
        )
        if any_hit:
            ids[i] = slot
            exact += np.int64(ray[EXACT, 0])
            continue
        if slot == NONE:
            t = np.inf
        elif axis == INSIDE:
            t = 0.0
        else:
            lo, hi = leaf_box(nodes, tight, 2 * slot)
            axis = settle_axis(lo, hi, ray, reach, t, axis)
            plane = near_plane(lo, hi, ray, axis)
            t = plane_distance(plane, ray[ORIGIN, axis], ray[DIRECTION, axis])
        write_hit(handles, ray, slot, t, axis, i, ids, ts, normals)
        exact += np.int64(ray[EXACT, 0])
    return exact
