# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What each part of a scene costs when it is on; and that it costs nothing when off: what a scene
that does not use it imports, compiles and allocates.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ...scene import ShapeKind, Shapes
from ..page import Page
from ..tables import Cell, Table
from .running import Job, ObstacleField, run_apart, run_in_turns

MICRO = 1e6
BASE = '3D, axis-aligned boxes'
KINDS = {
    'turned boxes': ShapeKind.BOX,
    'spheres': ShapeKind.SPHERE,
    'cylinders': ShapeKind.CYLINDER,
    'capsules': ShapeKind.CAPSULE,
}
ON_IN_BRIEF = (BASE, 'planar', 'spheres', 'batch of rays')
REPEATS = 2


def random_field(count: int, kind: ShapeKind, turned: bool, rays: int = 300) -> ObstacleField:
    """Obstacles of about a metre on one floor, as thick as in a tidy warehouse, and rays half way
    up: seen from above the answers are the same.
    """
    rng = np.random.default_rng(1)
    edge = 3.0 * count**0.5
    size = rng.uniform(0.2, 1.0, (count, 3))
    if kind != ShapeKind.BOX:
        size[:, 1] = size[:, 0]
        size[:, 2] = size[:, 0] + (0.0 if kind == ShapeKind.SPHERE else 0.5)
    turns = rng.normal(size=(count, 4)) if turned else np.zeros((count, 4))
    places, ends = rng.uniform(0, edge, (count, 3)), rng.uniform(0, edge, (2, rays, 3))
    places[:, 2] = ends[:, :, 2] = 1.0
    return ObstacleField(Shapes(np.full(count, kind, np.uint8), places, turns, size), *ends)


def mesh_field(count: int) -> ObstacleField:
    """The same places, an octahedron in each."""
    corners = np.array([(0.4, 0, 0), (0, 0.4, 0), (0, 0, 0.4)])
    signs = np.array([(x, y, z) for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    field = random_field(count, ShapeKind.BOX, True)
    return field._replace(triangles=corners * signs[:, None])


def parts_on(page: Page, brief: bool) -> None:
    """Measure."""
    count = 200 if brief else 2_000
    with tempfile.TemporaryDirectory() as folder:
        boxes = random_field(count, ShapeKind.BOX, False).save(Path(folder), 'boxes')
        jobs = {
            BASE: Job(boxes),
            'planar': Job(boxes, planar=True),
            'margin 0.1 m': Job(boxes, margin=0.1),
            'masks': Job(boxes, masks=True),
            'velocities, asked 0.3 s later': Job(boxes, moving=True),
            'batch of rays': Job(boxes, batch=2 if brief else 20),
        }
        for name, kind in KINDS.items():
            jobs[name] = Job(random_field(count, kind, True).save(Path(folder), name))
        jobs['meshes of 8 faces'] = Job(mesh_field(count).save(Path(folder), 'meshes'))
        if brief:
            jobs = {name: jobs[name] for name in ON_IN_BRIEF}
        _table(page, run_in_turns(jobs, 1 if brief else REPEATS), count)


def _table(page: Page, took: dict[str, dict[str, Any]], count: int) -> None:
    rows: list[list[Cell]] = []
    for name, one in took.items():
        times: list[Cell] = [one[key] * MICRO for key in ('update', 'raycast', 'overlap')]
        rows.append([name, *times, one['batch'] * MICRO if 'batch' in one else None])
        rows[-1] += [one['start'], one['memory']]
    page.add('### Each part on')
    page.add(
        f'{count:,} obstacles on a floor, in a scene of its own process; each row but the first '
        'turns one part on. *update*: all obstacles move by 5 cm. *raycast*, *overlap*: one call '
        'from Python. *start*: processor time from the start of Python to the first answer, with '
        'compiled kernels. *memory*: of the whole process, Python, numpy and numba included.'
    )
    header = ['part', 'us an obstacle, update', 'us, raycast', 'us, overlap']
    header += ['us a ray in a batch', 's, start', 'MB, memory']
    page.table(Table('features_on', header, rows))


def parts_off(page: Page, brief: bool) -> int:
    """Compare a scene that uses no part with one that uses just that part; return how many parts
    were there though they were off.
    """
    count = 200
    with tempfile.TemporaryDirectory() as folder:
        boxes = random_field(count, ShapeKind.BOX, False).save(Path(folder), 'boxes')
        round_ones = random_field(count, ShapeKind.CYLINDER, True).save(Path(folder), 'round')
        meshes = mesh_field(count).save(Path(folder), 'meshes')
        jobs = {
            'batches of rays': Job(boxes, batch=2, turns=1),
            'turned and round shapes': Job(round_ones, turns=1),
            'meshes': Job(meshes, turns=1),
            'planar scene': Job(boxes, planar=True, turns=1),
            'margin': Job(boxes, margin=0.1, turns=1),
            'velocities': Job(boxes, moving=True, turns=1),
        }
        if brief:
            jobs = {name: jobs[name] for name in ('margin', 'velocities')}
        without = run_apart(Job(boxes, turns=1))
        rows = [_difference(name, without, run_apart(job), count) for name, job in jobs.items()]
    page.add('### Each part off')
    page.add(
        f'{count} axis-aligned boxes, thin rays and overlaps: {len(without["kernels"])} kernels '
        f'have machine code, {without["tree"] / count:.0f} bytes a box are allocated, and of '
        f'rclpy, python-fcl and matplotlib {", ".join(without["libraries"]) or "none"} is '
        'imported. A row turns one part on and says what comes with it; off, none of that is '
        'there.'
    )
    header = ('part', 'kernels more when on', 'bytes a box more', 'for example')
    page.table(Table('features_off', header, rows))
    return len(without['libraries'])


def _difference(name: str, without: dict, on: dict, count: int) -> list[Cell]:
    more = sorted(set(on['kernels']) - set(without['kernels']))
    grown = (on['tree'] - without['tree']) / count
    return [name, len(more), grown, ', '.join(kernel.rpartition('.')[2] for kernel in more[:4])]
