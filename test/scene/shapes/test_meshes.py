# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convex meshes: against the same solids given otherwise, and python-fcl."""

import numpy as np
import pytest
from scene.inside import store_of
from scene.meshes import CUBE, SOLIDS
from scene.reference import icosphere, scene_of
from turns import unit_quaternions

from bvh_ros.scene import Mesh, ShapeKind, Shapes


def test_corners_stay_apart_whose_bits_are_summed_to_one_number():
    """Corners are told apart by such a number first."""
    factor = 0x1E3779B97F4A7C15

    def moved(x, by):
        bits = int(np.float64(x).view(np.uint64))
        bits = ((bits ^ bits >> 32) + by) % 2**64
        return np.uint64(bits ^ bits >> 32).view(np.float64)

    corners = np.array([[0, 1, 1], [0, moved(1.0, 1), moved(1.0, -factor)], [1, 0, 0], [-1, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
    for mesh in (Mesh(corners, faces), Mesh(corners[faces])):
        assert mesh.convex
        assert {*map(tuple, mesh.vertices)} == {*map(tuple, corners)}


@pytest.mark.parametrize(
    ('triangles', 'planar'), [(CUBE, False), (icosphere(3), True), (SOLIDS['ring'] / 8.0, True)]
)
def test_a_mesh_is_kept_once_while_it_only_moves_and_goes_with_its_last_obstacle(
    triangles, planar
):
    """In a planar scene so is its polygon, or the shadow of one that is not convex."""
    meshes = [Mesh(triangles), Mesh(triangles), Mesh(triangles * 2)]
    tilted = unit_quaternions(np.array([(0.3, 0.1, 0.2, 0.93)] * 3))
    scene = scene_of(Shapes.of_meshes(meshes, np.eye(3) * 9, tilted), planar)
    store = store_of(scene).columns.meshes
    assert len(store) == scene.stats()['meshes'] == 2
    before, hulls = store[0], store.hulls
    moved = Shapes.of_meshes([Mesh(triangles)], [(50, 2, 3)], tilted[:1])
    assert scene.update('test', ['0'], moved, stamp=2) == []
    assert store[0] is before
    assert store.hulls is hulls
    assert scene.raycast((50, -9, 3), (50.1, 9, 3), 0.5).name == '0'
    turned = Shapes.of_meshes([Mesh(triangles)], [(50, 2, 3)], [(0, 0, 0.6, 0.8)])
    assert scene.update('test', ['0'], turned, stamp=3) == []
    assert len(store) == scene.stats()['meshes'] == 2 + planar
    scene.remove('test', ['2'])
    assert len(store) == 1 + planar
    assert scene.update('test', ['0', '1'], Shapes.boxes(np.eye(3)[:2], 1), stamp=4) == []
    assert len(store) == scene.stats()['meshes'] == 0
    assert store_of(scene).columns.hulls is None
    assert scene.get('0').kind == ShapeKind.BOX
    assert scene.raycast((1, -5, 0), (1, 5, 0)).t == 0.45
    scene.update('test', ['0'], turned, stamp=5)
    scene.clear()
    assert scene.stats()['meshes'] == 0
