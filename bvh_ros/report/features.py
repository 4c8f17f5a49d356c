# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report features`: the cost of each part that is on, and that it is absent when off."""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import DynamicBVH
from ..scene import Scene, ShapeKind, Shapes
from .page import Cell, Page, Table
from .peers import each, one_processor
from .scenes import Boxes, Floats, query_edge, spread, uniform_boxes
from .timing import Job, interleaved, memory

# ---- Runs workloads, each in a process of its own.


WORKLOAD = Path(__file__).with_name('workload.py')


class ObstacleField(NamedTuple):
    """Obstacles, and segments to ask about."""

    shapes: Shapes
    starts: Floats
    goals: Floats
    triangles: Floats | None = None
    """Of the mesh that all obstacles are; None if they are none."""

    def save(self, folder: Path, name: str) -> Path:
        """Write it where a workload can read it."""
        path = folder / f'{name}.npz'
        columns = {**self.shapes._asdict(), **self._asdict()}
        del columns['shapes']
        np.savez(path, **{name: column for name, column in columns.items() if column is not None})
        return path


class Configuration(NamedTuple):
    """A configuration of a scene, see `workload`."""

    file: Path
    planar: bool = False
    margin: float = 0.0
    masks: bool = False
    batch: int = 0
    moving: bool = False
    turns: int = 9


def run_apart(job: Configuration) -> dict[str, Any]:
    """Run a workload: its figures (the fastest turn counts: what disturbs one makes it slower),
    the kernels that it compiled or loaded, and what it imported.
    """
    result = subprocess.run(
        [sys.executable, str(WORKLOAD), json.dumps(job._asdict(), default=str)],
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise RuntimeError(f'a workload failed: {result.stderr}')
    told: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return told


def run_in_turns(jobs: Mapping[str, Configuration], repeats: int) -> dict[str, dict[str, Any]]:
    """Medians of every job's figures, after an untimed round, which compiles what is not compiled
    yet.
    """
    for job in jobs.values():
        run_apart(job._replace(turns=1))
    told: dict[str, list[dict[str, Any]]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, job in jobs.items():
            told[name].append(run_apart(job))
    return {
        name: runs[0] | {
            key: statistics.median(run[key] for run in runs)
            for key, value in runs[0].items()
            if isinstance(value, float)
        }
        for name, runs in told.items()
    }  # fmt: skip


# ---- What each part of a scene costs when it is on; and that it costs nothing when off: what a
# scene that does not use it imports, compiles and allocates.


MICRO = 1e6
BASE = '3D, axis-aligned boxes'
KINDS = {
    'turned boxes': ShapeKind.BOX,
    'spheres': ShapeKind.SPHERE,
    'cylinders': ShapeKind.CYLINDER,
    'capsules': ShapeKind.CAPSULE,
}
ON_IN_BRIEF = (BASE, 'planar', 'spheres', 'batch of rays')
PARTS_REPEATS = 2


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
            BASE: Configuration(boxes),
            'planar': Configuration(boxes, planar=True),
            'margin 0.1 m': Configuration(boxes, margin=0.1),
            'masks': Configuration(boxes, masks=True),
            'velocities, asked 0.3 s later': Configuration(boxes, moving=True),
            'batch of rays': Configuration(boxes, batch=2 if brief else 20),
        }
        for name, kind in KINDS.items():
            jobs[name] = Configuration(random_field(count, kind, True).save(Path(folder), name))
        jobs['meshes of 8 faces'] = Configuration(mesh_field(count).save(Path(folder), 'meshes'))
        if brief:
            jobs = {name: jobs[name] for name in ON_IN_BRIEF}
        _table(page, run_in_turns(jobs, 1 if brief else PARTS_REPEATS), count)


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
            'batches of rays': Configuration(boxes, batch=2, turns=1),
            'turned and round shapes': Configuration(round_ones, turns=1),
            'meshes': Configuration(meshes, turns=1),
            'planar scene': Configuration(boxes, planar=True, turns=1),
            'margin': Configuration(boxes, margin=0.1, turns=1),
            'velocities': Configuration(boxes, moving=True, turns=1),
        }
        if brief:
            jobs = {name: jobs[name] for name in ('margin', 'velocities')}
        without = run_apart(Configuration(boxes, turns=1))
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


# ---- What it costs to ask where things will be, beside asking where they are.


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


# ---- What the parts of the node cost: how soon it serves, and its memory, with each
# configuration.


LEAN = 'no batch, no tf, no source'
NODES: dict[str, dict[str, object]] = {
    LEAN: {'batch': False, 'use_tf': False, 'sources': ['']},
    'markers': {'batch': False, 'use_tf': False},
    'markers, planar': {'batch': False, 'use_tf': False, 'planar': True},
    'markers, a view': {'batch': False, 'use_tf': False, 'views': ['ahead']},
    'markers, batch': {'use_tf': False},
    'markers, batch, tf: the default': {},
}


def node_parts(page: Page, brief: bool) -> None:
    """Start nodes, in turns."""
    page.add('### The node')
    if find_spec('rclpy') is None:
        page.add("Left out: there is no rclpy (pip install 'bvh_ros[ros]').")
        return
    nodes = {LEAN: NODES[LEAN]} if brief else NODES
    # The first of each is not timed: it compiles what is not compiled yet.
    took = _start_all(nodes, 2 if brief else 3, page.folder / 'features_node.log')
    page.add(
        'Processes of their own over ROS 2, compiled before: from the start of the process until '
        'it serves, and its memory then.'
    )
    rows: list[list[Cell]] = [
        [name, *(statistics.median(column) for column in zip(*runs, strict=True))]
        for name, runs in took.items()
    ]
    page.table(Table('features_node', ('configuration', 's until it serves', 'MB, memory'), rows))


def _start_all(
    nodes: dict[str, dict[str, object]], times: int, log: Path
) -> dict[str, list[tuple[float, float]]]:
    import rclpy

    from ..client import BvhClient
    from ..ros import running

    took: dict[str, list[tuple[float, float]]] = {name: [] for name in nodes}
    namespace = running.keep_apart()
    running.init()
    try:
        with log.open('wb') as output:
            for turn in range(times):
                for number, (name, parameters) in enumerate(nodes.items()):
                    own = f'{namespace}_{turn}_{number}'
                    began = time.perf_counter()
                    with running.running_node(own, parameters, log=output) as process:
                        node = rclpy.create_node('features', namespace=own)
                        running.wait_until_ready(BvhClient(node), process)
                        ready = time.perf_counter() - began
                        if turn:
                            took[name].append((ready, memory(process.pid)))
                        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    return took


INTRODUCTION = '## Features'
SECTIONS = {'on': parts_on, 'off': parts_off, 'other times': times, 'the node': node_parts}
