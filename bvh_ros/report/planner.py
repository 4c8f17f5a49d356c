# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What planners query by the thousand; loops over python-fcl and coal."""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from ..scene import Scene, Shapes
from ..scene.cast import exact_ball
from ..scene.shapes.shape import rotations, unit_quaternions
from . import edges
from .libraries import COAL, FCL, Library, collision_objects
from .page import Cell, Page
from .scenes import Boxes, Floats, spread, uniform_boxes, units
from .timing import Job, interleaved, one_processor, repeated

BOXES, ROWS, REPEATS = 10_000, (1, 100, 10_000), 7
LOOPED = 300  # rows of the loops over peers
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
    scene, names = Scene(), [f'box{row}' for row in range(len(boxes.lo))]
    scene.update('report', names, Shapes.boxes(boxes.centers, boxes.edges), stamp=0)
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


SECTIONS = {'Batches': batches, **edges.SECTIONS}
