# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Extreme and stiff cases, each with its verdict.

What is expected is computed in rationals. A ray is cast one by one, in a batch and as a query
whether it hits anything; a distance may be 2 ulp off. *float64 slab* is the usual test (numpy,
0 * inf bounds nothing); of meshes it is the watertight test in float64, without an inside.
"""

import math
import pickle
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .. import DynamicBVH
from ..scene import Mesh, Shapes
from .error.meshes import surface_of, watertight
from .error.truth import brute_force, enter_box, exact, root
from .error.worlds import corner_rays
from .page import Page
from .scenes import Boxes, Floats, Rays, scene_of, units

# ---- A case: one row of the table


LARGEST = 1.7976931348623157e308
HEADER = ('case', 'input', 'expected', 'got', 'verdict', 'float64 slab')


class Case(NamedTuple):
    """A case and its verdict."""

    name: str
    given: str
    expected: str  # by exact arithmetic, or the bound that is promised
    got: str
    passed: bool
    slab: str = '-'  # what the usual float64 slab test says, if it was tried


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


def agrees(t: float | None, exact: Fraction | None, share: Fraction | None = None) -> bool:
    """Whether both are a miss, or the distance is within a share of the exact one, or 2 ulp."""
    if t is None or exact is None:
        return t is None and exact is None
    if share is None:
        return within_2_ulp(t, exact)
    return abs(Fraction(t) - exact) <= share * exact


def marked(text: str, right: bool) -> str:
    """What another method says, and whether that is wrong."""
    return text if right else f'{text} (wrong)'


# ---- Rays at one box: in the plane of a face, through corners, at the ends of the doubles


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


AT_REST = Motion((0.0, 0.0, 0.0))


class Question(NamedTuple):
    """One box and one ray."""

    name: str
    lo: Vector
    hi: Vector
    origin: Vector
    direction: Vector
    t_max: float = math.inf
    motion: Motion = AT_REST


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
    Question('1e4 m/s, a resting ray', *UNIT, (1e4, 1, 0), (0, 0, 0), 1, Motion((1e4, 0, 0))),
    Question('1e-9 m/s, a resting ray', *UNIT, (2, 1, 0), (0, 0, 0), 1e10, SLOWLY),
    Question('fifty years later', *UNIT, (4.8e9 + 99, 1, 1), (-9, 0, 0), 9, LONG_AGO),
)


def ray_cases() -> list[Case]:
    """Cast every ray one by one, in a batch, and as a query whether anything is hit."""
    return [_cast(question) for question in QUESTIONS]


def exact_entry(
    lo: Vector, hi: Vector, origin: Vector, direction: Vector, motion: Motion = AT_REST
) -> Fraction | None:
    """Where a ray enters a closed box, in rationals."""
    since, pace = Fraction(motion.at) - Fraction(motion.reference), Fraction(motion.pace)
    speed = exact(motion.velocity)
    start, ahead = exact(origin) - speed * since, exact(direction) - speed * pace
    return enter_box(exact(lo), exact(hi), start, ahead)


def _cast(question: Question) -> Case:
    lo, hi, t_max, motion = question.lo, question.hi, question.t_max, question.motion
    ray = question.origin, question.direction
    entry = exact_entry(lo, hi, *ray, motion)
    if entry is not None and entry > t_max:
        entry = None
    tree = DynamicBVH()
    box, when = tree.insert(lo, hi), dict[str, Any]()
    if motion is not AT_REST:
        tree.set_velocities([box], [motion.velocity], motion.reference)
        when = {'at': motion.at, 'pace': motion.pace}
    for corner in (lo, hi):  # another box, so that there is a wide snapshot
        tree.insert(corner, corner, mask=2)
    hit = tree.raycast(*ray, t_max, mask=1, **when)
    many = np.tile(ray[0], (COPIES, 1)), np.tile(ray[1], (COPIES, 1)), t_max
    batch = tree.raycast_many(*many, mask=1, **when)
    answers = {hit.t if hit else None}
    answers |= {t if i >= 0 else None for i, t in zip(batch.ids, batch.t.tolist(), strict=True)}
    hits = {hit is not None, tree.occluded(*ray, t_max, mask=1, **when)}
    right = hits == {entry is not None} and all(agrees(t, entry) for t in answers)
    given = f'box {_text(lo)} to {_text(hi)}; ray {_text(ray[0])} + t {_text(ray[1])}'
    if not math.isinf(t_max):
        given += f', t <= {t_max!r}'
    if motion is not AT_REST:
        given += f'; {_text(motion.velocity)} m/s since {motion.reference!r} s, at {motion.at!r} s'
    got = ' or '.join(sorted(map(_hit, answers)))
    expected = _hit(None if entry is None else rounded(entry))
    return Case(question.name, given, expected, got, right, _slab(question, entry))


def _hit(t: float | None) -> str:
    return 'miss' if t is None else f'hit, t = {t!r}'


def _text(vector: Vector) -> str:
    return '(' + ', '.join(f'{float(x)!r}'.removesuffix('.0') for x in vector) + ')'


def _slab(question: Question, entry: Fraction | None) -> str:
    """What the usual test says, and whether that is right."""
    motion = question.motion
    speed, since = np.array([motion.velocity], float), motion.at - motion.reference
    boxes = Boxes(*(np.array([side], float) for side in question[1:3])).moved(speed * since)
    directions = np.array([question.direction]) - speed * motion.pace
    answer = brute_force(boxes, Rays(np.array([question.origin], float), directions))
    t = float(answer.ts[0])
    found = t if answer.rows[0] >= 0 and t <= question.t_max else None
    return marked(_hit(found), agrees(found, entry))


# ---- Boxes of every scale and speed, and rays at their corners


SCALES = (5e-324, 1e-300, 1e-160, 1e-3, 1.0, 1e8, 1e15, 1e150, 1e307)
BOXES, MANY, RAYS, RAYS_QUICK = 24, 250, 400, 70
EXTENT = 5  # of boxes: so rays at the largest scale are below the largest double


def scale_cases(brief: bool) -> Iterable[Case]:
    """One case a scale, then scales mixed in one scene."""
    scenes = {f'corner rays at scale {scale:g}': (1, [scale] * BOXES) for scale in SCALES}
    scenes['scales 1e-15 to 1e15 in one scene'] = 2, [*10.0 ** np.linspace(-15, 15, BOXES)]
    ends = 5e-324, 1e-308, 1e-150, 1.0, 1e150, 1e307
    scenes['5e-324 to 1.7e308 in one scene'] = 3, [*np.resize(ends, BOXES)]
    for name, (seed, scales) in scenes.items():
        many, column = RAYS_QUICK if brief else RAYS, np.array(scales)[:, None]
        rng = np.random.default_rng(seed)
        yield _compare(name, *corner_rays(len(scales), many, rng, column, EXTENT))
    yield _at_all_speeds(BOXES if brief else MANY, RAYS_QUICK if brief else 10 * RAYS)


def _at_all_speeds(count: int, many: int) -> Case:
    rng = np.random.default_rng(4)
    boxes, rays = corner_rays(count, many, rng, 1.0, EXTENT)
    speeds = rng.integers(-2, 3, (count, 3)) * np.geomspace(1e-9, 1e4, count)[:, None]
    times = rng.choice([0.0, 1.0, -0.5], many), rng.choice([0.0, 1.0, 0.5], many)
    return _compare('1e-9 to 1e4 m/s in one scene', boxes, rays, speeds, times)


def _compare(
    name: str,
    boxes: Boxes,
    rays: Rays,
    velocities: Floats | None = None,
    times: tuple[Floats, Floats] | None = None,
) -> Case:
    """Cast one by one and in a batch; times = (at, pace)."""
    tree, count = DynamicBVH.from_boxes(*boxes), len(rays.origins)
    if velocities is None:
        velocities = np.zeros_like(boxes.lo)
    else:
        tree.set_velocities(tree.ids(), velocities)
    at, pace = times or np.zeros((2, count))
    tree.validate()
    row_of = {handle: row for row, handle in enumerate(tree.ids().tolist())}
    sides = list(zip(*(x.tolist() for x in (*boxes, velocities)), strict=True))
    batch, hits, wrong = tree.raycast_many(*rays, at=at, pace=pace), 0, 0
    queries = zip(*(x.tolist() for x in (*rays, at, pace, *batch[:2])), strict=True)
    for origin, direction, begin, rate, handle, t in queries:
        entries = [
            (entry, row)
            for row, (lo, hi, velocity) in enumerate(sides)
            if (entry := exact_entry(lo, hi, origin, direction, Motion(velocity, begin, rate)))
            is not None
        ]
        first = min(entries, default=(None, -1))
        hit = tree.raycast(origin, direction, at=begin, pace=rate)
        single = (row_of[hit.id], hit.t) if hit else (-1, None)
        together = (row_of[handle], t) if handle >= 0 else (-1, None)
        wrong += not all(row == first[1] and agrees(t, first[0]) for row, t in (single, together))
        hits += bool(entries)
    given = f'{len(boxes.lo)} boxes, {count:,} rays: {len(boxes.lo) * count:,} exact entries'
    got = f'{int((batch.ids >= 0).sum())} hits, {wrong} wrong'
    return Case(name, given, f'{hits} hits, 0 wrong', got, wrong == 0)


# ---- Overlaps and distances of boxes; order of insertion, height and cost


ULP_UP, FAR = 1 + 2**-52, 1e9
# name, one box, another
PAIRS: tuple[tuple[str, tuple[Vector, Vector], tuple[Vector, Vector]], ...] = (
    ('faces touch', ((0, 0, 0), (1, 1, 1)), ((1, 0, 0), (2, 1, 1))),
    ('one ulp apart', ((0, 0, 0), (1, 1, 1)), ((ULP_UP, 0, 0), (2, 1, 1))),
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
        touches = len(tree.overlap(low, high)) == 1
        sides = list(zip(lo, hi, low, high, strict=True))
        expected = all(a <= d and c <= b for a, b, c, d in sides)
        both = len(tree.overlap_many([low], [high])[1]) == 1
        words = {True: 'touch', False: 'apart'}
        results = words[expected], words[touches], touches == both == expected
        yield Case(f'two boxes: {name}', f'{lo} to {hi}; {low} to {high}', *results)


def nearest_cases() -> Iterable[Case]:
    """Distance of a point from the unit box."""
    tree = DynamicBVH()
    tree.insert((0, 0, 0), (1, 1, 1))
    for name, point in POINTS:
        gaps = [max(-Fraction(x), Fraction(0), Fraction(x) - 1) for x in point]
        exact = root(sum((gap * gap for gap in gaps), Fraction(0)))
        distance = float(tree.nearest(point)[1][0])
        right = abs(Fraction(distance) - exact) <= Fraction(4 * math.ulp(rounded(exact)))
        with np.errstate(all='ignore'):
            apart = np.maximum(np.maximum(-np.array(point), np.array(point) - 1), 0.0)
            plain = float(np.sqrt((apart * apart).sum()))
        good = abs(plain - rounded(exact)) <= 4 * math.ulp(rounded(exact))
        results = repr(rounded(exact)), repr(distance), right, marked(repr(plain), good)
        yield Case(name, f'{point}', *results)


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
    holds = tree.height <= bound and 0 < cost < math.inf
    return Case(name, f'{len(lo):,} boxes', *said, holds)


# ---- Rays at a mesh that is not convex: three cubes in an L, whose entries are known


CORNER_OF_L = np.array([[[True], [True]], [[True], [False]]])  # which cells are filled
NEAR_ENOUGH = Fraction(1, 10**12)  # of a distance
UP_ULP = math.nextafter(1.0, 2.0)
# name, edge of a cell, origin and direction in edges
MESH_RAYS: tuple[tuple[str, float, Vector, Vector], ...] = (
    ('at the inner corner', 1.0, (3, 3, 0.5), (-1, -1, 0)),
    ('along the inner edge', 1.0, (1, 1, 3), (0, 0, -1)),
    ('through a corner only', 1.0, (1, 2, 2), (1, -1, -1)),
    ('through an edge only', 1.0, (3, 1, 0.5), (-1, -1, 0)),
    ('beside that edge by an ulp', 1.0, (3 * UP_ULP, 1, 0.5), (-1, -1, 0)),
    ('in the plane of a face', 1.0, (0.25, -3, 1), (0, 1, 0)),
    ('in it, zeros of either sign', 1.0, (-1, 0.5, 0.0), (1, -0.0, 0.0)),
    ('an ulp above it', 1.0, (0.25, -3, UP_ULP), (0, 1, 0)),
    ('between triangles of a face', 1.0, (0.5, 0.5, 9), (0, 0, -1)),
    ('in the notch of the L', 1.0, (1.5, 1.5, 9), (0, 0, -1)),
    ('starts on a face and leaves', 1.0, (0, 0.5, 0.5), (-1, 0, 0)),
    ('starts in the solid', 1.0, (0.5, 0.5, 0.5), (0, 0, 1)),
    ('cells of 0.1 m, a corner', 0.1, (-3, 4, 1), (1, -1, 0)),
    ('cells of 1e-25 m', 1e-25, (3, 3, 0.5), (-1, -1, 0)),
    ('cells of 1e25 m', 1e25, (3, 3, 0.5), (-1, -1, 0)),
    ('from 1e12 cells away', 1.0, (1e12, 1e12, 0.5), (-1, -1, 0)),
    ('from there, past the L', 1.0, (1e12, 2 - 1e12, 0.5), (-1, 1, 0)),
)


def mesh_cases() -> Iterable[Case]:
    """One ray a case, and a batch of it."""
    for name, edge, origin, direction in MESH_RAYS:
        corners, cells = surface_of(CORNER_OF_L) * edge, np.argwhere(CORNER_OF_L)
        start, ahead = [x * edge for x in origin], [x * edge for x in direction]
        sides = ((cell * edge, (cell + 1) * edge) for cell in cells)
        entries = [exact_entry(lo.tolist(), hi.tolist(), start, ahead) for lo, hi in sides]
        entry = min((entry for entry in entries if entry is not None), default=None)
        scene = scene_of(Shapes.of_meshes(Mesh(corners), np.zeros((1, 3))))
        answers = set()
        for count in (1, COPIES):
            hits = scene.raycast_many(np.tile(start, (count, 1)), np.tile(ahead, (count, 1)))
            answers |= {t if t < math.inf else None for t in hits.t.tolist()}
        right = all(agrees(t, entry, NEAR_ENOUGH) for t in answers)
        given = f'cells of {edge:g} m; ray {_text(start)} + t {_text(ahead)}'
        got = ' or '.join(sorted(map(_hit, answers)))
        expected = _hit(None if entry is None else rounded(entry))
        found = watertight(corners, Rays(np.array([start]), np.array([ahead]))).ts[0]
        other = None if math.isinf(found) else float(found)
        agreed = (other is None) == (entry is None)
        yield Case(f'a mesh: {name}', given, expected, got, right, marked(_hit(other), agreed))


# ---- Long and stiff runs: a million moves, speeds thirteen decades apart, teleports


WORST_COST = 1.25  # of a new build
TICK = 0.01  # s


def motion_cases(brief: bool) -> Iterable[Case]:
    """All of them."""
    yield _many_moves(20_000 if brief else 1_000_000)
    for margin in (0.0, 0.05):
        for ahead in (False, True):
            yield _stiff(60 if brief else 1_000, margin, ahead)
    yield _teleports(20 if brief else 500)


def over_new_build(tree: DynamicBVH) -> float:
    """Cost of a tree over that of a new one of the same boxes, fat as they are."""
    copy = pickle.loads(pickle.dumps(tree))
    copy.rebuild()
    return float(tree.cost() / copy.cost())


def _judged(tree: DynamicBVH, name: str, given: str, **counts: int) -> Case:
    """Cost and height are bounded, and each count is 0."""
    tree.validate()
    bound, cost = 4 * math.log2(len(tree)) + 4, over_new_build(tree)
    passed = cost <= WORST_COST and tree.height <= bound and not any(counts.values())
    expected = f'cost <= {WORST_COST} of a new build, height <= {bound:.1f}'
    got = f'cost {cost:.2f}, height {tree.height}'
    for what, count in counts.items():
        words = what.replace('_', ' ')
        expected, got = f'{expected}, 0 {words}', f'{got}, {count} {words}'
    return Case(name, given, expected, got, passed)


def _many_moves(total: int) -> Case:
    rng = np.random.default_rng(1)
    count, at_once = 2_000, 50
    lo = rng.uniform(0, 100, (count, 3))
    size = rng.uniform(0.5, 3, lo.shape)
    tree = DynamicBVH.from_boxes(lo, lo + size)
    handles, before = tree.ids(), tree.stats()['bytes']
    for _ in range(total // at_once):
        rows = rng.choice(count, at_once, replace=False)
        lo[rows] = rng.uniform(0, 100, (at_once, 3))
        tree.move_many(handles[rows], lo[rows], lo[rows] + size[rows])
    more, wrong = tree.stats()['bytes'] - before, int((tree.boxes(handles)[0] != lo).sum())
    name, given = f'{total:,} moves to anywhere', f'{count:,} boxes, {at_once} a call'
    return _judged(tree, name, given, bytes_more=more, wrong_places=wrong)


def _wrong_boxes(tree: DynamicBVH, lo: Floats, hi: Floats, rng: np.random.Generator) -> int:
    """How many of the overlaps around some boxes differ from those by comparisons."""
    wrong, handles = 0, tree.ids()
    for row in rng.integers(0, len(lo), 10):
        low, high = lo[row] - 5, hi[row] + 5
        rows = np.flatnonzero(((lo <= high) & (low <= hi)).all(axis=1))
        wrong += tree.overlap(low, high).tolist() != handles[rows].tolist()
    return wrong


def _stiff(ticks: int, margin: float, ahead: bool) -> Case:
    """1e4 m/s at every tick, 1e-9 m/s at every twentieth."""
    rng = np.random.default_rng(2)
    count = 400
    lo = rng.uniform(0, 1000, (count, 3))
    directions = units(rng.normal(size=lo.shape))
    fast = np.arange(count) % 2 == 0
    speed = directions * np.where(fast, 1e4, 1e-9)[:, None]
    tree = DynamicBVH.from_boxes(lo, lo + 1, margin=margin)
    handles, wrong = tree.ids(), 0
    for tick in range(ticks):
        rows = np.flatnonzero(fast if tick % 20 else fast | True)
        speed = np.where((lo < 0) & (speed < 0) | (lo > 1000) & (speed > 0), -speed, speed)
        lo[rows] += speed[rows] * np.where(fast[rows], TICK, 20 * TICK)[:, None]
        step = speed[rows] * TICK if ahead else None
        tree.move_many(handles[rows], lo[rows], lo[rows] + 1, step)
        if tick % 20 == 0:
            wrong += _wrong_boxes(tree, lo, lo + 1, rng)
    name = f'1e4 and 1e-9 m/s, margin {margin:g} m' + (', predicted' if ahead else '')
    return _judged(tree, name, f'{count} boxes, {ticks} ticks of {TICK} s', wrong_overlaps=wrong)


def _teleports(times: int) -> Case:
    """One box goes 1e15 m away and comes back, again and again."""
    rng = np.random.default_rng(3)
    lo = rng.uniform(0, 100, (500, 3))
    tree = DynamicBVH.from_boxes(lo, lo + 1, margin=0.1)
    handles, home, wrong = tree.ids(), lo[0].copy(), 0
    for _ in range(times):
        for place in (home + 1e15, home):
            lo[0] = place
            tree.move(handles[0], lo[0], lo[0] + 1)
            wrong += handles[0] not in tree.overlap(lo[0], lo[0])
    wrong += _wrong_boxes(tree, lo, lo + 1, rng)
    given = f'500 boxes, {times} returns'
    return _judged(tree, 'teleports by 1e15 m and back', given, wrong_overlaps=wrong)


def judge(title: str, cases: Callable[[bool], Iterable[Case]], page: Page, brief: bool) -> int:
    """Add a table of cases; return how many failed."""
    found = list(cases(brief))
    failed = sum(not case.passed for case in found)
    rows = [[*case[:4], 'PASS' if case.passed else 'FAIL', case.slab] for case in found]
    page.table(f'stability_{title.lower()}', HEADER, rows)
    page.add(f'**{len(found) - failed} of {len(found)} cases passed.**')
    return failed


SECTIONS = {
    'Rays': partial(judge, 'Rays', lambda brief: ray_cases()),
    'Scales': partial(judge, 'Scales', scale_cases),
    'Boxes': partial(judge, 'Boxes', lambda brief: (*pair_cases(), *nearest_cases())),
    'Order': partial(judge, 'Order', height_cases),
    'Motion': partial(judge, 'Motion', motion_cases),
    'Meshes': partial(judge, 'Meshes', lambda brief: mesh_cases()),
}
