# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lengths that neither overflow nor vanish."""

import math

from ...tree.compiler import inlined, lean_kernel

LARGE, SMALL = 2.0**200, 2.0**-200  # between them lengths may be multiplied four times


@inlined
def scale_of(largest):
    """The power of two that brings lengths between SMALL and LARGE; 1 where they are."""
    if SMALL < largest < LARGE or largest == 0.0:
        return 1.0
    return math.ldexp(1.0, min(max(-math.frexp(largest)[1], -1000), 1000))


@inlined
def hypot(one, other):
    """`math.hypot`, to the last digit, in less time where one of the two is zero."""
    if one == 0.0:
        return abs(other)
    return abs(one) if other == 0.0 else math.hypot(one, other)


@lean_kernel
def length(vector):
    """Euclidean length; neither overflows nor vanishes where the result does not."""
    total = abs(vector[0])
    for axis in range(1, vector.shape[0]):
        total = hypot(total, vector[axis])
    return total
