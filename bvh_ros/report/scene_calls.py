# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What one call of a scene costs from Python, all in; beside it one call of coal where it has the
like.
"""

from collections.abc import Callable
from importlib.util import find_spec
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np

from ..scene import Scene, Shapes
from .libraries.fcl import Coal
from .page import Page
from .scenes import EDGE, Boxes, Floats, incoherent_rays, query_edge, spread, uniform_boxes
from .tables import Cell, Table
from .timing import Job, interleaved

BOXES, CALLS, REPEATS = 10_000, 500, 9
RADIUS = 0.2  # m, of the swept ball
TEN = 10
STEP = 0.01  # m that an obstacle goes


class Asked(NamedTuple):
    """What the calls are about."""

    boxes: Boxes
    starts: Floats
    goals: Floats
    small: Boxes
    turns: Floats


def scene_calls(page: Page, brief: bool) -> None:
    """Measure."""
    size, calls, repeats = (300, 20, 3) if brief else (BOXES, CALLS, REPEATS)
    asked = make_asked(size, calls)
    jobs = {f'bvh_ros {name}': job for name, job in scene_jobs(asked).items()}
    if find_spec('coal') is not None:
        jobs |= {f'coal {name}': job for name, job in coal_jobs(asked).items()}
    times = {name: timing.nanoseconds / 1e3 for name, timing in interleaved(jobs, repeats).items()}
    rows: list[list[Cell]] = []
    for name in scene_jobs(asked):
        ours, theirs = times[f'bvh_ros {name}'], times.get(f'coal {name}')
        rows.append([name, ours, theirs, ours / theirs if theirs else None])
    page.add('### Calls of a scene')
    page.add(
        f'{size:,} named boxes, one call after the other, us a call with all that it takes: names '
        'looked up, input checked, points and normals of the hits. coal is asked for the pairs '
        'of the same box, without names, points or normals, or moves the same box.'
    )
    header = ['call', 'us a call', 'coal, us a call', 'ours / coal']
    page.table(Table('peers_scene_calls', header, rows))


def make_asked(size: int, calls: int) -> Asked:
    """Boxes, and so many questions."""
    rng = np.random.default_rng(1)
    boxes, rays = uniform_boxes(size, rng), incoherent_rays(calls, rng)
    corner = spread(calls, rng)
    return Asked(
        boxes,
        rays.origins,
        rays.origins + EDGE * rays.directions,
        Boxes(corner, corner + query_edge(boxes, 0.5)),
        rng.normal(size=(calls, 4)),
    )


def _each(function: Callable[..., Any], *columns: Any) -> Job:
    rows = list(zip(*columns, strict=True))

    def run() -> None:
        for row in rows:
            function(*row)

    return Job(run, len(rows))


def scene_jobs(asked: Asked) -> dict[str, Job]:
    """The calls, by name."""
    scene, (lo, hi) = Scene(), asked.boxes
    names = [f'box{row}' for row in range(len(lo))]
    middle, size = (lo + hi) / 2, hi - lo
    scene.update('report', names, Shapes.boxes(middle, size), stamp=0)

    def updates(many: int) -> Job:
        """Runs of rows that go a step, and back in the next turn."""
        runs = [slice(row, row + many) for row in range(min(len(asked.starts), len(lo) - many))]
        parts = [
            [(names[run], Shapes.boxes(middle[run] + step, size[run])) for run in runs]
            for step in (STEP, 0.0)
        ]
        turns = cycle(parts)

        def run() -> None:
            for named, shapes in next(turns):
                scene.update('report', named, shapes, stamp=1)

        return Job(run, len(runs))

    def swept(start: Floats, goal: Floats) -> None:
        scene.raycast(start, goal, RADIUS)

    return {
        'raycast': _each(scene.raycast, asked.starts, asked.goals),
        'swept ball': _each(swept, asked.starts, asked.goals),
        'overlap': _each(scene.overlap, *asked.small),
        'turned overlap': _each(scene.overlap, *asked.small, asked.turns),
        'nearest': _each(scene.nearest, asked.starts),
        'update of one': updates(1),
        'update of ten': updates(TEN),
    }


def coal_jobs(asked: Asked) -> dict[str, Job]:
    """What coal has of the kind."""
    library = Coal()
    objects = library._objects(asked.boxes)
    manager, small = library._manager(objects), library._objects(asked.small)
    centers = (asked.boxes.lo + asked.boxes.hi) / 2
    states = cycle((STEP, 0.0))

    def overlap(item: Any) -> None:
        library._collide(manager, [item], len(objects))

    def update() -> None:
        shift = next(states)
        for item, center in zip(objects[: len(small)], centers, strict=False):
            library._put(item, center + shift)
            manager.update()

    return {'overlap': _each(overlap, small), 'update of one': Job(update, len(small))}
