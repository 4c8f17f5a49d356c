# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Canonical forms and bounds of shapes."""

import itertools
import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from scene.distance import contacts
from scene.reference import bulging, hull_of, random_shapes
from scipy.spatial.transform import Rotation
from tree.reference import effort

from bvh_ros.report.scenes import wavy_ring
from bvh_ros.scene import Mesh, ShapeKind, Shapes
from bvh_ros.scene.shapes.shape import GEOMETRY, as_shapes, canonicalise, unit_quaternions

COMPONENTS = [q for q in itertools.product([-1, 0, 1], repeat=4) if sum(map(abs, q)) in (1, 2, 4)]


@pytest.mark.parametrize('scale', [1.0, 1.009, 0.991])
def test_the_24_rotations_of_a_cube_keep_a_box_aligned(scale):
    for components in COMPONENTS:
        check_rotation(components, scale)


def check_rotation(components, scale):
    position, size = np.array([0.1, 0.2, 0.3]), np.array([0.7, 1.1, 1.3])
    shapes = as_shapes(
        Shapes.boxes([position], size, [scale * np.array(components) / np.linalg.norm(components)])
    )
    form = canonicalise(shapes)
    assert not form.records['shaped'][0]
    matrix = np.rint(Rotation.from_quat(components).as_matrix())
    turned = np.abs(matrix) @ size
    assert (form.records['half'][0] * 2.0).tolist() == turned.tolist()
    assert form.lo[0].tolist() == (position - turned / 2).tolist()
    assert form.hi[0].tolist() == (position + turned / 2).tolist()


@pytest.mark.parametrize('quarter', range(-8, 9))
def test_computed_right_angles_are_right_angles(quarter):
    """Quaternions as robots make them: the sine and cosine of half a rounded angle."""
    yaw = quarter * math.pi / 2
    turn = [0, 0, math.sin(yaw / 2), math.cos(yaw / 2)]
    assert is_aligned(turn)
    turn[0] = 1e-14
    assert not is_aligned(turn)


def is_aligned(turn):
    form = canonicalise(as_shapes(Shapes.boxes([[0, 0, 0]], [1, 2, 3], [turn])))
    return not form.records['shaped'][0]


def test_a_row_does_not_depend_on_the_others():
    """Meshes drawn beside their origin among them: where their middle is has to be added up."""
    rng = np.random.default_rng(4)
    held = [Mesh(bulging(rng) + shift) for shift in (0.0, [3.0, 5.0, 7.0], [0.1, -9.0, 0.3])]
    places, turns = rng.normal(size=(300, 3)), unit_quaternions(rng.normal(size=(300, 4)))
    meshes = Shapes.of_meshes(held * 100, places, turns)
    for shapes in (as_shapes(meshes), as_shapes(random_shapes(rng, 300))):
        form = canonicalise(shapes)
        for row in range(300):
            alone = canonicalise(shapes.take([row]))
            for name in GEOMETRY.names:
                assert np.array_equal(form.records[name][row], alone.records[name][0])
            assert form.lo[row].tolist() == alone.lo[0].tolist()
            assert form.hi[row].tolist() == alone.hi[0].tolist()


@pytest.mark.parametrize('ndim', [2, 3])
def test_bounds_hold_the_exact_shape_and_what_counts_as_touching(ndim):
    """In 50 digits, of the quaternion as it is given; from above the height of what stands counts
    for nothing.
    """
    rng = np.random.default_rng(ndim)
    meshes = [contacts.prism(rng) for _ in range(4)]
    for number in range(effort(300, 20_000)):
        kind = list(ShapeKind)[number % len(ShapeKind)]
        decade = rng.uniform(-90, 90) if kind == ShapeKind.MESH else rng.uniform(-290, 290)
        body = contacts.solid(kind, meshes, rng)
        if kind == ShapeKind.MESH:
            mesh = Mesh(body.mesh.vertices[body.mesh.corners] * 10.0**decade)
            body = contacts.Solid(kind, mesh.size / 2, mesh.vertices, mesh)
        else:
            body = contacts.Solid(kind, body.half * 10.0**decade)
        turn = rng.normal(size=4)
        turn[:2] *= rng.choice([1.0, 0.0, 1e-16, 1e-160])
        turn *= rng.uniform(0.991, 1.009) / np.linalg.norm(turn)
        place = rng.normal(size=3) * body.half.max() * rng.choice([0.0, 1.0, 1e9])
        held = np.full(1, body.mesh, object)
        size = body.mesh.size if body.mesh else 2 * body.half
        shapes = Shapes(np.array([kind], np.uint8), place[None], turn[None], size[None], held)
        form = canonicalise(as_shapes(shapes), ndim)
        assert form.faults[0] == 0
        if not form.records['shaped'][0]:
            continue
        record, pads = form.records[0], []
        standing = not record['orientation'][:2].any()
        sizes = record['half'][: 2 if standing and ndim == 2 else 3]
        with localcontext() as context:
            context.prec = contacts.DIGITS
            for axis in range(ndim):
                far = contacts.reach(
                    body, contacts.matrix(turn), contacts.decimals(np.eye(3)[axis])
                )
                near = contacts.reach(
                    body, contacts.matrix(turn), -contacts.decimals(np.eye(3)[axis])
                )
                centre = Decimal(float(place[axis]))
                pads += [centre - near - Decimal(form.lo[0, axis])]
                pads += [Decimal(form.hi[0, axis]) - centre - far]
            largest = max(sizes.max(), np.abs(place[:ndim]).max())
            touching = 2.0**-46 * sizes.max() + 2.0**-51 * largest
            assert min(pads) >= Decimal(touching), (kind, place, turn, body.half)
            many = body.mesh is not None and len(body.mesh.vertices) > 64
            assert max(pads) <= Decimal((2.0**-4 if many else 2.0**-43) * largest)


def rod(rng, count=100):
    """A thin prism through the origin that leans, of so many corners, seen from its tip."""
    angle = np.arange(count) * (2 * np.pi / count)
    rim = np.stack([0.01 * np.cos(angle), 0.01 * np.sin(angle), 0 * angle], axis=1)
    turn = Rotation.random(random_state=rng).apply
    return hull_of(turn(np.concatenate([rim, rim + np.array([0, 0, 3])])))


@pytest.mark.parametrize('decade', [-25, 0, 25])
@pytest.mark.parametrize('name', ['ring', 'bulging', 'rod'])
def test_bounds_of_many_vertices_hold_them_and_are_close(name, decade):
    """In 50 digits. Along the mesh's own axes they are as tight as those of few vertices."""
    rng = np.random.default_rng(len(name) + decade + 30)
    if name == 'ring':
        places, faces = wavy_ring(14, 8)
        triangles = (places + np.array([0.3, 9.0, -2.0]))[faces]
    else:
        triangles = bulging(rng, 120) if name == 'bulging' else rod(rng)
    mesh = Mesh(triangles * 10.0**decade)
    assert len(mesh.vertices) > 64
    places = contacts.decimals(mesh.vertices).reshape(-1, 3)
    farthest = np.linalg.norm(mesh.vertices, axis=1).max()
    for number in range(effort(20, 300)):
        turn = unit_quaternions(rng.normal(size=(1, 4)))
        if number % 4 == 0:
            turn = unit_quaternions(np.array([COMPONENTS[rng.integers(len(COMPONENTS))]], float))
        form = canonicalise(as_shapes(Shapes.of_meshes([mesh], [[0, 0, 0]], turn)))
        with localcontext() as context:
            context.prec = contacts.DIGITS
            matrix = contacts.matrix(form.records['orientation'][0])
            centre = contacts.decimals(form.records['position'][0])
            found = places @ matrix.T + centre
            low = found.min(axis=0) - contacts.decimals(form.lo[0])
            high = contacts.decimals(form.hi[0]) - found.max(axis=0)
            spare = float(max(*low, *high))
            assert min(*low, *high) >= Decimal(2.0**-46 * farthest)
        assert spare <= (2.0**-42 if number % 4 == 0 else 2.0**-4) * 2 * farthest
