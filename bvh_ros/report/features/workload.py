# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One scene in a process of its own: `python workload.py '<job as JSON>'`.

Prints what it took, as JSON. Modules named in `without` are replaced by empty ones before the
scene is imported: a build without that part, in which using it would be an error.
"""

import importlib
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

FRAMES, ROUNDS, OVERLAPS = 7, 5, 100
STEP = 0.05  # m that obstacles go from frame to frame


class Absent(ModuleType):
    """A module whose names exist, so that others can import them, and cannot be used."""

    def __getattr__(self, name: str) -> object:
        if name.startswith('__'):
            raise AttributeError(name)
        return object()


def least(rounds: int, run: Callable[[], Any]) -> float:
    """Seconds of the fastest of some runs."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def memory() -> float:
    """Resident memory of this process, MB; 0 where the system does not tell."""
    try:
        status = Path('/proc/self/status').read_text(encoding='utf-8')
    except OSError:
        return 0.0
    return int(status.partition('VmRSS:')[2].split()[0]) / 1024


def main(job: dict[str, Any]) -> dict[str, float]:
    """Fill a scene, move it, and ask."""
    if 'bvh_ros' in sys.modules:
        raise RuntimeError('too late to leave out a part: run this file, not the module')
    for name in job['without']:
        sys.modules[name] = Absent(name)
    begin = time.perf_counter()
    scenes = importlib.import_module('bvh_ros.scene')
    given = np.load(job['file'])
    shapes = scenes.Shapes(
        **{name: given[name] for name in scenes.Shapes._fields if name in given}
    )
    count, rays = len(shapes.kind), list(zip(given['starts'], given['goals'], strict=True))
    names = scenes.Numbered('o', np.arange(count))
    scene = scenes.Scene(planar=job['planar'], margin=job['margin'])
    categories = 1 + np.arange(count) % 2 if job['masks'] else 1
    refused = scene.update('a', names, shapes, stamp=0, categories=categories)
    scene.raycast(*rays[0])
    took = {'start': time.perf_counter() - begin}
    if refused:
        raise ValueError(f'a row of the scene is refused: {refused[0].reason}')
    frame = 0

    def update() -> None:
        nonlocal frame
        frame += 1
        moved = shapes._replace(position=shapes.position + STEP * (frame % 2))
        scene.update('a', names, moved, stamp=frame, categories=categories)

    mask = 2 if job['masks'] else 0xFFFFFFFF
    took['update'] = least(FRAMES, update) / count
    took['raycast'] = least(ROUNDS, lambda: [scene.raycast(*ray, mask=mask) for ray in rays])
    took['raycast'] /= len(rays)
    boxes = rays[:OVERLAPS]
    took['overlap'] = least(
        ROUNDS, lambda: [scene.overlap(goal - 0.5, goal + 0.5, mask=mask) for _, goal in boxes]
    )
    took['overlap'] /= len(boxes)
    if job['batch']:
        starts = np.tile(given['starts'], (job['batch'], 1))
        ways = np.tile(given['goals'] - given['starts'], (job['batch'], 1))
        batch = least(ROUNDS, lambda: scene.raycast_many(starts, ways, 1.0, mask))
        took['batch'] = batch / len(starts)
    took['memory'] = memory()
    return took


if __name__ == '__main__':
    print(json.dumps(main(json.loads(sys.argv[1]))))
