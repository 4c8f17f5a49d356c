# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays at turned boxes, spheres and cylinders: what a simpler shape in their place costs."""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from ... import DynamicBVH
from ...scene import NO_NODE, Numbered, Scene, ShapeKind, Shapes
from ...scene.geometry.canonical import canonicalise
from ...scene.geometry.shapes import as_shapes
from ..page import Page
from ..scenes import EDGE, Boxes, Rays, incoherent_rays, spread
from . import recordings
from .scoring import Answer
from .truth import NOTHING, Truth, shapes_truth
from .ways import MEAN, WRONG, Way, compare, show, tree_answer

ShapesAndRays = tuple[Shapes, Rays]


def random_shapes(page: Page, brief: bool) -> None:
    """Turned boxes, spheres and cylinders everywhere."""
    rng = np.random.default_rng(4)
    count, asked = (100, 200) if brief else (3_000, 5_000)
    shapes, rays = some_shapes(count, rng), incoherent_rays(asked, rng)
    page.add('### Random shapes')
    page.add(
        f'{count:,} turned boxes, spheres and cylinders (a half, a quarter, a quarter) in a cube '
        f'of 100 m, {asked:,} rays. Square roots of the truth are cut off after 256 bits.'
    )
    title = f'Random shapes: {count:,} shapes, {asked:,} rays'
    _measure(page, brief, 'shapes', title, [(shapes, rays)])


def some_shapes(count: int, rng: np.random.Generator) -> Shapes:
    """A half turned boxes, a quarter spheres, a quarter cylinders."""
    kind = rng.permutation(np.resize([0, 1, 0, 2], count)).astype(np.uint8)
    size = rng.uniform(0.3, 1.7, (count, 3)) * (0.02 * EDGE**3 / count) ** (1 / 3)
    size[kind == ShapeKind.CYLINDER, 1] = size[kind == ShapeKind.CYLINDER, 0]
    size[kind == ShapeKind.SPHERE] = size[kind == ShapeKind.SPHERE, :1]
    return Shapes(kind, spread(count, rng), rng.normal(size=(count, 4)), size)


def shelves(page: Page, brief: bool) -> None:
    """Recorded tables and shelves, seen from round about."""
    page.add('### Shelves and tables')
    path = page.data / 'manipulation_scenes' / 'scenes.csv'
    if page.misses([path]):
        return
    rng = np.random.default_rng(5)
    asked = 20 if brief else 500
    scenes = recordings.shapes_by_scene(path)
    worlds = [(shapes, rays_round(shapes, asked, rng)) for shapes in scenes.values()]
    shown = sum(len(shapes.kind) for shapes, _ in worlds)
    page.add(
        f'{len(worlds)} planning scenes, {shown} boxes and cylinders; {asked} rays at each scene, '
        'from 1.5 m round its middle towards points in its bounds. Turned shapes are decided in '
        'float64: where boards are flush, less than 1e-15 m decides which of them is first.'
    )
    title = f'Shelves and tables: {len(worlds)} scenes, {asked * len(worlds):,} rays'
    _measure(page, brief, 'shelves', title, worlds)


def rays_round(shapes: Shapes, count: int, rng: np.random.Generator) -> Rays:
    """Rays of unit length from a sphere round the scene to points in its bounds."""
    lo, hi = bounds_of(shapes)
    targets = rng.uniform(lo.min(axis=0), hi.max(axis=0), (count, 3))
    away = rng.normal(size=(count, 3))
    origins = (lo.min(axis=0) + hi.max(axis=0)) / 2
    origins = origins + 1.5 * away / np.linalg.norm(away, axis=1)[:, None]
    ways = targets - origins
    return Rays(origins, ways / np.linalg.norm(ways, axis=1)[:, None])


def bounds_of(shapes: Shapes) -> Boxes:
    """The axis-aligned box round each shape, as the scene has them."""
    form = canonicalise(as_shapes(shapes))
    return Boxes(form.lo, form.hi)


def as_boxes(shapes: Shapes, kind: ShapeKind) -> Shapes:
    """The same with the box round every shape of a kind in its place."""
    return shapes._replace(kind=np.where(shapes.kind == kind, 0, shapes.kind).astype(np.uint8))


def scene_of(shapes: Shapes) -> Scene:
    """A scene of these shapes; the node handles are the rows, and one more."""
    scene = Scene()
    refused = scene.update('report', Numbered('', np.arange(len(shapes.kind))), shapes, stamp=0)
    if refused:
        raise ValueError(f'a shape was refused: {refused[0]}')
    return scene


def scene_answer(scene: Scene, rays: Rays) -> Answer:
    """First objects by their true shapes."""
    handles, ts, _, _ = scene.raycast_many(*rays)
    return Answer(np.where(handles == NO_NODE, NOTHING, handles.astype(np.int64) - 1), ts)


def _scene_way(worlds: Sequence[ShapesAndRays], kind: ShapeKind | None = None) -> Way:
    changed = [(as_boxes(shapes, kind) if kind else shapes, rays) for shapes, rays in worlds]
    scenes = [(scene_of(shapes), rays) for shapes, rays in changed]
    counts = [len(shapes.kind) for shapes, _ in worlds]
    return lambda: _joined([scene_answer(*pair) for pair in scenes], counts)


def _tree_way(worlds: Sequence[ShapesAndRays]) -> Way:
    trees = [(DynamicBVH.from_boxes(*bounds_of(shapes)), rays) for shapes, rays in worlds]
    counts = [len(shapes.kind) for shapes, _ in worlds]
    return lambda: _joined([tree_answer(*pair) for pair in trees], counts)


def _joined(answers: Sequence[Answer], counts: Sequence[int]) -> Answer:
    """Answers of several scenes as one; rows are counted on from scene to scene."""
    rows, first = [], 0
    for answer, count in zip(answers, counts, strict=True):
        rows.append(np.where(answer.rows == NOTHING, NOTHING, answer.rows + first))
        first += count
    return Answer(np.concatenate(rows), np.concatenate([answer.ts for answer in answers]))


def joined_truth(truths: Sequence[Truth], counts: Sequence[int]) -> Truth:
    """Truths of several scenes as one."""
    merged = _joined([Answer(truth.rows, truth.lengths) for truth in truths], counts)
    first_row = np.cumsum([0, *counts])
    first_ray = np.cumsum([0, *(len(truth.rows) for truth in truths)])

    def entry(row: int, ray: int) -> Fraction | None:
        place = int(np.searchsorted(first_ray, ray, side='right')) - 1
        return truths[place].entry(row - int(first_row[place]), ray - int(first_ray[place]))

    return Truth(merged.rows, [t for truth in truths for t in truth.ts], entry, merged.ts)


def _measure(
    page: Page, brief: bool, name: str, title: str, worlds: Sequence[ShapesAndRays]
) -> None:
    ways = {'bvh_ros, true shapes': _scene_way(worlds), 'AABB of each shape': _tree_way(worlds)}
    kinds = {kind for shapes, _ in worlds for kind in shapes.kind.tolist()}
    if ShapeKind.SPHERE in kinds:
        ways['sphere as its box'] = _scene_way(worlds, ShapeKind.SPHERE)
    if ShapeKind.CYLINDER in kinds:
        ways['cylinder as its box'] = _scene_way(worlds, ShapeKind.CYLINDER)
    counts = [len(shapes.kind) for shapes, _ in worlds]
    truth = joined_truth([shapes_truth(*world) for world in worlds], counts)
    show(page, name, title, ways, compare(ways, truth, brief), (WRONG, MEAN))
