# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays against boxes: the one slab test for inner nodes, and the exact decision for leaves.

A box is the overlap of its slabs (Kay and Kajiya 1986). A ray is inside the slab of one axis
between two distances,

    entry = (near - o) / d,   exit = (far - o) / d,   near, far = (lo, hi) if d > 0 else (hi, lo),

and meets the box if the latest entry is not after the earliest exit. A box from p to q that moves
along d meets another where a ray meets that one grown by it: (lo - q) / d and (hi - p) / d. The
planes of the grown box would have to be rounded, these differences need not be: so a ray here is a
box that moves, mostly one whose corners are one point.

**Inner nodes** must not lose a hit; a needless visit is harmless. With u = 2**-53, (plane - o) *
(1 / d) is within a factor (1 + u)**3 of the truth, so the comparison is padded by 1 + 16 u, more
than the 1 + 2 gamma(3) of Ize 2013, "Robust BVH Ray Traversal", section 3, because the best
distance so far has rounding of its own. `prepare_ray` keeps 1 / d away from overflow and
underflow, and a pad of `TINY` covers products that underflow.

**Leaves** are decided as real arithmetic decides. entry_a <= exit_b compares two quotients of
differences. Each is computed with two roundings, so with a relative error below 2 u + u**2 (below
the smallest normal double: an absolute error of at most 2**-1074). Two computed values that differ
by more than 8 u, relatively, and by more than `TINY` are in the order of their exact ones. Else
multiplying out by both directions leaves the sign of a sum of four products, which `exact_sign`
computes without rounding.
"""

import math

import numpy as np

from ..compiler import inlined, lean_kernel
from .exact import sign_of_four_products

PAD = 1.0 + 16 * 2.0**-53
CLEAR = 1.0 + 8 * 2.0**-53
TINY = 1e-322
INSIDE = -1  # the axis of a hit whose ray starts inside

# The rows of a ray: `set_ray` or `set_swept_box` writes the first three, prepare_ray the inverses;
# ray[EXACT, 0] says whether a decision about it took exact arithmetic.
ORIGIN, UPPER, DIRECTION, INVERSE, EXACT = range(5)
RAY_ROWS = 5
RAY_FLOATS = 3 * RAY_ROWS


@inlined
def is_finite(origin, direction):
    finite = True
    for k in range(origin.shape[0]):
        finite &= np.isfinite(origin[k]) & np.isfinite(direction[k])
    return finite


@inlined
def set_ray(ray, origin, direction):
    """Write the rows of a ray."""
    set_swept_box(ray, origin, origin, direction)


@inlined
def set_swept_box(ray, lo, hi, translation):
    """Write the rows of a box that is swept along `translation`."""
    for axis in range(lo.shape[0]):
        ray[ORIGIN, axis] = lo[axis]
        ray[UPPER, axis] = hi[axis]
        ray[DIRECTION, axis] = translation[axis]
    ray[EXACT, 0] = 0.0


@inlined
def prepare_ray(ray, bounds_lo, bounds_hi):
    """Fill the row of inverses; return (scale, wide).

    The traversal measures distance in units of 2**scale, see `traversal_distance`; scale is 0
    unless 1 / d or a distance would leave the normal doubles. An axis whose inverse still would is
    NaN, which bounds nothing in `intersect_node`: the leaves decide. `wide` says that plane -
    origin may overflow.
    """
    largest = 0.0
    reach = 0.0
    for axis in range(bounds_lo.shape[0]):
        largest = max(largest, abs(ray[DIRECTION, axis]))
        above, below = bounds_hi[axis] - ray[ORIGIN, axis], bounds_lo[axis] - ray[UPPER, axis]
        reach = max(reach, abs(above), abs(below))
    scale = 0
    if largest > 0.0 and not (2.0**-1000 < largest < 2.0**1000 and reach < largest * 2.0**1000):
        scale = (
            3 - math.frexp(largest)[1]
        )  # the largest component in [4, 8): no distance along it overflows
    for axis in range(bounds_lo.shape[0]):
        direction = ray[DIRECTION, axis]
        scaled = direction
        if scale != 0:
            scaled = math.ldexp(direction, scale)
        inverse = 1.0 / abs(scaled)
        if direction != 0.0 and not (inverse < np.inf and math.ldexp(scaled, -scale) == direction):
            inverse = np.nan
        ray[INVERSE, axis] = math.copysign(inverse, direction)
    return scale, math.isinf(reach)


@inlined
def traversal_distance(t, scale):
    """A computed distance in the traversal's units, raised by its absolute error: that of a t
    which underflowed may matter there.
    """
    return t if scale == 0 else math.ldexp(t + TINY, -scale)


@inlined
def rounded_slabs(lo, hi, ray, limit):
    """Where a ray enters a box, where it leaves it, `limit` at the latest, and the axis entered
    last: (entry, leave, axis), each distance with an error of three roundings.

    0 * inf is NaN where the ray runs in the plane of a face: comparisons with NaN are false, so
    the slab bounds nothing, and the touching ray goes on, as closed boxes want.
    """
    entry, leave, entered = 0.0, limit, INSIDE
    for axis in range(lo.shape[0]):
        inverse = ray[INVERSE, axis]
        at_lo = (lo[axis] - ray[UPPER, axis]) * inverse
        at_hi = (hi[axis] - ray[ORIGIN, axis]) * inverse
        near, far = (at_lo, at_hi) if inverse > 0.0 else (at_hi, at_lo)
        if near > entry:
            entry, entered = near, axis
        leave = far if far < leave else leave
    return entry, leave, entered


@inlined
def intersect_node(lo, hi, ray, limit, wide):
    """Distance at which the ray may enter a node's box, or inf if it surely misses it or enters
    after `limit`.
    """
    entry, leave, _ = rounded_slabs(lo, hi, ray, limit)
    if math.isinf(entry):
        return 0.0 if wide else np.inf
    return entry if entry <= leave * PAD + TINY else np.inf


@inlined
def plane_distance(plane, origin, direction):
    """(plane - origin) / direction within 2 ulp; inf only where the exact value is as large."""
    difference = plane - origin
    if math.isinf(difference):
        return (plane * 0.5 - origin * 0.5) / direction * 2.0
    return difference / direction


@lean_kernel
def compare_distances(
    t, plane, origin, direction, other_t, other_plane, other_origin, other_direction
):
    """Sign of (plane - origin) / direction - the same of the other, exactly; t and other_t are the
    computed values, not negative.
    """
    if t * CLEAR + TINY < other_t:
        return -1
    if other_t * CLEAR + TINY < t:
        return 1
    sign = sign_of_four_products(
        plane,
        other_direction,
        -origin,
        other_direction,
        -other_plane,
        direction,
        other_origin,
        direction,
    )
    return sign if (direction > 0.0) == (other_direction > 0.0) else -sign


@inlined
def near_plane(lo, hi, ray, axis):
    return lo[axis] if ray[DIRECTION, axis] > 0.0 else hi[axis]


@inlined
def front(ray, axis):
    """Where what moves meets the near plane of an axis: the origin of a ray, the leading side of a
    box.
    """
    return ray[UPPER, axis] if ray[DIRECTION, axis] > 0.0 else ray[ORIGIN, axis]


@inlined
def _rear(ray, axis):
    """Where it leaves the far plane."""
    return ray[ORIGIN, axis] if ray[DIRECTION, axis] > 0.0 else ray[UPPER, axis]


@inlined
def _order(ray, t, plane, axis, other_t, other_plane, other_origin, other_axis):
    """`compare_distances` of the near plane of an axis and any plane along one ray."""
    if t * CLEAR + TINY < other_t:
        return -1
    if other_t * CLEAR + TINY < t:
        return 1
    ray[EXACT, 0] = 1.0
    return compare_distances(
        t,
        plane,
        front(ray, axis),
        ray[DIRECTION, axis],
        other_t,
        other_plane,
        other_origin,
        ray[DIRECTION, other_axis],
    )


@inlined
def _within(ray, t, plane, axis, t_max):
    """Whether the ray reaches the near plane of an axis by t_max, exactly."""
    if math.isinf(t_max) or t * CLEAR + TINY < t_max:
        return True
    if t_max * CLEAR + TINY < t:
        return False
    ray[EXACT, 0] = 1.0
    origin, direction = front(ray, axis), ray[DIRECTION, axis]
    return compare_distances(t, plane, origin, direction, t_max, t_max, 0.0, 1.0) <= 0


@inlined
def _enters_later(lo, hi, ray, t, plane, axis, other_t, other_axis):
    """Whether the near plane of an axis is met after that of another."""
    other_plane, other_origin = near_plane(lo, hi, ray, other_axis), front(ray, other_axis)
    return _order(ray, t, plane, axis, other_t, other_plane, other_origin, other_axis) > 0


@lean_kernel
def intersect_exact(lo, hi, ray, t_max):
    """Exact decision of a ray and a closed box: (hit, t, axis).

    `axis` is the one entered last, INSIDE where the ray starts in the box. Ties between axes go to
    the lowest. Where it took exact arithmetic, ray[EXACT, 0] becomes 1.
    """
    t, entered = 0.0, INSIDE
    for axis in range(lo.shape[0]):
        direction = ray[DIRECTION, axis]
        below, above = ray[UPPER, axis] < lo[axis], ray[ORIGIN, axis] > hi[axis]
        if not (below or above):
            continue
        if direction == 0.0 or below != (direction > 0.0):
            return False, np.inf, INSIDE  # parallel outside, or flying away
        plane = lo[axis] if below else hi[axis]
        distance = plane_distance(plane, front(ray, axis), direction)
        if entered == INSIDE or _enters_later(lo, hi, ray, distance, plane, axis, t, entered):
            t, entered = distance, axis
    if entered == INSIDE:
        return True, 0.0, INSIDE
    plane = near_plane(lo, hi, ray, entered)
    for axis in range(lo.shape[0]):
        direction = ray[DIRECTION, axis]
        if axis != entered and direction != 0.0:
            far = hi[axis] if direction > 0.0 else lo[axis]
            rear = _rear(ray, axis)
            leave = plane_distance(far, rear, direction)
            if _order(ray, t, plane, entered, leave, far, rear, axis) > 0:
                return False, np.inf, INSIDE
    return _within(ray, t, plane, entered, t_max), t, entered


@lean_kernel
def compare_hits(ray, lo, hi, hit, other_lo, other_hi, other):
    """Sign of the exact difference of two hits' distances along one ray; a hit is (t, axis)."""
    (t, axis), (other_t, other_axis) = hit, other
    if axis == INSIDE or other_axis == INSIDE:
        return (0 if other_axis == INSIDE else -1) if axis == INSIDE else 1
    plane, other_plane = (
        near_plane(lo, hi, ray, axis),
        near_plane(other_lo, other_hi, ray, other_axis),
    )
    if axis == other_axis:  # one axis, one direction: the planes are in the order of the hits
        if plane == other_plane:
            return 0
        return -1 if (plane < other_plane) == (ray[DIRECTION, axis] > 0.0) else 1
    return _order(ray, t, plane, axis, other_t, other_plane, front(ray, other_axis), other_axis)
