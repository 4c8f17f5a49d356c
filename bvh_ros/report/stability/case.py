# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One row of the table of stability: what was asked, what is right, and what was answered."""

import math
from fractions import Fraction
from typing import NamedTuple

LARGEST = 1.7976931348623157e308
NOT_ASKED = '-'

HEADER = ('case', 'input', 'expected', 'got', 'verdict', 'float64 slab')


class Case(NamedTuple):
    """A case and its verdict."""

    name: str
    asked: str
    expected: str
    """By exact arithmetic, or the bound that is promised."""
    got: str
    passed: bool
    slab: str = NOT_ASKED
    """What the usual float64 slab test says."""

    def cells(self) -> list[str]:
        """The row under `HEADER`."""
        verdict = 'PASS' if self.passed else 'FAIL'
        return [self.name, self.asked, self.expected, self.got, verdict, self.slab]


def rounded(exact: Fraction) -> float:
    """The nearest double; inf where the largest is exceeded."""
    try:
        return float(exact)
    except OverflowError:
        return math.inf


def within_2_ulp(t: float, exact: Fraction) -> bool:
    """Whether a distance is as near to the exact one as the tree promises."""
    nearest = rounded(exact)
    if math.isinf(t) or math.isinf(nearest):
        return max(t, nearest) == math.inf and min(t, nearest) >= math.nextafter(LARGEST, 0.0)
    slack = 1e-323 if nearest < 2.3e-308 else 2 * math.ulp(nearest)
    return abs(Fraction(t) - exact) <= Fraction(slack)
