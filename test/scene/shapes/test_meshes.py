# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convex meshes: against the same solids given otherwise, and python-fcl."""

import math

import numpy as np
import pytest
from scene.inside import store_of
from scene.reference import box_of_triangles, bulging, scene_of

from bvh_ros.scene import Mesh, Scene, ShapeKind, Shapes, mesh_of

CUBE = box_of_triangles((1, 1, 1))


@pytest.mark.parametrize(
    ('triangles', 'words'),
    [
        (np.empty((0, 3, 3)), 'must have shape'),
        (np.zeros((4, 3)), 'must have shape'),
        (
            np.where(np.arange(108).reshape(12, 3, 3) == 9, np.nan, CUBE),
            'triangle 1 is not finite',
        ),
        (CUBE[:-1], 'not closed'),
        (CUBE[:1], 'flat'),
        (np.concatenate([CUBE, [[*CUBE[0, :2], (0, 0, 0)]]]), 'triangle 0 belongs to 3 triangles'),
        (np.full((3, 3, 3), 0.1), 'no triangle with an area'),
        (CUBE * (1, 1, 1e-8), 'flat'),
        (np.concatenate([CUBE[:1], CUBE[:1]]), 'flat'),
        (np.concatenate([CUBE, CUBE + 3.0]), 'convex'),
        (CUBE * 1e-150, 'too small'),
    ],
)
def test_what_is_no_convex_solid_is_refused(triangles, words):
    with pytest.raises(ValueError, match=words):
        mesh_of(np.asarray(triangles, np.float64), 'convex')


def test_a_dent_is_refused_and_float32_is_not():
    rng = np.random.default_rng(1)
    round_one = bulging(rng, 200)
    assert len(Mesh(round_one.astype(np.float32)).vertices) == 200
    dented = (
        np.where((round_one == round_one[0, 0]).all(axis=2, keepdims=True), 0.3, 1) * round_one
    )
    with pytest.raises(ValueError, match='not convex'):
        mesh_of(dented, 'convex')


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


def test_a_row_needs_its_mesh():
    cube = Mesh(CUBE)
    rows = Shapes.of_meshes([cube, cube], np.zeros((2, 3)))
    assert rows.mesh is not None
    rows.mesh[0] = None
    scene = Scene()
    (refusal,) = scene.update('test', ['a', 'b'], rows, stamp=1)
    assert (refusal.name, 'needs its Mesh' in refusal.reason) == ('a', True)
    (refusal,) = scene.update(
        'test', ['c'], rows.take([1])._replace(size=np.ones((1, 3)) * 2), stamp=1
    )
    assert 'size of it' in refusal.reason


def test_an_inside_counts():
    """A mesh is solid: what is wholly within it touches it."""
    scene = scene_of(
        Shapes.of_meshes([Mesh(box_of_triangles((4, 4, 4)))], [(0, 0, 0)], [(0.1, 0.2, 0, 0.97)])
    )
    assert scene.overlap((0, 0, 0), (0.1, 0.1, 0.1))[0].t == 0.0
    assert scene.overlap((0, 0, 0), (0, 0, 0))[0].normal.tolist() == [0, 0, 0]
    assert scene.raycast((0, 0, 0), (9, 0, 0)).t == 0.0
    assert scene.raycast((0, 0, 0), (9, 0, 0), 0.1).t == 0.0
    assert scene.raycast((0, 0, 0), (9, 0, 0), skip_inside=True) is None


def test_a_mesh_is_kept_once_and_forgotten_with_its_last_obstacle():
    mesh, other = CUBE, CUBE * 2
    scene = scene_of(Shapes.of_meshes([Mesh(mesh), Mesh(mesh), Mesh(other)], np.eye(3) * 9))
    store = store_of(scene).columns.meshes
    assert len(store) == 2
    first = store.hulls
    moved = Shapes.of_meshes([Mesh(mesh)], [(5, 5, 5)])
    assert scene.update('test', ['0'], moved, stamp=2) == []
    assert store.hulls is first
    assert scene.raycast((5, 5, 0), (5, 5, 9)).name == '0'
    scene.remove('test', ['2'])
    assert len(store) == 1
    assert scene.update('test', ['0', '1'], Shapes.boxes(np.eye(3)[:2], (1, 1, 1)), stamp=3) == []
    assert len(store) == 0
    assert store_of(scene).columns.hulls is None
    assert scene.get('0').kind == ShapeKind.BOX
    assert math.isclose(scene.raycast((1, 0, -5), (1, 0, 5)).t, 0.45)
