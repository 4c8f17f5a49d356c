# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `Scene.plot` draws is the surface of each shape, turned and placed as it is."""

import numpy as np
import pytest
from scene.meshes import TETRAHEDRON
from scene.reference import changed, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, NodeScene, ShapeKind, Shapes, inspection

TURN = (0.1, -0.5, 0.3, 0.8)
SIZES = {
    ShapeKind.BOX: (1.0, 2.0, 3.0),
    ShapeKind.SPHERE: (2.0, 2.0, 2.0),
    ShapeKind.CYLINDER: (1.0, 1.0, 3.0),
    ShapeKind.CAPSULE: (1.0, 1.0, 3.0),
}


def shapes_of(kind):
    place, turn = [(5.0, -3.0, 1.0)], [TURN]
    if kind == ShapeKind.MESH:
        return Shapes.of_meshes([Mesh(TETRAHEDRON)], place, turn)
    return Shapes([kind], place, turn, SIZES[kind])


def scene_with(kind, **given):
    scene = NodeScene(**given)
    assert scene.update('us', ['it'], shapes_of(kind), stamp=0) == []
    return scene


@pytest.mark.parametrize('kind', ShapeKind)
def test_a_surface_fills_the_bounds_of_its_shape_and_faces_outwards(kind):
    scene = scene_with(kind)
    (surface,) = inspection.surfaces(scene.shapes_of('us', 9))
    lo, hi = scene.bounds
    coarse = 0.0 if kind in (ShapeKind.BOX, ShapeKind.MESH) else 0.03  # round ones have corners
    np.testing.assert_allclose(surface.min(axis=(0, 1)), lo, atol=1e-12 + coarse)
    np.testing.assert_allclose(surface.max(axis=(0, 1)), hi, atol=1e-12 + coarse)
    if kind != ShapeKind.MESH:  # the triangles of a mesh are wound as they came
        outward = np.cross(surface[:, 2] - surface[:, 0], surface[:, 3] - surface[:, 1])
        away = surface.mean(axis=1) - surface.mean(axis=(0, 1))
        assert (np.einsum('ij,ij->i', outward, away) > 0.0).all()


@pytest.mark.parametrize('kind', ShapeKind)
def test_a_surface_is_closed(kind):
    """Every way out of it from its middle goes through one of its faces."""
    (surface,) = inspection.surfaces(
        changed(shapes_of(kind), orientation=np.array([(0, 0, 0, 1.0)]))
    )
    ways = np.random.default_rng(5).normal(size=(200, 3))
    middle = surface.mean(axis=(0, 1))
    met = np.zeros(len(ways), bool)
    for face in surface:
        for corner in range(1, len(face) - 1):
            a, b, c = face[[0, corner, corner + 1]] - middle
            volume = np.linalg.det(np.stack((a, b, c)))
            if abs(volume) > 1e-9:
                shares = np.linalg.solve(np.stack((a, b, c), axis=1), ways.T)
                met |= (shares > -1e-9).all(axis=0)
    assert met.all()


@pytest.mark.parametrize('kind', ShapeKind)
@pytest.mark.parametrize('planar', [False, True])
def test_every_shape_is_drawn(pyplot, kind, planar):
    scene = scene_with(kind, planar=planar)
    axes = scene.plot(levels=0)
    assert len(axes.collections) == 2
    assert all(one.get_clip_on() == planar for one in axes.collections)
    lo, hi = scene.bounds
    assert axes.get_xlim()[0] <= lo[0] < hi[0] <= axes.get_xlim()[1]
    if planar:
        (outline,) = axes.collections[0].get_paths()
        np.testing.assert_allclose(outline.vertices.max(axis=0), hi, atol=0.03)


@pytest.mark.parametrize('unit', [1e-12, 1.0, 1e12])
def test_a_picture_is_as_large_as_the_world(pyplot, unit):
    scene = scene_of(Shapes.boxes([(0.0, 0.0, 0.0)], 2.0 * unit))
    lo, hi = scene.plot().get_xlim()
    assert 1.0 < hi / unit < 1.1
    assert -1.1 < lo / unit < -1.0


FOLD = Mesh([[(2, 0, 0), (3, 0, 0), (3, 1, 1)], [(2, 0, 0), (3, 1, 1), (2, 1, 0)]])


def test_the_triangle_that_a_ray_meets_is_outlined(pyplot):
    turn = Rotation.from_quat(TURN)
    place = np.array((5.0, -3.0, 1.0))
    scene = scene_of(Shapes.of_meshes(FOLD, [place], TURN), names=['it'], of=NodeScene, stamp=0)
    middle = turn.apply(np.array((2.3, 0.7, 0.3))) + place
    along = turn.apply((0.0, 0.0, 4.0))
    axes = scene.plot(rays=[[middle + along, middle - along]])
    triangle = turn.apply([(2, 0, 0), (3, 1, 1), (2, 1, 0)]) + place
    edges = np.stack((triangle, np.roll(triangle, -1, axis=0)), axis=1)
    np.testing.assert_allclose(axes.collections[-1]._segments3d, edges, atol=1e-12)
    free = scene.plot(rays=[[middle + along, middle + 2.0 * along]])
    assert len(free.collections) == len(axes.collections) - 1


@pytest.mark.parametrize('kind', [*ShapeKind, FOLD])
def test_the_box_around_an_obstacle_is_tight(kind):
    shapes = Shapes.of_meshes(FOLD, [(5, -3, 1)], TURN) if kind is FOLD else shapes_of(kind)
    scene = scene_of(shapes, names=['it'], source='us', of=NodeScene, stamp=0)
    (surface,) = inspection.surfaces(scene.shapes_of('us', 9))
    middle, orientation, size = scene.own_box('it')
    local = Rotation.from_quat(orientation).inv().apply(surface.reshape(-1, 3) - middle)
    coarse = 0.03 if kind in (ShapeKind.SPHERE, ShapeKind.CYLINDER, ShapeKind.CAPSULE) else 1e-12
    np.testing.assert_allclose(local.max(axis=0), 0.5 * size, atol=coarse)
    np.testing.assert_allclose(local.min(axis=0), -0.5 * size, atol=coarse)


def test_handles_and_shapes_of_a_source_are_row_for_row():
    scene = NodeScene()
    for name, x in (('a', 1.0), ('b', 2.0), ('c', 3.0)):
        scene.update('odd' if name == 'b' else 'us', [name], Shapes.boxes([(x, 0, 0)], 1), stamp=0)
    handles = scene.handles_of('us', 9)
    assert [scene.name_of(int(handle)) for handle in handles] == ['a', 'c']
    assert scene.shapes_of('us', 9).position[:, 0].tolist() == [1.0, 3.0]
    assert scene.handles_of('us', 1).tolist() == handles[:1].tolist()
