# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where rays enter boxes, spheres and cylinders, in whole numbers: nothing of the tree is used.

Doubles are whole multiples of one small power of two. In that unit a ray and a box are integers. A
turned shape is seen from its own frame: the matrix of a quaternion q that is not normalised turns
and stretches by |q|^2, and a distance along a ray stays what it is when the whole world is
stretched. So the rotation of any given quaternion is exact as well. Square roots (of spheres and
cylinders) are cut off after `ROOT_BITS` bits, far below anything a double could show.
"""

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

from ...scene.geometry.shapes import ShapeKind, Shapes

Whole = list[int]
ROOT_BITS = 256


def bits_below_the_point(values: Iterable[float]) -> int:
    """Least number of binary places that writes all the values exactly."""
    return max((x.as_integer_ratio()[1].bit_length() - 1 for x in values), default=0)


def whole(values: Iterable[float], bits: int) -> Whole:
    """The values in units of 2**-bits."""
    ratios = (x.as_integer_ratio() for x in values)
    return [n << (bits + 1 - d.bit_length()) for n, d in ratios]


def enter_slabs(near: Sequence[int], far: Sequence[int], way: Sequence[int]) -> Fraction | None:
    """Where a ray enters a closed box; near and far are its planes seen from the ray's origin."""
    entry, entry_over = 0, 1
    leave, leave_over = 1, 0  # infinity
    for a, b, d in zip(near, far, way, strict=True):
        if d == 0:
            if a > 0 or b < 0:
                return None
            continue
        if d < 0:
            a, b, d = -b, -a, -d
        if a * entry_over > entry * d:
            entry, entry_over = a, d
        if b * leave_over < leave * d:
            leave, leave_over = b, d
    if entry * leave_over > leave * entry_over:
        return None
    return Fraction(entry, entry_over)


def _disc_interval(
    start: Sequence[int], way: Sequence[int], radius: int
) -> tuple[Fraction, Fraction] | None:
    """Where a line along a way that is not zero is within a radius of the origin."""
    a = sum(d * d for d in way)
    b = sum(o * d for o, d in zip(start, way, strict=True))
    c = sum(o * o for o in start) - radius * radius
    under = b * b - a * c
    if under < 0:
        return None
    root = Fraction(math.isqrt(under << (2 * ROOT_BITS)), 1 << ROOT_BITS)
    return (-b - root) / a, (-b + root) / a


def enter_sphere(start: Sequence[int], way: Sequence[int], radius: int) -> Fraction | None:
    """Where a ray enters the ball around the origin."""
    if sum(o * o for o in start) <= radius * radius:
        return Fraction(0)
    if not any(way):
        return None
    found = _disc_interval(start, way, radius)
    return found[0] if found and found[0] >= 0 else None


def enter_cylinder(
    start: Sequence[int], way: Sequence[int], radius: int, half_height: int
) -> Fraction | None:
    """Where a ray enters the cylinder about the z axis: an endless one and a slab."""
    x, y, z = start
    if x * x + y * y <= radius * radius and abs(z) <= half_height:
        return Fraction(0)
    entry, leave = Fraction(0), None
    if way[0] or way[1]:
        found = _disc_interval(start[:2], way[:2], radius)
        if found is None:
            return None
        entry, leave = max(entry, found[0]), found[1]
    elif x * x + y * y > radius * radius:
        return None
    if way[2]:
        low, high = sorted(Fraction(side * half_height - z, way[2]) for side in (-1, 1))
        entry, leave = max(entry, low), high if leave is None else min(leave, high)
    elif abs(z) > half_height:
        return None
    return entry if leave is not None and entry <= leave else None


class WholeShapes:
    """Shapes in whole numbers, for rays whose numbers need no more than `bits` binary places."""

    def __init__(self, shapes: Shapes, bits: int) -> None:
        half, turn = (shapes.size * 0.5).tolist(), shapes.orientation.tolist()
        self.bits = max(bits, *map(bits_below_the_point, (shapes.position.ravel().tolist(),)))
        self.bits = max(self.bits, bits_below_the_point(x for row in half for x in row))
        self._kinds: list[int] = shapes.kind.tolist()
        self._half = [whole(row, self.bits) for row in half]
        self._centre = [whole(row, self.bits) for row in shapes.position.tolist()]
        self._turn = [_stretched_rotation(row) for row in turn]

    def entry(self, row: int, origin: Whole, way: Whole) -> Fraction | None:
        """Where a ray, in units of 2**-bits, enters a shape."""
        rows, stretch = self._turn[row]
        offset = [o - c for o, c in zip(origin, self._centre[row], strict=True)]
        start = [sum(m * x for m, x in zip(line, offset, strict=True)) for line in rows]
        ahead = [sum(m * x for m, x in zip(line, way, strict=True)) for line in rows]
        half = [stretch * h for h in self._half[row]]
        if self._kinds[row] == ShapeKind.SPHERE:
            return enter_sphere(start, ahead, half[0])
        if self._kinds[row] == ShapeKind.CYLINDER:
            return enter_cylinder(start, ahead, half[0], half[2])
        near = [-h - s for h, s in zip(half, start, strict=True)]
        far = [h - s for h, s in zip(half, start, strict=True)]
        return enter_slabs(near, far, ahead)


def _stretched_rotation(quaternion: list[float]) -> tuple[list[list[int]], int]:
    """Rows that turn the world into the shape's frame, stretched by the second value: |q|^2."""
    if not any(quaternion):
        quaternion = [0.0, 0.0, 0.0, 1.0]
    x, y, z, w = whole(quaternion, bits_below_the_point(quaternion))
    columns: Any = (
        (x * x - y * y - z * z + w * w, 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), y * y - x * x - z * z + w * w, 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), z * z - x * x - y * y + w * w),
    )
    return [list(column) for column in columns], x * x + y * y + z * z + w * w
