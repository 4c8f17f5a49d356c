# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is measured in a process of its own: a scene at work, and the kernels of a node."""

import gc
import json
import math
import os
import subprocess
import sys
import time
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bvh_ros.report.timing import Job, memory, seconds
from bvh_ros.scene import Mesh, Numbered, Scene, ShapeKind, Shapes
from bvh_ros.scene.shapes.shape import IDENTITY, unit_quaternions
from bvh_ros.tree.compiler.kernel_parts import Kernel

if TYPE_CHECKING:
    from bvh_ros.ros import compile_jobs

RAYS, OVERLAPS = 300, 100
STEP = 0.05  # m that obstacles go from frame to frame
SPEED, LATER = 1.5, 300_000_000  # m/s; ns after the update


class Configuration(NamedTuple):
    """A scene of obstacles on a floor, and how it is used."""

    obstacles: int
    kind: str = 'BOX'  # a name of `ShapeKind`
    turned: bool = False
    planar: bool = False
    margin: float = 0.0
    masks: bool = False
    batch: int = 0  # how many times all rays are in a batch; 0: no batch
    moving: bool = False
    turns: int = 9  # of the work; the fastest counts, as disturbances only slow it down


def obstacles(job: Configuration, rng: np.random.Generator) -> Shapes:
    """Obstacles of about a metre on one floor, as dense as in a tidy warehouse."""
    count, kind = job.obstacles, ShapeKind[job.kind]
    size = rng.uniform(0.2, 1.0, (count, 3))
    if kind in (ShapeKind.SPHERE, ShapeKind.CYLINDER, ShapeKind.CAPSULE):
        size[:, 1] = size[:, 0]
        size[:, 2] = size[:, 0] + (0.0 if kind == ShapeKind.SPHERE else 0.5)
    turns = (
        unit_quaternions(rng.normal(size=(count, 4)))
        if job.turned
        else np.tile(IDENTITY, (count, 1))
    )
    places = rng.uniform(0, 3.0 * count**0.5, (count, 3))
    places[:, 2] = 1.0
    if kind == ShapeKind.MESH:
        corners = np.array([(0.4, 0, 0), (0, 0.4, 0), (0, 0, 0.4)])
        signs = np.array([(x, y, z) for x in (1, -1) for y in (1, -1) for z in (1, -1)])
        octahedron = Mesh(corners * signs[:, None])
        return Shapes.of_meshes([octahedron] * count, places, turns)
    return Shapes(np.full(count, kind, np.uint8), places, turns, size)


def prepare(job: Configuration) -> tuple[Scene, dict[str, Job]]:
    """Fill a scene and query it a first time."""
    rng = np.random.default_rng(1)
    shapes, count = obstacles(job, rng), job.obstacles
    # Half way up, so that the answers are the same when seen from above.
    starts, goals = rng.uniform(0, 3.0 * count**0.5, (2, RAYS, 3)) * (1, 1, 0) + (0, 0, 1.0)
    rays = list(zip(starts, goals, strict=True))
    names = Numbered('o', np.arange(count))
    scene = Scene(planar=job.planar, margin=job.margin)
    options: dict[str, Any] = {'categories': 1 + np.arange(count) % 2 if job.masks else 1}
    if job.moving:
        options['velocities'] = np.full((count, 3), SPEED)
    refused = scene.update('a', names, shapes, stamp=0, **options)
    if refused:
        raise ValueError(f'a row of the scene is refused: {refused[0].reason}')
    scene.raycast(*rays[0])
    frame = 0

    def update() -> None:
        nonlocal frame
        frame += 1
        moved = shapes._replace(position=shapes.position + STEP * (frame % 2))
        scene.update('a', names, moved, stamp=frame, **options)

    query: dict[str, Any] = {'mask': 2 if job.masks else 0xFFFFFFFF}
    if job.moving:
        query['at'] = LATER
    boxes = [(goal - 0.5, goal + 0.5) for goal in goals[:OVERLAPS]]
    work = {
        'update': Job(update, count),
        'raycast': Job(lambda: [scene.raycast(*ray, **query) for ray in rays], len(rays)),
        'overlap': Job(lambda: [scene.overlap(*box, **query) for box in boxes], len(boxes)),
    }
    if job.batch:
        many = np.tile(starts, (job.batch, 1)), np.tile(goals - starts, (job.batch, 1)), 1.0
        work['batch'] = Job(lambda: scene.raycast_many(*many, **query), len(many[0]))
    return scene, work


def measure(job: Configuration) -> dict[str, Any]:
    """Take turns: us a unit of each kind of work, and what it took."""
    scene, work = prepare(job)
    figures: dict[str, Any] = {'start': time.process_time(), 'batch': math.nan}
    for kind, (run, count, _) in work.items():
        run()
        figures[kind] = 1e6 * min(seconds(run) for _ in range(job.turns)) / count
    figures['memory'] = memory()
    stats = scene.stats()
    figures['tree'] = float(
        stats['bytes'] + stats['tree']['bytes'] + stats['tree']['snapshot_bytes']
    )
    figures['kernels'] = sorted({kernel.name for kernel in compiled()})
    loaded = {name.partition('.')[0] for name in sys.modules}
    figures['libraries'] = sorted(loaded & {'rclpy', 'fcl', 'matplotlib'})
    return figures


def run_apart(job: Configuration) -> dict[str, Any]:
    """Run a workload: its figures, the kernels that it compiled or loaded, what it imported."""
    program = f'import json; from {__name__} import *; print(json.dumps(measure({job!r})))'
    figures: dict[str, Any] = json.loads(printed(program))
    return figures


def printed(program: str, **environment: str) -> str:
    """What a program prints in a process of its own."""
    command, variables = [sys.executable, '-c', program], {**os.environ, **environment}
    ended = subprocess.run(command, env=variables, stdout=subprocess.PIPE, text=True, check=True)
    return ended.stdout


# The kernels that a process has compiled, and those of a node without configuration.


class Entry(NamedTuple):
    """A kernel, compiled for one signature."""

    name: str
    signature: str
    seconds: float  # all of it; 0 for what was in the cache
    llvm: float  # seconds of that in LLVM


def default_jobs() -> list['compile_jobs.Job']:
    """Return what compiles all that a node without configuration calls."""
    from bvh_ros.ros import compile_jobs
    from bvh_ros.ros.cdr import marker_array
    from bvh_ros.ros.sources import SOURCE_TYPES

    decode = partial(marker_array.read, marker_array.EMPTY)
    kinds = SOURCE_TYPES['MarkerArray'].kinds
    needs = compile_jobs.Needs(planar=False, margin=0.0, kinds=kinds, batch=True)
    markers = compile_jobs.Job('decode markers', 'decode markers', 2.0, decode, early=True)
    return [*compile_jobs.jobs(needs), markers]


def compile_apart(**environment: str) -> list[Entry]:
    """Compile in a new process; return its kernels, the slowest first."""
    program = f"""
import json
import math
from {__name__} import *
for job in default_jobs():
    job.run()
print(json.dumps(compiled()))
"""
    entries = [Entry(*columns) for columns in json.loads(printed(program, **environment))]
    return sorted(entries, key=lambda entry: -entry.seconds)


def compiled() -> list[Entry]:
    """The kernels that this process has called."""
    found = []
    for kernel in gc.get_objects():
        if isinstance(kernel, Kernel):
            name = f'{kernel.py_func.__module__.removeprefix("bvh_ros.")}.{kernel.__name__}'
            for signature, result in kernel.overloads.items():
                timers = (result.metadata or {}).get('timers', {})
                times = (timers.get(lock, 0.0) for lock in ('compiler_lock', 'llvm_lock'))
                found.append(Entry(name, str(signature), *times))
    return found
