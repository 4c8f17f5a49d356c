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
Axis = tuple[int, int, int]  # sides of the box from the origin, and the direction


class Root(NamedTuple):
    """The number middle - sqrt(square)."""

    middle: Fraction
    square: Fraction

    def __float__(self) -> float:
        """Within one ulp: as a quotient in which nothing cancels; not for numbers below zero."""
        if not self.square:
            return float(self.middle)
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
    ndim, (size, *numbers) = len(lo), _whole(radius, *lo, *hi, *origin, *direction)
    lows, highs, here, steps = (numbers[i : i + ndim] for i in range(0, 4 * ndim, ndim))
    axes = [
        (low - x, high - x, step)
        for low, high, x, step in zip(lows, highs, here, steps, strict=True)
    ]
    flat = _flat_touch(axes, size)
    if flat is not None:
        return flat
    limit = size**2
    if _quadratic(axes, Fraction(0))[2] <= limit:
        return START
    planes = {Fraction(plane, step) for low, high, step in axes if step for plane in (low, high)}
    crossings = sorted({Fraction(0), Fraction(1), *(t for t in planes if 0 < t < 1)})
    for begin, end in pairwise(crossings):
        a, b, c = _quadratic(axes, (begin + end) / 2)
        if a == 0:
            continue  # as far away all along as at its begin
        middle = Fraction(b, a)
        closest = min(max(middle, begin), end)
        if (a * closest - 2 * b) * closest + c <= limit:
            return Root(middle, middle**2 - Fraction(c - limit, a))
    return None


def _whole(*numbers: float) -> list[int]:
    """Doubles in units of one power of two: integers, as these take a tenth of the time."""
    ratios = [number.as_integer_ratio() for number in numbers]
    bits = max(divisor.bit_length() for _, divisor in ratios)
    return [number << (bits - divisor.bit_length()) for number, divisor in ratios]


def _flat_touch(axes: list[Axis], size: int) -> Root | None:
    """`first_touch` where that is of a face, much sooner told; None where it is not."""
    for axis, (low, high, step) in enumerate(axes):
        ahead, length = (low - size, step) if step > 0 else (-high - size, -step)
        others = axes[:axis] + axes[axis + 1 :]
        if 0 < ahead <= length and all(
            below * length <= way * ahead <= above * length for below, above, way in others
        ):
            return Root(Fraction(ahead, length), Fraction(0))
    return None


def _quadratic(axes: list[Axis], t: Fraction) -> tuple[int, int, int]:
    """The squared distance next to t: a t**2 - 2 b t + c, over the axes on which it is outside."""
    a = b = c = 0
    for low, high, step in axes:
        if not low <= step * t <= high:
            plane = low if step * t < low else high
            a, b, c = a + step**2, b + step * plane, c + plane**2
    return a, b, c


def compare(one: Root, other: Root) -> int:
    """Sign of one - other."""
    if one == other:
        return 0
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
