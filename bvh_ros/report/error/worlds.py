# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Random and recorded worlds of boxes and other shapes, and the rays through them."""

import csv
from collections import defaultdict
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ... import DynamicBVH
from ...scene import NO_NODE, Numbered, Scene, ShapeKind, Shapes
from ...scene.shapes.shape import as_shapes, canonicalise
from ..page import Page
from ..scenes import EDGE, Boxes, Floats, Rays, incoherent_rays, spread, uniform_boxes
from .truth import NOTHING, Answer, Truth, boxes_truth, shapes_truth
from .ways import MEAN, WRONG, Way, box_ways, compare, show, tree_answer

# ---- Recorded input: a building, a laser scan, traffic and shelves, read from their CSV files.


Line = dict[str, str]


def cubes(path: Path) -> Boxes:
    """Rows of x, y, z, size."""
    rows = np.loadtxt(path, delimiter=',', skiprows=1)
    half = rows[:, 3:] / 2
    return Boxes(rows[:, :3] - half, rows[:, :3] + half)


def scan_directions(path: Path) -> Floats:
    """Unit vectors towards the returns of a scan from the origin."""
    ends = np.loadtxt(path, delimiter=',', skiprows=1)[:, 1:]
    unit: Floats = ends / np.linalg.norm(ends, axis=1)[:, None]
    return unit


def _numbers(rows: list[Line], columns: str) -> Floats:
    return np.array([[float(row[name]) for name in columns.split()] for row in rows])


def shapes_by_scene(path: Path) -> dict[str, Shapes]:
    """Boxes and cylinders of each planning scene."""
    scenes: dict[str, list[Line]] = defaultdict(list)
    with open(path, newline='', encoding='utf-8') as file:
        for row in csv.DictReader(file):
            scenes[row['scene']].append(row)
    return {
        name: Shapes(
            np.array([ShapeKind[row['shape'].upper()] for row in rows], np.uint8),
            _numbers(rows, 'cx cy cz'),
            _numbers(rows, 'qx qy qz qw'),
            _numbers(rows, 'sx sy sz'),
        )
        for name, rows in scenes.items()
    }


class Track(NamedTuple):
    """One vehicle, k frames in order of time."""

    times: Floats
    """(k,) s."""
    positions: Floats
    """(k, 3) m."""
    turns: Floats
    """(k, 4) quaternions x, y, z, w, neighbours on one side of the sphere."""
    size: Floats
    """(3,) m."""


def tracks(path: Path) -> dict[int, Track]:
    """Vehicles by number."""
    vehicles: dict[int, list[Line]] = defaultdict(list)
    with open(path, newline='', encoding='utf-8') as file:
        for row in csv.DictReader(file):
            vehicles[int(row['id'])].append(row)
    return {number: _track(rows) for number, rows in sorted(vehicles.items())}


def _track(rows: list[Line]) -> Track:
    turns = _numbers(rows, 'qx qy qz qw')
    for i in range(1, len(turns)):
        if turns[i] @ turns[i - 1] < 0:
            turns[i] *= -1
    size = _numbers(rows[:1], 'sx sy sz')[0]
    return Track(_numbers(rows, 't_s')[:, 0], _numbers(rows, 'cx cy cz'), turns, size)


# ---- Rays at axis-aligned boxes: random, adversarial, and a real scan in a real building.


PLACES, PLACES_QUICK = 20, 2  # in the building, each with as many beams


def random_scene(page: Page, brief: bool) -> None:
    """Boxes everywhere, rays from anywhere to anywhere."""
    rng = np.random.default_rng(1)
    count, asked = (300, 200) if brief else (10_000, 20_000)
    boxes, rays = uniform_boxes(count, rng), incoherent_rays(asked, rng)
    page.add('### Random boxes')
    page.add(f'{count:,} boxes that fill 2 % of a cube of 100 m, {asked:,} rays.')
    _measure_boxes(page, brief, 'random', 'Random boxes, random rays', boxes, rays)


def adversarial_scene(page: Page, brief: bool) -> None:
    """Boxes on a lattice of tenths, rays through their corners, edges and face planes."""
    count, asked = (100, 200) if brief else (2_000, 20_000)
    boxes, rays = corner_rays(count, asked, np.random.default_rng(2))
    page.add('### Adversarial rays')
    page.add(
        f'{count:,} boxes, some flat, whose corners are multiples of 0.1 m, {asked:,} rays aimed '
        'at corners, edges and faces from other such points, many in the plane of a face. '
        'Where a ray only touches, rounding decides, unless the decision is exact.'
    )
    _measure_boxes(page, brief, 'adversarial', 'Corner, edge and face rays', boxes, rays)


def corner_rays(count: int, asked: int, rng: np.random.Generator) -> tuple[Boxes, Rays]:
    """Boxes and rays of lattice points; the directions are not normalised."""
    low = rng.integers(-40, 40, (count, 3))
    high = low + rng.integers(0, 4, (count, 3))
    lo, hi = low.astype(np.float64) * 0.1, high.astype(np.float64) * 0.1
    rows = rng.integers(0, count, asked)
    targets = np.where(rng.random((asked, 3)) < 0.5, low[rows], high[rows])
    steps = rng.integers(-3, 4, (asked, 3))
    steps[~steps.any(axis=1)] = (1, 2, 3)
    # Half of the rays from any lattice point, half along a simple direction.
    anywhere = np.where(rng.random((asked, 3)) < 0.15, targets, rng.integers(-80, 80, (asked, 3)))
    before = targets - steps * rng.integers(1, 30, (asked, 1))
    simple = rng.random((asked, 1)) < 0.5
    origins = np.where(simple, before, anywhere) * 0.1
    directions = np.where(simple, steps.astype(float), targets * 0.1 - origins)
    directions[~directions.any(axis=1)] = (0.1, 0.2, 0.3)
    return Boxes(lo, hi), Rays(origins, directions)


def building_scene(page: Page, brief: bool) -> None:
    """A real building, and the beams of a real scanner set up in its free places."""
    page.add('### Building 079, Freiburg')
    files = [
        page.data / 'octomap_fr079' / 'occupied_voxels.csv',
        page.data / 'octomap_fr079' / 'free_voxels_sample.csv',
        page.data / 'freiburg_scan3d' / 'scan.csv',
    ]
    if page.misses(files):
        return
    places = PLACES_QUICK if brief else PLACES
    beams = 50 if brief else 500
    boxes, free = cubes(files[0]), cubes(files[1])
    stand = np.random.default_rng(3).choice(len(free.lo), places, replace=False)
    directions = scan_directions(files[2])
    directions = directions[np.linspace(0, len(directions) - 1, beams).astype(int)]
    origins = np.repeat((free.lo[stand] + free.hi[stand]) / 2, beams, axis=0)
    page.add(
        f'{len(boxes.lo):,} cubes of an OctoMap of the building; {beams} beams of a laser scan '
        f'at each of {places} places in its free space (the scan was taken at a place of its own; '
        'its directions are what is real here).'
    )
    rays = Rays(origins, np.tile(directions, (places, 1)))
    _measure_boxes(page, brief, 'building', 'Freiburg 079, real scan', boxes, rays)


def _measure_boxes(
    page: Page, brief: bool, name: str, title: str, boxes: Boxes, rays: Rays
) -> None:
    ways, truth = box_ways(boxes, rays), boxes_truth(boxes, rays)
    found = compare(ways, truth, brief)
    show(page, name, f'{title}: {len(boxes.lo):,} boxes, {len(rays.origins):,} rays', ways, found)


# ---- Rays at turned boxes, spheres and cylinders: what a simpler shape in their place costs.


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
    _measure_shapes(page, brief, 'shapes', title, [(shapes, rays)])


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
    scenes = shapes_by_scene(path)
    worlds = [(shapes, rays_round(shapes, asked, rng)) for shapes in scenes.values()]
    shown = sum(len(shapes.kind) for shapes, _ in worlds)
    page.add(
        f'{len(worlds)} planning scenes, {shown} boxes and cylinders; {asked} rays at each scene, '
        'from 1.5 m round its middle towards points in its bounds. Turned shapes are decided in '
        'float64: where boards are flush, less than 1e-15 m decides which of them is first.'
    )
    title = f'Shelves and tables: {len(worlds)} scenes, {asked * len(worlds):,} rays'
    _measure_shapes(page, brief, 'shelves', title, worlds)


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


def _measure_shapes(
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
