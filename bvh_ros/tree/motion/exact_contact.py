# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The exact decision of a ray, or a swept box, and a box that moves.

It decides as `query.slab` does of boxes at rest, in relative motion: on each axis `gap` is how far
a side of the box is ahead, `rate` how fast it comes nearer. Their signs are exact. A distance
along a ray, gap over rate, is computed within 2 ulp. Where that does not decide the order of two
of them, `compare_products` multiplies the four sums without rounding.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..batch.streams import ASK, MEETS, MISSES
from ..compiler import inlined, lean_kernel, prefetch, stack_array, trailing_zeros
from ..nodes import NONE, leaf_box
from ..query.exact import (
    LIMB_BITS,
    LIMB_MASK,
    LIMBS,
    LOWEST_BIT,
    add_product,
    two_product,
    two_sum,
)
from ..query.slab import CLEAR, DIRECTION, EXACT, INSIDE, ORIGIN, PAD, TINY, UPPER
from ..simd.moving_sides import moving_slabs

PRODUCT_LIMBS = 2 * LIMBS + 1
LIMB = 2.0**LIMB_BITS


@lean_kernel
def clear(limbs):
    """limbs (n,) int64 = 0."""
    for i in range(limbs.shape[0]):
        limbs[i] = 0


@lean_kernel
def magnitude(limbs):
    """Bring limbs (n,) int64 to 0 <= limb < 2**32, those of the magnitude; return the sign."""
    carry, sign = np.int64(0), np.int64(0)
    for i in range(limbs.shape[0]):
        total = limbs[i] + carry
        limbs[i], carry = total & LIMB_MASK, total >> LIMB_BITS
        sign |= limbs[i]
    if carry >= 0:
        return np.int64(sign | carry != 0)
    carry = np.int64(1)  # the two's complement
    for i in range(limbs.shape[0]):
        total = (~limbs[i] & LIMB_MASK) + carry
        limbs[i], carry = total & LIMB_MASK, total >> LIMB_BITS
    return np.int64(-1)


@lean_kernel
def _ends(limbs):
    """(first, last + 1) of the limbs that are not 0."""
    first, end = 0, limbs.shape[0]
    while end > 0 and limbs[end - 1] == 0:
        end -= 1
    while first < end and limbs[first] == 0:
        first += 1
    return first, end


@lean_kernel
def leading(limbs):
    """The leading digits of a magnitude: (high, low, exponent), 97 bits at least."""
    end = _ends(limbs)[1]
    if end == 0:
        return 0.0, 0.0, np.int64(0)
    top = end - 1
    high, low = float(limbs[top]), 0.0
    if top >= 1:
        high, low = two_sum(high, limbs[top - 1] / LIMB)
    if top >= 2:
        low += limbs[top - 2] / LIMB**2
    if top >= 3:
        low += limbs[top - 3] / LIMB**3
    high, low = two_sum(high, low)  # the top limb may hold one bit
    return high, low, np.int64(LIMB_BITS * top - LOWEST_BIT)


@lean_kernel
def _add_product(into, one, other, sign):
    """Add sign * one * other, two magnitudes."""
    first, end = _ends(one)
    other_first, other_end = _ends(other)
    for i in range(first, end):
        for j in range(other_first, other_end):
            product = np.uint64(one[i]) * np.uint64(other[j])
            into[i + j] += sign * np.int64(product & np.uint64(LIMB_MASK))
            into[i + j + 1] += sign * np.int64(product >> np.uint64(LIMB_BITS))


@lean_kernel
def compare_products(a, b, c, d):
    """The sign of a * b - c * d for four magnitudes."""
    limbs = stack_array(PRODUCT_LIMBS, np.int64)
    clear(limbs)
    _add_product(limbs, a, b, np.int64(1))
    _add_product(limbs, c, d, np.int64(-1))
    return magnitude(limbs)


CANCELLED = 2.0**-40
SMALL, LARGE = 2.0**-900, 2.0**900
DOUBT = 2.0**-50  # of the terms of a sum of three: more than its rounding
A_SECOND, A_NANOSECOND = 1e9, 1e-9


@inlined
def elapsed(at, reference, nanoseconds):
    """at - reference in s as (what it is rounded, what that lacks)."""
    if not nanoseconds:
        return two_sum(at, -reference)
    whole, rest = two_sum(np.rint(at * A_SECOND), -np.rint(reference * A_SECOND))
    since = whole * A_NANOSECOND
    product, error = two_product(since, A_SECOND)
    return since, ((whole - product) - error + rest) * A_NANOSECOND


@lean_kernel
def gap(plane, front, velocity, at, reference, nanoseconds):
    """plane - front + velocity * (at - reference) as (high, low, exponent)."""
    since, lost = elapsed(at, reference, nanoseconds)
    if velocity == 0.0 or since == 0.0:
        apart, least = two_sum(plane, -front)
        if apart == 0.0 or SMALL < abs(apart) < LARGE:
            return apart, least, 0
    else:
        high, low, enough = quick_gap(plane, front, velocity, since, lost)
        if enough:
            return high, low, 0
    return exact_gap(plane, front, velocity, at, reference, nanoseconds)


@inlined
def quick_gap(plane, front, velocity, since, lost):
    """`gap` in doubles, since + lost = at - reference: (high, low, whether that is enough)."""
    shift, below = two_product(velocity, since)
    apart, least = two_sum(plane, -front)
    total, rest = two_sum(apart, shift)
    rest += below + velocity * lost + least
    high = total + rest
    largest = max(abs(plane), abs(front), abs(shift))
    enough = (max(CANCELLED * largest, SMALL) < abs(high)) & (largest < LARGE)
    return high, rest - (high - total), enough


@inlined
def surely_below(plane, front, shift):
    """Whether plane - front + shift is below zero, beyond its rounding."""
    doubt = (abs(plane) + abs(front) + abs(shift)) * DOUBT
    return (plane - front) + shift < -(doubt + SMALL)


@inlined
def rate(direction, velocity, pace, nanoseconds):
    """direction - velocity * pace as (high, low, exponent)."""
    return gap(direction, 0.0, -velocity, pace, 0.0, nanoseconds)


@lean_kernel
def exact_gap(plane, front, velocity, at, reference, nanoseconds):
    """`gap`, added up without rounding."""
    limbs = stack_array(LIMBS, np.int64)
    add_gap(limbs, plane, front, velocity, at, reference, nanoseconds)
    sign = magnitude(limbs)
    high, low, exponent = leading(limbs)
    if nanoseconds:
        share = high / A_SECOND
        product, error = two_product(share, A_SECOND)
        high, low = share, ((high - product) - error + low) / A_SECOND
    return sign * high, sign * low, exponent


@lean_kernel
def add_gap(limbs, plane, front, velocity, at, reference, nanoseconds):
    """Let an accumulator hold `gap`; 10**9 times of it where times are whole nanoseconds, of which
    a second is no sum of products.
    """
    clear(limbs)
    second = 1.0
    if nanoseconds:
        second, at, reference = A_SECOND, np.rint(at * A_SECOND), np.rint(reference * A_SECOND)
    add_product(limbs, plane, second)
    add_product(limbs, front, -second)
    add_product(limbs, velocity, at)
    add_product(limbs, -velocity, reference)


@lean_kernel
def quotient(above, below):
    """The quotient of two triples, within 2 ulp; inf where it exceeds the largest double, within
    1e-323 where it is subnormal.
    """
    (high, low, exponent), (divisor, rest, other_exponent) = above, below
    share = high / divisor
    if SMALL < abs(share) < LARGE:
        product, error = two_product(share, divisor)
        share += ((high - product) - error + (low - share * rest)) / divisor
    return share if exponent == other_exponent else math.ldexp(share, exponent - other_exponent)


@functools.cache
def velocity_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a slot: the velocity, m/s, of the box `owner`, and the time at which that box is
    at its place in the tree, s. Another box in the slot has no velocity.
    """
    velocity = 'velocity', np.float64, (ndim,)
    return np.dtype([('owner', np.int64), ('reference', np.float64), velocity])


def velocity_records(capacity: int, ndim: int, old: NDArray[Any] | None = None) -> NDArray[Any]:
    """Records for so many slots, with the contents of smaller ones, and a last record for boxes
    without a velocity.
    """
    new = np.zeros(capacity + 1, velocity_dtype(ndim))
    new['owner'] = NONE
    if old is not None:
        new[: len(old) - 1] = old[:-1]
    return new


class Moving(NamedTuple):
    """The motion of a tree's boxes, for kernels."""

    velocities: NDArray[Any]
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
    """Boxes move for so long after their reference time, s, and then stand; inf if for ever."""


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
    row = moving.velocities.shape[0] - 1
    if slot < row and moving.velocities[slot].owner == tree.handles[slot]:
        row = slot
    return lo, hi, moving.velocities[row].velocity, moving.velocities[row].reference


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
    prefetch(moving.velocities, slot, 1)
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


STOPPED = 16  # is added to the face of a box that had come to rest when it was met
LATER = 2.0**-40  # of times: more than is lost as the last of a course is computed


@inlined
def end_of(box, left):
    """When a box stops, s; inf if it never does."""
    return box[3] + left if moves(box) else np.inf


@inlined
def moment_of(box, at, left):
    """A time, or the end if that was before: the box is at one place at both."""
    return min(at, box[3] + left)


@inlined
def _standing(course, end):
    """A course past a box that stands where it is at the end."""
    return Course(course.ray, end, 0.0, course.nanoseconds, np.inf)


@inlined
def _stop(end):
    """A side that is met when time is up: its gap is end - at, its rate the pace."""
    return 0.0, 0.0, -1.0, end, 0.0


@inlined
def phase_at_hit(box, course, face):
    """The course in the phase of a box in which it was met, moving or at rest, and the face."""
    end = end_of(box, course.left)
    if face >= STOPPED + INSIDE:
        return _standing(course, end), face - STOPPED
    return (_standing(course, end) if end < course.at else course), face


@inlined
def _after_the_end(box, phase, t, face, course, end):
    """Sign of the t at which a face is met, in a phase of the box, less the t at which it
    stops.
    """
    stop = _stop(end)
    times, other = (phase.at, phase.pace), (course.at, course.pace)
    return compare(
        phase, t, side_of(box, phase, face), times, quotient_of(course, stop), stop, other
    )


@lean_kernel
def _meet_both(box, course, t_max, end):
    """`meet_box` of a box that moves when the course starts, and may stop meanwhile."""
    hit, t, face = meet(box, course, t_max)
    if hit and (face == INSIDE or _after_the_end(box, course, t, face, course, end) <= 0):
        return hit, t, face
    phase = _standing(course, end)
    hit, t, face = meet(box, phase, t_max)
    if hit:
        hit = face != INSIDE and _after_the_end(box, phase, t, face, course, end) >= 0
    return hit, t, face + STOPPED


@inlined
def meet_box(box, course, t_max):
    """`meet` of a box that may stop: (hit, t, face); `phase_at_hit` reads the face."""
    end = end_of(box, course.left)
    if end < course.at:
        return meet(box, _standing(course, end), t_max)
    if course.pace > 0.0 and not _is_over(course, t_max, end):
        return _meet_both(box, course, t_max, end)
    return meet(box, course, t_max)


@inlined
def _is_over(course, t_max, end):
    """Whether a course surely is before the end."""
    duration = course.pace * t_max
    more = (abs(course.at) + duration) * LATER + (1.0 + t_max) * A_NANOSECOND
    return course.at + duration + more < end or end == np.inf


@inlined
def face_met(box, course, t_max, t, face):
    """The face that `meet_box` says, of which t and the axis are known."""
    end = end_of(box, course.left)
    if end < course.at or course.pace <= 0.0 or _is_over(course, t, end):
        return face
    more = (abs(end) + abs(course.at)) * LATER + (1.0 + t) * A_NANOSECOND
    if course.at + course.pace * t > end + more:
        return face + STOPPED
    return meet_box(box, course, t_max)[2]


@inlined
def distance_of(box, course, face):
    """t of `meet_box`, given its face."""
    phase, face = phase_at_hit(box, course, face)
    return 0.0 if face == INSIDE else quotient_of(phase, side_of(box, phase, face))


@lean_kernel
def is_before(tree, moving, course, hit, other):
    """Whether the first of two hits of a course, `query.ray.Hit` with faces for axes, is the
    nearer, or as near with the smaller handle.
    """
    box, other_box = box_of(tree, moving, hit.slot), box_of(tree, moving, other.slot)
    phase, face = phase_at_hit(box, course, hit.axis)
    other_phase, other_face = phase_at_hit(other_box, course, other.axis)
    order = np.int64(face != INSIDE) - np.int64(other_face != INSIDE)
    if face != INSIDE and other_face != INSIDE:
        times, other_times = (phase.at, phase.pace), (other_phase.at, other_phase.pace)
        side = side_of(box, phase, face)
        other_side = side_of(other_box, other_phase, other_face)
        order = compare(course, hit.t, side, times, other.t, other_side, other_times)
    return order < 0 or (order == 0 and tree.handles[hit.slot] < tree.handles[other.slot])


# Below SLOWEST, the speed of a ray towards a box counts as none. The t of a hit may be NEAR, as a
# share, from that of the same box's record.
SLOWEST, NEAR = 1e-290, 2.0**-16
FASTEST, LEAST_32 = 1e30, np.float32(1e-37)
LOST = 2.0**-44  # of lengths: more than a ray and a box that are written here lose by rounding


@inlined
def quick_decision(leaves, slot, origin, direction, since, pace, limit):
    """Decide where rounding cannot matter: (verdict, t, face), as `wide.best_hit.quick_decision`.
    `since` the start of the span.

    MEETS: surely met, and before `limit`, at `face`; t is not before that, nor later by more than
    NEAR of it.
    """
    missed, doubt, entry, leave, entered_by, others_by, surely, lanes, negative, within = (
        moving_slabs(leaves, slot, origin, direction, since, pace, 0.0, SLOWEST)
    )
    if within and limit > 0.0:
        return MEETS, 0.0, INSIDE
    if missed or entry > min(leave, limit) * PAD + TINY:
        return MISSES, limit, INSIDE
    surely = min(surely, limit * (1.0 - NEAR))
    clear = others_by * PAD < entry and entered_by * PAD < surely and not doubt
    if clear and lanes & (lanes - 1) == 0 and entered_by < entry * (1.0 + 0.5 * NEAR):
        axis = np.int64(trailing_zeros(np.uint32(lanes)))
        return MEETS, entered_by, 2 * axis + (negative >> axis & 1)
    return ASK, limit, INSIDE


@inlined
def may_meet(leaves, slot, origin, direction, since, pace, limit, more):
    """Whether a course may meet a leaf before `limit` whose box is larger by `more` on all sides;
    as `quick_decision`, where it does not say MISSES.
    """
    missed, _, entry, leave, _, _, _, _, _, _ = moving_slabs(
        *(leaves, slot, origin, direction, since, pace, more, SLOWEST)
    )
    return not (missed | (entry > min(leave, limit) * PAD + TINY))


@lean_kernel
def quick_decision_of_both(tree, moving, leaves, slot, path, limit):
    """`quick_decision` of a box that moves for a part of a path = (origin, direction, at, pace),
    and then stands: by a record of each part. `leaves` has the type of these.
    """
    (origin, direction, at, pace), box = path, box_of(tree, moving, slot)
    part, end, until = stack_array(1, leaves), box[3] + moving.left, np.inf
    if end < at:
        until = -1.0
    elif pace > 0.0:
        until = (end - at) / pace
    if until >= 0.0:
        first = min(limit, until)
        span = at, (end if pace > 0.0 else at)
        _write_part(part[0], box, box[2], span, origin)
        verdict, t, face = quick_decision(part, 0, origin, direction, 0.0, pace, first)
        if verdict == MEETS and t < until * (1.0 - 2.0 * NEAR):
            return verdict, t, np.int64(face)
        if verdict != MISSES or until > limit * (1.0 + NEAR):
            return (ASK if verdict == MEETS else verdict), limit, np.int64(INSIDE)
    still = stack_array(3, np.float64)
    still[:] = 0.0
    _write_part(part[0], box, still, (end, end), origin)
    verdict, t, face = quick_decision(part, 0, origin, direction, 0.0, 0.0, limit)
    if verdict == MEETS and until >= 0.0:
        if face == INSIDE or t <= until * (1.0 + 2.0 * NEAR):
            return ASK, limit, np.int64(INSIDE)
        face += STOPPED
    return verdict, t, np.int64(face)


@inlined
def _write_part(leaf, box, velocity, span, origin):
    """Write the record of a box that goes at a velocity from the first time of a span to its last,
    for a ray from an origin. Where they meet on an axis, the ray has gone no further than the sum
    of all that `more` is a share of.
    """
    (lo, hi, given, reference), (start, stop) = box, span
    leaf.loose = np.float32(0.0)
    for axis in range(lo.shape[0]):
        speed = np.float32(velocity[axis] if abs(velocity[axis]) < FASTEST else 0.0)
        shift, rest = given[axis] * (start - reference), velocity[axis] - np.float64(speed)
        rest *= stop - start
        more = abs(lo[axis]) + abs(hi[axis]) + abs(origin[axis])
        more += abs(given[axis]) * (abs(start) + abs(stop) + abs(reference))
        more = more * LOST + SLOWEST
        leaf.velocity[axis] = speed
        leaf.lo[axis] = lo[axis] + shift + min(rest, 0.0) - more
        leaf.hi[axis] = hi[axis] + shift + max(rest, 0.0) + more
        # By half more, as it is a float32.
        loose = np.float32((abs(rest) + 3.0 * more) * 1.5) + LEAST_32
        leaf.loose = max(leaf.loose, loose)
