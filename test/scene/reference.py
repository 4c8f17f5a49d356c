# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a scene must answer, computed another way: signed distances, dense sampling, brute force.

A solid is (kind, position, matrix, half). Nothing here uses the package's formulas: the distance
of a point from a solid is found in the solid's frame, the first contact of a ball by sampling the
distance along the segment.
"""

import itertools
import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from turns import unit_quaternions

from bvh_ros.scene import NodeScene, Scene, ShapeKind, Shapes, unchecked_shapes

Floats = NDArray[np.float64]
COLUMNS = 'kind', 'position', 'orientation', 'size', 'mesh'


class Solid(NamedTuple):
    kind: ShapeKind
    position: Floats
    matrix: Floats
    half: Floats

    def distances(self, points: Floats) -> Floats:
        """Distances of points (n, 3) from the closed solid, 0 inside."""
        local = (points - self.position) @ self.matrix
        if self.kind == ShapeKind.BOX:
            return np.linalg.norm(local - np.clip(local, -self.half, self.half), axis=1)
        if self.kind == ShapeKind.SPHERE:
            return np.maximum(np.linalg.norm(local, axis=1) - self.half[0], 0.0)
        if self.kind == ShapeKind.CAPSULE:
            straight = self.half[2] - self.half[0]
            local[:, 2] -= np.clip(local[:, 2], -straight, straight)
            return np.maximum(np.linalg.norm(local, axis=1) - self.half[0], 0.0)
        across = np.maximum(np.linalg.norm(local[:, :2], axis=1) - self.half[0], 0.0)
        return np.hypot(across, np.maximum(np.abs(local[:, 2]) - self.half[2], 0.0))

    def distances_from_above(self, points: Floats) -> Floats:
        """Distances of (x, y) of points (n, 3) from the solid's shadow on the ground.

        The distance from a convex set is the largest n . p - support(n) over unit normals n.
        """
        return widest_gap(points[:, :2] - self.position[:2], self.reach)

    def reach(self, normals: Floats) -> Floats:
        """How far it, or its shadow, reaches from its centre along unit vectors (..., 3 or 2)."""
        local = normals @ self.matrix[: normals.shape[-1]]
        if self.kind == ShapeKind.BOX:
            return np.abs(local) @ self.half
        if self.kind == ShapeKind.SPHERE:
            return np.full(local.shape[:-1], self.half[0])
        if self.kind == ShapeKind.CAPSULE:
            return self.half[0] + np.abs(local[..., 2]) * (self.half[2] - self.half[0])
        radial = np.hypot(local[..., 0], local[..., 1]) * self.half[0]
        return radial + np.abs(local[..., 2]) * self.half[2]


def widest_gap(offsets: Floats, support: Callable[[Floats], Floats]) -> Floats:
    """max over unit n of n . offset - support(n), not below 0; by ever closer samples of n."""
    angles = np.linspace(-math.pi, math.pi, 181)
    normals, step = np.stack([np.cos(angles), np.sin(angles)], axis=1), angles[1] - angles[0]
    best = angles[np.argmax(offsets @ normals.T - support(normals), axis=1)][:, None]
    for _ in range(13):
        angles = best + np.linspace(-1, 1, 17) * step
        normals = np.stack([np.cos(angles), np.sin(angles)], axis=2)
        gaps = np.einsum('nka,na->nk', normals, offsets) - support(normals)
        best = np.take_along_axis(angles, np.argmax(gaps, axis=1)[:, None], axis=1)
        step /= 8
    return np.maximum(gaps.max(axis=1), 0.0)


def surface_distances(points: Floats, triangles: Floats) -> Floats:
    """Distances of points (n, 3) from triangles (m, 3, 3): of faces, seen straight on, and edges
    the nearest. A triangle without an area has edges only.
    """
    sides = np.roll(triangles, -1, axis=1) - triangles
    normals, squares = np.cross(sides[:, 0], sides[:, 1]), np.sum(sides * sides, axis=2)
    areas = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(areas, 1e-300)[:, None]
    from_corner = points[:, None, None] - triangles
    straight_on = np.einsum('mei,nmei->nme', np.cross(normals[:, None], sides), from_corner) >= 0
    share = np.einsum('mei,nmei->nme', sides, from_corner) / np.maximum(squares, 1e-300)
    to_edge = from_corner - np.clip(share, 0.0, 1.0)[..., None] * sides
    heights = np.abs(np.einsum('mi,nmi->nm', normals, from_corner[:, :, 0]))
    faced = straight_on.all(axis=2) & (areas > 1e-9 * squares.max(axis=1))
    nearest = np.linalg.norm(to_edge, axis=3).min(axis=2)
    return np.where(faced, np.minimum(heights, nearest), nearest).min(axis=1)


def hull_distances(points: Floats, triangles: Floats) -> Floats:
    """Distances of points (n, 3) from the convex solid with these faces (m, 3, 3), 0 inside."""
    normals = np.cross(*np.moveaxis(triangles[:, 1:] - triangles[:, :1], 1, 0))
    from_middle = triangles[:, 0] - triangles.mean(axis=(0, 1))
    normals *= np.copysign(1.0, np.einsum('mi,mi->m', normals, from_middle))[:, None]
    heights = points @ normals.T - np.einsum('mi,mi->m', normals, triangles[:, 0])
    return np.where((heights <= 0.0).all(axis=1), 0.0, surface_distances(points, triangles))


def geometry_arrays(shapes: Shapes) -> list[Solid]:
    turns = np.where(np.any(shapes.orientation, axis=1)[:, None], shapes.orientation, [0, 0, 0, 1])
    matrices = Rotation.from_quat(turns).as_matrix()
    return [
        Solid(ShapeKind(kind), position, matrix, size / 2)
        for kind, position, matrix, size in zip(
            shapes.kind, shapes.position, matrices, shapes.size, strict=True
        )
    ]


def hull_of(points: ArrayLike) -> Floats:
    """Triangles (n, 3, 3) around points (m, 3)."""
    return np.asarray(points, float)[ConvexHull(points).simplices]


def box_of_triangles(size: ArrayLike) -> Floats:
    """Triangles (12, 3, 3) of a box about the origin."""
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return hull_of(signs * size)


def bulging(rng: np.random.Generator, count: int = 20) -> Floats:
    """Triangles around points on an ellipsoid."""
    points = rng.normal(size=(count, 3))
    return hull_of(points / np.linalg.norm(points, axis=1)[:, None] * rng.uniform(0.2, 1, 3))


def icosphere(splits: int) -> Floats:
    """Triangles (20 * 4**splits, 3, 3) of a sphere of radius 1."""
    golden = (1 + math.sqrt(5)) / 2
    corners = [(0.0, a, b * golden) for a in (-1, 1) for b in (-1, 1)]
    triangles = hull_of([np.roll(corner, k) for corner in corners for k in range(3)])
    for _ in range(splits):
        middles = (triangles + np.roll(triangles, -1, axis=1)) / 2
        parts = [
            np.stack([triangles[:, k], middles[:, k], middles[:, k - 1]], 1) for k in range(3)
        ]
        triangles = np.concatenate([*parts, middles])
    return triangles / np.linalg.norm(triangles, axis=2, keepdims=True)


def scene_of(
    shapes: Shapes,
    planar: bool = False,
    *,
    names: Any = None,
    source: str = 'test',
    stamp: Any = 1,
    categories: Any = 1,
    velocities: Any = None,
    of: type[Scene] = Scene,
    **options: Any,
) -> Any:
    """A scene of obstacles: by default named by their rows, from one source."""
    scene = of(planar=planar, **options)
    names = [str(row) for row in range(len(shapes.kind))] if names is None else names
    told = {'stamp': stamp, 'categories': categories, 'velocities': velocities}
    assert scene.update(source, names, shapes, **told) == []
    return scene


@cache
def kept_scene(planar: bool) -> NodeScene:
    """One for many: a new one looks up its kernels anew, which takes longer than questions."""
    return NodeScene(planar=planar)


def refilled(shapes: Shapes, planar: bool = False) -> NodeScene:
    """As `scene_of`, but the same scene each time."""
    scene = kept_scene(planar)
    scene.clear()
    names = [str(row) for row in range(len(shapes.kind))]
    assert scene.update('test', names, shapes, stamp=1) == []
    return scene


def changed(shapes: Shapes, **columns: Any) -> Shapes:
    """Shapes with some of their columns as they are given, legal or not."""
    return unchecked_shapes(**{**dict(zip(COLUMNS, shapes, strict=True)), **columns})


def random_turns(rng: np.random.Generator, count: int) -> Floats:
    """Unit quaternions (n, 4)."""
    return unit_quaternions(rng.normal(size=(count, 4)))


def random_shapes(rng: np.random.Generator, count: int, reach: float = 5.0) -> Shapes:
    """Shapes of all kinds, also flat boxes: unturned, by right angles, about z, free."""
    kind = rng.integers(0, 4, count).astype(np.uint8)
    size = rng.uniform(0.05, 2.0, (count, 3))
    size[rng.random(count) < 0.1, 2] = 0.01
    size[kind != ShapeKind.BOX, 1] = size[kind != ShapeKind.BOX, 0]
    size[kind == ShapeKind.SPHERE, 2] = size[kind == ShapeKind.SPHERE, 0]
    size[kind == ShapeKind.CAPSULE, 2] += size[kind == ShapeKind.CAPSULE, 0]
    turns = rng.normal(size=(count, 4))
    manner = rng.integers(0, 4, count)
    turns[manner == 0] = 0.0
    turns[manner == 1] = rng.integers(-1, 2, (int((manner == 1).sum()), 4))
    turns[manner == 2, :2] = 0.0
    turns = unit_quaternions(turns) * rng.uniform(0.991, 1.009, (count, 1))
    return Shapes(kind, rng.uniform(-reach, reach, (count, 3)), turns, size)
