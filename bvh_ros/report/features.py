# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The cost of each part that is on, and that it is absent when off."""

import statistics
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from itertools import cycle, product
from typing import Any

import numpy as np

from bvh_ros.scene.shapes.shape import unit_quaternions

from .. import DynamicBVH
from ..scene import Scene, Shapes
from . import scenes
from .page import Cell, Page
from .scenes import Boxes, Floats, Jobs, Queries
from .timing import Job, interleaved, memory, one_processor
from .workload import Configuration, run_apart

# ---- The cost of each part of a scene that is on, and what a scene without it does not load


FIGURES = 'update', 'raycast', 'overlap', 'batch', 'start', 'memory'
COUNT, COUNT_OFF = 2_000, 200  # obstacles
ON: dict[str, dict[str, Any]] = {
    '3D, axis-aligned boxes': {},
    'planar': {'planar': True},
    'margin 0.1 m': {'margin': 0.1},
    'masks': {'masks': True},
    'velocities, asked 0.3 s later': {'moving': True},
    'batch of rays': {'batch': 20},
    'turned boxes': {'turned': True},
    'spheres': {'kind': 'SPHERE', 'turned': True},
    'cylinders': {'kind': 'CYLINDER', 'turned': True},
    'capsules': {'kind': 'CAPSULE', 'turned': True},
    'meshes of 8 faces': {'kind': 'MESH', 'turned': True},
}
ON_IN_BRIEF = '3D, axis-aligned boxes', 'planar', 'spheres', 'batch of rays'
OFF: dict[str, dict[str, Any]] = {
    'batches of rays': {'batch': 2},
    'turned and round shapes': {'kind': 'CYLINDER', 'turned': True},
    'meshes': {'kind': 'MESH', 'turned': True},
    'planar scene': {'planar': True},
    'margin': {'margin': 0.1},
    'velocities': {'moving': True},
}
OFF_IN_BRIEF = 'margin', 'velocities'
ON_TURNS = 3  # the first is not counted: it compiles what is not compiled yet


def parts_on(page: Page, brief: bool) -> None:
    """2,000 obstacles on a floor, in a scene of its own process; each row but the first turns one
    part on. *update*: all obstacles move by 5 cm. *raycast*, *overlap*: one call from Python.
    *start*: processor time from the start of Python to the first answer, with compiled kernels.
    *memory*: of the whole process, Python, numpy and numba included.
    """
    count = 200 if brief else COUNT
    jobs = {
        name: Configuration(count, **options)
        for name, options in ON.items()
        if not brief or name in ON_IN_BRIEF
    }
    turns = [
        {name: run_apart(job) for name, job in jobs.items()}
        for _ in range(2 if brief else ON_TURNS)
    ]
    rows: list[list[Cell]] = []
    for name in jobs:
        runs = [turn[name] for turn in turns[1:]]
        medians = [statistics.median(run[key] for run in runs) for key in FIGURES]
        rows.append([name, *(None if np.isnan(figure) else figure for figure in medians)])
    header = ['part', 'us an obstacle, update', 'us, raycast', 'us, overlap']
    header += ['us a ray in a batch', 's, start', 'MB, memory']
    page.table('features_on', header, rows)


def parts_off(page: Page, brief: bool) -> int:
    """200 axis-aligned boxes, thin rays and overlaps. A row turns one part on and says what comes
    with it; off, none of that is there.
    """
    off = run_apart(Configuration(COUNT_OFF, turns=1))
    rows: list[list[Cell]] = []
    for name, options in OFF.items():
        if brief and name not in OFF_IN_BRIEF:
            continue
        on = run_apart(Configuration(COUNT_OFF, turns=1, **options))
        more = sorted(set(on['kernels']) - set(off['kernels']))
        examples = ', '.join(kernel.rpartition('.')[2] for kernel in more[:4])
        rows.append([name, len(more), (on['tree'] - off['tree']) / COUNT_OFF, examples])
    page.add(
        f'Without any part {len(off["kernels"])} kernels have machine code, '
        f'{off["tree"] / COUNT_OFF:.0f} bytes a box are allocated, and of rclpy, python-fcl and '
        f'matplotlib {", ".join(off["libraries"]) or "none"} is imported.'
    )
    header = ('part', 'kernels more when on', 'bytes a box more', 'for example')
    page.table('features_off', header, rows)
    return len(off['libraries'])


# ---- The cost of queries about another time


BOXES, ROWS, CALLS, REPEATS = 10_000, 10_000, 300, 9
SPEED, FAST, LENGTH, RADIUS = 1.5, 10.0, 5.0, 0.2  # m/s, standard deviation an axis; m
ALONG, OF_SPEED = (17.0, 0.0, 0.0), (1.0, 0.1, 0.0)  # m/s, and shares: one carriageway
SHORT = 0.9  # s: obstacles predicted no longer than this rest at the end of a segment
STEP = 0.1  # m
Velocities = Floats | None


def _tree(boxes: Boxes, velocities: Velocities, queries: Queries) -> Jobs:
    tree, steps = DynamicBVH.from_boxes(*boxes), cycle((STEP, 0.0))
    ids = tree.ids()

    def refresh() -> None:
        tree.move_many(ids, *boxes.moved(next(steps)))
        if velocities is not None:
            tree.set_velocities(ids, velocities)

    refresh()
    timed = velocities is not None
    return {**scenes.of_tree(tree, queries, timed), 'all updated': Job(refresh, len(ids))}


def _scene(
    shapes: Shapes, velocities: Velocities, queries: Queries, max_prediction: float = np.inf
) -> Jobs:
    scene, names = Scene(max_prediction=max_prediction), [f'b{i}' for i in range(len(shapes.kind))]
    turns = cycle((shapes._replace(position=shapes.position + STEP), shapes))

    def update() -> None:
        scene.update('report', names, next(turns), stamp=0, velocities=velocities)

    update()
    timed = velocities is not None
    return {
        **scenes.of_scene(scene, names, queries, timed),
        'all updated': Job(update, len(names)),
    }


def times(page: Page, brief: bool) -> None:
    """10,000 boxes that fill 2 % of a cube of 100 m, and as many that move at 1.5 m/s on each
    axis, or at 10; or one way, at 17 m/s and so much more or less; or for 0.9 s and then no more.
    Segments of 5 m, which take a second; boxes, points and shapes a second later. us a call, row
    or box, without velocities and with them.
    """
    rng = np.random.default_rng(7)
    boxes, starts = (
        scenes.uniform_boxes(200 if brief else BOXES, rng),
        scenes.spread(50 if brief else ROWS, rng),
    )
    slow, directions = SPEED * rng.normal(size=boxes.lo.shape), rng.normal(size=starts.shape)
    reach, directions = scenes.query_edge(boxes, 0.5) / 2, LENGTH * scenes.units(directions)
    small = Boxes(starts - reach, starts + reach)
    lines = starts, directions, starts + directions
    queries = Queries(*lines, 1.0, small, directions, RADIUS, CALLS, (0, 1, 16))
    still = Shapes.boxes(boxes.centers, boxes.edges)
    turned = Shapes.boxes(
        boxes.centers, boxes.edges, unit_quaternions(rng.normal(size=(len(slow), 4)))
    )
    fast, along = FAST / SPEED * slow, np.array(ALONG) + OF_SPEED * slow
    worlds: dict[str, tuple[Callable[..., Jobs], Any, Floats]] = {
        'tree': (_tree, boxes, slow),
        'scene': (_scene, still, slow),
        'scene, turned boxes': (_scene, turned, slow),
        f'tree, {FAST:g} m/s': (_tree, boxes, fast),
        f'scene, turned boxes, {FAST:g} m/s': (_scene, turned, fast),
        'tree, one way': (_tree, boxes, along),
        'scene, one way': (_scene, still, along),
        'scene, at rest by then': (partial(_scene, max_prediction=SHORT), still, slow),
    }
    rows: list[list[Cell]] = []
    for world, (make, obstacles, velocities) in worlds.items():
        rest, then = make(obstacles, None, queries), make(obstacles, velocities, queries)
        jobs = Jobs()
        for name in then:
            jobs |= {f'at rest: {name}': rest[name], f'then: {name}': then[name]}
        with one_processor():
            found = interleaved(jobs, 2 if brief else REPEATS)
        for name in then:
            pair = [found[f'{which}: {name}'].microseconds for which in ('at rest', 'then')]
            rows.append([world, name, *pair, pair[1] / pair[0]])
    header = ['world', 'question', 'us, at rest', 'us, at a time', 'ratio']
    page.table('features_times', header, rows)


# ---- The node: time until it serves, and memory, by configuration


LEAN = 'no batch, no tf, no source'
NODES: dict[str, dict[str, object]] = {
    LEAN: {'batch': False, 'use_tf': False, 'sources': ['']},
    'markers': {'batch': False, 'use_tf': False},
    'markers, planar': {'batch': False, 'use_tf': False, 'planar': True},
    'markers, a view': {'batch': False, 'use_tf': False, 'views': ['ahead']},
    'markers, batch': {'use_tf': False},
    'markers, batch, tf: the default': {},
}
NODE_TURNS = 3  # the first is not timed: it compiles what is not compiled yet


def node_parts(page: Page, brief: bool) -> None:
    """Processes of their own over ROS 2, compiled before: from the start of the process until it
    serves, and its memory then.
    """
    if find_spec('rclpy') is None:
        page.add("Left out: there is no rclpy (pip install 'bvh_ros[ros]').")
        return
    import rclpy

    from ..client import BvhClient
    from ..ros import running

    nodes = {LEAN: NODES[LEAN]} if brief else NODES
    figures: dict[str, list[tuple[float, float]]] = {name: [] for name in nodes}
    starts = product(range(2 if brief else NODE_TURNS), nodes.items())
    namespace = running.keep_apart()
    running.init()
    try:
        with (page.folder / 'features_node.log').open('wb') as log:
            for number, (_, (name, parameters)) in enumerate(starts):
                space, began = f'{namespace}_{number}', time.perf_counter()
                with running.running_node(space, parameters, log=log) as process:
                    node = rclpy.create_node('features', namespace=space)
                    running.wait_until_ready(BvhClient(node), process)
                    figures[name].append((time.perf_counter() - began, memory(process.pid)))
                    node.destroy_node()
    finally:
        rclpy.try_shutdown()
    rows = [[name, *np.median(some[1:], axis=0).tolist()] for name, some in figures.items()]
    page.table('features_node', ('configuration', 's until it serves', 'MB, memory'), rows)


SECTIONS = {
    'Each part on': parts_on,
    'Each part off': parts_off,
    'Queries about another time': times,
    'The node': node_parts,
}
