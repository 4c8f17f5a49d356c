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
from ..scene import Numbered, Scene, ShapeKind, Shapes
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


def some_shapes(count: int, rng: np.random.Generator) -> Shapes:
    """A half turned boxes, a quarter spheres, a quarter cylinders."""
    kind = rng.permutation(np.resize([0, 1, 0, 2], count)).astype(np.uint8)
    size = rng.uniform(0.3, 1.7, (count, 3)) * (0.02 * EDGE**3 / count) ** (1 / 3)
    size[kind == ShapeKind.CYLINDER, 1] = size[kind == ShapeKind.CYLINDER, 0]
    size[kind == ShapeKind.SPHERE] = size[kind == ShapeKind.SPHERE, :1]
    return Shapes(kind, spread(count, rng), unit_quaternions(rng.normal(size=(count, 4))), size)


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


def scene_of(shapes: Shapes) -> Scene:
    """A scene of these shapes; their names are the rows, the node handles are one more."""
    scene = Scene()
    refused = scene.update('report', Numbered('', np.arange(len(shapes.kind))), shapes, stamp=0)
    if refused:
        raise ValueError(f'a shape was refused: {refused[0]}')
    return scene


# ---- Queries of a tree and of a scene by name: single calls, small and large batches


SECOND = 10**9
BALL = 0.2  # m, radius of single calls
Times = dict[str, Any]
NOW: Times = {}
PACED: Times = {'at': 0.0, 'pace': 1.0}  # a ray starts at 0 s
THEN: Times = {'at': 1.0}
TOGETHER: Times = {'at': 0, 'until': SECOND}  # a segment takes a second
LATER: Times = {'at': SECOND}
Jobs = dict[str, Job]


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


def _batches(queries: Queries, ask: Callable[..., object], *arguments: Any, **times: Any) -> Jobs:
    """Batches of several sizes; arrays have a row a query, other arguments are for all."""
    found, count, name = Jobs(), len(arguments[0]), ask.__name__
    ask = partial(ask, **times)
    for rows in queries.batches:
        if not rows:
            found[name] = Job(partial(ask, *arguments), count)
            continue
        calls = min(count // rows, queries.calls)
        parts = [
            part[: calls * rows].reshape(calls, rows, 3)
            if isinstance(part, np.ndarray)
            else [part] * calls
            for part in arguments
        ]
        found[f'{name}, {rows} a call'] = each(ask, *parts)
    return found


def of_tree(tree: DynamicBVH, queries: Queries, timed: bool = False) -> Jobs:
    """Queries of a tree; `timed`: about another time."""
    paced, then = (PACED, THEN) if timed else (NOW, NOW)
    few = slice(queries.calls)
    starts, directions, small, batches = *queries[:2], queries.small, partial(_batches, queries)
    rays = starts[few], directions[few], [queries.t_max] * len(starts[few])
    boxes = small.lo[few], small.hi[few]
    return {
        'raycast': each(partial(tree.raycast, **paced), *rays),
        'occluded': each(partial(tree.occluded, **paced), *rays),
        'overlap': each(partial(tree.overlap, **then), *boxes),
        'nearest': each(partial(tree.nearest, **then), starts[few]),
        'boxcast': each(partial(tree.boxcast, **paced), *boxes, queries.sweeps[few]),
        **batches(tree.raycast_many, starts, directions, queries.t_max, **paced),
        **batches(tree.occluded_many, starts, directions, queries.t_max, **paced),
        **batches(tree.raycast_all_many, starts, directions, queries.t_max, **paced),
        **batches(tree.overlap_many, *small, **then),
        **batches(tree.nearest_many, starts, **then),
    }


def of_scene(scene: Scene, names: list[str], queries: Queries, timed: bool = False) -> Jobs:
    """Queries of a scene with obstacles of these names; `timed`: about another time."""
    together, later = (TOGETHER, LATER) if timed else (NOW, NOW)
    few = slice(queries.calls)
    starts, directions, goals, batches = *queries[:3], partial(_batches, queries)
    ends, boxes = (starts[few], goals[few]), (queries.small.lo[few], queries.small.hi[few])
    radii = [BALL] * len(ends[0])
    turns = unit_quaternions(np.random.default_rng(1).normal(size=(len(ends[0]), 4)))
    size = tuple(queries.small.edges[0].tolist())
    shapes, clearance = Shapes.boxes(ends[0], size), partial(scene.clearance_many, **later)
    each_shape = [shapes.take([row]) for row in range(len(shapes.kind))]
    found = {
        'raycast': each(partial(scene.raycast, **together), *ends),
        'swept ball': each(partial(scene.raycast, **together), *ends, radii),
        'overlap': each(partial(scene.overlap, **later), *boxes),
        'turned overlap': each(partial(scene.overlap, **later), *boxes, turns),
        'nearest': each(partial(scene.nearest, **later), ends[0]),
        'clearance': each(partial(scene.clearance, **later), names[few]),
        **batches(scene.raycast_many, starts, directions, queries.t_max, **together),
        **batches(scene.sweep_many, starts, goals, queries.radius, **together),
        **batches(scene.overlap_many, starts, size, **later),
        **batches(scene.nearest_many, starts, **later),
        'clearance_many, 1 a call': each(clearance, each_shape),
    }
    if 0 in queries.batches:
        found['clearance_many'] = Job(partial(clearance, shapes), len(shapes.kind))
    return found
