# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sums and products of two doubles as unrounded sums of two (Knuth 1969; Dekker 1971)."""

from .compiler import inlined

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
