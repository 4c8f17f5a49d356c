# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far a plane that moves is from what may meet it, and how fast the two come together.

At time `at` a plane that was told at `reference` is ahead of a front by

    gap = plane - front + velocity * (at - reference),

and a front that moves by `direction` a unit of t, while time goes by `pace`, comes nearer by

    rate = direction - velocity * pace.

They meet at t = gap / rate. Times may stand for whole nanoseconds (`Moving.nanoseconds`), few of
which are doubles of seconds: then `at`, `reference` and `pace` mean the nearest ones.

Differences of such sums lose digits where terms cancel. So each is a triple (high, low, exponent),
(high + low) * 2**exponent, of a relative error below 2**-55, with the sign that real arithmetic
gives it, 0 only where it is. In doubles, the terms' errors kept, it is wrong by less than 2**-100
of its largest term: enough unless it is smaller than 2**-40 of that one, or leaves 2**-900 ..
2**900. Then `wide_numbers` adds it up without rounding.
"""

import math

import numpy as np

from ..compiler import inlined, lean_kernel, stack_array
from ..rays.exact_sign import LIMBS, add_product
from ..unrounded import two_product, two_sum
from .wide_numbers import clear, leading, magnitude

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
    way, below = two_product(velocity, since)
    apart, least = two_sum(plane, -front)
    total, rest = two_sum(apart, way)
    rest += below + velocity * lost + least
    high = total + rest
    largest = max(abs(plane), abs(front), abs(way))
    enough = (max(CANCELLED * largest, SMALL) < abs(high)) & (largest < LARGE)
    return high, rest - (high - total), enough


@inlined
def surely_below(plane, front, way):
    """Whether plane - front + way is below zero, as far as its rounding tells that."""
    doubt = (abs(plane) + abs(front) + abs(way)) * DOUBT
    return (plane - front) + way < -(doubt + SMALL)


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
