# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report planner`: what planners ask by the thousand, and loops over python-fcl and coal."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from ..scene import Scene, Shapes
from ..scene.cast import exact_ball
from ..scene.shapes.shape import rotations, unit_quaternions
from .libraries import Coal, Fcl, centers
from .page import Cell, Page, Table
from .peers import many_times, one_processor
from .scenes import Boxes, Floats, spread, uniform_boxes
from .timing import Job, interleaved

BOXES, ROWS, REPEATS = 10_000, (1, 100, 10_000), 7
LOOPED = 300  # rows that peers are asked about
LONG, RADIUS, SIZE, LARGE = 5.0, 0.2, (0.9, 0.6, 0.5), (3.6, 2.4, 2.0)  # m
TINY = 1e-18  # m: a point, for who wants a size
SWEPT = {'thin rays': 0.0, 'swept balls': RADIUS}


class Question(NamedTuple):
    """What is asked in one call: of some rows a time, a truth or a distance each."""

    ask: Callable[[slice], Floats]
    size: tuple[float, ...] = ()
    """Of the peers' box, or radius of their ball; () where they have no such query."""
    distance: bool = False


def questions(boxes: Boxes, starts: Floats, goals: Floats, turns: Floats) -> dict[str, Question]:
    """By name."""
    scene, names = Scene(), [f'box{row}' for row in range(len(boxes.lo))]
    scene.update('report', names, Shapes.boxes(centers(boxes), boxes.hi - boxes.lo), stamp=0)
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


def loop(
    peer: Fcl, boxes: Boxes, asked: tuple[Floats, Floats], question: Question
) -> Callable[[], Floats]:
    """The same of a peer: object by object, with its narrow phase."""
    manager, coal = peer._manager(peer._objects(boxes)), peer.module == 'coal'
    module = __import__(peer.module)
    form = (module.Box if len(question.size) > 1 else module.Sphere)(*question.size)
    place = module.Transform3s if coal else module.Transform
    items = [module.CollisionObject(form, place(*pose)) for pose in zip(*asked, strict=True)]
    for item in items if coal else ():
        item.computeAABB()
    kind = 'Distance' if question.distance else 'Collision'
    ask = manager.distance if question.distance else manager.collide
    callback = None if coal else getattr(module, f'default{kind}Callback')

    def one(item: Any) -> float:
        if coal:
            told = getattr(module, f'{kind}CallBackDefault')()
            ask(item, told)
            result = told.data.result
        else:
            data = getattr(module, f'{kind}Data')()
            ask(item, data, callback)
            result = data.result
        if question.distance:
            return max(float(result.min_distance), 0.0)
        return float(result.isCollision() if coal else result.is_collision)

    return lambda: np.array([one(item) for item in items])


def exact_ts(boxes: Boxes, starts: Floats, goals: Floats, radius: float) -> Floats:
    """When balls first touch any box, in exact arithmetic; inf if they do not."""
    ts = np.full(len(starts), np.inf)
    for row, (start, way) in enumerate(zip(starts, goals - starts, strict=True)):
        beside = np.maximum(np.maximum(boxes.lo - start, start - boxes.hi), 0.0)
        for box in np.flatnonzero(np.linalg.norm(beside, axis=1) <= LONG + 2.0 * radius + 0.1):
            ends = boxes.lo[box].tolist(), boxes.hi[box].tolist(), start.tolist(), way.tolist()
            root = exact_ball.first_touch(*ends, radius)
            ts[row] = min(ts[row], np.inf if root is None else float(root))
    return ts


def least_gaps(boxes: Boxes, size: tuple[float, ...], asked: tuple[Floats, Floats]) -> Floats:
    """How far turned boxes are from what is nearest to each; negative where one is in another: how
    deep. That is the widest gap along fifteen axes (Ericson, Real-Time Collision Detection, 2005,
    section 4.4.1), which is no wider than the distance of boxes apart: that is a least square.
    """
    half, halves, least = np.resize(size, 3) / 2, (boxes.hi - boxes.lo) / 2, []
    for turn, place in zip(*asked, strict=True):
        axes = np.vstack([np.eye(3), turn.T, np.cross(np.eye(3)[:, None], turn.T).reshape(9, 3)])
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        offsets = centers(boxes) - place
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


def truth(
    question: Question, name: str, boxes: Boxes, ways: tuple[Floats, Floats], turns: Floats
) -> Floats:
    """What is right, by looking at every box."""
    if name in SWEPT:
        return exact_ts(boxes, *ways, SWEPT[name])
    size = question.size or LARGE
    gaps = least_gaps(boxes, size if len(size) > 1 else (TINY,), (turns, ways[0]))
    if question.distance:
        return np.maximum(gaps, 0.0)
    return (gaps <= 0.0).astype(np.float64) if question.size else gaps


def batches(page: Page, brief: bool) -> None:
    """Measure."""
    rng, counts = np.random.default_rng(3), ROWS[:2] if brief else ROWS
    boxes, starts = uniform_boxes(300 if brief else BOXES, rng), spread(counts[-1], rng)
    turns, few = rng.normal(size=(len(starts), 4)), slice(min(LOOPED, counts[-1]))
    goals = starts + LONG * (turns[:, :3] / np.linalg.norm(turns[:, :3], axis=1)[:, None])
    asked = rotations(unit_quaternions(turns))[few], starts[few]
    peers = [peer for peer in (Fcl(), Coal()) if peer.installed()]
    rows: list[list[Cell]] = []
    for name, question in questions(boxes, starts, goals, turns).items():
        calls = {str(n): Job(partial(question.ask, slice(n)), n) for n in counts}
        jobs = {row: many_times(job, brief) for row, job in calls.items()}
        for peer in peers if question.size else ():
            jobs[peer.name] = Job(loop(peer, boxes, asked, question), len(starts[few]))
        with one_processor():
            found = interleaved(jobs, 2 if brief else REPEATS, warm=not brief)
        row: list[Cell] = [name, *(found[str(n)].nanoseconds / 1e3 for n in counts)]
        exact = truth(question, name, boxes, (starts[few], goals[few]), asked[0])
        answers = question.ask(few).astype(np.float64)
        wrong = answers != exact
        most = float(np.abs(answers[wrong] - exact[wrong]).max(initial=0.0))
        row.append(most * LONG if name in SWEPT else most)
        for peer in peers:
            row += [None] * 3
            if peer.name in jobs:
                error = np.abs(answers - jobs[peer.name].run())
                ratio = found[str(counts[-1])].nanoseconds / found[peer.name].nanoseconds
                row[-3:] = [ratio, int(np.count_nonzero(error > 1e-6)), float(error.max())]
        rows.append(row)
    page.add(TEXT)
    header = ['question', *(f'us a row, {n:,} a call' for n in counts), 'error at most, m']
    for peer in peers:
        header += [f'ours / {peer.name}', 'otherwise', 'by at most, m']
    page.table(Table('planner', header, rows))


TEXT = (
    f'{BOXES:,} axis-aligned boxes that fill 2 % of a cube of 100 m, one thread. Segments of '
    f'{LONG} m, balls of {RADIUS} m; boxes of {SIZE} m, few of which meet something, and of '
    f'{LARGE} m, turned in any way. Peers are asked in a loop, with objects that are ready, '
    'whether a box meets anything, and how far it, or a ball of 1 nm, is from what is nearest; '
    f'the largest batch is held against them. *error*: of {LOOPED} answers, held against every '
    'box, for segments in exact arithmetic; 1 where only one of both touches. *otherwise*: '
    'answers that are not ours, to 1e-6.'
)
INTRODUCTION = '## Planner'
SECTIONS = {'batches': batches}
