# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When a swept ball touches an axis-aligned box, in exact arithmetic.

The squared distance of origin + t * direction from a box is convex in t and, between two of
planes of faces, a quadratic with rational coefficients. So the first contact is the smaller root
of one of them, middle - sqrt(square), and two of those can be told apart by squaring twice.
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from math import isqrt
from typing import NamedTuple

DIGITS = 70  # bits of a root, at least, before it is rounded to a double


class Root(NamedTuple):
    """The number middle - sqrt(square)."""

    middle: Fraction
    square: Fraction

    def __float__(self) -> float:
        """Within one ulp: as a quotient in which nothing cancels; not for numbers below zero."""
        total = self.middle + _square_root(self.square)
        return float((self.middle**2 - self.square) / total) if total else 0.0


START = Root(Fraction(0), Fraction(0))


def rational(t: float) -> Root:
    """A double as a root."""
    return Root(Fraction(t), Fraction(0))


def first_touch(
    lo: Sequence[float],
    hi: Sequence[float],
    origin: Sequence[float],
    direction: Sequence[float],
    radius: float,
) -> Root | None:
    """The least t from 0 to 1 at which origin + t * direction is within `radius` of the box; None
    if there is none, START if it is from the beginning.
    """
    axes = [
        (Fraction(low) - Fraction(x), Fraction(high) - Fraction(x), Fraction(step))
        for low, high, x, step in zip(lo, hi, origin, direction, strict=True)
    ]
    limit = Fraction(radius) ** 2
    if _quadratic(axes, Fraction(0))[2] <= limit:
        return START
    planes = {plane / step for low, high, step in axes if step for plane in (low, high)}
    crossings = sorted({Fraction(0), Fraction(1), *(t for t in planes if 0 < t < 1)})
    for begin, end in pairwise(crossings):
        a, b, c = _quadratic(axes, (begin + end) / 2)
        if a == 0:
            continue  # as far away all along as at its begin
        middle = b / a
        closest = min(max(middle, begin), end)
        if (a * closest - 2 * b) * closest + c <= limit:
            return Root(middle, middle**2 - (c - limit) / a)
    return None


def _quadratic(
    axes: list[tuple[Fraction, Fraction, Fraction]], t: Fraction
) -> tuple[Fraction, Fraction, Fraction]:
    """The squared distance next to t: a t**2 - 2 b t + c, over the axes on which it is outside."""
    a, b, c = Fraction(0), Fraction(0), Fraction(0)
    for low, high, step in axes:
        if not low <= step * t <= high:
            plane = low if step * t < low else high
            a, b, c = a + step**2, b + step * plane, c + plane**2
    return a, b, c


def compare(one: Root, other: Root) -> int:
    """Sign of one - other."""
    gap = one.middle - other.middle
    lean = _sign(one.square - other.square)  # of the difference of the square roots
    if _sign(gap) != lean:
        return _sign(_sign(gap) - lean)
    # Both differences point the same way: |gap| against |sqrt a - sqrt b|, by their squares.
    rest = one.square + other.square - gap**2
    return lean * (1 if rest < 0 else _sign(4 * one.square * other.square - rest**2))


def _sign(x: Fraction | int) -> int:
    return (x > 0) - (x < 0)


def _square_root(x: Fraction) -> Fraction:
    """Rounded down, to a relative error below 2**-DIGITS."""
    product = x.numerator * x.denominator
    shift = max(DIGITS + 1 - product.bit_length() // 2, 0)
    return Fraction(isqrt(product << 2 * shift), x.denominator << shift)
