# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays through the wide snapshot: sixteen boxes a vector operation, decided in float64.

The distance of a plane is fma(plane, 1 / d, -o / d) in the snapshot's units. With e = 2**-24, the
rounding of 1 / d, of o / d and of the result make an error of at most |1 / d| (1 + |o|) 2 e (1 + 4
e), so every entry is lowered and every exit raised by PAD32 |1 / d| (1 + |o|), twice that. (Ize
2013 bounds (plane - o) * (1 / d); the fused form needs the term with |o|.) Directions are scaled
to a largest component of 1, and components below 2**-40 are taken for 2**-40: such an axis' exit
then is beyond 2**17 at least, further than anything that a ray from within 2**10 scene sizes can
meet. Other rays take the binary tree.

What passes is decided in float64 by `quick_decision`, and where that cannot tell, by `slab.meets`,
as everywhere.
"""

import math

import numpy as np

from .compiling import inlined, lean_kernel
from .machine import WIDTH, float_bits, seen16, slab16, stack_array, trailing_zeros
from .nodes import ALL, NONE, leaf_box
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

PAD32 = 2.0**-22
FARTHEST_ORIGIN = 2.0**10
STEEPEST = 2.0**40
ALL32 = np.uint32(ALL)
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
def fill_ray(ray, center, per_length, ndim):
    """Write inverses; return (suited, largest component of the direction). What is not finite is
    not suited: NaN is in no range.
    """
    suited, largest = True, 0.0
    for axis in range(ndim):
        direction = abs(ray[DIRECTION, axis])
        distance = abs(ray[ORIGIN, axis] - center[axis]) * per_length
        suited &= distance < FARTHEST_ORIGIN and (direction == 0.0 or 1e-290 < direction < 1e200)
        largest = max(largest, direction)
        ray[INVERSE, axis] = 1.0 / ray[DIRECTION, axis]
    return suited and largest > 1e-200 and 1e-290 < largest * per_length < 1e290, largest


@inlined
def axis_constants(ray, axis, center, per_length, largest, ndim):
    """For `slab16`: near and far plane offsets, inverse, near shift, far shift of one axis, with
    the largest direction made 1.
    """
    inverse = ray[INVERSE, axis] * largest
    slope = min(abs(inverse), STEEPEST)
    origin = (ray[ORIGIN, axis] - center[axis]) * per_length
    pad = PAD32 * slope * (1.0 + abs(origin))
    slope = math.copysign(slope, inverse)
    near = axis * WIDTH if slope > 0.0 else (axis + ndim) * WIDTH
    far = (2 * axis + ndim) * WIDTH - near
    shift = -origin * slope
    return near, far, np.float32(slope), np.float32(shift - pad), np.float32(shift + pad)


@inlined
def limit32(t, unit):
    """A distance in the snapshot's units, surely not less than t."""
    return np.float32(t * unit) * np.float32(1.0 + PAD32) + np.float32(1e-30)


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
def nearest_child(hits, entries, kids, at, stack, top):
    """The nearest of the children of `hits`, one at least; the others go onto the stack, nearer
    ones above: (child, top).

    What is on the stack is one number, a child below the bits of its distance: these have the
    order of the distances, so one comparison and one move sort it in. The nearest never goes
    there: it is wanted next, and a store and a load on its way are a tenth of a ray.
    """
    lane = np.int64(trailing_zeros(hits))
    hits = np.uint32(hits & np.uint32(hits - np.uint32(1)))
    child = kids[at + lane]
    if hits == np.uint32(0):
        return child, top
    near, floor = stack_key(entries[lane], child), top
    while hits != np.uint32(0):
        lane = np.int64(trailing_zeros(hits))
        hits = np.uint32(hits & np.uint32(hits - np.uint32(1)))
        key = stack_key(entries[lane], kids[at + lane])
        near, far, place = min(key, near), max(key, near), top
        while place > floor and stack[place] < far:
            stack[place + 1] = stack[place]
            place -= 1
        stack[place + 1] = far
        top += 1
    return np.int32(near), top


@inlined
def stack_key(entry_bits, child):
    return np.int64(entry_bits) << 32 | np.int64(np.uint32(child))


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
    stride = 2 * ndim * WIDTH
    near_x, far_x, inverse_x, in_x, out_x = axis_constants(
        ray, 0, center, per_length, largest, ndim
    )
    near_y, far_y, inverse_y, in_y, out_y = axis_constants(
        ray, 1, center, per_length, largest, ndim
    )
    near_z, far_z, inverse_z, in_z, out_z = axis_constants(
        ray, ndim - 1, center, per_length, largest, ndim
    )
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
            at = np.int64(child) * WIDTH
            if ndim == 2:
                hits = slab16(
                    planes,
                    child * stride,
                    (near_x, near_y),
                    (far_x, far_y),
                    (inverse_x, inverse_y),
                    (in_x, in_y),
                    (out_x, out_y),
                    limit,
                    entries,
                )
            else:
                hits = slab16(
                    planes,
                    child * stride,
                    (near_x, near_y, near_z),
                    (far_x, far_y, far_z),
                    (inverse_x, inverse_y, inverse_z),
                    (in_x, in_y, in_z),
                    (out_x, out_y, out_z),
                    limit,
                    entries,
                )
            if mask != ALL32:
                hits = np.uint32(hits & seen16(wide_masks, at, mask))
            if hits != np.uint32(0):
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
