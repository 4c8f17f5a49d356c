# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays at one mesh that is not convex: exact, rounded, and with simpler shapes in its place."""

import numpy as np
from scipy.spatial import ConvexHull

from ... import DynamicBVH
from ...scene import Mesh, Shapes
from ..libraries import EMBREE, embree_scene
from ..page import Page
from ..scenes import Boxes, Floats, Rays
from .methods import SLOW_RAYS, WRONG, Method, Panel, World, batch, compare
from .truth import NOTHING, Answer, Truth, boxes_truth
from .worlds import true_shapes

CELL = 0.1  # m
SHARE = 0.05  # of the cells is filled
MEAN = Panel('mean error of the distance, m', lambda s: s.mean, 1e-9, 10.0)


def mesh_of_cells(page: Page, brief: bool) -> None:
    """The surface of cubes of 0.1 m that fill 5 % of a grid of 20 x 20 x 20, as one mesh; 10,000
    rays from the lattice around it at corners of these cubes, many along faces and edges. The
    truth is that of the cubes. *float64 watertight* is the test of Woop, Benthin and Wald (2013)
    in numpy, without a tree; Embree's is float32, of the first triangle.
    """
    edge, many = (7, 200) if brief else (20, 10_000)
    rng = np.random.default_rng(6)
    filled = rng.random((edge,) * 3) < SHARE
    cells = np.argwhere(filled)
    boxes = boxes_of(cells)
    rays = _rays(cells, edge, many, rng)
    of_boxes = boxes_truth(boxes, rays)
    ts = of_boxes.ts
    rows = np.where(of_boxes.rows == NOTHING, NOTHING, 0)
    truth = Truth(rows, ts, lambda row, ray: ts[ray], of_boxes.lengths)
    triangles = surface_of(filled) * CELL
    title = f'A mesh of {len(triangles):,} triangles, {many:,} rays'
    world = World(_methods(triangles, rays), truth)
    compare(page, 'mesh', title, [world], brief, (WRONG, MEAN))


def boxes_of(cells: np.ndarray) -> Boxes:
    """The cubes at cells (n, 3)."""
    return Boxes(*(np.multiply(cells + k, CELL, dtype=np.float64) for k in (0, 1)))


def surface_of(filled: np.ndarray) -> Floats:
    """Triangles (m, 3, 3) between filled and empty cells of a grid of unit cubes."""
    filled, squares = np.pad(filled, 1), []
    for axis, step in enumerate(np.eye(3, dtype=np.int64)):
        one, other = np.roll(step, 1), np.roll(step, 2)
        low = np.argwhere(np.diff(filled, axis=axis)) - 1 + step
        squares.append(np.stack((low, low + one, low + one + other, low + other), axis=1))
    corners = np.concatenate(squares)[:, [0, 1, 2, 0, 2, 3]]
    return corners.reshape(-1, 3, 3).astype(np.float64)


def _rays(cells: np.ndarray, edge: int, count: int, rng: np.random.Generator) -> Rays:
    """From outside; the directions are not normalised."""
    steps = rng.integers(-3, 4, (count, 3))
    steps[~steps.any(axis=1)] = (1, 2, 3)
    targets = cells[rng.integers(0, len(cells), count)] + rng.integers(0, 2, (count, 3))
    origins = (targets - 2 * edge * steps) * CELL
    simple = rng.random((count, 1)) < 0.5
    return Rays(
        origins.astype(np.float64),
        np.where(simple, steps.astype(np.float64), targets * CELL - origins),
    )


def _methods(triangles: Floats, rays: Rays) -> dict[str, Method]:
    corners = triangles.reshape(-1, 3)
    hull = ConvexHull(corners)
    box = DynamicBVH.from_boxes(corners.min(axis=0)[None], corners.max(axis=0)[None])
    few = Rays(rays.origins[:SLOW_RAYS], rays.directions[:SLOW_RAYS])

    def of_mesh(mesh: Mesh) -> Method:
        return true_shapes(Shapes.of_meshes(mesh, np.zeros((1, 3))), rays)

    methods = {
        'bvh_ros, true shapes': of_mesh(Mesh(triangles)),
        'float64 watertight': Method(lambda: watertight(triangles, few), lambda found: found),
        'convex hull of the mesh': of_mesh(Mesh(hull.points, hull.simplices)),
        'AABB of each shape': batch(box, rays),
    }
    if EMBREE.installed():
        faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
        scene, given = embree_scene((corners.astype(np.float32), faces)), EMBREE.rays(rays)

        def answer(found: np.ndarray) -> Answer:
            ts = scene.run(*given, query='DISTANCE').astype(np.float64)
            return Answer(np.where(found < 0, NOTHING, 0), np.where(found < 0, np.inf, ts))

        methods['Embree 4, float32'] = Method(lambda: scene.run(*given), answer)
    return methods


def watertight(triangles: Floats, rays: Rays) -> Answer:
    """The test of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection" (2013), 3."""
    rows, ts = np.full(len(rays.origins), NOTHING), np.full(len(rays.origins), np.inf)
    for ray, (origin, direction) in enumerate(zip(*rays, strict=True)):
        z = int(np.abs(direction).argmax())
        x, y = (z + 1) % 3, (z + 2) % 3
        offset = triangles - origin
        shear_x, shear_y = direction[[x, y]] / direction[z]
        ax = offset[..., x] - shear_x * offset[..., z]
        ay = offset[..., y] - shear_y * offset[..., z]
        u = ax[:, 2] * ay[:, 1] - ay[:, 2] * ax[:, 1]
        v = ax[:, 0] * ay[:, 2] - ay[:, 0] * ax[:, 2]
        w = ax[:, 1] * ay[:, 0] - ay[:, 1] * ax[:, 0]
        total = u + v + w
        apart = (np.minimum(np.minimum(u, v), w) < 0) & (np.maximum(np.maximum(u, v), w) > 0)
        good = ~apart & (total != 0)
        height = (u * offset[:, 0, z] + v * offset[:, 1, z] + w * offset[:, 2, z])[good]
        t = height / total[good] / direction[z]
        t = t[t >= 0]
        if len(t):
            rows[ray], ts[ray] = 0, t.min()
    return Answer(rows, ts)
