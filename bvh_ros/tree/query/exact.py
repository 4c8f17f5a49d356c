# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sign of a sum of products of doubles, as real arithmetic has it.

A Kulisch accumulator (Kulisch and Miranker 1986): a fixed-point number wide enough for every
product of two doubles, so that adding is integer arithmetic and nothing can round, overflow or
underflow. The smallest bit of a product is 2**-2148 and the largest below 2**2048: 4,196 bits,
kept as limbs of 32 bits in int64, whose upper halves hold the carries until the end.
"""

import math

import numpy as np

from ..compiler import inlined, lean_kernel, stack_array

LOWEST_BIT = 2148
LIMBS = 136
LIMB_BITS = 32
LIMB_MASK = (1 << LIMB_BITS) - 1
HALF_BITS = 27  # a 53-bit significand in two halves, so that a product of halves fits an int64
HALF_MASK = (1 << HALF_BITS) - 1


@inlined
def _deposit(limbs, value, bit, sign):
    """Add sign * value * 2**bit, for 0 <= value < 2**32."""
    limb = bit >> 5
    spread = value << (bit & 31)
    limbs[limb] += sign * (spread & LIMB_MASK)
    limbs[limb + 1] += sign * (spread >> LIMB_BITS)


@inlined
def _significand(x):
    """abs(x) as (bits, exponent), an integer below 2**53 times a power of two; exponent >= -1074,
    subnormals too.
    """
    fraction, exponent = math.frexp(abs(x))
    bits, place = np.int64(fraction * 2.0**53), np.int64(exponent) - 53
    if place < -1074:
        return bits >> (-1074 - place), np.int64(-1074)
    return bits, place


@lean_kernel
def add_product(limbs, x, y):
    """Add x * y to the accumulator, exactly."""
    if x == 0.0 or y == 0.0:
        return
    x_bits, x_exponent = _significand(x)
    y_bits, y_exponent = _significand(y)
    bit = x_exponent + y_exponent + LOWEST_BIT
    sign = np.int64(1) if (x < 0.0) == (y < 0.0) else np.int64(-1)
    for x_half in range(2):
        for y_half in range(2):
            product = ((x_bits >> (HALF_BITS * x_half)) & HALF_MASK) * (
                (y_bits >> (HALF_BITS * y_half)) & HALF_MASK
            )
            place = bit + HALF_BITS * (x_half + y_half)
            _deposit(limbs, product & LIMB_MASK, place, sign)
            _deposit(limbs, product >> LIMB_BITS, place + LIMB_BITS, sign)


@lean_kernel
def accumulator_sign(limbs):
    """-1, 0 or 1. Carries are passed upwards; the top limb then has the sign of the whole."""
    carry = np.int64(0)
    any_bit = np.int64(0)
    for limb in range(LIMBS):
        total = limbs[limb] + carry
        carry = total >> LIMB_BITS
        any_bit |= total & LIMB_MASK
    if carry < 0:
        return -1
    return 1 if any_bit | carry != 0 else 0


@lean_kernel
def sign_of_four_products(a, b, c, d, e, f, g, h):
    """Sign of a*b + c*d + e*f + g*h for finite doubles."""
    limbs = stack_array(LIMBS, np.int64)
    for limb in range(LIMBS):
        limbs[limb] = 0
    add_product(limbs, a, b)
    add_product(limbs, c, d)
    add_product(limbs, e, f)
    add_product(limbs, g, h)
    return accumulator_sign(limbs)


# ---- Sums and products of two doubles as unrounded sums of two (Knuth 1969; Dekker 1971).


HALVES = 2.0**27 + 1.0  # times a double, to part its digits in two halves


@inlined
def two_sum(a, b):
    """a + b without rounding."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@inlined
def two_product(a, b):
    """a * b without rounding."""
    product, large, other_large = a * b, HALVES * a, HALVES * b
    high, other_high = large - (large - a), other_large - (other_large - b)
    low, other_low = a - high, b - other_high
    error = high * other_high - product
    return product, ((error + high * other_low) + low * other_high) + low * other_low
