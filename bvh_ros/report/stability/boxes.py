# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances of boxes; order of insertion and cost."""

import math
from collections.abc import Iterable
from fractions import Fraction

import numpy as np

from ... import DynamicBVH
from ..scenes import Floats
from .case import LARGEST, Case, rounded
from .rays import TINIEST, Vector

UP, FAR = 1 + 2**-52, 1e9
# name, one box, another
PAIRS: tuple[tuple[str, tuple[Vector, Vector], tuple[Vector, Vector]], ...] = (
    ('faces touch', ((0, 0, 0), (1, 1, 1)), ((1, 0, 0), (2, 1, 1))),
    ('one ulp apart', ((0, 0, 0), (1, 1, 1)), ((UP, 0, 0), (2, 1, 1))),
    ('corners touch', ((0, 0, 0), (1, 1, 1)), ((1, 1, 1), (2, 2, 2))),
    ('faces at signed zeros', ((-1, -1, -1), (-0.0, 1, 1)), ((0.0, -1, -1), (1, 1, 1))),
    ('a flat box in a face', ((0, 0, 0), (1, 1, 1)), ((0.2, 0.2, 1), (0.4, 0.4, 1))),
    ('a point in a corner', ((0, 0, 0), (1, 1, 1)), ((1, 1, 1), (1, 1, 1))),
    ('coincident', ((0, 0, 0), (1, 1, 1)), ((0, 0, 0), (1, 1, 1))),
    ('smallest boxes, a step apart', ((0,) * 3, (TINIEST,) * 3), ((1e-323,) * 3, (1e-322,) * 3)),
    ('largest boxes that touch', ((-LARGEST,) * 3, (0,) * 3), ((0,) * 3, (LARGEST,) * 3)),
    ('a grain of 1e-15 on a block of 1e15', ((0,) * 3, (1e15,) * 3), ((1e15,) * 3, (2e15,) * 3)),
    ('1 mm apart, 1e9 m away', ((FAR,) * 3, (FAR + 1,) * 3), ((FAR + 1.001,) * 3, (FAR + 2,) * 3)),
)
POINTS: tuple[tuple[str, Vector], ...] = (
    ('nearest: from an edge', (2.0, 2.0, 0.5)),
    ('nearest: inside', (0.5, 0.5, 0.5)),
    ('nearest: 1e-160 off, whose square vanishes', (-1e-160, 0.5, 0.5)),
    ('nearest: 1e200 off, whose square overflows', (1e200, 1e200, 0.5)),
)


def pair_cases() -> Iterable[Case]:
    """Whether two boxes touch, by comparisons, and by the tree."""
    for name, (lo, hi), (low, high) in PAIRS:
        tree = DynamicBVH()
        tree.insert(lo, hi)
        met = len(tree.overlap(low, high)) == 1
        sides = list(zip(lo, hi, low, high, strict=True))
        expected = all(a <= d and c <= b for a, b, c, d in sides)
        both = len(tree.overlap_many([low], [high])[1]) == 1
        words, asked = {True: 'touch', False: 'apart'}, f'{lo} to {hi}; {low} to {high}'
        told = words[expected], words[met], met == both == expected
        yield Case(f'two boxes: {name}', asked, *told)


def nearest_cases() -> Iterable[Case]:
    """Distance of a point from the unit box."""
    tree = DynamicBVH()
    tree.insert((0, 0, 0), (1, 1, 1))
    for name, point in POINTS:
        gaps = [max(-Fraction(x), Fraction(0), Fraction(x) - 1) for x in point]
        square = sum((gap * gap for gap in gaps), Fraction(0))
        bits = 2600  # below the point, so that the square root of anything is exact to a double
        exact = Fraction(math.isqrt(int(square * 4**bits)), 2**bits)
        distance = float(tree.nearest(point)[1][0])
        right = abs(Fraction(distance) - exact) <= Fraction(4 * math.ulp(rounded(exact)))
        with np.errstate(all='ignore'):
            apart = np.maximum(np.maximum(-np.array(point), np.array(point) - 1), 0.0)
            plain = float(np.sqrt((apart * apart).sum()))
        good = abs(plain - rounded(exact)) <= 4 * math.ulp(rounded(exact))
        told = repr(rounded(exact)), repr(distance), right, _judged(repr(plain), good)
        yield Case(name, f'{point}', *told)


def _judged(text: str, right: bool) -> str:
    return text if right else f'{text} (wrong)'


def height_cases(brief: bool) -> Iterable[Case]:
    """Inputs that make lists of naive trees: heights and costs."""
    count = 500 if brief else 10_000
    row = np.arange(count, dtype=float)
    doubles = 10.0 ** np.linspace(-323, 308, count)
    scenes = {
        'sorted input, one by one': row,
        'sorted backwards, one by one': row[::-1],
        'all boxes the same, one by one': np.zeros(count),
        'each box twice as large as the last': 2.0 ** np.linspace(-1000, 1000, count),
        '5e-324 to 1e308, one by one': doubles,
        '1e308 to 5e-324, one by one': doubles[::-1],
    }
    for name, places in scenes.items():
        yield _height(name, places, not name.startswith('each'))
    yield _height('5e-324 to 1e308, built at once', doubles, False, at_once=True)


def _height(name: str, places: Floats, shifted: bool, at_once: bool = False) -> Case:
    """Boxes from the place (or from zero) to one edge beyond."""
    hi = np.tile(places[:, None] * (1.5 if places.max() > 1e300 else 1.0), (1, 3))
    hi = hi + (1.0 if places.max() < 1e300 else 0.0)
    lo = np.tile(places[:, None], (1, 3)) if shifted else np.zeros_like(hi)
    tree = DynamicBVH.from_boxes(lo, hi) if at_once else DynamicBVH()
    for low, high in () if at_once else zip(lo, hi, strict=True):
        tree.insert(low, high)
    tree.validate()
    bound, cost = 4 * math.log2(len(lo)) + 4, tree.cost()
    said = f'height <= {bound:.1f}; cost finite, above 0', f'height {tree.height}; cost {cost:.3g}'
    kept = tree.height <= bound and 0 < cost < math.inf
    return Case(name, f'{len(lo):,} boxes', *said, kept)
