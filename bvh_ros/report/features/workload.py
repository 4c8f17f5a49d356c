# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes side by side in a process of its own: `python workload.py '<order as JSON>'`.

Fills a scene for each job and does short turns of the same work with each, one after the other.
Prints as JSON what each turn took, by job and kind of work; of one job alone also what the process
took until its first answer, and its memory.
"""

import gc
import importlib
import importlib.util
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

OVERLAPS = 100
STEP = 0.05  # m that obstacles go from frame to frame

Work = dict[str, tuple[Callable[[], object], int]]  # what is done in a turn, and how many of them


def seconds(run: Callable[[], object]) -> float:
    """How long one run takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def memory() -> float:
    """Resident memory of this process, MB; 0 where the system does not tell."""
    try:
        status = Path('/proc/self/status').read_text(encoding='utf-8')
    except OSError:
        return 0.0
    return int(status.partition('VmRSS:')[2].split()[0]) / 1024


def prepare(job: dict[str, Any]) -> Work:
    """Fill a scene of the job's build and ask it a first time."""
    if job['kernels']:
        os.environ['NUMBA_CACHE_DIR'] = job['kernels']  # read when the package is imported
    scenes = importlib.import_module(f'{job["package"]}.scene')
    given = np.load(job['file'])
    shapes = scenes.Shapes(
        **{name: given[name] for name in scenes.Shapes._fields if name in given}
    )
    if 'triangles' in given:
        meshes = [scenes.Mesh(given['triangles'])] * len(shapes.kind)
        shapes = scenes.Shapes.of_meshes(meshes, shapes.position, shapes.orientation)
    count, rays = len(shapes.kind), list(zip(given['starts'], given['goals'], strict=True))
    names = scenes.Numbered('o', np.arange(count))
    scene = scenes.Scene(planar=job['planar'], margin=job['margin'])
    categories = 1 + np.arange(count) % 2 if job['masks'] else 1
    refused = scene.update('a', names, shapes, stamp=0, categories=categories)
    if refused:
        raise ValueError(f'a row of the scene is refused: {refused[0].reason}')
    scene.raycast(*rays[0])
    frame = 0

    def update() -> None:
        nonlocal frame
        frame += 1
        moved = shapes._replace(position=shapes.position + STEP * (frame % 2))
        scene.update('a', names, moved, stamp=frame, categories=categories)

    mask = 2 if job['masks'] else 0xFFFFFFFF
    boxes = [(goal - 0.5, goal + 0.5) for _, goal in rays[:OVERLAPS]]
    work: Work = {
        'update': (update, count),
        'raycast': (lambda: [scene.raycast(*ray, mask=mask) for ray in rays], len(rays)),
        'overlap': (lambda: [scene.overlap(*box, mask=mask) for box in boxes], len(boxes)),
    }
    if job['batch']:
        starts = np.tile(given['starts'], (job['batch'], 1))
        ways = np.tile(given['goals'] - given['starts'], (job['batch'], 1))
        work['batch'] = (lambda: scene.raycast_many(starts, ways, 1.0, mask), len(starts))
    return work


def prepare_apart(number: int, job: dict[str, Any]) -> Work:
    """Prepare with code objects of the job's own: in one that several scenes share, Python's
    shortcuts fit the first one only, and it would seem 6 % faster.
    """
    spec = importlib.util.spec_from_file_location(f'work_{number}', __file__)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    work: Work = module.prepare(job)
    return work


def main(order: dict[str, Any]) -> dict[str, dict[str, list[float]]]:
    """Take turns."""
    if hasattr(os, 'sched_setaffinity'):  # one core: nothing moves between caches
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    sys.path[:0] = dict.fromkeys(job['path'] for job in order['jobs'].values())
    given = order['jobs'].items()
    jobs = {name: prepare_apart(k, job) for k, (name, job) in enumerate(given)}
    took: dict[str, dict[str, list[float]]] = {
        name: {kind: [] for kind in work} for name, work in jobs.items()
    }
    if len(jobs) == 1:
        (alone,) = took.values()
        alone['start'] = [time.process_time()]
    kinds = dict.fromkeys(kind for work in jobs.values() for kind in work)
    gc.disable()
    for kind in kinds:
        takers = [(name, *work[kind]) for name, work in jobs.items() if kind in work]
        for _, run, _ in takers:
            run()
        for turn in range(order['turns']):
            # Everybody follows everybody else in time.
            for name, run, count in takers[turn % len(takers) :] + takers[: turn % len(takers)]:
                took[name][kind].append(seconds(run) / count)
        gc.collect()
    if len(jobs) == 1:
        alone['memory'] = [memory()]
    return took


if __name__ == '__main__':
    print(json.dumps(main(json.loads(sys.argv[1]))))
