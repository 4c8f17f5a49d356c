# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A scene in a process of its own: `python workload.py '<job as JSON>'`.

Prints as JSON what a unit of each kind of work took, the processor time until the first answer,
the memory of the process and of the scene, and which kernels and modules it took.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bvh_ros.report.timing import memory
from bvh_ros.scene import Mesh, Numbered, Scene, Shapes

OVERLAPS = 100
STEP = 0.05  # m that obstacles go from frame to frame
SPEED, LATER = 1.5, 300_000_000  # m/s; ns after they were told

Work = dict[str, tuple[Callable[[], object], int]]  # what is done in a turn, and how many of them


def kernels() -> list[str]:
    """Every kernel of this package that has machine code in this process."""
    found = set()
    for name, module in sys.modules.items():
        for value in vars(module).values() if name.startswith('bvh_ros') else ():
            if hasattr(value, 'py_func') and value.signatures:
                found.add(f'{value.py_func.__module__}.{value.py_func.__name__}')
    return sorted(found)


def prepare(job: dict[str, Any]) -> tuple[Scene, Work]:
    """Fill a scene and ask it a first time."""
    given = np.load(job['file'])
    shapes = Shapes(**{name: given[name] for name in Shapes._fields if name in given})
    if 'triangles' in given:
        meshes = [Mesh(given['triangles'])] * len(shapes.kind)
        shapes = Shapes.of_meshes(meshes, shapes.position, shapes.orientation)
    count, rays = len(shapes.kind), list(zip(given['starts'], given['goals'], strict=True))
    names = Numbered('o', np.arange(count))
    scene = Scene(planar=job['planar'], margin=job['margin'])
    categories = 1 + np.arange(count) % 2 if job['masks'] else 1
    told: dict[str, Any] = {'categories': categories}
    if job['moving']:
        told['velocities'] = np.full((count, 3), SPEED)
    refused = scene.update('a', names, shapes, stamp=0, **told)
    if refused:
        raise ValueError(f'a row of the scene is refused: {refused[0].reason}')
    scene.raycast(*rays[0])
    frame = 0

    def update() -> None:
        nonlocal frame
        frame += 1
        moved = shapes._replace(position=shapes.position + STEP * (frame % 2))
        scene.update('a', names, moved, stamp=frame, **told)

    ask: dict[str, Any] = {'mask': 2 if job['masks'] else 0xFFFFFFFF}
    if job['moving']:
        ask['at'] = LATER
    boxes = [(goal - 0.5, goal + 0.5) for _, goal in rays[:OVERLAPS]]
    work: Work = {
        'update': (update, count),
        'raycast': (lambda: [scene.raycast(*ray, **ask) for ray in rays], len(rays)),
        'overlap': (lambda: [scene.overlap(*box, **ask) for box in boxes], len(boxes)),
    }
    if job['batch']:
        starts = np.tile(given['starts'], (job['batch'], 1))
        ways = np.tile(given['goals'] - given['starts'], (job['batch'], 1))
        work['batch'] = (lambda: scene.raycast_many(starts, ways, 1.0, **ask), len(starts))
    return scene, work


def main(job: dict[str, Any]) -> dict[str, Any]:
    """Take turns."""
    scene, work = prepare(job)
    told: dict[str, Any] = {'start': time.process_time()}
    for kind, (run, count) in work.items():
        run()
        took = []
        for _ in range(job['turns']):
            began = time.perf_counter()
            run()
            took.append((time.perf_counter() - began) / count)
        told[kind] = min(took)
    told['memory'] = memory()
    stats = scene.stats()
    told['tree'] = float(stats['bytes'] + stats['tree']['bytes'] + stats['tree']['snapshot_bytes'])
    told['kernels'] = kernels()
    told['libraries'] = sorted(
        {name.partition('.')[0] for name in sys.modules} & {'rclpy', 'fcl', 'matplotlib'}
    )
    return told


if __name__ == '__main__':
    print(json.dumps(main(json.loads(sys.argv[1]))))
