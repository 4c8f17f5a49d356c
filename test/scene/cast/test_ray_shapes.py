# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Touching counts: rays and balls that just graze a shape, in numbers that doubles hold."""

import math

import numpy as np
import pytest
from scene.reference import box_of_triangles, scene_of

from bvh_ros.scene import NO_NODE, Mesh, ShapeKind, Shapes

BOX, SPHERE, CYLINDER, CAPSULE, MESH = ShapeKind


def alone(kind, size, orientation=(0, 0, 0, 1), position=(0, 0, 0)):
    place, turn, edges = (np.array([part], float) for part in (position, orientation, size))
    if kind == MESH:
        shapes = Shapes.of_meshes([Mesh(box_of_triangles(size))], place, turn)
    else:
        shapes = Shapes(np.array([kind]), place, turn, edges)
    return scene_of(shapes, names=['x'])


# kind, size, start, goal, radius, then t, point and normal of the hit
CONTACTS = [
    (BOX, (2, 2, 2), (-5, 0, 0), (5, 0, 0), 0.5, 0.35, (-1, 0, 0), (-1, 0, 0)),
    (BOX, (2, 2, 2), (-5, 1.5, 0), (5, 1.5, 0), 0.5, 0.4, (-1, 1, 0), (0, 1, 0)),  # along a face
    (BOX, (2, 2, 2), (-5, 1.3, 0), (5, 1.3, 0), 0.5, 0.36, (-1, 1, 0), (-0.8, 0.6, 0)),  # an edge
    (BOX, (2, 2, 2), (-8, 3, 5), (8, 3, 5), 6.0, 0.1875, (-1, 1, 1), (-2 / 3, 1 / 3, 2 / 3)),
    (BOX, (2, 2, 2), (-5, 0, 0), (-1.5, 0, 0), 0.5, 1.0, (-1, 0, 0), (-1, 0, 0)),  # at the goal
    (BOX, (2, 2, 2), (-1.5, 0, 0), (-5, 0, 0), 0.5, 0.0, (-1, 0, 0), (-1, 0, 0)),  # and off again
    (BOX, (2, 2, 0), (0, 0, -4), (0, 0, 4), 1.0, 0.375, (0, 0, 0), (0, 0, -1)),  # a flat box
    (SPHERE, (2, 2, 2), (-5, 0, 0), (5, 0, 0), 0.0, 0.4, (-1, 0, 0), (-1, 0, 0)),
    (SPHERE, (2, 2, 2), (-5, 1, 0), (5, 1, 0), 0.0, 0.5, (0, 1, 0), (0, 1, 0)),
    (SPHERE, (2, 2, 2), (-5, 3, 0), (5, 3, 0), 2.0, 0.5, (0, 1, 0), (0, 1, 0)),
    (SPHERE, (2, 2, 2), (0, 3, 0), (0, 3, 0), 2.0, 0.0, (0, 1, 0), (0, 1, 0)),  # no way at all
    (CAPSULE, (2, 2, 6), (-5, 0, 0), (5, 0, 0), 0.0, 0.4, (-1, 0, 0), (-1, 0, 0)),
    (CAPSULE, (2, 2, 6), (-5, 1, 2), (5, 1, 2), 0.0, 0.5, (0, 1, 2), (0, 1, 0)),  # where it bends
    (CAPSULE, (2, 2, 6), (0, 0, 8), (0, 0, -8), 0.0, 0.3125, (0, 0, 3), (0, 0, 1)),
    (CAPSULE, (2, 2, 6), (-5, 0, 4), (5, 0, 4), 1.0, 0.5, (0, 0, 3), (0, 0, 1)),
    (CAPSULE, (2, 2, 2), (-5, 3, 0), (5, 3, 0), 2.0, 0.5, (0, 1, 0), (0, 1, 0)),  # a ball
    (CYLINDER, (2, 2, 4), (-5, 0, 0), (5, 0, 0), 0.0, 0.4, (-1, 0, 0), (-1, 0, 0)),
    (CYLINDER, (2, 2, 4), (-5, 1, 0), (5, 1, 0), 0.0, 0.5, (0, 1, 0), (0, 1, 0)),  # along the side
    (CYLINDER, (2, 2, 4), (0.5, 0, 6), (0.5, 0, -6), 0.0, 1 / 3, (0.5, 0, 2), (0, 0, 1)),
    (CYLINDER, (2, 2, 4), (-5, 0, 2), (5, 0, 2), 0.0, 0.4, (-1, 0, 2), (-1, 0, 0)),  # in the cap
    (CYLINDER, (2, 2, 4), (1, 0, 5), (1, 0, -5), 0.0, 0.3, (1, 0, 2), (0, 0, 1)),  # down the side
    (CYLINDER, (2, 2, 4), (-5, 1.5, 0), (5, 1.5, 0), 0.5, 0.5, (0, 1, 0), (0, 1, 0)),
    (CYLINDER, (2, 2, 4), (-5, 0, 2.5), (5, 0, 2.5), 0.5, 0.4, (-1, 0, 2), (0, 0, 1)),  # a cap
    (CYLINDER, (2, 2, 4), (1.5, 0, 5), (1.5, 0, -5), 0.5, 0.3, (1, 0, 2), (1, 0, 0)),  # a side
    (CYLINDER, (2, 2, 4), (-5, 0, 2.3), (5, 0, 2.3), 0.5, 0.36, (-1, 0, 2), (-0.8, 0, 0.6)),  # rim
]  # fmt: skip


@pytest.mark.parametrize(
    ('kind', 'size', 'start', 'goal', 'radius', 't', 'point', 'normal'), CONTACTS
)
def test_contacts(kind, size, start, goal, radius, t, point, normal):
    hit = alone(kind, size).raycast(start, goal, radius)
    assert hit.t == pytest.approx(t, abs=1e-14)
    assert hit.point == pytest.approx(point, abs=1e-12)
    assert hit.normal == pytest.approx(normal, abs=1e-7)


@pytest.mark.parametrize('kind', list(ShapeKind))
@pytest.mark.parametrize('radius', [0.0, 0.5])
def test_a_start_inside_is_met_at_once_without_a_normal(kind, radius):
    scene = alone(kind, (2, 2, 2), (0, 0, 0.6, 0.8))
    for goal in ((5, 0, 0), (0.1, 0.2, 0.3)):
        hit = scene.raycast((0.1, 0.2, 0.3), goal, radius)
        assert hit.t == 0.0
        assert hit.point.tolist() == [0.1, 0.2, 0.3]
        assert hit.normal.tolist() == [0, 0, 0]
        assert scene.raycast((0.1, 0.2, 0.3), goal, radius, skip_inside=True) is None
    (touched,) = scene.overlap((0.1, 0.2, 0.3), (0.1, 0.2, 0.3), tolerance=radius)
    assert (touched.t, touched.normal.tolist()) == (0.0, [0, 0, 0])


@pytest.mark.parametrize('kind', list(ShapeKind))
def test_just_out_of_reach(kind):
    scene = alone(kind, (2, 2, 2))
    assert scene.raycast((-5, 0, 0), (-1.5 - 1e-12, 0, 0), 0.5) is None
    assert scene.raycast((-5, 1.5 + 1e-12, 0), (5, 1.5 + 1e-12, 0), 0.5) is None
    assert scene.raycast((-1.5 - 1e-12, 0, 0), (-5, 0, 0), 0.5) is None


def test_a_far_start_costs_few_digits():
    """Each contact is 1e6 m away and still found to a nanometre."""
    for kind in ShapeKind:
        scene = alone(kind, (0.2, 0.2, 0.2), (0, 0, 0.1, 1))
        hit = scene.raycast((-1e6, 0, 0), (1e6, 0, 0), 0.05)
        reach = 0.15 if kind not in (BOX, MESH) else 0.05 + 0.1 * (math.sqrt(2) * math.cos(0.0))
        assert -reach - 1e-9 <= hit.t * 2e6 - 1e6 <= -0.15 + 1e-9
        assert scene.raycast((-1e6, 0.1, 0.15 + 1e-6), (1e6, 0.1, 0.15 + 1e-6), 0.05) is None


@pytest.mark.parametrize('kind', ShapeKind)
def test_a_ray_without_an_end_that_misses(kind):
    """It comes back at all: among capsules it once looked for ever."""
    for turn in ((0, 0, 0, 1), (0.1, 0.3, 0.3, 0.9)):
        scene = alone(kind, (2, 2, 2 + 2 * (kind == CAPSULE)), turn)
        hits = scene.raycast_many([(-5, 1.4, 1.4)], [(1, 0.3, 0.3)])
        assert (hits.handles[0], hits.t[0]) == (NO_NODE, math.inf)


def test_thin_rays_among_boxes_stay_exact_beside_other_shapes():
    """A ray along the common edge of boxes, decided as the tree alone decides it."""
    boxes = Shapes.boxes([[0.1 * i, 0.1, 0.1] for i in range(30)], [0.1, 0.1, 0.1])
    scene = scene_of(boxes, names=[f'b{i}' for i in range(30)])
    rays = [
        ([-1, y, z], [4, y, z]) for y in (0.05, 0.15, 0.1) for z in (0.05, 0.15000000000000002)
    ]
    rays += [([-1, -1 / 3, 0.1], [4, 4 / 3, 0.1]), ([0.05, 0.05, -1], [0.05, 0.05, 1])]
    alone = [
        [(h.name, h.t, h.point.tolist(), h.normal.tolist()) for h in scene.raycast_all(*ray)]
        for ray in rays
    ]
    first = [scene.raycast(*ray) for ray in rays]
    scene.update(
        'test',
        ['ball'],
        Shapes(
            np.array([1]), np.array([[0, 9.0, 9]]), np.array([[0.0, 0, 0, 1]]), np.ones((1, 3))
        ),
        stamp=1,
    )
    beside = [
        [(h.name, h.t, h.point.tolist(), h.normal.tolist()) for h in scene.raycast_all(*ray)]
        for ray in rays
    ]
    assert sum(map(len, alone)) > 60
    for ray, one, other, hit in zip(rays, alone, beside, first, strict=True):
        assert one == other
        again = scene.raycast(*ray)
        assert (hit is None) == (again is None)
        assert hit is None or (hit.name, hit.t) == (again.name, again.t)
