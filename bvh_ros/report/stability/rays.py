# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays at one box, that may move: in the plane of a face, through corners, with zeros, and at the
ends of the range of doubles.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from ... import DynamicBVH
from ..error.exact import bits_below_the_point, enter_slabs, whole
from ..error.truth import brute_force
from ..scenes import Boxes, Rays
from .case import LARGEST, Case, rounded, within_2_ulp

Vector = Sequence[float]
TINIEST = 5e-324
COPIES = 64  # of a ray, so that a batch goes through the wide snapshot
UNIT = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


class Motion(NamedTuple):
    """How a box moves, and when the ray starts."""

    velocity: Vector
    at: float = 0.0
    pace: float = 1.0
    reference: float = 0.0


class Question(NamedTuple):
    """One box and one ray."""

    name: str
    lo: Vector
    hi: Vector
    origin: Vector
    direction: Vector
    t_max: float = math.inf
    motion: Motion | None = None


THIRD, SOON = 1 / 3, math.nextafter(1.5, 0.0)
TENTHS, MOST = ((0.1,) * 3, (0.3,) * 3), (LARGEST,) * 3
ALONG, TOWARDS, SLOWLY = Motion((3, 0, 0)), Motion((-1, 0, 0)), Motion((1e-9, 0, 0))
UP, BACK, LONG_AGO = Motion((0, 0, 0.1)), Motion((-0.1, 0, 0)), Motion((3, 0, 0), 1.6e9)
QUESTIONS = (
    Question('ray in the plane of a face', *UNIT, (-1, 0.5, 1), (1, 0, 0)),
    Question('ray in the plane of two faces: along an edge', *UNIT, (-1, 1, 1), (1, 0, 0)),
    Question('along an edge, zeros of either sign', *UNIT, (-1, 1, 0), (1, -0.0, 0.0)),
    Question('box at signed zeros', (-1, -0.0, 0.0), (1, 0.0, -0.0), (-3, 0, -0.0), (1, -0.0, 0)),
    Question('in a plane one ulp beside the face', *UNIT, (-1, 0.5, 1 + 2**-52), (1, 0, 0)),
    Question('through a corner only', *UNIT, (-1, 0, 2), (1, 1, -1)),
    Question('through an edge only', *UNIT, (-3, 3, 0.5), (1, -0.5, 0.0)),
    Question('diagonal of thirds', *UNIT, (-1, -1, -1), (THIRD, THIRD, THIRD)),
    Question('corner of tenths, from tenths', *TENTHS, (-0.2, 0.6, 0.0), (0.1, -0.1, 0.1)),
    Question('corner of tenths, barely missed', (0.1,) * 3, (0.7,) * 3, (0, 0.8, 0.1), (1, -1, 0)),
    Question('starts in a corner and leaves', *UNIT, (1, 1, 1), (1, 1, 1)),
    Question('starts on a face and goes along', *UNIT, (0.5, 1, 0.5), (1, 0, 0)),
    Question('flat box, seen from the side', (0, 0, 1), (1, 1, 1), (-1, 0.5, 1), (1, 0, 0)),
    Question('flat box, met from above', (0, 0, 1), (1, 1, 1), (0.5, 0.5, 3), (0, 0, -1)),
    Question('point', (1, 2, 3), (1, 2, 3), (0, 0, 0), (1, 2, 3)),
    Question('point of thirds', (THIRD, 2 / 3, 1), (THIRD, 2 / 3, 1), (0, 0, 0), (1, 2, 3)),
    Question('zero direction inside', *UNIT, (0.5, 1, 0), (0, 0, 0)),
    Question('zero direction outside', *UNIT, (0.5, 1 + 2**-52, 0), (0, 0, -0.0)),
    Question('t_max is the entry', *UNIT, (-0.3, 0.5, 0.5), (0.1, 0, 0), math.nextafter(3, 0)),
    Question('t_max is the entry, exactly', *UNIT, (-3, 0.5, 0.5), (1, 0, 0), 3.0),
    Question('t_max one ulp below', *UNIT, (-3, 0.5, 0.5), (1, 0, 0), math.nextafter(3, 0)),
    Question('t_max rounds to the entry', *UNIT, (-1, 0.5, 0.5), (3, 0, 0), THIRD),
    Question('t_max zero, on the face', *UNIT, (0, 0.5, 0.5), (1, 0, 0), 0.0),
    Question('tiny direction', *UNIT, (-1, 0.5, 0.5), (TINIEST, 0, 0)),
    Question('tiny direction, t beyond doubles', *UNIT, (-1e9, 0.5, 0.5), (TINIEST, 0, 0)),
    Question('huge direction', *UNIT, (-1, 0.5, 0.5), (LARGEST, 0, 0)),
    Question('huge and tiny components', *UNIT, (-1, 0.5, 0.5), (LARGEST, TINIEST, -TINIEST)),
    Question('smallest box', (0,) * 3, (TINIEST,) * 3, (-TINIEST,) * 3, (TINIEST,) * 3),
    Question('smallest box, unit direction', (0,) * 3, (TINIEST,) * 3, (-1, 0, 0), (1, 0, 0)),
    Question('largest box, from its corner', (-LARGEST,) * 3, MOST, MOST, UNIT[1]),
    Question('across the whole range', MOST, MOST, (-LARGEST,) * 3, UNIT[1]),
    Question('far origin: 1e30 box edges away', *UNIT, (-1e30, 0.5, 0.5), (1, 0, 0)),
    Question('far origin, barely beside', *UNIT, (-1e30, -1e30, 0.5), (1, 1 + 2**-52, 0)),
    Question('moves with the ray, touches', *UNIT, (-0.0, 0.5, 1), (3, 0, 0), 9.0, ALONG),
    Question('moves with it, an ulp beside', *UNIT, (-TINIEST, 0.5, 1), (3, 0, 0), 9, ALONG),
    Question('parallel, 1e-9 m/s apart', *UNIT, (-1, 0.5, 1), (3 + 1e-9, 0, 0), 1e12, ALONG),
    Question('grazes a corner that moves', *UNIT, (-1, 0, 2), (1, 1, -1), 9, Motion((0, 0, 0.5))),
    Question('corner of tenths that moves', *TENTHS, (-0.2, -0.6, -0.2), (0.1, 0.3, 0.2), 9, UP),
    Question('barely missed, moving', *TENTHS, (-0.1, 0.5, -0.3), (0.1, -0.1, 0.3), 9, BACK),
    Question('contact at the end', (3, 0, 0), (4, 1, 1), (0, 1, 0), (1, 0, 0), 1.5, TOWARDS),
    Question('contact an ulp after it', (3, 0, 0), (4, 1, 1), (0, 1, 0), (1, 0, 0), SOON, TOWARDS),
    Question('1e4 m/s, met by who stands', *UNIT, (1e4, 1, 0), (0, 0, 0), 1, Motion((1e4, 0, 0))),
    Question('1e-9 m/s, met by who stands', *UNIT, (2, 1, 0), (0, 0, 0), 1e10, SLOWLY),
    Question('fifty years later', *UNIT, (4.8e9 + 99, 1, 1), (-9, 0, 0), 9, LONG_AGO),
)


def ray_cases() -> list[Case]:
    """Ask every question one by one, in a batch, and whether anything is met at all."""
    return [_ask(question) for question in QUESTIONS]


def exact_entry(
    lo: Vector, hi: Vector, origin: Vector, direction: Vector, motion: Motion | None = None
) -> Fraction | None:
    """Where a ray enters a closed box, in whole numbers."""
    velocity, *times = motion or Motion((0.0,) * len(lo))
    rows = [[float(x) for x in row] for row in (lo, hi, origin, direction, velocity, times)]
    bits = bits_below_the_point(x for row in rows for x in row)
    low, high, start, way, speed, (at, pace, reference) = (whole(row, bits) for row in rows)
    gone = [v * (at - reference) for v in speed]
    near = [((plane - o) << bits) + g for plane, o, g in zip(low, start, gone, strict=True)]
    far = [((plane - o) << bits) + g for plane, o, g in zip(high, start, gone, strict=True)]
    rates = [(d << bits) - v * pace for d, v in zip(way, speed, strict=True)]
    return enter_slabs(near, far, rates)


def _ask(question: Question) -> Case:
    lo, hi, t_max = question.lo, question.hi, question.t_max
    origin, direction = question.origin, question.direction
    motion = question.motion
    exact = exact_entry(lo, hi, origin, direction, motion)
    if exact is not None and not math.isinf(t_max) and exact > Fraction(t_max):
        exact = None
    tree = DynamicBVH()
    box, when = tree.insert(lo, hi), dict[str, Any]()
    if motion:
        tree.set_velocities([box], [motion.velocity], motion.reference)
        when = {'at': motion.at, 'pace': motion.pace}
    for corner in (lo, hi):  # a box beside it, so that there is a wide snapshot
        tree.insert(corner, corner, mask=2)
    hit = tree.raycast(origin, direction, t_max, mask=1, **when)
    rays = np.tile(origin, (COPIES, 1)), np.tile(direction, (COPIES, 1))
    batch = tree.raycast_many(*rays, t_max, mask=1, **when)
    answers = {hit.t if hit else None}
    answers |= {t if i >= 0 else None for i, t in zip(batch.ids, batch.t.tolist(), strict=True)}
    met = {hit is not None, tree.occluded(origin, direction, t_max, mask=1, **when)}
    right = met == {exact is not None} and all(_agrees(t, exact) for t in answers)
    asked = f'box {_text(lo)} to {_text(hi)}; ray {_text(origin)} + t {_text(direction)}'
    if not math.isinf(t_max):
        asked += f', t <= {t_max!r}'
    if motion:
        asked += f'; {_text(motion.velocity)} m/s since {motion.reference!r} s, at {motion.at!r} s'
    expected, got = (
        _met(None if exact is None else rounded(exact)),
        ' or '.join(sorted(map(_met, answers))),
    )
    return Case(question.name, asked, expected, got, right, _slab(question, exact))


def _agrees(t: float | None, exact: Fraction | None) -> bool:
    if t is None or exact is None:
        return t is None and exact is None
    return within_2_ulp(t, exact)


def _met(t: float | None) -> str:
    return 'miss' if t is None else f'hit, t = {t!r}'


def _text(vector: Vector) -> str:
    return '(' + ', '.join(f'{float(x)!r}'.removesuffix('.0') for x in vector) + ')'


def _slab(question: Question, exact: Fraction | None) -> str:
    """What the usual test says, and whether that is right."""
    velocity, at, pace, reference = question.motion or Motion((0.0,) * 3)
    speed, since = np.array([velocity], float), at - reference
    boxes = Boxes(*(np.array([side], float) + speed * since for side in question[1:3]))
    rays = Rays(np.array([question.origin], float), np.array([question.direction]) - speed * pace)
    rows, ts = brute_force(boxes, rays)
    t = float(ts[0]) if rows[0] >= 0 and ts[0] <= question.t_max else None
    return _met(t) if _agrees(t, exact) else f'{_met(t)} (wrong)'
