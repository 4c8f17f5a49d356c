# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Off costs nothing: what a scene that does not use a part imports, compiles and allocates."""

import tempfile
from pathlib import Path

from ...scene import ShapeKind
from ..page import Page
from ..tables import Cell, Table
from .on import mesh_field, random_field
from .running import Job, run_apart


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
        }
        if brief:
            jobs = {name: jobs[name] for name in ('batches of rays', 'margin')}
        without = run_apart(Job(boxes, turns=1))
        rows = [_row(name, without, run_apart(job), count) for name, job in jobs.items()]
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


def _row(name: str, without: dict, on: dict, count: int) -> list[Cell]:
    more = sorted(set(on['kernels']) - set(without['kernels']))
    grown = (on['tree'] - without['tree']) / count
    return [name, len(more), grown, ', '.join(kernel.rpartition('.')[2] for kernel in more[:4])]
