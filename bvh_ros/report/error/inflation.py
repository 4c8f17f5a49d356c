# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clearance by the rounded shape, and by the inflated one: what sharp corners get wrong."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...scene import Scene, Shapes
from ...scene.shapes import rotations, unit_quaternions
from ..page import Page
from ..progress import Progress
from ..scenes import Floats, Rays
from ..tables import Cell, Table
from ..timing import Job, interleaved
from . import recordings
from .shape_scenes import bounds_of, rays_round, scene_of

TOLERANCES = (0.01, 0.05, 0.2)  # m
ASKED, ASKED_QUICK = 200, 5  # of each question at each scene
REPEATS, REPEATS_QUICK = 5, 1
EDGES = (0.05, 0.3)  # m, of a query box: about a hand
LENGTH = 3.0  # m, of a ray: across the scene
QUESTIONS = 3
HEADER = (
    'tolerance, m', 'question', 'asked', 'answers: rounded', 'inflated', 'false',
    'false, % of the inflated', 'free queries', 'of them taken for occupied, %',
    'rounded: us a query', 'inflated', 'rounded over inflated',
)  # fmt: skip
Answers = set[tuple[int, int]]
"""(query, node handle), the queries of all scenes numbered on."""


class Asked(NamedTuple):
    """Questions at one scene, the same ones in both ways; each gives the handles found."""

    rounded: list[Callable[[], list[int]]]
    inflated: list[Callable[[], list[int]]]


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    return len(TOLERANCES) * QUESTIONS * (REPEATS_QUICK if brief else REPEATS)


def inflated_boxes(page: Page, progress: Progress, brief: bool) -> None:
    """Overlaps and rays with clearance at recorded tables and shelves."""
    page.add('### Clearance: rounded against inflated')
    path = page.data / 'manipulation_scenes' / 'scenes.csv'
    if page.misses([path]):
        return
    worlds = list(recordings.shapes_by_scene(path).values())
    asked = ASKED_QUICK if brief else ASKED
    page.add(
        f'{len(worlds)} planning scenes, {asked} questions of each kind at each. *Rounded*: the '
        'shape grown by the tolerance all round, as `tolerance` means it. *Inflated*: the same '
        'question without tolerance, where a query box (for a point: a cube) has its edges longer '
        'by twice the tolerance, and for rays every obstacle. *False*: obstacles that only the '
        'inflated box reports; of rays only the first obstacle counts, and only on a free way.'
    )
    rows: list[list[Cell]] = []
    for tolerance in TOLERANCES:
        for name, ask in (('turned box', _boxes), ('point', _points), ('ray', _rays)):
            progress.say(f'error: tolerance {tolerance:g} m, {name}')
            rng = np.random.default_rng(6)  # for every tolerance the same questions
            asked_of = [ask(shapes, asked, tolerance, rng) for shapes in worlds]
            rows.append([f'{tolerance:g}', name, *_row(asked_of, progress, brief)])
    page.table(Table('error_inflation', HEADER, rows))


def _row(asked_of: list[Asked], progress: Progress, brief: bool) -> list[Cell]:
    rounded = [question for asked in asked_of for question in asked.rounded]
    inflated = [question for asked in asked_of for question in asked.inflated]
    right, wide = _answers(rounded), _answers(inflated)
    free = set(range(len(rounded))) - {query for query, _ in right}
    taken = free & {query for query, _ in wide}
    false = len(wide - right)
    jobs = {
        'rounded': Job(lambda: [question() for question in rounded], len(rounded)),
        'inflated': Job(lambda: [question() for question in inflated], len(inflated)),
    }
    times = interleaved(jobs, REPEATS_QUICK if brief else REPEATS, progress.step)
    took = [times[job].nanoseconds / 1e3 for job in jobs]
    shares = 100 * false / max(len(wide), 1), 100 * len(taken) / max(len(free), 1)
    counts: list[Cell] = [len(rounded), len(right), len(wide), false, shares[0]]
    return [*counts, len(free), shares[1], *took, took[0] / took[1]]


def _answers(questions: list[Callable[[], list[int]]]) -> Answers:
    return {(query, handle) for query, ask in enumerate(questions) for handle in ask()}


def _centres(shapes: Shapes, count: int, rng: np.random.Generator) -> Floats:
    lo, hi = bounds_of(shapes)
    return rng.uniform(lo.min(axis=0), hi.max(axis=0), (count, 3))


def _boxes(shapes: Shapes, count: int, tolerance: float, rng: np.random.Generator) -> Asked:
    """Turned boxes anywhere in the scene's bounds."""
    scene, centres = scene_of(shapes), _centres(shapes, count, rng)
    turns = unit_quaternions(rng.normal(size=(count, 4)))
    halves = rng.uniform(*EDGES, (count, 3)) / 2
    matrices = rotations(turns)
    asked = Asked([], [])
    for centre, turn, half, matrix in zip(centres, turns, halves, matrices, strict=True):
        diagonal, wide = matrix @ half, matrix @ (half + tolerance)
        box = centre - diagonal, centre + diagonal, turn
        asked.rounded.append(_overlap(scene, *box, tolerance))
        asked.inflated.append(_overlap(scene, centre - wide, centre + wide, turn, 0.0))
    return asked


def _points(shapes: Shapes, count: int, tolerance: float, rng: np.random.Generator) -> Asked:
    """Points: a ball, and the cube round it."""
    scene, identity = scene_of(shapes), np.array([0.0, 0.0, 0.0, 1.0])
    asked = Asked([], [])
    for centre in _centres(shapes, count, rng):
        asked.rounded.append(_overlap(scene, centre, centre, identity, tolerance))
        cube = centre - tolerance, centre + tolerance
        asked.inflated.append(_overlap(scene, *cube, identity, 0.0))
    return asked


def _overlap(
    scene: Scene, start: Floats, goal: Floats, turn: Floats, tolerance: float
) -> Callable[[], list[int]]:
    return lambda: [hit.handle for hit in scene.overlap(start, goal, turn, tolerance)]


def _rays(shapes: Shapes, count: int, tolerance: float, rng: np.random.Generator) -> Asked:
    """A swept ball, and a thin ray at obstacles that are larger. Only whether the way is free."""
    scene = scene_of(shapes)
    larger = scene_of(shapes._replace(size=shapes.size + 2 * tolerance))
    rays: Rays = rays_round(shapes, count, rng)
    goals = rays.origins + LENGTH * rays.directions
    ways = list(zip(rays.origins, goals, strict=True))
    return Asked(
        [_blocked(scene, *way, tolerance) for way in ways],
        [_blocked(larger, *way, 0.0) for way in ways],
    )


def _blocked(scene: Scene, start: Floats, goal: Floats, radius: float) -> Callable[[], list[int]]:
    return lambda: [0] if scene.raycast(start, goal, radius) else []
