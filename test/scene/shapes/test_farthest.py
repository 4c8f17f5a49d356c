# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The farthest vertex against all of them, above all on fine flat faces rounded to float32."""

import numpy as np
import pytest
from scene.reference import bulging, icosphere, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Shapes
from bvh_ros.scene.shapes.hull import Hull
from bvh_ros.scene.shapes.mesh import FEW, farthest_vertex


def grid_cube(cells):
    """A cube of 1 m whose faces are cells x cells squares."""
    steps = np.linspace(-0.5, 0.5, cells + 1)
    a, b = np.meshgrid(steps, steps, indexing='ij')
    parts = []
    for axis in range(3):
        for side in (-0.5, 0.5):
            place = np.empty((cells + 1, cells + 1, 3))
            place[..., axis], place[..., axis - 2], place[..., axis - 1] = side, a, b
            corners = place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]
            parts += [np.stack(corners[:3], 2), np.stack((corners[0], *corners[2:]), 2)]
    return np.concatenate([part.reshape(-1, 3, 3) for part in parts])


def as_published(triangles, offset, seed):
    """Turned, far from the origin, and in float32."""
    turn = Rotation.random(random_state=seed)
    places = turn.apply(triangles.reshape(-1, 3)) + np.array([1.0, 0.7, 0.0]) * offset
    return places.astype(np.float32).astype(float).reshape(-1, 3, 3)


MESHES = [
    pytest.param(lambda: icosphere(4) * (1, 0.3, 2), id='ellipsoid'),
    pytest.param(lambda: icosphere(2) * (1e-3, 1, 10), id='needle'),
    pytest.param(lambda: bulging(np.random.default_rng(1), 1000), id='random'),
    pytest.param(lambda: bulging(np.random.default_rng(2), 30), id='few'),
    pytest.param(lambda: grid_cube(16), id='exact faces'),
    *(
        pytest.param(lambda n=n, at=at: as_published(grid_cube(n), at, n), id=f'{n} at {at} m')
        for n, at in ((8, 0.0), (32, 0.0), (16, 20.0), (32, 100.0), (32, 1000.0))
    ),
]


@pytest.mark.parametrize('triangles', MESHES)
def test_no_vertex_is_farther(triangles):
    mesh, rng = Mesh(triangles()), np.random.default_rng(3)
    assert (len(mesh.discs) > 0) == (len(mesh.vertices) > FEW)
    hull = Hull(mesh.vertices, mesh.discs, mesh.radius)
    normals = mesh.normals[rng.integers(len(mesh.normals), size=200)]
    turns = rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(-12, 0, (200, 1))
    ways = [rng.normal(size=(200, 3)), normals, normals + turns, np.eye(3), -np.eye(3)]
    for way in np.concatenate(ways):
        heights = mesh.vertices @ way
        found = heights[farthest_vertex(hull, *way)]
        assert found >= heights.max() - 2.0**-49 * mesh.radius * np.linalg.norm(way)


def test_a_vertex_in_a_box_is_never_free():
    """Boxes that a face of a fine mesh enters with one vertex, along every face's normal."""
    mesh = Mesh(as_published(grid_cube(32), 1000.0, 5))
    scene = scene_of(Shapes.of_meshes([mesh], [[0, 0, 0]]))
    places = mesh.vertices + mesh.centre
    rng = np.random.default_rng(6)
    for way in mesh.normals[rng.integers(len(mesh.normals), size=30)]:
        deepest = places[np.argmax(places @ way)]
        turn = Rotation.align_vectors([way], [[1, 0, 0]])[0]
        for depth, touches in ((1e-9, True), (-1e-9, False)):
            centre = deepest + way * (0.5 - depth)
            box = Shapes.boxes([centre], [1, 4, 4], [turn.as_quat()])
            assert bool(scene.overlap_shape(box)) == touches
            assert bool(scene.overlap(centre, centre, tolerance=0.5)) == touches
