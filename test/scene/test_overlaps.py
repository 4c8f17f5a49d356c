# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlap queries: exactly among axis-aligned boxes, elsewhere against fcl and brute force."""

import math
from fractions import Fraction

import fcl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene.reference import random_shapes, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import ShapeKind, Shapes

lattice = st.integers(-6, 6).map(lambda i: i * 0.1)
points = st.tuples(lattice, lattice, lattice)


@given(
    st.lists(
        st.tuples(points, st.tuples(*[st.integers(0, 8).map(lambda i: i * 0.1)] * 3)), min_size=1
    ),
    points,
    points,
    st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.1 * math.sqrt(2), 5e-324]),
)
def test_aligned_boxes_are_decided_as_real_arithmetic_does(boxes, start, goal, tolerance):
    position, size = np.array([b[0] for b in boxes]), np.array([b[1] for b in boxes])
    scene = scene_of(Shapes.boxes(position, size))
    expected = []
    for i, (lo, hi) in enumerate(zip(position - size / 2, position + size / 2, strict=True)):
        square = Fraction(0)
        for axis in range(3):
            low, high = sorted((Fraction(start[axis]), Fraction(goal[axis])))
            gap = max(Fraction(lo[axis]) - high, low - Fraction(hi[axis]), Fraction(0))
            square += gap**2
        if square <= Fraction(tolerance) ** 2:
            expected.append(str(i))
    found = scene.overlap(start, goal, tolerance=tolerance)
    assert sorted(hit.name for hit in found) == sorted(expected)
    assert [(hit.t, hit.handle) for hit in found] == sorted((hit.t, hit.handle) for hit in found)


def as_fcl(kind, position, quaternion, size, grown=0.0):
    x, y, z, w = quaternion
    shape = {
        ShapeKind.BOX: lambda: fcl.Box(*size),
        ShapeKind.SPHERE: lambda: fcl.Sphere(size[0] / 2 + grown),
        ShapeKind.CYLINDER: lambda: fcl.Cylinder(size[0] / 2, size[2]),
        ShapeKind.CAPSULE: lambda: fcl.Capsule(size[0] / 2, size[2] - size[0]),
    }[kind]()
    return fcl.CollisionObject(shape, fcl.Transform(np.array([w, x, y, z]), np.asarray(position)))


def corners_of(position, quaternion, size):
    """Two opposite corners, as a client sends them."""
    diagonal = Rotation.from_quat(quaternion).apply(np.asarray(size) / 2)
    return position - diagonal, position + diagonal


def unit(orientation):
    turn = orientation if orientation.any() else np.array([0.0, 0.0, 0.0, 1.0])
    return turn / np.linalg.norm(turn)


@pytest.mark.parametrize('tolerance', [0.0, 0.25])
def test_turned_boxes_overlap_as_python_fcl_says(tolerance):
    rng = np.random.default_rng(11)
    shapes = random_shapes(rng, 300, reach=4.0)
    scene = scene_of(shapes)
    objects = [as_fcl(ShapeKind(k), p, unit(q), s) for k, p, q, s in zip(*shapes[:4], strict=True)]
    touching = 0
    for _ in range(40):
        turn, size, centre = rng.normal(size=4), rng.uniform(0.05, 3.0, 3), rng.uniform(-4, 4, 3)
        turn = unit(turn)
        start, goal = corners_of(centre, turn, size)
        found = {hit.name for hit in scene.overlap(start, goal, turn, tolerance)}
        query = as_fcl(ShapeKind.BOX, centre, turn, size)
        for i, other in enumerate(objects):
            if tolerance == 0.0:
                expected = fcl.collide(query, other) > 0
            else:
                expected = fcl.distance(query, other) <= tolerance
            if (str(i) in found) != expected:
                # fcl's distance from a cylinder may be wrong by 2e-4
                assert abs(fcl.distance(query, other) - tolerance) < 1e-3, (i, shapes.kind[i])
            touching += expected
    assert touching > 300
