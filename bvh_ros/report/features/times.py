# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What it costs to ask where things will be, beside asking where they are."""

from collections.abc import Callable, Mapping
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np

from ... import DynamicBVH
from ...scene import Scene, Shapes
from ..calls import each
from ..page import Page
from ..peers import one_processor
from ..scenes import Boxes, Floats, query_edge, spread, uniform_boxes
from ..tables import Cell, Table
from ..timing import Job, interleaved

BOXES, ROWS, CALLS, REPEATS = 10_000, 10_000, 300, 9
SPEED, FAST, WAY, RADIUS = 1.5, 10.0, 5.0, 0.2  # m/s, standard deviation an axis; m
ALONG, OF_SPEED = (17.0, 0.0, 0.0), (1.0, 0.1, 0.0)  # m/s, and shares: one carriageway
SHORT = 0.9  # s: who goes on no longer has come to rest by the end of a way
STEP = 0.1  # m
SECOND = 10**9
TOLD = 'all told anew'
FEW = 1, 16  # rows of a small batch
TOGETHER, LATER = {'at': 0, 'until': SECOND}, {'at': SECOND}  # a way takes a second
PACED, THEN = {'at': 0.0, 'pace': 1.0}, {'at': 1.0}

# By name: the method, its arguments, how many it answers (0: one by one), and its times.
Questions = Mapping[str, tuple[Callable[..., object], tuple[Any, ...], int, dict[str, Any]]]


def _jobs(questions: Questions, timed: bool) -> dict[str, Job]:
    found = {}
    for name, (ask, given, count, times) in questions.items():
        call = partial(ask, **times) if timed else ask
        found[name] = Job(partial(call, *given), count) if count else each(call, *given)
    return found


def _small(ask: Callable[..., object], *given: Any, times: dict[str, Any]) -> Questions:
    """Of small batches; arrays of `given` have a row a question, others are for all."""
    found = {}
    for rows in FEW:
        calls: list[Any] = []
        size = len(given[0]) // rows * rows
        for part in given:
            if isinstance(part, np.ndarray):
                calls.append(part[:size].reshape(-1, rows, 3)[:CALLS])
            else:
                calls.append([part] * min(size // rows, CALLS))
        found[f'{ask.__name__}, {rows} a call'] = ask, tuple(calls), 0, times
    return found


def _of_tree(boxes: Boxes, velocities: Floats | None, asked: tuple[Floats, ...]) -> Questions:
    tree, (starts, ways, lo, hi) = DynamicBVH.from_boxes(*boxes), asked
    if velocities is not None:
        tree.set_velocities(tree.ids(), velocities)
    steps, ids = cycle((STEP, 0.0)), tree.ids()

    def refresh() -> None:
        step = next(steps)
        tree.move_many(ids, boxes.lo + step, boxes.hi + step)
        if velocities is not None:
            tree.set_velocities(ids, velocities)

    few, count = slice(CALLS), len(starts)
    rays, limits = (starts, ways), (starts[few], ways[few], np.ones(len(starts[few])))
    return {
        'raycast': (tree.raycast, limits, 0, PACED),
        'boxcast': (tree.boxcast, (lo[few], hi[few], ways[few]), 0, PACED),
        'overlap': (tree.overlap, (lo[few], hi[few]), 0, THEN),
        'nearest': (tree.nearest, (starts[few],), 0, THEN),
        'raycast_many': (tree.raycast_many, (*rays, 1.0), count, PACED),
        **_small(tree.raycast_many, starts, ways, 1.0, times=PACED),
        'overlap_many': (tree.overlap_many, (lo, hi), count, THEN),
        **_small(tree.overlap_many, lo, hi, times=THEN),
        'nearest_many': (tree.nearest_many, (starts,), count, THEN),
        **_small(tree.nearest_many, starts, times=THEN),
        TOLD: (refresh, (), len(ids), {}),
    }


def _of_scene(
    shapes: Shapes,
    velocities: Floats | None,
    asked: tuple[Floats, ...],
    max_prediction: float = np.inf,
) -> Questions:
    scene, (starts, ways, lo, hi) = Scene(max_prediction=max_prediction), asked
    names = [f'box{row}' for row in range(len(shapes.kind))]
    scene.update('report', names, shapes, stamp=0, velocities=velocities)
    few, count, goals = slice(CALLS), len(starts), starts + ways
    size = tuple((hi - lo)[0].tolist())
    many = Shapes.boxes(starts[few], size)

    turns = cycle((shapes, shapes._replace(position=shapes.position + STEP)))

    def update() -> None:
        scene.update('report', names, next(turns), stamp=0, velocities=velocities)

    def ball(start: Floats, goal: Floats, **times: Any) -> object:
        return scene.raycast(start, goal, RADIUS, **times)

    return {
        'raycast': (scene.raycast, (starts[few], goals[few]), 0, TOGETHER),
        'swept ball': (ball, (starts[few], goals[few]), 0, TOGETHER),
        'overlap': (scene.overlap, (lo[few], hi[few]), 0, LATER),
        'nearest': (scene.nearest, (starts[few],), 0, LATER),
        'clearance': (scene.clearance, (names[few],), 0, LATER),
        'raycast_many': (scene.raycast_many, (starts, ways, 1.0), count, TOGETHER),
        **_small(scene.raycast_many, starts, ways, 1.0, times=TOGETHER),
        'sweep_many': (scene.sweep_many, (starts, goals, RADIUS), count, TOGETHER),
        **_small(scene.sweep_many, starts, goals, RADIUS, times=TOGETHER),
        'overlap_many': (scene.overlap_many, (starts, size), count, LATER),
        **_small(scene.overlap_many, starts, size, times=LATER),
        'nearest_many': (scene.nearest_many, (starts,), count, LATER),
        **_small(scene.nearest_many, starts, times=LATER),
        'clearance_many': (scene.clearance_many, (many,), len(many.kind), LATER),
        TOLD: (update, (), len(names), {}),
    }


def times(page: Page, brief: bool) -> None:
    """Measure."""
    rng = np.random.default_rng(7)
    boxes, starts = uniform_boxes(200 if brief else BOXES, rng), spread(50 if brief else ROWS, rng)
    velocities, ways = SPEED * rng.normal(size=boxes.lo.shape), rng.normal(size=starts.shape)
    ways *= WAY / np.linalg.norm(ways, axis=1)[:, None]
    reach = query_edge(boxes, 0.5) / 2
    asked = starts, ways, starts - reach, starts + reach
    middle, size = (boxes.lo + boxes.hi) / 2, boxes.hi - boxes.lo
    turned = Shapes.boxes(middle, size, rng.normal(size=(len(size), 4)))
    still, faster = Shapes.boxes(middle, size), FAST / SPEED

    def fast(speeds: Floats | None) -> Floats | None:
        return None if speeds is None else faster * speeds

    def along(speeds: Floats | None) -> Floats | None:
        return None if speeds is None else np.array(ALONG) + OF_SPEED * speeds

    worlds: dict[str, Callable[[Floats | None], Questions]] = {
        'tree': lambda speeds: _of_tree(boxes, speeds, asked),
        'scene': lambda speeds: _of_scene(still, speeds, asked),
        'scene, turned boxes': lambda speeds: _of_scene(turned, speeds, asked),
        f'tree, {FAST:g} m/s': lambda speeds: _of_tree(boxes, fast(speeds), asked),
        f'scene, turned boxes, {FAST:g} m/s': lambda speeds: _of_scene(
            turned, fast(speeds), asked
        ),
        'tree, one way': lambda speeds: _of_tree(boxes, along(speeds), asked),
        'scene, one way': lambda speeds: _of_scene(still, along(speeds), asked),
        'scene, at rest by then': lambda speeds: _of_scene(still, speeds, asked, SHORT),
    }
    rows: list[list[Cell]] = []
    for world, make in worlds.items():
        jobs = {'at rest': _jobs(make(None), False), 'then': _jobs(make(velocities), True)}
        both = {f'{which}: {name}': jobs[which][name] for name in jobs['then'] for which in jobs}
        with one_processor():
            found = interleaved(both, 2 if brief else REPEATS, warm=not brief)
        for name in jobs['then']:
            rest, then = (found[f'{which}: {name}'].nanoseconds / 1e3 for which in jobs)
            rows.append([world, name, rest, then, then / rest])
    page.add('### Asking about another time')
    page.add(
        f'{len(size):,} boxes that fill 2 % of a cube of 100 m, and as many that move at {SPEED} '
        f'm/s on each axis, or at {FAST}; or one way, at {ALONG[0]:g} m/s and so much more or '
        f'less; or for {SHORT} s and then no more. Ways of {WAY} m, which take a second; boxes, '
        'points and shapes a second later. us a call, row or box, without velocities and with '
        'them.'
    )
    header = ['world', 'question', 'us, at rest', 'us, at a time', 'ratio']
    page.table(Table('features_times', header, rows))
