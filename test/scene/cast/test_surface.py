# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Surfaces as exporters write them, and what is refused with a reason."""

import gc
import itertools
import weakref

import numpy as np
import pytest
from scene.meshes import CUBE, cut_cube, single
from scene.reference import icosphere
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, mesh_of


def turned(triangles, seed=1):
    return triangles @ Rotation.random(random_state=seed).as_matrix().T


def shuffled(triangles, seed=2):
    """In another order, and wound anyhow."""
    rng = np.random.default_rng(seed)
    order = np.array(list(itertools.permutations(range(3))))
    triangles = triangles[rng.permutation(len(triangles))]
    return np.take_along_axis(triangles, order[rng.integers(0, 6, len(triangles))][:, :, None], 1)


def cut_by_a_cap(triangles):
    """Triangle 0 becomes two that meet its neighbour through one without area."""
    one, two, three = triangles[0]
    middle = (one + two) / 2
    cap = [one, middle, two]
    return np.concatenate([triangles[1:], [[one, middle, three], [middle, two, three], cap]])


def with_sliver(triangles, width):
    """Of two corners at the first edge each triangle has one or the other, `width` apart."""
    one, two, three = triangles[0]
    moved = one + (two - one) * width
    rest = triangles[1:]
    return np.concatenate([rest, [[moved, two, three], [one, moved, three], [one, moved, two]]])


@pytest.mark.parametrize(
    ('triangles', 'vertices'),
    [
        pytest.param(CUBE, 8, id='cube'),
        pytest.param(shuffled(CUBE), 8, id='wound anyhow'),
        pytest.param(np.concatenate([CUBE, CUBE[:, ::-1]]), 8, id='both sides'),
        pytest.param(np.concatenate([CUBE, CUBE[:2, [0, 0, 1]]]), 8, id='edges as triangles'),
        pytest.param(np.concatenate([CUBE, CUBE[:2, [0, 0, 0]]]), 8, id='corners as triangles'),
        pytest.param(np.concatenate([CUBE, CUBE[:1] * 0 + 9]), 8, id='mote'),
        pytest.param(np.concatenate([CUBE, CUBE[:1] * 1e6 * (1, 0, 0)]), 8, id='stray'),
        pytest.param(cut_by_a_cap(CUBE), 9, id='no area'),
        pytest.param(single(turned(cut_by_a_cap(CUBE))), 9, id='no area, float32'),
        pytest.param(with_sliver(CUBE, 1e-9), 9, id='narrower than float32'),
        pytest.param(with_sliver(CUBE, 1e-4), 9, id='sliver'),
        pytest.param(single(turned(with_sliver(CUBE, 1e-5))), 9, id='sliver, float32'),
        pytest.param(single(turned(cut_cube(7))), 6 * 49 + 2, id='coplanar, float32'),
        pytest.param(single(turned(CUBE) + 1000), 8, id='far away, float32'),
        pytest.param(turned(CUBE) + 4e6, 8, id='far away'),
        pytest.param(single(turned(CUBE * (1, 1e-3, 30))), 8, id='stretched, float32'),
        pytest.param(shuffled(single(icosphere(4))), 2562, id='fine, float32'),
        pytest.param(icosphere(3) * 1e-60, 642, id='tiny'),
    ],
)
def test_what_exporters_write_is_taken(triangles, vertices):
    mesh = Mesh(triangles)
    assert len(mesh.vertices) == vertices
    outwards = np.einsum('ni,ni->n', mesh.normals, mesh.vertices[mesh.corners].mean(axis=1))
    assert (outwards > 0).all()
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0)


def dented(triangles, by):
    """One corner pushed towards the middle by a share of its distance."""
    corner = triangles[0, 0]
    same = (np.abs(triangles - corner) < 1e-12).all(axis=2, keepdims=True)
    return np.where(same, 1 - by, 1) * triangles


def hollow(triangles, by):
    """All corners near a pole pushed in smoothly, no edge by much."""
    height = triangles[:, :, 2:] / np.linalg.norm(triangles, axis=2, keepdims=True)
    return triangles * (1 - by * np.clip((height - 0.8) / 0.2, 0, 1) ** 2)


L_SHAPE = np.concatenate([CUBE, CUBE + np.eye(3)[0], CUBE + np.eye(3)[1]])


@pytest.mark.parametrize(
    ('triangles', 'words'),
    [
        pytest.param(dented(icosphere(2), 0.2), 'not convex at triangle', id='dent'),
        pytest.param(dented(icosphere(4), 4e-3), 'not convex at triangle', id='fine dent'),
        pytest.param(single(dented(icosphere(4), 1e-2)), 'not convex at', id='float32 dent'),
        pytest.param(hollow(icosphere(4), 0.3), 'not convex at triangle', id='wide hollow'),
        pytest.param(CUBE[:, :, [0, 1, 0]], 'flat', id='folded flat'),
        pytest.param(CUBE * (1, 1, 0), 'flat', id='scaled flat'),
        pytest.param(CUBE[:2], 'flat', id='one side'),
        pytest.param(
            CUBE[1:], 'an edge of triangle .* belongs to 1 triangles, not two', id='open'
        ),
        pytest.param(L_SHAPE, 'belongs to', id='three cubes'),
        pytest.param(np.concatenate([CUBE, CUBE + 3]), 'not the surface of one', id='two solids'),
        pytest.param(
            np.concatenate([CUBE, [[*CUBE[0, :2], (0, 0, 0)]]]), 'belongs to 3 triangles', id='fin'
        ),
        pytest.param(CUBE[:1], 'flat', id='one triangle'),
        pytest.param(np.concatenate([CUBE[:1], CUBE[:1]]), 'flat', id='the same twice'),
        pytest.param(CUBE * (1, 1, 1e-8), 'flat', id='as good as flat'),
        pytest.param(CUBE * 1e-150, 'too small', id='too small'),
    ],
)
def test_what_is_no_convex_solid_is_refused_in_a_sentence(triangles, words):
    with pytest.raises(ValueError, match=words) as refused:
        mesh_of(triangles, 'convex')
    assert '\n' not in str(refused.value)
    with pytest.raises(ValueError, match=words):
        mesh_of(turned(shuffled(triangles)), 'convex')


@pytest.mark.parametrize(
    ('triangles', 'words'),
    [
        (np.empty((0, 3, 3)), 'must have shape'),
        (np.zeros((4, 3)), 'must have shape'),
        (
            np.where(np.arange(108).reshape(12, 3, 3) == 9, np.nan, CUBE),
            'triangle 1 is not finite',
        ),
        (np.full((3, 3, 3), 0.1), 'no triangle with an area'),
    ],
)
def test_what_is_no_surface_is_refused(triangles, words):
    with pytest.raises(ValueError, match=words):
        mesh_of(triangles, 'convex')


def test_a_mesh_that_comes_again_is_recognised_while_it_is_in_use():
    mesh = mesh_of(CUBE)
    assert mesh_of(CUBE.copy()) is mesh
    assert mesh_of(CUBE * 2) is not mesh
    seen = weakref.ref(mesh)
    del mesh
    gc.collect()
    assert seen() is None
