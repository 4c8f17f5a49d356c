# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What planners query by the thousand; loops over python-fcl and coal."""

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from ..scene import Scene, Shapes
from ..scene.cast import exact_ball
from ..scene.shapes.shape import rotations, unit_quaternions
from .error.methods import COLOURS, LETTERS, scale
from .libraries import COAL, FCL, Library, collision_objects
from .page import Cell, Page
from .scenes import Boxes, Floats, scene_of, spread, uniform_boxes, units
from .timing import Job, alone, interleaved, one_processor, repeated

BOXES, ROWS, REPEATS = 10_000, (1, 100, 10_000), 7
LOOPED = 300  # rows of the loops over peers, and of the finest samples
LONG, RADIUS, SIZE, LARGE = 5.0, 0.2, (0.9, 0.6, 0.5), (3.6, 2.4, 2.0)  # m
TINY = 1e-18  # m: a point as a box
SWEPT = {'thin rays': 0.0, 'swept balls': RADIUS}


class Question(NamedTuple):
    """A query of one call: for each of some rows a time, a truth or a distance."""

    ask: Callable[[slice], Floats]
    # Of the peers' box, or radius of their ball; () where they have no such query.
    size: tuple[float, ...] = ()
    distance: bool = False


class Poses(NamedTuple):
    """Rows of queries."""

    turns: Floats  # (n, 3, 3) rotation matrices of boxes
    starts: Floats  # (n, 3) where boxes are, and where segments begin
    goals: Floats  # (n, 3) where segments end


def questions(boxes: Boxes, starts: Floats, goals: Floats, turns: Floats) -> dict[str, Question]:
    """By name."""
    scene = scene_of(Shapes.boxes(boxes.centers, boxes.edges))
    small, large = (Shapes.boxes(starts, size, turns) for size in (SIZE, LARGE))
    return {
        'thin rays': Question(lambda k: scene.sweep_many(starts[k], goals[k]).t),
        'swept balls': Question(lambda k: scene.sweep_many(starts[k], goals[k], RADIUS).t),
        'turned boxes': Question(lambda k: scene.overlap_many(starts[k], SIZE, turns[k]), SIZE),
        'large ones': Question(lambda k: scene.overlap_many(starts[k], LARGE, turns[k]), LARGE),
        'nearest': Question(lambda k: scene.nearest_many(starts[k])[1][:, 0], (1e-9,), True),
        'clearance': Question(lambda k: scene.clearance_many(small.take(k))[1], SIZE, True),
        'depth of large ones': Question(
            lambda k: scene.clearance_many(large.take(k), signed=True)[1]
        ),
    }


def loop(peer: Library, boxes: Boxes, poses: Poses, question: Question) -> Callable[[], Floats]:
    """The same of a peer: object by object, with its narrow phase."""
    library, coal = import_module(peer.module), peer is COAL
    manager = peer.build(peer.prepare(boxes)).manager
    form = (library.Box if len(question.size) > 1 else library.Sphere)(*question.size)
    forms = [form] * len(poses.starts)
    items = collision_objects(peer.module, forms, poses.turns, poses.starts)
    kind = 'Distance' if question.distance else 'Collision'
    ask = manager.distance if question.distance else manager.collide
    callback = () if coal else (getattr(library, f'default{kind}Callback'),)
    collector = getattr(library, f'{kind}CallBackDefault' if coal else f'{kind}Data')

    def one(item: Any) -> float:
        collected = collector()
        ask(item, collected, *callback)
        result = collected.data.result if coal else collected.result
        if question.distance:
            return max(float(result.min_distance), 0.0)
        return float(result.isCollision() if coal else result.is_collision)

    return lambda: np.array([one(item) for item in items])


# ---- What is right, by looking at every box


def exact_ts(boxes: Boxes, poses: Poses, radius: float) -> Floats:
    """When balls first touch any box, in exact arithmetic; inf if they do not."""
    ts = np.full(len(poses.starts), np.inf)
    for row, (start, step) in enumerate(
        zip(poses.starts, poses.goals - poses.starts, strict=True)
    ):
        apart = np.maximum(np.maximum(boxes.lo - start, start - boxes.hi), 0.0)
        for box in np.flatnonzero(np.linalg.norm(apart, axis=1) <= LONG + 2.0 * radius + 0.1):
            corners = boxes.lo[box].tolist(), boxes.hi[box].tolist()
            root = exact_ball.first_touch(*corners, start.tolist(), step.tolist(), radius)
            ts[row] = min(ts[row], np.inf if root is None else float(root))
    return ts


def least_gaps(boxes: Boxes, size: tuple[float, ...], poses: Poses) -> Floats:
    """How far turned boxes are from what is nearest to each; negative where one is in another: how
    deep. That is the widest gap along fifteen axes (Ericson, Real-Time Collision Detection, 2005,
    section 4.4.1), which is no wider than the distance of boxes apart: that is a least square.
    """
    half, halves, least = np.resize(size, 3) / 2, boxes.edges / 2, []
    for turn, place in zip(poses.turns, poses.starts, strict=True):
        axes = np.vstack([np.eye(3), turn.T, np.cross(np.eye(3)[:, None], turn.T).reshape(9, 3)])
        axes = units(axes)
        offsets = boxes.centers - place
        reach = halves @ np.abs(axes).T + np.abs(axes @ turn) @ half
        gaps = (np.abs(offsets @ axes.T) - reach).max(axis=1)
        least.append(gaps.min() if gaps.min() <= 0.0 else np.inf)
        for row in np.argsort(gaps):
            if gaps[row] > least[-1] or gaps[row] <= 0.0:
                break
            # Where in either: place + turn @ x is as close as can be to the centre + y.
            limits, frames = np.concatenate([half, halves[row]]), np.hstack([turn, -np.eye(3)])
            found = lsq_linear(frames, offsets[row], (-limits, limits), 'bvls', tol=1e-15)
            least[-1] = min(least[-1], float(np.linalg.norm(found.fun)))
    return np.array(least)


def truth(question: Question, name: str, boxes: Boxes, poses: Poses) -> Floats:
    """What is right."""
    if name in SWEPT:
        return exact_ts(boxes, poses, SWEPT[name])
    size = question.size or LARGE
    gaps = least_gaps(boxes, size if len(size) > 1 else (TINY,), poses)
    if question.distance:
        return np.maximum(gaps, 0.0)
    return (gaps <= 0.0).astype(np.float64) if question.size else gaps


# ---- The table


def batches(page: Page, brief: bool) -> None:
    """10,000 axis-aligned boxes that fill 2 % of a cube of 100 m, one thread. Segments of 5 m,
    balls of 0.2 m; boxes of (0.9, 0.6, 0.5) m, few of which overlap something, and of (3.6, 2.4,
    2) m, turned in any direction. Peers answer in a loop, with objects that are ready, whether a
    box overlaps anything, and how far it, or a ball of 1 nm, is from what is nearest; the largest
    batch is compared with theirs. *error*: of 300 answers, compared with every box, for segments
    in exact arithmetic; 1 where only one of both touches. *otherwise*: answers that are not ours,
    to 1e-6.
    """
    rng, counts = np.random.default_rng(3), ROWS[:2] if brief else ROWS
    boxes, starts = uniform_boxes(300 if brief else BOXES, rng), spread(counts[-1], rng)
    turns = unit_quaternions(rng.normal(size=(len(starts), 4)))
    few = slice(min(LOOPED, counts[-1]))
    goals = starts + LONG * units(turns[:, :3])
    poses = Poses(rotations(turns)[few], starts[few], goals[few])
    peers = [peer for peer in (FCL, COAL) if peer.installed()]
    rows: list[list[Cell]] = []
    for name, question in questions(boxes, starts, goals, turns).items():
        jobs = {str(n): repeated(Job(partial(question.ask, slice(n)), n)) for n in counts}
        for peer in peers if question.size else ():
            jobs[peer.name] = Job(loop(peer, boxes, poses, question), len(poses.starts))
        with one_processor():
            found = interleaved(jobs, 2 if brief else REPEATS)
        exact, answers = truth(question, name, boxes, poses), question.ask(few).astype(np.float64)
        wrong = answers != exact
        most = float(np.abs(answers[wrong] - exact[wrong]).max(initial=0.0))
        row: list[Cell] = [name, *(found[str(n)].microseconds for n in counts)]
        row.append(most * LONG if name in SWEPT else most)
        for peer in peers:
            if peer.name in jobs:
                error = np.abs(answers - jobs[peer.name].run())
                ratio = found[str(counts[-1])].nanoseconds / found[peer.name].nanoseconds
                row += [ratio, int(np.count_nonzero(error > 1e-6)), float(error.max())]
            else:
                row += [None] * 3
        rows.append(row)
    header = ['question', *(f'us a row, {n:,} a call' for n in counts), 'error at most, m']
    for peer in peers:
        header += [f'ours / {peer.name}', 'otherwise', 'by at most, m']
    page.table('planner', header, rows)


# ---- Edges: a box that moves and turns, certified, sampled, and by rapier and fcl


EDGES, EDGE_REPEATS = 2_000, 5
BODY, LENGTH, ANGLE = np.array((0.6, 0.4, 0.3)), 0.5, np.deg2rad(30.0)  # m, m, rad
RESOLUTION, EXACT = 1e-4, 1e-6  # m
DENSER = 1.7  # times the edges of `uniform_boxes`
ARM = float(np.linalg.norm(BODY)) / 2.0
SHAPE = Shapes.boxes([0.0, 0.0, 0.0], BODY)
W_FIRST = [3, 0, 1, 2]  # a quaternion, as peers have it


class Edges(NamedTuple):
    """n edges."""

    starts: Floats
    turns: Floats
    goals: Floats
    goal_turns: Floats
    axes: Floats  # of the turn between both

    def take(self, rows: Any) -> 'Edges':
        """Some of them."""
        return Edges(*(column[rows] for column in self))


def turned_by(axes: Floats, angle: Any, turns: Floats) -> Floats:
    """Quaternions after turns by angles (n, 1), or one for all, about unit vectors (n, 3)."""
    after: Floats = (Rotation.from_rotvec(axes * angle) * Rotation.from_quat(turns)).as_quat()
    return after


class World(NamedTuple):
    """Turned boxes, and a scene of them."""

    scene: Scene
    boxes: Boxes  # as they are before the turns
    turns: Floats


def world(brief: bool, times: int = 1) -> tuple[World, Edges]:
    """Turned boxes and edges, so many times as many."""
    rng = np.random.default_rng(7)
    boxes = uniform_boxes(300 if brief else BOXES, rng)
    half = boxes.edges * (0.5 * DENSER)
    boxes = Boxes(boxes.centers - half, boxes.centers + half)
    turned = unit_quaternions(rng.normal(size=(len(boxes.lo), 4)))
    scene = scene_of(Shapes.boxes(boxes.centers, boxes.edges, turned))
    count = times * (100 if brief else EDGES)
    starts, turns = spread(3 * count, rng), unit_quaternions(rng.normal(size=(3 * count, 4)))
    free = ~scene.overlap_shape_many(SHAPE, starts, turns)
    starts, turns = starts[free][:count], turns[free][:count]
    goals = starts + LENGTH * units(rng.normal(size=(count, 3)))
    axes = units(rng.normal(size=(count, 3)))
    edges = Edges(starts, turns, goals, turned_by(axes, ANGLE, turns), axes)
    return World(scene, boxes, turned), edges


def certified(scene: Scene, edges: Edges, resolution: float) -> Floats:
    """When each edge first meets something; inf if never."""
    hits: Any = scene.sweep_shape_many(SHAPE, *edges[:4], resolution=resolution)
    t: Floats = hits.t
    return t


def sampled(scene: Scene, edges: Edges, step: float) -> Floats:
    """The same at poses between which no point goes farther than `step`, m."""
    poses = int(np.ceil((LENGTH + ANGLE * ARM) / step)) + 1
    share, count = np.linspace(0.0, 1.0, poses), len(edges.starts)
    places = edges.starts[:, None] + share[:, None] * (edges.goals - edges.starts)[:, None]
    axes, turns = (np.repeat(rows, poses, axis=0) for rows in (edges.axes, edges.turns))
    turns = turned_by(axes, np.tile(share * ANGLE, count)[:, None], turns)
    touched = scene.overlap_shape_many(SHAPE, places.reshape(-1, 3), turns).reshape(count, poses)
    return np.where(touched.any(axis=1), share[touched.argmax(axis=1)], np.inf)


SWEEP, POSES = 'sweep between two poses', 'poses on the way'
METHODS: dict[str, Callable[[Scene, Edges, float], Floats]] = {SWEEP: certified, POSES: sampled}
STEPS = {SWEEP: (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), POSES: (0.1, 0.03, 0.01, 3e-3, 1e-3)}  # m


def of_rapier(world: World, edges: Edges) -> Callable[[], Floats]:
    """`cast_shape_nonlinear` in a loop: float32."""
    rapier = import_module('rapier3d')

    def pose(place: Floats, turn: Floats) -> Any:
        return rapier.Isometry3(place.tolist(), rapier.Rotation3(*turn[W_FIRST].tolist()))

    scene, boxes = rapier.PhysicsWorld(), world.boxes
    for centre, half, turn in zip(boxes.centers, boxes.edges / 2.0, world.turns, strict=True):
        collider = rapier.Collider.cuboid(*half.tolist())
        scene.add_collider(collider.position(pose(centre, turn)).build())
    scene.detect_collisions()
    scene.update_query_pipeline()
    box, options = rapier.SharedShape.cuboid(*(BODY / 2.0).tolist()), rapier.ShapeCastOptions()
    still = [0.0, 0.0, 0.0]
    motions = [
        rapier.NonlinearRigidMotion(
            pose(start, turn), still, (goal - start).tolist(), (axis * ANGLE).tolist()
        )
        for start, turn, goal, _, axis in zip(*edges, strict=True)
    ]
    ask = scene.query_pipeline.cast_shape_nonlinear

    def run() -> Floats:
        hits = [ask(motion, box, options, 0.0, 1.0) for motion in motions]
        return np.array([np.inf if hit is None else hit[1].time_of_impact for hit in hits])

    return run


def of_fcl(world: World, edges: Edges) -> Callable[[], Floats]:
    """`continuousCollide` of each pair that the tree finds."""
    fcl, scene = import_module('fcl'), world.scene
    forms = [fcl.Box(*edge) for edge in world.boxes.edges]
    obstacles = collision_objects('fcl', forms, world.turns[:, W_FIRST], world.boxes.centers)
    request = fcl.ContinuousCollisionRequest(
        ccd_motion_type=fcl.CCDMotionType.CCDM_LINEAR,
        ccd_solver_type=fcl.CCDSolverType.CCDC_CONSERVATIVE_ADVANCEMENT,
    )
    reach = np.abs(edges.goals - edges.starts) + 2.0 * ARM
    middle = (edges.starts + edges.goals) / 2.0
    offsets, handles = scene.overlap_many(middle, reach, want='all')
    rows = [int(scene.name_of(int(handle))) for handle in handles]
    still = [obstacle.getTransform() for obstacle in obstacles]
    items = []
    for i in range(len(middle)):
        start = fcl.Transform(edges.turns[i][W_FIRST], edges.starts[i])
        goal = fcl.Transform(edges.goal_turns[i][W_FIRST], edges.goals[i])
        box = fcl.CollisionObject(fcl.Box(*BODY), start)
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
    boxes, every = world(brief)
    some = every.take(slice(30 if brief else LOOPED))
    exact = certified(boxes.scene, every, EXACT)

    def sweep(edges: Edges) -> Job:
        run = partial(certified, boxes.scene, edges, RESOLUTION)
        return Job(run, max(len(edges.starts), 1))

    jobs = {
        'sweep_shape_many': sweep(every),
        'the same, free edges': sweep(every.take(np.isinf(exact))),
        'the same, edges with contact': sweep(every.take(np.isfinite(exact))),
        'poses every 1 mm': Job(partial(sampled, boxes.scene, some, 1e-3), len(some.starts)),
    }
    if find_spec('rapier3d'):
        jobs['rapier3d'] = Job(of_rapier(boxes, some), len(some.starts))
    if find_spec('fcl'):
        jobs['python-fcl'] = Job(of_fcl(boxes, some), len(some.starts))
    with one_processor():
        found = interleaved(jobs, 2 if brief else EDGE_REPEATS)
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
    (scene, *_), every = world(brief, 30)
    usual = every.take(slice(LOOPED))
    free = ~scene.overlap_shape_many(SHAPE, every.goals, every.goal_turns)
    every = every.take(free & np.isfinite(certified(scene, every, 1e-8)))
    exact, speed = certified(scene, every, 1e-8), LENGTH + ANGLE * ARM
    rows: list[list[Cell]] = []
    for name, steps in STEPS.items():
        for step in steps:
            t, run = METHODS[name](scene, every, step), partial(METHODS[name], scene, usual, step)
            with one_processor():
                took = alone(run, LOOPED, 1 if brief else 3).microseconds
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
        face, label = 'white' if name == POSES else COLOURS[name], f'{LETTERS[name]}  {name}'
        axes.plot(*zip(*points, strict=True), 'o-', color=COLOURS[name], mfc=face, label=label)
    for name, step, time, wrong, meet, missed in rows:
        text = f'{1000 * step:g} mm' + (f': {missed} of {meet} missed' if missed else '')
        side, shift = ('right', -8) if name == SWEEP else ('left', 8)
        axes.annotate(
            text, (time, wrong), (shift, 3), textcoords='offset points', fontsize=8, ha=side
        )
    axes.set(xlabel='run time an edge, µs', ylabel='contact wrong by at most, m')
    scale(axes, [row[2] for row in rows], 1e-5, 1.0)
    axes.legend(frameon=False, loc='lower right')
    return figure


SECTIONS = {'Batches': batches, 'Edges': comparison, 'Edges by resolution': resolutions}
