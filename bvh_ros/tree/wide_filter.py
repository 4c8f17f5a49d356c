# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One ray against the boxes of a wide node, in float32: what surely misses is left out.

The distance of a plane is fma(plane, 1 / d, -o / d) in the snapshot's units. With e = 2**-24, the
rounding of 1 / d, of o / d and of the result make an error of at most |1 / d| (1 + |o|) 2 e (1 + 4
e), so every entry is lowered and every exit raised by PAD32 |1 / d| (1 + |o|), twice that. (Ize
2013 bounds (plane - o) * (1 / d); the fused form needs the term with |o|.) Directions are scaled
to a largest component of 1, and components below 2**-40 are taken for 2**-40: such an axis' exit
then is beyond 2**17 at least, further than anything that a ray from within 2**10 scene sizes can
meet. Other rays take the binary tree.
"""

import math

import numpy as np

from .compiling import inlined
from .machine import WIDTH, seen16, slab16, trailing_zeros
from .nodes import ALL
from .slab import DIRECTION, INVERSE, ORIGIN

PAD32 = 2.0**-22
FARTHEST_ORIGIN = 2.0**10
STEEPEST = 2.0**40
ALL32 = np.uint32(ALL)


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
def filter_axes(ray, center, per_length, largest, ndim):
    """`axis_constants` of every axis; of two, the second stands for the third."""
    return (
        axis_constants(ray, 0, center, per_length, largest, ndim),
        axis_constants(ray, 1, center, per_length, largest, ndim),
        axis_constants(ray, ndim - 1, center, per_length, largest, ndim),
    )


@inlined
def children_met(planes, masks, child, axes, limit, mask, entries, ndim):
    """Bit mask of the children of a wide node that the ray may meet up to `limit` and the mask
    sees; `entries` gets the bits of their distances.
    """
    (near_x, far_x, slope_x, in_x, out_x), (near_y, far_y, slope_y, in_y, out_y), z = axes
    near_z, far_z, slope_z, in_z, out_z = z
    at = np.int64(child) * WIDTH
    if ndim == 2:
        hits = slab16(
            planes,
            at * 4,
            (near_x, near_y),
            (far_x, far_y),
            (slope_x, slope_y),
            (in_x, in_y),
            (out_x, out_y),
            limit,
            entries,
        )
    else:
        hits = slab16(
            planes,
            at * 6,
            (near_x, near_y, near_z),
            (far_x, far_y, far_z),
            (slope_x, slope_y, slope_z),
            (in_x, in_y, in_z),
            (out_x, out_y, out_z),
            limit,
            entries,
        )
    if mask != ALL32:
        hits = np.uint32(hits & seen16(masks, at, mask))
    return hits


@inlined
def limit32(t, unit):
    """A distance in the snapshot's units, surely not less than t."""
    return np.float32(t * unit) * np.float32(1.0 + PAD32) + np.float32(1e-30)


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
