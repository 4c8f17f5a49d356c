# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The random scenes of the report, and queries of them by name."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from .. import DynamicBVH
from ..scene import Scene, Shapes
from ..scene.shapes.shape import unit_quaternions
from .timing import Job, each

Floats = NDArray[np.float64]

EDGE = 100.0  # m, of the cube that the boxes fill
FILLED = 0.02  # of its volume


class Boxes(NamedTuple):
    """n boxes, shape (n, 3) each, m."""

    lo: Floats
    hi: Floats

    @property
    def edges(self) -> Floats:
        """Lengths of the edges, (n, 3)."""
        return self.hi - self.lo

    @property
    def centers(self) -> Floats:
        """Centres, (n, 3)."""
        middle: Floats = (self.lo + self.hi) / 2
        return middle

    def moved(self, shift: Floats | float) -> 'Boxes':
        """The boxes, each shifted by its row, or all alike."""
        return Boxes(self.lo + shift, self.hi + shift)


class Rays(NamedTuple):
    """n rays, shape (n, 3) each; the directions are unit vectors."""

    origins: Floats
    directions: Floats


def uniform_boxes(count: int, rng: np.random.Generator) -> Boxes:
    """Boxes of random proportions, spread evenly, that fill about 2 % of the cube."""
    size = (FILLED * EDGE**3 / count) ** (1 / 3)
    centers = spread(count, rng)
    half = rng.uniform(0.16, 0.8, (count, 3)) * size
    return Boxes(centers - half, centers + half)


def spread(count: int, rng: np.random.Generator) -> Floats:
    """Points spread evenly over the cube."""
    return rng.uniform(-EDGE / 2, EDGE / 2, (count, 3))


def units(vectors: Floats) -> Floats:
    """The vectors (n, 3) at length 1."""
    unit: Floats = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    return unit


def incoherent_rays(count: int, rng: np.random.Generator) -> Rays:
    """Rays from anywhere to anywhere, in float32 numbers: every library gets the same rays."""
    directions = units(rng.normal(size=(count, 3)))
    return Rays(
        spread(count, rng).astype(np.float32).astype(np.float64),
        directions.astype(np.float32).astype(np.float64),
    )


def query_edge(boxes: Boxes, hits: float) -> float:
    """Edge of the cube that overlaps so many of the boxes on average, at a random place."""

    def too_many(edge: float) -> float:
        return float(np.prod(boxes.edges + edge, axis=1).sum()) / EDGE**3 - hits

    return float(brentq(too_many, 0.0, EDGE, xtol=1e-12))


def wavy_ring(around: int, across: int) -> tuple[Floats, NDArray[np.int32]]:
    """Vertices, m, and faces of a solid ring with waves, two triangles a field of the grid."""
    u = np.arange(around)[:, None] * (2 * np.pi / around)
    v = np.arange(across)[None] * (2 * np.pi / across)
    thick = 0.4 + 0.06 * np.sin(7 * u) * np.cos(3 * v)
    wide = 1.0 + thick * np.cos(v)
    parts = wide * np.cos(u), wide * np.sin(u), thick * np.sin(v)
    row = np.arange(around * across).reshape(around, across)
    right, above = np.roll(row, -1, axis=0), np.roll(row, -1, axis=1)
    corner = np.roll(right, -1, axis=1)
    faces = np.stack([row, right, corner, row, corner, above], axis=2)
    return np.stack(parts, axis=2).reshape(-1, 3), faces.reshape(-1, 3).astype(np.int32)


# ---- Queries of a tree and of a scene by name: single calls, small and large batches


SECOND = 10**9
BALL = 0.2  # m, radius of single calls
PACED, THEN = {'at': 0.0, 'pace': 1.0}, {'at': 1.0}  # a ray starts at 0 s; 1 s later
TOGETHER, LATER = {'at': 0, 'until': SECOND}, {'at': SECOND}  # a segment takes a second


class Question(NamedTuple):
    """A query of a tree or scene."""

    ask: Callable[..., object]
    arguments: tuple[Any, ...]
    units: int = 0  # rows of a batch; 0: it is called with each row of the arguments
    times: dict[str, Any] | None = None  # the arguments that name another time

    def job(self, timed: bool = False) -> Job:
        """With or without another time."""
        ask = partial(self.ask, **self.times) if timed and self.times else self.ask
        if self.units:
            return Job(partial(ask, *self.arguments), self.units)
        return each(ask, *self.arguments)


class Queries(NamedTuple):
    """What is queried: n rows (n, 3) each."""

    starts: Floats
    directions: Floats
    goals: Floats
    t_max: float  # of rays along the directions
    small: Boxes
    sweeps: Floats  # of the small boxes
    radius: float  # of batches of balls
    calls: int  # most single calls
    batches: Sequence[int]  # rows of a batch; 0: all


Questions = dict[str, Question]


def _batches(
    queries: Queries, ask: Callable[..., object], *arguments: Any, times: Any = None
) -> Questions:
    """Batches of several sizes; arrays have a row a query, other arguments are for all."""
    found, count = {}, len(arguments[0])
    for rows in queries.batches:
        if not rows:
            found[ask.__name__] = Question(ask, arguments, count, times)
            continue
        calls = min(count // rows, queries.calls)
        parts = [
            part[: calls * rows].reshape(calls, rows, 3)
            if isinstance(part, np.ndarray)
            else [part] * calls
            for part in arguments
        ]
        found[f'{ask.__name__}, {rows} a call'] = Question(ask, tuple(parts), 0, times)
    return found


def of_tree(tree: DynamicBVH, queries: Queries) -> Questions:
    """Queries of a tree."""
    few = slice(queries.calls)
    starts, directions, small, batches = *queries[:2], queries.small, partial(_batches, queries)
    rays = starts[few], directions[few], [queries.t_max] * len(starts[few])
    boxes = small.lo[few], small.hi[few]
    return {
        'raycast': Question(tree.raycast, rays, 0, PACED),
        'occluded': Question(tree.occluded, rays, 0, PACED),
        'overlap': Question(tree.overlap, boxes, 0, THEN),
        'nearest': Question(tree.nearest, rays[:1], 0, THEN),
        'boxcast': Question(tree.boxcast, (*boxes, queries.sweeps[few]), 0, PACED),
        **batches(tree.raycast_many, starts, directions, queries.t_max, times=PACED),
        **batches(tree.occluded_many, starts, directions, queries.t_max, times=PACED),
        **batches(tree.raycast_all_many, starts, directions, queries.t_max, times=PACED),
        **batches(tree.overlap_many, *small, times=THEN),
        **batches(tree.nearest_many, starts, times=THEN),
    }


def of_scene(scene: Scene, names: list[str], queries: Queries) -> Questions:
    """Queries of a scene with obstacles of these names."""
    few = slice(queries.calls)
    starts, directions, goals, batches = *queries[:3], partial(_batches, queries)
    ends, boxes = (starts[few], goals[few]), (queries.small.lo[few], queries.small.hi[few])
    radii = [BALL] * len(ends[0])
    turns = unit_quaternions(np.random.default_rng(1).normal(size=(len(ends[0]), 4)))
    size = tuple(queries.small.edges[0].tolist())
    shapes = Shapes.boxes(ends[0], size)
    each_shape = [shapes.take([row]) for row in range(len(shapes.kind))]
    found = {
        'raycast': Question(scene.raycast, ends, 0, TOGETHER),
        'swept ball': Question(scene.raycast, (*ends, radii), 0, TOGETHER),
        'overlap': Question(scene.overlap, boxes, 0, LATER),
        'turned overlap': Question(scene.overlap, (*boxes, turns), 0, LATER),
        'nearest': Question(scene.nearest, ends[:1], 0, LATER),
        'clearance': Question(scene.clearance, (names[few],), 0, LATER),
        **batches(scene.raycast_many, starts, directions, queries.t_max, times=TOGETHER),
        **batches(scene.sweep_many, starts, goals, queries.radius, times=TOGETHER),
        **batches(scene.overlap_many, starts, size, times=LATER),
        **batches(scene.nearest_many, starts, times=LATER),
        'clearance_many, 1 a call': Question(scene.clearance_many, (each_shape,), 0, LATER),
    }
    if 0 in queries.batches:
        many = Question(scene.clearance_many, (shapes,), len(shapes.kind), LATER)
        found['clearance_many'] = many
    return found
