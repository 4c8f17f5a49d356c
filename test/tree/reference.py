# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a tree must answer: brute force over all boxes, in exact arithmetic.

Doubles are whole numbers of one small power of two, so in that unit every difference and product
of coordinates is a Python integer: nothing rounds, overflows or vanishes. A distance along a ray
is a `Fraction` of two of them.
"""

import math
import os
from collections.abc import Iterable, Sequence
from fractions import Fraction
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numba import config
from numpy.typing import ArrayLike, NDArray

from bvh_ros import DynamicBVH, RayHit

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

LONG = bool(os.environ.get('BVH_ROS_LONG_TESTS'))
LARGEST = 1.7976931348623157e308
SMALLEST = 5e-324
INSIDE = -1


def effort(short: int, long: int) -> int:
    """How much to try, or, where `short` is more than `long`, a stride: `long` where the
    environment sets BVH_ROS_LONG_TESTS, and a third of the effort where NUMBA_BOUNDSCHECK has code
    check its indices. A wrong one is met sooner than a wrong answer, and those are looked for in
    full where code is as it is used.
    """
    if LONG:
        return long
    if not config.BOUNDSCHECK:
        return short
    return 3 * short if short > long else -(-short // 3)


class ExactHit(NamedTuple):
    """One box that a ray meets."""

    t: Fraction
    row: int
    axis: int
    """The axis entered last, ties to the lowest; INSIDE where the ray starts in the box."""


by_t = attrgetter('t')  # fractions are slow to compare: once each, and not for == before <


# ---- rays


def exact_hits(
    lo: Floats, hi: Floats, origins: Floats, directions: Floats
) -> list[list[ExactHit]]:
    """For every ray all boxes that it meets, by exact t, then row."""
    return _exact_hits(lo, hi, origins, origins, directions)


def exact_sweeps(
    lo: Floats, hi: Floats, low: Floats, high: Floats, translations: Floats
) -> list[list[ExactHit]]:
    """For every swept box all boxes that it touches on its way, t at most 1, by exact t, then
    row.
    """
    sweeps = _exact_hits(lo, hi, low, high, translations)
    return [[hit for hit in hits if hit.t <= 1] for hits in sweeps]


def _exact_hits(*corners: Floats) -> list[list[ExactHit]]:
    bits = finest(corners)
    lo, hi, *asked = ([whole(row, bits) for row in rows] for rows in corners)
    boxes = list(zip(lo, hi, strict=True))
    return [_hits_of_box(boxes, *one) for one in zip(*asked, strict=True)]


def finest(arrays: Iterable[ArrayLike]) -> int:
    """All these doubles are whole numbers in units of 2**-bits."""
    values = np.concatenate([np.ravel(array) for array in arrays]).tolist()
    return max(x.as_integer_ratio()[1].bit_length() - 1 for x in values)


def whole(values: ArrayLike, bits: int) -> list[int]:
    """Doubles in units of 2**-bits."""
    ratios = [x.as_integer_ratio() for x in np.ravel(values).tolist()]
    return [n << (bits + 1 - d.bit_length()) for n, d in ratios]


def _hits_of_box(
    boxes: list[tuple[list[int], list[int]]], low: list[int], high: list[int], ways: list[int]
) -> list[ExactHit]:
    hits = []
    for row, (lo, hi) in enumerate(boxes):
        sides = zip(lo, hi, low, high, ways, strict=True)
        entry = latest_entry([(a - top, b - bottom, way) for a, b, bottom, top, way in sides])
        if entry is not None:
            hits.append(ExactHit(entry[0], row, entry[1]))
    return sorted(hits, key=by_t)  # rows are in order, and stay so where t is the same


def latest_entry(gaps: list[tuple[int, int, int]]) -> tuple[Fraction, int] | None:
    """Of axes (near, far, way), sides at distances near / way and far / way: the latest entry, not
    before 0, and its axis, unless it is after the earliest leave.
    """
    entry, entry_over, entered = 0, 1, INSIDE
    leave, leave_over = 1, 0  # infinity
    for axis, (near, far, way) in enumerate(gaps):
        if way == 0:
            if near > 0 or far < 0:
                return None
            continue
        if way < 0:
            near, far, way = -far, -near, -way
        if near * entry_over > entry * way:
            entry, entry_over, entered = near, way, axis
        if far * leave_over < leave * way:
            leave, leave_over = far, way
    if entry * leave_over > leave * entry_over:
        return None
    return Fraction(entry, entry_over), entered


def seen(
    hits: Sequence[ExactHit],
    handles: Ids,
    t_max: float = math.inf,
    skip_inside: bool = False,
    visible: NDArray[np.bool_] | None = None,
) -> list[ExactHit]:
    """The hits that a query with these limits returns, by exact t, then handle. `visible` says
    which rows the mask sees.
    """
    limit = None if math.isinf(t_max) else Fraction(t_max)
    kept = [
        hit
        for hit in hits
        if (limit is None or hit.t <= limit)
        and not (skip_inside and hit.axis == INSIDE)
        and (visible is None or visible[hit.row])
    ]
    return sorted(sorted(kept, key=lambda hit: handles[hit.row]), key=by_t)


def is_within_2_ulp(t: float, exact: Fraction) -> bool:
    """Whether t is as near to the exact distance as promised; infinite where that exceeds the
    largest double.
    """
    ulp = Fraction(math.ulp(min(float(min(exact, Fraction(LARGEST))), LARGEST)))
    if math.isinf(t):
        return exact > Fraction(LARGEST) - 2 * ulp
    return abs(Fraction(t) - exact) <= 2 * ulp


def check_hit(
    hit: RayHit, exact: ExactHit, lo: Floats, hi: Floats, sweep: tuple[Floats, Floats, Floats]
) -> None:
    """Check everything that is promised of one hit but its handle; lo and hi are of the box that
    is met; `sweep` is the corners of the swept box, and its way. A ray is a box whose corners are
    its origin.
    """
    low, high, way = sweep
    normal = np.zeros(len(lo))
    if exact.axis != INSIDE:
        normal[exact.axis] = -np.sign(way[exact.axis])
        assert hit.point[exact.axis] == (lo if way[exact.axis] > 0 else hi)[exact.axis]
    assert hit.normal.tolist() == normal.tolist()
    assert is_within_2_ulp(hit.t, exact.t), (hit.t, float(exact.t))
    assert (lo <= hit.point).all()
    assert (hit.point <= hi).all()
    if exact.axis == INSIDE:
        assert hit.t == 0.0
    if math.isinf(hit.t):
        return
    for axis in range(len(lo)):
        if axis != exact.axis:
            start = (Fraction(low[axis]) + Fraction(high[axis])) / 2
            place = exact.t * Fraction(way[axis]) + start
            place = min(max(place, Fraction(lo[axis])), Fraction(hi[axis]))
            _check_coordinate(hit.point[axis], place, exact.t, start, Fraction(way[axis]))


def _check_coordinate(
    got: float, place: Fraction, t: Fraction, start: Fraction, way: Fraction
) -> None:
    """It is the exact one within a few roundings of the numbers that make it."""
    slack = (abs(t * way) + abs(start)) * Fraction(2, 10**15)
    slack += Fraction(SMALLEST) * (4 + 4 * abs(way))
    assert abs(Fraction(got) - place) <= slack, (got, float(place))


# ---- boxes and points: comparisons of doubles are exact by themselves


def overlapping_rows(lo: Floats, hi: Floats, low: Floats, high: Floats) -> Ids:
    """Rows of the boxes that touch the closed box from low to high."""
    return np.flatnonzero(((lo <= high) & (low <= hi)).all(axis=1))


def overlapping_pairs(lo: Floats, hi: Floats) -> list[tuple[int, int]]:
    """Pairs of rows of touching boxes, the smaller row first, sorted."""
    return [
        (row, int(other) + row + 1)
        for row in range(len(lo))
        for other in overlapping_rows(lo[row + 1 :], hi[row + 1 :], lo[row], hi[row])
    ]


def squared_distance(lo: Floats, hi: Floats, point: Floats) -> Fraction:
    """Exact square of the distance of a point from a closed box."""
    bits = finest((lo, hi, point))
    total = 0
    for low, high, x in zip(*(whole(side, bits) for side in (lo, hi, point)), strict=True):
        total += max(low - x, 0, x - high) ** 2
    return Fraction(total, 1 << 2 * bits)


def is_distance(value: float, square: Fraction, roundings: float) -> bool:
    """Whether it is the root, within so many roundings."""
    if math.isinf(value):
        return square > Fraction(LARGEST) ** 2
    slack = Fraction(value) * Fraction(roundings) / 2**53 + 20 * Fraction(SMALLEST)
    low, high = max(Fraction(value) - slack, Fraction(0)), Fraction(value) + slack
    return low * low <= square <= high * high


def half_area(lo: Floats, hi: Floats) -> Fraction:
    """Exact half of the surface area of a box in 3D, of the perimeter in 2D."""
    edges = [Fraction(h) - Fraction(s) for s, h in zip(lo.tolist(), hi.tolist(), strict=True)]
    if len(edges) == 2:
        return sum(edges, Fraction(0))
    x, y, z = edges
    return x * y + y * z + z * x


# ---- trees


def snapshot(tree: DynamicBVH) -> tuple[object, ...]:
    """All that a caller can see of a tree without asking it where boxes are met."""
    lo, hi = tree.boxes(tree.ids())
    masks = tree.masks(tree.ids())
    return tree.ids().tolist(), lo.tolist(), hi.tolist(), masks.tolist(), tree.cost(), tree.height
