# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of all kinds of shapes against python-fcl's `collide` and `distance`, each disagreement
listed with what is true.
"""

from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scene import ShapeKind, Shapes
from ...scene.clearance import gap as distance_of
from ...scene.narrow_phase import near_pairs
from ...scene.query_shape import solids
from ...scene.shapes import canonical, rotations, unit_quaternions
from ..page import Page
from ..progress import Progress
from ..scenes import Floats
from ..tables import Cell, Table
from .contacts import contacts, random_pairs, widest_gap

GAPS = (-1e-2, -1e-4, -1e-6, -1e-8, -1e-10, -1e-13, 1e-13, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
RANDOM, PAIRS = 50_000, 50_000  # and those of all the gaps together
RANDOM_QUICK, PAIRS_QUICK = 120, 120
FAR_OFF = 1e-6  # m, of two distances: python-fcl stops at about this
HEADER = (
    'gap, m', 'pairs', 'touching: bvh_ros wrong', 'of them with a cylinder',
    'python-fcl wrong', 'of them with a cylinder', 'distance: bvh_ros, largest error, m',
    'python-fcl, largest error, m', f'python-fcl off by more than {FAR_OFF:g} m',
)  # fmt: skip
LISTED = ('gap, m', 'pair', 'one', 'other', 'question', 'true', 'bvh_ros', 'python-fcl', 'why')
SUMMED = ('why', 'disagreements', 'closest to touching, m', 'farthest from it, m', 'kinds, most')

OURS = 'bvh_ros wrong beside a cylinder'
OURS_ELSE = 'bvh_ros wrong without a cylinder'
OURS_FAR = 'bvh_ros: its distance is off'
WITHIN = 'python-fcl wrong, within its tolerance of 1e-6 m'
BEYOND = 'python-fcl wrong, beyond its tolerance'
THEIRS_FAR = 'python-fcl: its distance is off'


class Answers(NamedTuple):
    """Of n pairs."""

    touching: NDArray[np.bool_]
    distances: Floats
    """m; 0 where they touch."""


class Disagreement(NamedTuple):
    """A pair for which the two differ; a row of the list."""

    gap: float
    pair: int
    one: str
    other: str
    question: str
    true: float
    ours: float
    theirs: float
    why: str


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    return len(GAPS) + 1


def against_fcl(page: Page, progress: Progress, brief: bool) -> None:
    """Random pairs and contacts."""
    page.add('### Pairs of shapes against python-fcl')
    if find_spec('fcl') is None:
        page.add('Left out: python-fcl is not installed.')
        for _ in range(steps(brief)):
            progress.step()
        return
    _explain(page)
    listed: list[Disagreement] = []
    rows = []
    rng = np.random.default_rng(31)
    for name, shapes in _cases(brief, rng):
        progress.say(f'error: pairs, {name}')
        ours, theirs = our_answers(shapes), fcl_answers(shapes)
        gaps = _true_gaps(name, shapes, ours, theirs, rng)
        rows.append(_row(name, shapes, gaps, ours, theirs))
        listed += _disagreements(shapes, gaps, ours, theirs)
        progress.step()
    page.table(Table('error_pairs', HEADER, rows))
    page.table(Table('error_pairs_why', SUMMED, _summed(listed)))
    page.add(
        'Why: python-fcl iterates for all but a few kinds of pairs, ends at about 1e-6 m and '
        'calls apart what is no deeper than that; its distances end as early, some earlier. '
        'bvh_ros calls apart only what a plane keeps apart by more than about 4e-15 of the larger '
        'shape; where GJK gains no more digits beside a round rim, the widest gap between planes '
        'is searched for until none can be wider.'
    )
    Table('error_pairs_listed', LISTED, listed).write_csv(page.folder)


def _explain(page: Page) -> None:
    page.add(
        'Turned boxes, spheres, cylinders and capsules of 0.05 to 2 m, also 1 cm thin ones. '
        '*Random*: pairs anywhere near each other; where the two answers differ, the truth is '
        'the widest gap between two parallel planes. All others are contacts, made so that the '
        'gap is known; a negative gap is a depth. Touching is asked of both by their `collide`, '
        f'and every distance that differs by more than {FAR_OFF:g} m counts as a disagreement, '
        'too. `error_pairs_listed.csv` has every disagreement, one a row (for touching: 1 yes, '
        '0 no); the second table sums them up.'
    )


def _cases(brief: bool, rng: np.random.Generator) -> Iterator[tuple[float | str, Shapes]]:
    yield 'random', random_pairs(RANDOM_QUICK if brief else RANDOM, rng)
    for gap in GAPS:
        yield gap, contacts((PAIRS_QUICK if brief else PAIRS) // len(GAPS), gap, rng)


def our_answers(shapes: Shapes) -> Answers:
    """What the narrow phase and the clearance say of rows 2 i and 2 i + 1."""
    form, aligned = canonical(shapes)
    records = solids(form, ~aligned)
    count = len(records) // 2
    touching, distances, points = np.empty(count, np.bool_), np.empty(count), np.empty((2, 3))
    near_pairs(records, None, np.arange(2 * count).reshape(-1, 2), False, touching)
    for i in range(count):
        distances[i] = distance_of(records[2 * i], records[2 * i + 1], None, False, points)
    return Answers(touching, distances)


def fcl_answers(shapes: Shapes) -> Answers:
    """What python-fcl says of them."""
    import fcl

    objects = fcl_objects(shapes)
    pairs = list(zip(objects[::2], objects[1::2], strict=True))
    touching = np.array([fcl.collide(*pair) > 0 for pair in pairs])
    distances = np.array([max(fcl.distance(*pair), 0.0) for pair in pairs])
    return Answers(touching, distances)


def fcl_objects(shapes: Shapes) -> list[Any]:
    """The shapes as python-fcl has them."""
    import fcl

    matrices = rotations(unit_quaternions(shapes.orientation))
    objects = []
    for row, (kind, size) in enumerate(zip(shapes.kind, shapes.size.tolist(), strict=True)):
        if kind == ShapeKind.BOX:
            geometry = fcl.Box(*size)
        elif kind == ShapeKind.SPHERE:
            geometry = fcl.Sphere(size[0] / 2)
        elif kind == ShapeKind.CYLINDER:
            geometry = fcl.Cylinder(size[0] / 2, size[2])
        else:
            geometry = fcl.Capsule(size[0] / 2, size[2] - size[0])
        place = fcl.Transform(matrices[row], shapes.position[row])
        objects.append(fcl.CollisionObject(geometry, place))
    return objects


def _apart(ours: Answers, theirs: Answers) -> NDArray[np.bool_]:
    """Where the distances differ, or one says nought."""
    return np.abs(ours.distances - theirs.distances) > FAR_OFF


def _true_gaps(
    name: float | str, shapes: Shapes, ours: Answers, theirs: Answers, rng: np.random.Generator
) -> Floats:
    """Gaps of the pairs; of random ones NaN where the two agree."""
    count = len(ours.touching)
    if not isinstance(name, str):
        return np.full(count, name)
    gaps = np.full(count, np.nan)
    for i in np.flatnonzero((ours.touching != theirs.touching) | _apart(ours, theirs)).tolist():
        gaps[i] = widest_gap(shapes.take(slice(2 * i, 2 * i + 2)), rng)
    return gaps


def _row(
    name: float | str, shapes: Shapes, gaps: Floats, ours: Answers, theirs: Answers
) -> list[Cell]:
    known = ~np.isnan(gaps)
    beside = (shapes.kind.reshape(-1, 2) == ShapeKind.CYLINDER).any(axis=1)
    wrong = [known & (one.touching != (gaps < 0)) for one in (ours, theirs)]
    counts = [int(np.count_nonzero(w & which)) for w in wrong for which in (known, beside)]
    errors = [np.abs(one.distances - np.maximum(gaps, 0.0))[known] for one in (ours, theirs)]
    largest = [float(error.max(initial=0.0)) for error in errors]
    off = int(np.count_nonzero(errors[1] > FAR_OFF))
    return [f'{name:g}' if known.all() else 'random', len(gaps), *counts, *largest, off]


def _disagreements(
    shapes: Shapes, gaps: Floats, ours: Answers, theirs: Answers
) -> list[Disagreement]:
    found = []
    kinds = [ShapeKind(kind).name.lower() for kind in shapes.kind]
    for i in np.flatnonzero(ours.touching != theirs.touching).tolist():
        one, other, gap = kinds[2 * i], kinds[2 * i + 1], float(gaps[i])
        if ours.touching[i] != (gap < 0):
            why = OURS if 'cylinder' in (one, other) else OURS_ELSE
        else:
            why = WITHIN if abs(gap) <= FAR_OFF else BEYOND
        said = float(gap < 0), float(ours.touching[i]), float(theirs.touching[i])
        found.append(Disagreement(gap, i, one, other, 'touching', *said, why))
    for i in np.flatnonzero(_apart(ours, theirs)).tolist():
        true = max(float(gaps[i]), 0.0)
        said = true, float(ours.distances[i]), float(theirs.distances[i])
        why = OURS_FAR if abs(said[1] - true) > FAR_OFF else THEIRS_FAR
        one, other = kinds[2 * i], kinds[2 * i + 1]
        found.append(Disagreement(float(gaps[i]), i, one, other, 'distance', *said, why))
    return found


def _summed(listed: list[Disagreement]) -> list[list[Cell]]:
    """A row for each reason."""
    rows: list[list[Cell]] = []
    for why in (OURS, OURS_ELSE, OURS_FAR, WITHIN, BEYOND, THEIRS_FAR):
        mine = [one for one in listed if one.why == why]
        kinds = [' and '.join(sorted((one.one, one.other))) for one in mine]
        most = max(sorted(set(kinds)), key=kinds.count, default='')
        gaps = [abs(one.gap) for one in mine]
        shown: list[Cell] = [min(gaps), max(gaps)] if gaps else [None, None]
        rows.append([why, len(mine), *shown, f'{most} ({kinds.count(most)})' if most else ''])
    return rows
