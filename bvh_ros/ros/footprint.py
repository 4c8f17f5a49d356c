# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The footprint that goes along paths: a box, a ball, or a polygon as Nav2 writes it."""

from __future__ import annotations

import ast
import itertools
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bvh_ros.scene import AS_CONVEX, Shapes, mesh_of

MOST_CORNERS = 200
Corner = tuple[float, float]


def of_numbers(lengths: Sequence[float], farthest: float) -> tuple[Shapes, ...]:
    """Edge lengths of a box, or the radius of a ball, as one shape; ValueError if they are not."""
    if len(lengths) not in (1, 3) or not all(0.0 < length <= farthest for length in lengths):
        raise ValueError(
            'must be [sx, sy, sz] of a box or [radius] of a ball, above 0 and at most '
            f"{farthest:g}, or a polygon as text, '[[x, y], ...]'"
        )
    origin = [0.0, 0.0, 0.0]
    if len(lengths) == 1:
        return (Shapes.spheres(origin, lengths[0]),)
    return (Shapes.boxes(origin, lengths),)


def of_polygon(text: str, height: float, farthest: float) -> tuple[Shapes, ...]:
    """Convex prisms that make up what stands on a polygon, from z = 0 to `height`.

    Parameters
    ----------
    text : str
        Nav2's form, ``'[[x, y], [x, y], ...]'``, m, in either sense.

    Raises
    ------
    ValueError
        If it is no simple polygon.
    """
    corners = _corners(text, farthest)
    _require_simple(corners)
    if _turn(*_lowest(corners)) < 0:
        corners.reverse()
    shapes = []
    for part in convex_parts(corners):
        mesh = mesh_of(_prism(part, height), AS_CONVEX)
        shapes.append(Shapes.of_meshes([mesh], [0.0, 0.0, 0.0]))
    return tuple(shapes)


def _corners(text: str, farthest: float) -> list[Corner]:
    try:
        given: Any = ast.literal_eval(text.strip())
        rows = [given, *given]
        numbers = [number for x, y in given for number in (x, y)]
        if not all(type(row) in (list, tuple) for row in rows):
            raise TypeError
        if not all(type(number) in (int, float) for number in numbers):
            raise TypeError
        corners = [(float(x), float(y)) for x, y in given]
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError, OverflowError):
        raise ValueError("must be a polygon '[[x, y], [x, y], ...]'") from None
    if len(corners) > 1 and corners[0] == corners[-1]:
        del corners[-1]  # a closed ring
    if not 3 <= len(corners) <= MOST_CORNERS:
        raise ValueError(f'must have 3 to {MOST_CORNERS} corners, not {len(corners)}')
    for corner in corners:
        if not all(math.isfinite(c) and abs(c) <= farthest for c in corner):
            raise ValueError(f'has the corner {list(corner)}, which is not within {farthest:g} m')
    return corners


def _turn(a: Corner, b: Corner, c: Corner) -> int:
    """1 where a, b, c turn left, -1 where right, 0 where they are on a line; exactly."""
    (ax, ay), (bx, by), (cx, cy) = (map(Fraction, corner) for corner in (a, b, c))
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    return (area > 0) - (area < 0)


def _lowest(corners: Sequence[Corner]) -> tuple[Corner, Corner, Corner]:
    """A corner that is surely convex, between its neighbours: the lowest, leftmost one."""
    i = min(range(len(corners)), key=lambda k: corners[k][::-1])
    return corners[i - 1], corners[i], corners[(i + 1) % len(corners)]


def _require_simple(corners: list[Corner]) -> None:
    """ValueError if edges cross or touch. Corners on a straight edge are removed."""
    while True:
        count = len(corners)
        straight = [
            i
            for i in range(count)
            if _turn(corners[i - 1], corners[i], corners[(i + 1) % count]) == 0
        ]
        for i in straight:
            a, b, c = corners[i - 1], corners[i], corners[(i + 1) % count]
            if not (a != b != c and _between(a, b, c)):
                raise ValueError(f'turns back at the corner {list(b)}')
        if not straight or count <= 3:
            break
        del corners[straight[0]]
    if straight:
        raise ValueError('has no area')
    edges = [(corners[i - 1], corners[i]) for i in range(len(corners))]
    for (i, one), (j, other) in itertools.combinations(enumerate(edges), 2):
        if j - i not in (1, len(edges) - 1) and _touch(*one, *other):
            raise ValueError(f'is not simple: the edges {list(one)} and {list(other)} meet')


def _between(a: Corner, b: Corner, c: Corner) -> bool:
    """Whether b, which is on a line with a and c, lies between them."""
    return all(min(p, r) <= q <= max(p, r) for p, q, r in zip(a, b, c, strict=True))


def _touch(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    """Whether two closed segments have a point in common."""
    turns = _turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b)
    if turns[0] != turns[1] and turns[2] != turns[3]:
        return True
    ends = ((a, c, b), (a, d, b), (c, a, d), (c, b, d))
    return any(turn == 0 and _between(*end) for turn, end in zip(turns, ends, strict=True))


def convex_parts(corners: Sequence[Corner]) -> list[list[Corner]]:
    """Convex polygons that make up a simple one, counter-clockwise, with corners of it only.

    Ears are cut off (Meisters 1975), then parts are put together again while they stay convex
    (Hertel and Mehlhorn 1983).
    """
    left, parts = list(corners), []
    while len(left) > 3:
        for i in range(len(left)):
            a, b, c = left[i - 1], left[i], left[(i + 1) % len(left)]
            others = (p for p in left if p not in (a, b, c))
            if _turn(a, b, c) > 0 and not any(_inside(p, a, b, c) for p in others):
                parts.append([a, b, c])
                del left[i]
                break
        else:
            raise ValueError('is not simple')
        # A corner that has become straight belongs to no ear.
        count = len(left)
        left = [p for i, p in enumerate(left) if _turn(left[i - 1], p, left[(i + 1) % count]) != 0]
    if len(left) == 3:
        parts.append(left)
    return _united(parts)


def _inside(p: Corner, a: Corner, b: Corner, c: Corner) -> bool:
    return min(_turn(a, b, p), _turn(b, c, p), _turn(c, a, p)) >= 0


def _united(parts: list[list[Corner]]) -> list[list[Corner]]:
    again = True
    while again:
        again = False
        for one, other in itertools.combinations(parts, 2):
            whole = _joined(one, other)
            if whole is not None:
                parts = [part for part in parts if part is not one and part is not other]
                parts.append(whole)
                again = True
                break
    return parts


def _joined(one: list[Corner], other: list[Corner]) -> list[Corner] | None:
    """Two polygons with a common edge as one, if that is convex."""
    for i, j in itertools.product(range(len(one)), range(len(other))):
        if one[i - 1] == other[j] and one[i] == other[j - 1]:
            whole = [*one[i:], *one[:i]]
            rest = [*other[j:], *other[:j]]  # begins where `whole` ends, ends where it begins
            whole += rest[1:-1]
            count = len(whole)
            turns = [_turn(whole[k - 1], whole[k], whole[(k + 1) % count]) for k in range(count)]
            if min(turns) < 0:
                return None
            return [corner for corner, turn in zip(whole, turns, strict=True) if turn > 0]
    return None


def _prism(corners: Sequence[Corner], height: float) -> NDArray[np.float64]:
    """Triangles of a prism."""
    low = [(x, y, 0.0) for x, y in corners]
    high = [(x, y, height) for x, y in corners]
    triangles = []
    for i in range(1, len(corners) - 1):
        triangles += [(low[0], low[i + 1], low[i]), (high[0], high[i], high[i + 1])]
    for i in range(len(corners)):
        triangles += [(low[i - 1], low[i], high[i]), (low[i - 1], high[i], high[i - 1])]
    return np.array(triangles, np.float64)
