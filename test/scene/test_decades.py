# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is occupied is never answered free, at any size and from any distance that doubles hold.

The answer is right, or the shape is refused in words.
"""

import numpy as np
import pytest
from scene.reference import box_of_triangles, refilled
from tree.reference import effort

from bvh_ros.scene import NO_NODE, Mesh, ShapeKind, Shapes

TURNS = [0.3, -0.2, 0.5, 0.8], [0.0, 0.0, 0.0, 1.0]
DECADES = [*range(-300, 301, effort(100, 20)), -307, -60, 60, 307]
MESHES = 100  # beyond this decade a mesh is refused
WAYS = np.array([[1, 0, 0], [-0.3, 0.5, 0]])


def shape(kind, decade, turn):
    size = np.full((1, 3), 10.0**decade)
    if kind == ShapeKind.MESH:
        return Shapes.of_meshes([Mesh(box_of_triangles(np.ones(3)) * size)], [[0, 0, 0]], [turn])
    return Shapes(np.array([kind]), np.zeros((1, 3)), np.array([turn]), size)


def decades(kind):
    return [decade for decade in DECADES if kind != ShapeKind.MESH or abs(decade) < MESHES]


def scenes(kind, planar):
    """An obstacle about the origin alone, of each decade."""
    for decade in decades(kind):
        for turn in TURNS:
            yield decade, refilled(shape(kind, decade, turn), planar)


PLANAR = [(kind, True) for kind in ShapeKind]
SOLID = [(kind, False) for kind in (ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CYLINDER)]


@pytest.mark.parametrize(('kind', 'planar'), PLANAR + SOLID)
def test_rays_and_balls_from_afar_to_the_middle_and_beyond(kind, planar):
    for decade, scene in scenes(kind, planar):
        for away in {decade - 5, decade + 1, decade + 10, 155, *DECADES}:
            if not -307 <= away <= 307:
                continue
            for start in WAYS * 10.0**away:
                for ball in (0.0, 0.1 * 10.0**decade, 0.1 * 10.0**away):
                    case = decade, away, ball
                    for goal in (np.zeros(3), -start):  # exactly opposite
                        assert scene.raycast(start, goal, ball) is not None, case
                    assert len(scene.raycast_all(start, goal, ball)) == 1, case
                powers = 2.0 ** np.array([[0.0], [-500.0], [500.0]])
                with np.errstate(over='ignore'):
                    rays = -start * powers
                rays = rays[np.isfinite(rays).all(axis=1) & (rays / powers == -start).all(axis=1)]
                found, t, _, normals = scene.raycast_many([start] * len(rays), rays)
                assert (found != NO_NODE).all(), (decade, away)
                assert (t >= 0).all()
                assert np.isfinite(normals).all()


@pytest.mark.parametrize(('kind', 'planar'), PLANAR)
def test_points_and_shapes_at_the_same_place(kind, planar):
    for decade, scene in scenes(kind, planar):
        for other in ShapeKind:
            for size in decades(other):
                touched = scene.overlap_shape(shape(other, size, TURNS[0]))
                assert len(touched) == 1, (decade, other, size)
        for place in ([0.0, 0.0, 0.0], [0.2 * 10.0**decade, 0.0, 0.0]):
            assert len(scene.overlap(place, place)) == 1, decade
            assert scene.nearest(place)[0].t <= 1e-12 * 10.0**decade, decade
        for away in DECADES:
            far = 10.0**away
            if away > decade + 1:
                t = scene.nearest([far, 0, 0])[0].t
                assert 0.8 * far <= t <= far * (1 + 1e-12), (decade, away)
