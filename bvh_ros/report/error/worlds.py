# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Random and recorded worlds of boxes and other shapes, and the rays through them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ... import DynamicBVH
from ...scene import NO_NODE, CastHits, ShapeKind, Shapes
from ...scene.shapes.shape import as_shapes, canonicalise
from .. import scenes
from ..page import Page
from ..scenes import Boxes, Floats, Rays
from .methods import MEAN, WRONG, Method, World, batch, box_methods, compare
from .truth import NOTHING, Answer, boxes_truth, shapes_truth

# ---- Recordings from CSV files: a building, a laser scan and shelves


def table(path: Path) -> Any:
    """The rows of a CSV file, by the names of its columns."""
    return np.genfromtxt(path, delimiter=',', names=True, dtype=None, encoding='utf-8')


def columns(rows: Any, names: str) -> Floats:
    """Some columns of a table as numbers, shape (n, k)."""
    return np.column_stack([rows[name] for name in names.split()]).astype(np.float64)


def cubes(path: Path) -> Boxes:
    """Rows of x, y, z, size."""
    rows = table(path)
    centers, half = columns(rows, 'x y z'), columns(rows, 'size') / 2
    return Boxes(centers - half, centers + half)


def shapes_by_scene(path: Path) -> dict[str, Shapes]:
    """Boxes and cylinders of each planning scene."""
    every = table(path)
    found = {}
    for name in dict.fromkeys(every['scene'].tolist()):
        rows = every[every['scene'] == name]
        kinds = np.array([ShapeKind[kind.upper()] for kind in rows['shape']], np.uint8)
        names = ('cx cy cz', 'qx qy qz qw', 'sx sy sz')
        position, orientation, size = (columns(rows, some) for some in names)
        found[name] = Shapes(kinds, position, orientation, size)
    return found


# ---- Axis-aligned boxes: random, adversarial, and a real scan in a real building


PLACES, PLACES_QUICK = 20, 2  # in the building, each with as many beams


def random_scene(page: Page, brief: bool) -> None:
    """10,000 boxes that fill 2 % of a cube of 100 m, 20,000 rays."""
    rng = np.random.default_rng(1)
    count, many = (300, 200) if brief else (10_000, 20_000)
    boxes, rays = scenes.uniform_boxes(count, rng), scenes.incoherent_rays(many, rng)
    _compare_boxes(page, brief, 'random', 'Random boxes, random rays', boxes, rays)


def adversarial_scene(page: Page, brief: bool) -> None:
    """2,000 boxes, some flat, whose corners are multiples of 0.1 m, 20,000 rays aimed at corners,
    edges and faces from other such points, many in the plane of a face. Where a ray only touches,
    rounding decides, unless the decision is exact.
    """
    count, many = (100, 200) if brief else (2_000, 20_000)
    boxes, rays = corner_rays(count, many, np.random.default_rng(2))
    _compare_boxes(page, brief, 'adversarial', 'Corner, edge and face rays', boxes, rays)


def corner_rays(
    count: int, many: int, rng: np.random.Generator, scales: Floats | float = 0.1, extent: int = 40
) -> tuple[Boxes, Rays]:
    """Boxes, some flat, and rays of lattice points; the directions are not normalised.

    `scales`: of the lattice, m; shape (count, 1): each box and its rays have a lattice of their
    own. `extent`: of the boxes, in lattice steps from the middle.
    """
    scales = np.broadcast_to(scales, (count, 1))
    low = rng.integers(-extent, extent, (count, 3))
    high = low + rng.integers(0, 4, (count, 3))
    rows = rng.integers(0, count, many)
    targets = np.where(rng.random((many, 3)) < 0.5, low[rows], high[rows])
    steps = rng.integers(-3, 4, (many, 3))
    steps[~steps.any(axis=1)] = (1, 2, 3)
    # Half of the rays from any lattice point, half along a simple direction.
    from_target = rng.random((many, 3)) < 0.15
    places = rng.integers(-2 * extent, 2 * extent, (many, 3))
    anywhere = np.where(from_target, targets, places)
    before = targets - steps * rng.integers(1, 3 * extent // 4, (many, 1))
    simple = rng.random((many, 1)) < 0.5
    origins = np.where(simple, before, anywhere) * scales[rows]
    directions = np.where(simple, steps.astype(float), targets * scales[rows] - origins)
    directions[~directions.any(axis=1)] = (0.1, 0.2, 0.3)
    return Boxes(low * scales, high * scales), Rays(origins, directions)


def building_scene(page: Page, brief: bool) -> None:
    """Cubes of an OctoMap of the building; 500 beams of a laser scan at each of 20 places in its
    free space. The scan was taken at a place of its own; its directions are what is real here.
    """
    names = 'octomap_fr079/occupied_voxels', 'octomap_fr079/free_voxels_sample'
    files = [page.data / f'{name}.csv' for name in (*names, 'freiburg_scan3d/scan')]
    if page.misses(files):
        return
    places, beams = (PLACES_QUICK, 50) if brief else (PLACES, 500)
    boxes, free = cubes(files[0]), cubes(files[1])
    stand = np.random.default_rng(3).choice(len(free.lo), places, replace=False)
    ends = columns(table(files[2]), 'ex ey ez')
    directions = scenes.units(ends)[np.linspace(0, len(ends) - 1, beams).astype(int)]
    rays = Rays(np.repeat(free.centers[stand], beams, axis=0), np.tile(directions, (places, 1)))
    _compare_boxes(page, brief, 'building', 'Freiburg 079, real scan', boxes, rays)


def _compare_boxes(
    page: Page, brief: bool, name: str, title: str, boxes: Boxes, rays: Rays
) -> None:
    title = f'{title}: {len(boxes.lo):,} boxes, {len(rays.origins):,} rays'
    world = World(box_methods(boxes, rays), boxes_truth(boxes, rays))
    compare(page, name, title, [world], brief)


# ---- Turned boxes, spheres and cylinders; the error of simpler shapes in their place


def random_shapes(page: Page, brief: bool) -> None:
    """3,000 turned boxes, spheres and cylinders (a half, a quarter, a quarter) in a cube of 100 m,
    5,000 rays. Square roots of the truth are cut off after 256 bits.
    """
    rng = np.random.default_rng(4)
    count, many = (100, 200) if brief else (3_000, 5_000)
    world = scenes.some_shapes(count, rng), scenes.incoherent_rays(many, rng)
    title = f'Random shapes: {count:,} shapes, {many:,} rays'
    _compare_shapes(page, brief, 'shapes', title, [world])


def shelves(page: Page, brief: bool) -> None:
    """Planning scenes of boxes and cylinders; 500 rays at each scene, from 1.5 m round its middle
    towards points in its bounds. Turned shapes are decided in float64: where boards are flush,
    less than 1e-15 m decides which of them is first.
    """
    path = page.data / 'manipulation_scenes' / 'scenes.csv'
    if page.misses([path]):
        return
    rng, many = np.random.default_rng(5), 20 if brief else 500
    several = shapes_by_scene(path).values()
    worlds = [(shapes, rays_round(shapes, many, rng)) for shapes in several]
    title = f'Shelves and tables: {len(worlds)} scenes, {many * len(worlds):,} rays'
    _compare_shapes(page, brief, 'shelves', title, worlds)


def rays_round(shapes: Shapes, count: int, rng: np.random.Generator) -> Rays:
    """Rays of unit length from a sphere round the scene to points in its bounds."""
    boxes = bounds_of(shapes)
    lo, hi = boxes.lo.min(axis=0), boxes.hi.max(axis=0)
    targets = rng.uniform(lo, hi, (count, 3))
    origins = (lo + hi) / 2 + 1.5 * scenes.units(rng.normal(size=(count, 3)))
    return Rays(origins, scenes.units(targets - origins))


def bounds_of(shapes: Shapes) -> Boxes:
    """The axis-aligned box round each shape, as the scene has them."""
    form = canonicalise(as_shapes(shapes))
    return Boxes(form.lo, form.hi)


def true_shapes(shapes: Shapes, rays: Rays) -> Method:
    """First hits in a scene of these shapes."""
    scene = scenes.scene_of(shapes)

    def answer(hits: CastHits) -> Answer:
        rows = np.where(hits.handles == NO_NODE, NOTHING, hits.handles.astype(np.int64) - 1)
        return Answer(rows, hits.t)

    return Method(lambda: scene.raycast_many(*rays), answer)


def _boxed(shapes: Shapes, kind: ShapeKind) -> Shapes:
    """A box in the place of every shape of a kind."""
    kinds = np.where(shapes.kind == kind, ShapeKind.BOX, shapes.kind).astype(np.uint8)
    return shapes._replace(kind=kinds)


def _compare_shapes(
    page: Page, brief: bool, name: str, title: str, several: Sequence[tuple[Shapes, Rays]]
) -> None:
    kinds = {kind for shapes, _ in several for kind in shapes.kind.tolist()}
    worlds = []
    for shapes, rays in several:
        tree = DynamicBVH.from_boxes(*bounds_of(shapes))
        methods = {
            'bvh_ros, true shapes': true_shapes(shapes, rays),
            'AABB of each shape': batch(tree, rays),
        }
        for kind in (ShapeKind.SPHERE, ShapeKind.CYLINDER):
            if kind in kinds:
                methods[f'{kind.name.lower()} as its box'] = true_shapes(
                    _boxed(shapes, kind), rays
                )
        worlds.append(World(methods, shapes_truth(shapes, rays)))
    compare(page, name, title, worlds, brief, (WRONG, MEAN))
