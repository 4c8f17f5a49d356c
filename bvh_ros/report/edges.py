# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Edges of a planner: a box that moves and turns, certified, sampled, and by rapier and fcl."""

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from ..ros.conversions import rotations
from ..scene import Scene, Shapes
from ..scene.shapes.shape import unit_quaternions
from .error.methods import COLOURS, LETTERS, scale
from .page import Cell, Page
from .scenes import Boxes, Floats, spread, uniform_boxes, units
from .timing import Job, interleaved, one_processor

BOXES, EDGES, REPEATS = 10_000, 2_000, 5
LOOPED = 300  # edges of the loops over peers, and of the finest samples
SIZE, LENGTH, ANGLE = np.array((0.6, 0.4, 0.3)), 0.5, np.deg2rad(30.0)  # m, m, rad
RESOLUTION, EXACT = 1e-4, 1e-6  # m
DENSER = 1.7  # times the edges of `uniform_boxes`
ARM = float(np.linalg.norm(SIZE)) / 2.0
SWEEP, POSES = 'sweep between two poses', 'poses on the way'
STEPS = {SWEEP: (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), POSES: (0.1, 0.03, 0.01, 3e-3, 1e-3)}  # m


class Edges(NamedTuple):
    """n edges."""

    starts: Floats
    turns: Floats
    goals: Floats
    goal_turns: Floats

    def take(self, rows: Any) -> 'Edges':
        """Some of them."""
        return Edges(*(column[rows] for column in self))


def turn_about(axes: Floats, angle: Any) -> Floats:
    """Quaternions of turns by an angle about unit vectors (n, 3)."""
    angles = np.broadcast_to(angle, len(axes))[:, None] / 2.0
    return np.hstack([axes * np.sin(angles), np.cos(angles)])


def world(brief: bool, times: int = 1) -> tuple[Scene, Any, Floats, Edges, Floats]:
    """A scene of turned boxes, the boxes and their turns, edges, so many times as many, and the
    axes of those.
    """
    rng, scene = np.random.default_rng(7), Scene()
    boxes = uniform_boxes(300 if brief else BOXES, rng)
    half = boxes.edges * (0.5 * DENSER)
    boxes = Boxes(boxes.centers - half, boxes.centers + half)
    turned = unit_quaternions(rng.normal(size=(len(boxes.lo), 4)))
    names = [f'box{row}' for row in range(len(boxes.lo))]
    scene.update('report', names, Shapes.boxes(boxes.centers, boxes.edges, turned), stamp=0)
    count = times * (100 if brief else EDGES)
    starts, turns = spread(3 * count, rng), unit_quaternions(rng.normal(size=(3 * count, 4)))
    free = ~scene.overlap_shape_many(Shapes.boxes([0.0, 0.0, 0.0], SIZE), starts, turns)
    starts, turns = starts[free][:count], turns[free][:count]
    goals = starts + LENGTH * units(rng.normal(size=(count, 3)))
    axes = units(rng.normal(size=(count, 3)))
    edges = Edges(starts, turns, goals, rotations.multiply(turn_about(axes, ANGLE), turns))
    return scene, boxes, turned, edges, axes


def certified(scene: Scene, edges: Edges, resolution: float = RESOLUTION) -> Floats:
    """When each edge first meets something; inf if never."""
    t: Floats = scene.sweep_shape_many(
        Shapes.boxes([0.0, 0.0, 0.0], SIZE), *edges, resolution=resolution
    ).t  # type: ignore[union-attr]
    return t


def sampled(scene: Scene, edges: Edges, axes: Floats, step: float) -> Floats:
    """The same at poses between which no point goes farther than `step`, m."""
    poses = int(np.ceil((LENGTH + ANGLE * ARM) / step)) + 1
    share, count = np.linspace(0.0, 1.0, poses), len(edges.starts)
    places = edges.starts[:, None] + share[:, None] * (edges.goals - edges.starts)[:, None]
    turned = turn_about(np.repeat(axes, poses, axis=0), np.tile(share * ANGLE, count))
    turns = rotations.multiply(turned, np.repeat(edges.turns, poses, axis=0))
    shape = Shapes.boxes([0.0, 0.0, 0.0], SIZE)
    touched = scene.overlap_shape_many(shape, places.reshape(-1, 3), turns).reshape(count, poses)
    return np.where(touched.any(axis=1), share[touched.argmax(axis=1)], np.inf)


def of_rapier(boxes: Any, turned: Floats, edges: Edges, axes: Floats) -> Callable[[], Floats]:
    """`cast_shape_nonlinear` in a loop: float32."""
    rapier = import_module('rapier3d')
    scene = rapier.PhysicsWorld()
    for centre, half, turn in zip(boxes.centers, boxes.edges / 2.0, turned, strict=True):
        collider = rapier.Collider.cuboid(*half.tolist())
        pose = rapier.Isometry3(centre.tolist(), rapier.Rotation3(*turn[[3, 0, 1, 2]].tolist()))
        scene.add_collider(collider.position(pose).build())
    scene.detect_collisions()
    scene.update_query_pipeline()
    box, options = rapier.SharedShape.cuboid(*(SIZE / 2.0).tolist()), rapier.ShapeCastOptions()
    motions = [
        rapier.NonlinearRigidMotion(
            rapier.Isometry3(start.tolist(), rapier.Rotation3(*turn[[3, 0, 1, 2]].tolist())),
            [0.0, 0.0, 0.0],
            (goal - start).tolist(),
            (axis * ANGLE).tolist(),
        )
        for start, turn, goal, axis in zip(*edges[:3], axes, strict=True)
    ]
    ask = scene.query_pipeline.cast_shape_nonlinear

    def run() -> Floats:
        hits = [ask(motion, box, options, 0.0, 1.0) for motion in motions]
        return np.array([np.inf if hit is None else hit[1].time_of_impact for hit in hits])

    return run


def of_fcl(scene: Scene, boxes: Any, turned: Floats, edges: Edges) -> Callable[[], Floats]:
    """`continuousCollide` of each pair that the tree finds."""
    fcl = import_module('fcl')
    w_first = [3, 0, 1, 2]
    obstacles = [
        fcl.CollisionObject(fcl.Box(*edge), fcl.Transform(turn[w_first], centre))
        for edge, turn, centre in zip(boxes.edges, turned, boxes.centers, strict=True)
    ]
    request = fcl.ContinuousCollisionRequest(
        ccd_motion_type=fcl.CCDMotionType.CCDM_LINEAR,
        ccd_solver_type=fcl.CCDSolverType.CCDC_CONSERVATIVE_ADVANCEMENT,
    )
    reach = np.abs(edges.goals - edges.starts) + 2.0 * ARM
    middle = (edges.starts + edges.goals) / 2.0
    offsets, handles = scene.overlap_many(middle, reach, want='all')
    rows = [int(scene.name_of(int(handle))[3:]) for handle in handles]
    still = [obstacle.getTransform() for obstacle in obstacles]
    items = []
    for i in range(len(middle)):
        start = fcl.Transform(edges.turns[i][w_first], edges.starts[i])
        goal = fcl.Transform(edges.goal_turns[i][w_first], edges.goals[i])
        box = fcl.CollisionObject(fcl.Box(*SIZE), start)
        items += [(i, box, goal, row) for row in rows[offsets[i] : offsets[i + 1]]]

    def run() -> Floats:
        first = np.full(len(middle), np.inf)
        for i, box, goal, row in items:
            result = fcl.ContinuousCollisionResult()
            fcl.continuousCollide(box, goal, obstacles[row], still[row], request, result)
            if result.is_collide:
                first[i] = min(first[i], result.time_of_contact)
        return first

    return run


def comparison(page: Page, brief: bool) -> None:
    """2,000 edges of a box of 0.6 x 0.4 x 0.3 m, 0.5 m and 30 degrees each, that begin where it is
    free, among 10,000 turned boxes that fill 10 % of a cube of 100 m; one thread.
    `sweep_shape_many` at a resolution of 0.1 mm; poses no farther apart than 1 mm, by
    `overlap_shape_many`; `cast_shape_nonlinear` of rapier3d in a loop; `continuousCollide` of
    python-fcl for each pair whose bounds our tree finds to overlap, with objects that are ready
    and without the time of a tree (coal has no continuous collision in Python). *misses*: edges
    that meet something at a resolution of 1 um, and are free here. *meets*: the other way round.
    """
    scene, boxes, turned, every, axes = world(brief)
    few = slice(30 if brief else LOOPED)
    some, their_axes = every.take(few), axes[few]
    exact = certified(scene, every, EXACT)
    free, touching = np.isinf(exact), np.isfinite(exact)
    jobs = {
        'sweep_shape_many': Job(partial(certified, scene, every), len(every.starts)),
        'the same, free edges': Job(partial(certified, scene, every.take(free)), int(free.sum())),
        'the same, edges with contact': Job(
            partial(certified, scene, every.take(touching)), max(int(touching.sum()), 1)
        ),
        'poses every 1 mm': Job(partial(sampled, scene, some, their_axes, 1e-3), len(some.starts)),
    }
    if find_spec('rapier3d'):
        jobs['rapier3d'] = Job(of_rapier(boxes, turned, some, their_axes), len(some.starts))
    if find_spec('fcl'):
        jobs['python-fcl'] = Job(of_fcl(scene, boxes, turned, some), len(some.starts))
    with one_processor():
        found = interleaved(jobs, 2 if brief else REPEATS)
    ours, rows = found['sweep_shape_many'].nanoseconds, []
    for name, job in jobs.items():
        row: list[Cell] = [name, found[name].microseconds, ours / found[name].nanoseconds]
        if name.startswith('the same'):
            row += [None, None, None]
        else:
            t = job.run()
            right = exact[: len(t)]
            row += [
                len(t),
                int(np.count_nonzero(np.isfinite(right) & np.isinf(t))),
                int(np.count_nonzero(np.isinf(right) & np.isfinite(t))),
            ]
        rows.append(row)
    header = ['method', 'us an edge', 'ours / this', 'edges', 'misses', 'meets']
    page.table('edges', header, rows)


def resolutions(page: Page, brief: bool) -> None:
    """Error against run time: the sweep by its resolution, poses by how far apart they are. Of
    60,000 such edges, those count that are free at both ends and meet something at a resolution of
    10 nm. *wrong by*: how far the box is from where it does so. *missed*: edges that seem free.
    The time is that of 300 edges, most of which are free.
    """
    scene, _, _, every, axes = world(brief, 30)
    shape = Shapes.boxes([0.0, 0.0, 0.0], SIZE)
    free = ~scene.overlap_shape_many(shape, every.goals, every.goal_turns)
    usual, usual_axes = every.take(slice(LOOPED)), axes[:LOOPED]
    chosen = free & np.isfinite(certified(scene, every, 1e-8))
    every, axes = every.take(chosen), axes[chosen]
    exact, speed = certified(scene, every, 1e-8), LENGTH + ANGLE * ARM
    rows: list[list[Cell]] = []
    for name, steps in STEPS.items():
        for step in steps:
            if name == SWEEP:
                run = partial(certified, scene, usual, step)
                t = certified(scene, every, step)
            else:
                run = partial(sampled, scene, usual, usual_axes, step)
                t = sampled(scene, every, axes, step)
            with one_processor():
                took = interleaved({'': Job(run, LOOPED)}, 1 if brief else 3)[''].microseconds
            found = np.isfinite(t)
            wrong = float(np.abs(exact[found] - t[found]).max(initial=0.0)) * speed
            rows.append([name, step, took, wrong, len(t), int(np.count_nonzero(~found))])
    header = 'method', 'resolution or step, m', 'us an edge', 'wrong by at most, m'
    page.table('edge_resolutions', (*header, 'meet', 'missed'), rows)
    page.picture('edge_resolutions', 'Error against run time of edges', _drawn(rows))


def _drawn(rows: Sequence[Sequence[Any]]) -> Any:
    """A line for each method; what misses edges says how many."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.8, 4.0), layout='constrained')
    axes = figure.add_subplot()
    for name in STEPS:
        points = [(time, wrong) for kind, _, time, wrong, *_ in rows if kind == name]
        style: dict[str, Any] = {
            'color': COLOURS[name],
            'mfc': COLOURS[name] if name == SWEEP else 'white',
        }
        axes.plot(*zip(*points, strict=True), 'o-', **style, label=f'{LETTERS[name]}  {name}')
    for name, step, time, wrong, meet, missed in rows:
        text = f'{1000 * step:g} mm' + (f': {missed} of {meet} missed' if missed else '')
        right = name == SWEEP
        place: dict[str, Any] = {
            'xytext': (-8 if right else 8, 3),
            'ha': 'right' if right else 'left',
        }
        axes.annotate(text, (time, wrong), textcoords='offset points', fontsize=8, **place)
    axes.set(xlabel='run time an edge, µs', ylabel='contact wrong by at most, m')
    scale(axes, [row[2] for row in rows], 1e-5, 1.0)
    axes.legend(frameon=False, loc='lower right')
    return figure


SECTIONS = {'Edges': comparison, 'Edges by resolution': resolutions}
