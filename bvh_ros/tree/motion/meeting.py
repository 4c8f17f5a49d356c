# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The exact decision of a ray, or a box that is swept, and a box that goes on for ever.

As `rays.slab` decides of boxes at rest, in relative motion: on each axis `sums.gap` is how far a
side of the box is ahead, `sums.rate` how fast it comes nearer. Their signs are exact. Of two
distances along a ray, gap over rate, each is computed within 2 ulp; where that does not tell
their order, the products of the four sums do, which `wide_numbers` multiplies without rounding.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import inlined, lean_kernel, prefetch, stack_array
from ..nodes import leaf_box
from ..rays.exact_sign import LIMBS
from ..rays.slab import CLEAR, DIRECTION, EXACT, INSIDE, ORIGIN, TINY, UPPER
from .sums import add_gap, gap, quotient, rate
from .wide_numbers import compare_products, magnitude


class Moving(NamedTuple):
    """What kernels know of the motion of a tree's boxes."""

    kept: NDArray[Any]
    """Of `velocities.velocity_dtype`, by slot."""
    nodes: NDArray[Any]
    """Of `bounds.moving_dtype`: nodes of the tree, from `start` to `stop`."""
    start: float
    stop: float
    version: int
    """Of the tree when the nodes were fitted."""
    nanoseconds: bool
    """Whether the times of decisions are whole nanoseconds: the nearest, as `sums` has them."""
    left: float
    """Boxes go on for so long, s, after they were told, and then stand; inf if they never do."""


class Course(NamedTuple):
    """How a ray or box goes."""

    ray: NDArray[np.float64]
    """Of `rays.slab`."""
    at: float
    """When it starts, s."""
    pace: float
    """Seconds a unit of t."""
    nanoseconds: bool
    """As of `Moving`, as `left`."""
    left: float


@inlined
def course_of(ray, at, pace, moving):
    """A course among the boxes of a tree."""
    return Course(ray, at, pace, moving.nanoseconds, moving.left)


@inlined
def box_of(tree, moving, slot):
    """The box of a slot as (lo, hi, velocity, reference)."""
    lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
    row = moving.kept.shape[0] - 1
    if slot < row and moving.kept[slot].owner == tree.handles[slot]:
        row = slot
    return lo, hi, moving.kept[row].velocity, moving.kept[row].reference


@inlined
def moves(box):
    """Whether it has a velocity that is not zero."""
    going = False
    for axis in range(box[2].shape[0]):
        going |= box[2][axis] != 0.0
    return going


@inlined
def fetch_box(tree, moving, slot):
    """Ask for the memory of what `box_of` reads."""
    prefetch(tree.handles, slot, 1)
    prefetch(moving.kept, slot, 1)
    if tree.tight.shape[0] > 0:
        prefetch(tree.tight, slot, 1)
    else:
        prefetch(tree.nodes, 2 * slot, 1)


@inlined
def _side(box, course, axis, lower):
    """One side of a box, and what of the ray meets it: (plane, front, velocity, reference,
    direction).
    """
    lo, hi, velocity, reference = box
    plane = lo[axis] if lower else hi[axis]
    front = course.ray[UPPER, axis] if lower else course.ray[ORIGIN, axis]
    return plane, front, velocity[axis], reference, course.ray[DIRECTION, axis]


@inlined
def _gap(course, side):
    plane, front, velocity, reference, _ = side
    return gap(plane, front, velocity, course.at, reference, course.nanoseconds)


@inlined
def _rate(course, side):
    return rate(side[4], side[2], course.pace, course.nanoseconds)


@lean_kernel
def _compare_exactly(side, times, other, other_times, whole):
    """Sign of gap / rate - the same of another side; both quotients not negative; times = (at,
    pace) of each, whole nanoseconds or not.
    """
    gaps, rates = stack_array(LIMBS, np.int64), stack_array(LIMBS, np.int64)
    other_gaps, other_rates = stack_array(LIMBS, np.int64), stack_array(LIMBS, np.int64)
    plane, front, velocity, reference, direction = side
    add_gap(gaps, plane, front, velocity, times[0], reference, whole)
    add_gap(rates, direction, 0.0, -velocity, times[1], 0.0, whole)
    plane, front, velocity, reference, direction = other
    add_gap(other_gaps, plane, front, velocity, other_times[0], reference, whole)
    add_gap(other_rates, direction, 0.0, -velocity, other_times[1], 0.0, whole)
    magnitude(gaps)
    magnitude(rates)
    magnitude(other_gaps)
    magnitude(other_rates)
    return compare_products(gaps, other_rates, other_gaps, rates)


@inlined
def compare(course, t, side, times, other_t, other, other_times):
    """The same, of which t and other_t are computed values."""
    if t * CLEAR + TINY < other_t:
        return np.int64(-1)
    if other_t * CLEAR + TINY < t:
        return np.int64(1)
    course.ray[EXACT, 0] = 1.0
    return _compare_exactly(side, times, other, other_times, course.nanoseconds)


@lean_kernel
def _compare(course, t, side, other_t, other):
    """The same of one course."""
    times = course.at, course.pace
    return compare(course, t, side, times, other_t, other, times)


@inlined
def _is_lower(face):
    return face & 1 == 0


@inlined
def side_of(box, course, face):
    """What `_side` says of a face."""
    return _side(box, course, face >> 1, _is_lower(face))


@inlined
def quotient_of(course, side):
    """The t at which a side is met."""
    return quotient(_gap(course, side), _rate(course, side))


@lean_kernel
def meet(box, course, t_max):
    """Exact decision of a course and a closed box that goes on: (hit, t, face).

    `face` is that of the axis entered last, ties to the lowest: 2 axis, or 2 axis + 1 for the
    upper one; INSIDE where they touch at the start.
    """
    t, entered = 0.0, np.int64(INSIDE)
    for axis in range(box[0].shape[0]):
        low, high = _side(box, course, axis, True), _side(box, course, axis, False)
        below, above = _gap(course, low), _gap(course, high)
        if not (below[0] > 0.0 or above[0] < 0.0):
            continue
        lower = below[0] > 0.0
        speed = _rate(course, low)
        if speed[0] == 0.0 or (speed[0] > 0.0) != lower:
            return False, np.inf, np.int64(INSIDE)
        distance = quotient(below if lower else above, speed)
        if entered != INSIDE:
            other = side_of(box, course, entered)
            if _compare(course, distance, low if lower else high, t, other) <= 0:
                continue
        t, entered = distance, np.int64(2 * axis + (0 if lower else 1))
    if entered == INSIDE:
        return True, 0.0, entered
    near = side_of(box, course, entered)
    for axis in range(box[0].shape[0]):
        speed = _rate(course, _side(box, course, axis, True))
        if axis != entered >> 1 and speed[0] != 0.0:
            far = _side(box, course, axis, speed[0] < 0.0)
            if _compare(course, t, near, quotient(_gap(course, far), speed), far) > 0:
                return False, np.inf, np.int64(INSIDE)
    if not math.isinf(t_max) and _compare(course, t, near, t_max, (t_max, 0.0, 0.0, 0.0, 1.0)) > 0:
        return False, np.inf, np.int64(INSIDE)
    return True, t, entered
