# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of twice the digits: the unrounded sum of two doubles, the second below the last digit
of the first (Dekker, "A Floating-Point Technique for Extending the Available Precision", 1971).

A number is a pair (high, low); a vector is an array (3, 2). Lengths are about 1.
"""

import numpy as np

from ...tree.access import two_product, two_sum
from ...tree.compiler import lean_kernel


@lean_kernel
def plus(a, b):
    total, error = two_sum(a[0], b[0])
    below, least = two_sum(a[1], b[1])
    total, error = two_sum(total, error + below)
    return two_sum(total, error + least)


@lean_kernel
def times(a, b):
    product, error = two_product(a[0], b[0])
    return two_sum(product, error + (a[0] * b[1] + a[1] * b[0]))


@lean_kernel
def over(a, b):
    share = a[0] / b[0]
    product = times(b, (share, 0.0))
    rest = plus(a, (-product[0], -product[1]))
    return two_sum(share, rest[0] / b[0])


@lean_kernel
def dot2(one, other):
    total = np.float64(0.0), np.float64(0.0)
    for axis in range(3):
        part = times((one[axis, 0], one[axis, 1]), (other[axis, 0], other[axis, 1]))
        total = plus(total, part)
    return total


@lean_kernel
def cross2(one, other, out):
    """Fill in the cross product."""
    for axis in range(3):
        y, z = (axis + 1) % 3, (axis + 2) % 3
        first = times((one[y, 0], one[y, 1]), (other[z, 0], other[z, 1]))
        second = times((one[z, 0], one[z, 1]), (other[y, 0], other[y, 1]))
        out[axis, 0], out[axis, 1] = plus(first, (-second[0], -second[1]))
