# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `Scene.plot` draws is the surface of each shape, turned and placed as it is."""

import numpy as np
import pytest

from bvh_ros.scene import Mesh, Scene, ShapeKind, Shapes, plotting

TURN = (0.1, -0.5, 0.3, 0.8)
SIZES = {
    ShapeKind.BOX: (1.0, 2.0, 3.0),
    ShapeKind.SPHERE: (2.0, 2.0, 2.0),
    ShapeKind.CYLINDER: (1.0, 1.0, 3.0),
    ShapeKind.CAPSULE: (1.0, 1.0, 3.0),
}
CORNERS = np.vstack((np.zeros(3), np.eye(3)))
TETRAHEDRON = Mesh([np.delete(CORNERS, corner, axis=0) for corner in range(4)])


def shapes_of(kind):
    place, turn = [(5.0, -3.0, 1.0)], [TURN]
    if kind == ShapeKind.MESH:
        return Shapes.of_meshes([TETRAHEDRON], place, turn)
    return Shapes.boxes(place, SIZES[kind], turn)._replace(kind=np.array([kind], np.uint8))


def scene_of(kind, **given):
    scene = Scene(**given)
    assert scene.update('us', ['it'], shapes_of(kind), stamp=0) == []
    return scene


@pytest.mark.parametrize('kind', ShapeKind)
def test_a_surface_fills_the_bounds_of_its_shape_and_faces_outwards(kind):
    scene = scene_of(kind)
    (surface,) = plotting.surfaces(scene.shapes_of('us', 9))
    lo, hi = scene.bounds
    coarse = 0.0 if kind in (ShapeKind.BOX, ShapeKind.MESH) else 0.03  # round ones have corners
    np.testing.assert_allclose(surface.min(axis=(0, 1)), lo, atol=1e-12 + coarse)
    np.testing.assert_allclose(surface.max(axis=(0, 1)), hi, atol=1e-12 + coarse)
    if kind != ShapeKind.MESH:  # the triangles of a mesh are wound as they came
        outward = np.cross(surface[:, 2] - surface[:, 0], surface[:, 3] - surface[:, 1])
        away = surface.mean(axis=1) - surface.mean(axis=(0, 1))
        assert (np.einsum('ij,ij->i', outward, away) > 0.0).all()


@pytest.mark.parametrize('kind', ShapeKind)
@pytest.mark.parametrize('planar', [False, True])
def test_every_shape_is_drawn(kind, planar):
    pyplot = pytest.importorskip('matplotlib.pyplot', reason='matplotlib is not installed')
    pyplot.switch_backend('agg')
    scene = scene_of(kind, planar=planar)
    axes = scene.plot(levels=0)
    assert len(axes.collections) == 2
    lo, hi = scene.bounds
    assert axes.get_xlim()[0] <= lo[0] < hi[0] <= axes.get_xlim()[1]
    if planar:
        (outline,) = axes.collections[0].get_paths()
        np.testing.assert_allclose(outline.vertices.max(axis=0), hi, atol=0.03)
    pyplot.close('all')


def test_handles_and_shapes_of_a_source_are_row_for_row():
    scene = Scene()
    for name, x in (('a', 1.0), ('b', 2.0), ('c', 3.0)):
        scene.update('odd' if name == 'b' else 'us', [name], Shapes.boxes([(x, 0, 0)], 1), stamp=0)
    handles = scene.handles_of('us', 9)
    assert [scene.name_of(int(handle)) for handle in handles] == ['a', 'c']
    assert scene.shapes_of('us', 9).position[:, 0].tolist() == [1.0, 3.0]
    assert scene.handles_of('us', 1).tolist() == handles[:1].tolist()
