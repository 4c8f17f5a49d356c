# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What each part of a scene costs when it is on, and when it is there but unused."""

import tempfile
from pathlib import Path

import numpy as np

from ...scene import ShapeKind, Shapes
from .. import plots
from ..page import Page
from ..progress import Progress
from ..tables import Cell, Table
from .running import Figures, Job, World, medians, run_in_turns

MICRO = 1e6
BASE = '3D, axis-aligned boxes'
KINDS = {
    'turned boxes': ShapeKind.BOX,
    'spheres': ShapeKind.SPHERE,
    'cylinders': ShapeKind.CYLINDER,
    'capsules': ShapeKind.CAPSULE,
}
ON = (BASE, 'planar', *KINDS, 'margin 0.1 m', 'masks', 'batch of rays')
ON_IN_BRIEF = (BASE, 'planar', 'spheres', 'batch of rays')

# Modules that a scene of axis-aligned boxes asked for thin rays and overlaps never enters.
SHAPES = ('casting', 'contact', 'gjk', 'narrow_phase', 'ray_shapes', 'separation')
BALLS = ('ball_casting', 'exact_balls')
PLANAR = ('overlap_footprint', 'ray_footprint')
WITHOUT: dict[str, tuple[str, ...]] = {
    'nothing: the same build again': (),
    'batches of rays': ('tree.ordering', 'tree.wide_raycasting'),
    'swept boxes': ('tree.boxcasting',),
    'swept balls': tuple(f'scene.{name}' for name in BALLS),
    'other shapes and the narrow phase': tuple(
        f'scene.{name}' for name in (*SHAPES, *BALLS, *PLANAR)
    ),
}
OFF_IN_BRIEF = ('other shapes and the narrow phase',)
RATIOS = ('update', 'raycast', 'overlap', 'start', 'memory')
WHOLE = 'whole'


def chosen(brief: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Rows of the two tables."""
    return (ON_IN_BRIEF, OFF_IN_BRIEF) if brief else (ON, tuple(WITHOUT))


def repeats(brief: bool) -> tuple[int, int]:
    """Of the two tables."""
    return (1, 1) if brief else (3, 7)


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    (on, off), (used, unused) = repeats(brief), chosen(brief)
    return on * len(used) + off * (len(unused) + 1)


def random_world(count: int, kind: ShapeKind, turned: bool, rays: int = 300) -> World:
    """Obstacles of about a metre, as thick as in a tidy warehouse."""
    rng = np.random.default_rng(1)
    edge = 2.0 * count ** (1 / 3)
    size = rng.uniform(0.2, 1.0, (count, 3))
    if kind != ShapeKind.BOX:
        size[:, 1] = size[:, 0]
        size[:, 2] = size[:, 0] + (0.0 if kind == ShapeKind.SPHERE else 0.5)
    turns = rng.normal(size=(count, 4)) if turned else np.zeros((count, 4))
    kinds = np.full(count, kind, np.uint8)
    shapes = Shapes(kinds, rng.uniform(0, edge, (count, 3)), turns, size)
    return World(shapes, *rng.uniform(0, edge, (2, rays, 3)))


def run(page: Page, progress: Progress, brief: bool) -> None:
    """Measure."""
    count = 200 if brief else 2_000
    (on, off), (used, unused) = repeats(brief), chosen(brief)
    with tempfile.TemporaryDirectory() as folder:
        boxes = random_world(count, ShapeKind.BOX, False).save(Path(folder), 'boxes')
        jobs = {
            BASE: Job(boxes),
            'planar': Job(boxes, planar=True),
            'margin 0.1 m': Job(boxes, margin=0.1),
            'masks': Job(boxes, masks=True),
            'batch of rays': Job(boxes, batch=2 if brief else 20),
        }
        for name, kind in KINDS.items():
            jobs[name] = Job(random_world(count, kind, True).save(Path(folder), name))
        progress.say('features: each part on')
        runs = run_in_turns({name: jobs[name] for name in used}, on, progress.step)
        _parts_on(page, {name: medians(taken) for name, taken in runs.items()}, count)
        progress.say('features: each part unused')
        builds = {WHOLE: Job(boxes)}
        for name in unused:
            modules = tuple(f'bvh_ros.{module}' for module in WITHOUT[name])
            builds[name] = Job(boxes, without=modules)
        _parts_unused(page, run_in_turns(builds, off, progress.step))


def _parts_on(page: Page, took: dict[str, Figures], count: int) -> None:
    rows: list[list[Cell]] = []
    for name, one in took.items():
        times: list[Cell] = [one[key] * MICRO for key in ('update', 'raycast', 'overlap')]
        rows.append([name, *times, one['batch'] * MICRO if 'batch' in one else None])
        rows[-1] += [one['start'], one['memory']]
    page.add('### Each part on')
    page.add(
        f'{count:,} obstacles in a scene of its own process; each row but the first turns one '
        'part on. *update*: all obstacles move by 5 cm. *raycast*, *overlap*: one call from '
        'Python. *start*: from the import to the first answer, with compiled kernels. *memory*: '
        'of the whole process, Python, numpy and numba included.'
    )
    header = ['part', 'us an obstacle, update', 'us, raycast', 'us, overlap']
    header += ['us a ray in a batch', 's, start', 'MB, memory']
    page.table(Table('features_on', header, rows))
    groups = {
        name: {key: one[key] / took[BASE][key] for key in ('update', 'raycast', 'overlap')}
        for name, one in took.items()
        if name != BASE
    }
    path = page.plot('features_on', 'Cost of each part when it is on')
    label = 'time over that of 3D axis-aligned boxes'
    plots.ratios(path, groups, label, 'Cost of each part when it is on')


def _parts_unused(page: Page, took: dict[str, list[Figures]]) -> None:
    """The fastest runs are compared: what disturbs a run only makes it slower."""
    whole = took.pop(WHOLE)
    rows: list[list[Cell]] = []
    for name, runs in took.items():
        row: list[Cell] = [name]
        for key in RATIOS:
            without = min(run[key] for run in runs)
            row.append(min(run[key] for run in whole) / without)
        rows.append(row)
    page.add('### Each part off')
    page.add(
        'The whole build, a part of it unused, over a build without that part: its modules are '
        'empty, and entering them would be an error. Axis-aligned boxes, thin rays, overlaps; '
        f'least of {len(whole)} processes each, in turns. The first row is what chance does.'
    )
    header = ('left out of the build', *(f'{key}, ratio' for key in RATIOS))
    page.table(Table('features_off', header, rows))
