# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Accumulators of `exact_sign` as whole numbers: their magnitudes, leading digits and products."""

import numpy as np

from ..compiler import lean_kernel, stack_array
from ..rays.exact_sign import LIMB_BITS, LIMB_MASK, LIMBS, LOWEST_BIT
from ..unrounded import two_sum

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
