# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts of everything with everything, edges and faces along each other above all.

Decisions are right from a gap or depth of 1e-12 of the pair on, distances to 1e-13, and the same
from either side; a common point lies in both. `contacts` measures the truth in 50 digits.
"""

import math
from decimal import localcontext

import numpy as np
import pytest
from scene.distance.contacts import (
    BOX,
    CYLINDER,
    DIGITS,
    MESH,
    contacts,
    decimals,
    matrix,
    outside,
    pairs_of,
    scene_of,
)
from scene.reference import box_of_triangles
from scipy.spatial.transform import Rotation
from tree.reference import effort

from bvh_ros.scene import Mesh, Scene, Shapes
from bvh_ros.scene.distance.narrow_phase import gap as distance_of
from bvh_ros.scene.distance.narrow_phase import near_pairs

COUNT = effort(400, 200_000)  # of each of five kinds
BATCH = 2000
GAPS = [10.0**-k for k in range(1, 13)] + [1.1e-12, 2e-12, 5e-12]
NEAR, FAR = (0.0, 1.0), (100.0, 1e4)
DECIDED, EXACT, COMMON = 1e-12, 1e-13, 1e-9
KINDS = [
    pytest.param(('upright',), NEAR, False, id='upright'),
    pytest.param(('upright',), NEAR, True, id='planar'),
    pytest.param(('parallel',), NEAR, False, id='parallel'),
    pytest.param(('nearly', 'free'), NEAR, False, id='turned'),
    pytest.param(('upright', 'parallel', 'free'), FAR, False, id='far away'),
]


def faults(made, planar):
    """What is answered wrong: (fault, contact)."""
    pairs, geometry, hulls = pairs_of(made, scene_of(made, planar))
    found, points = np.empty((2, len(made)), np.bool_), np.empty((2, 2, 3))
    for side, order in enumerate((pairs, pairs[:, ::-1].copy())):
        near_pairs(geometry, hulls, order, planar, found[side])
    for k, one in enumerate(made):
        pair = geometry[pairs[k]]
        distance = distance_of(pair[0], hulls, pair[1], hulls, planar, points[0])
        if distance != distance_of(pair[1], hulls, pair[0], hulls, planar, points[1]):
            yield 'another distance from the other side', one
        if (points[1, ::-1] != points[0]).any():
            yield 'other points from the other side', one
        wrong = found[:, k] != (one.gap < 0)
        if wrong.any() and abs(one.gap) >= DECIDED * one.size:
            yield 'wrong decision', one
        if abs(distance - max(one.gap, 0.0)) > EXACT * one.size:
            yield f'wrong distance {distance}', one
        places = zip(one.geometry_arrays, one.positions, one.turns, points[0], strict=True)
        if max(outside(*place, planar) for place in places) > COMMON * one.size:
            yield 'a point outside', one


@pytest.mark.parametrize(('manners', 'offsets', 'planar'), KINDS)
def test_every_contact(manners, offsets, planar):
    rng = np.random.default_rng([len(manners), int(planar)])
    for _ in range(max(COUNT // BATCH, 1)):
        made = contacts(min(COUNT, BATCH), rng, manners, GAPS, offsets)
        for fault, one in faults(made, planar):
            pytest.fail(f'{fault}: {one}')


def test_a_common_point_of_what_overlaps_deeply():
    """Solids put into each other anyhow, a small one inside a large one among them."""
    rng = np.random.default_rng(5)
    made = contacts(COUNT, rng, ('free',), [0.01], (0.0,))
    for one in made:
        one.positions[1] = one.positions[0] + rng.uniform(-0.4, 0.4, 3) * one.size
    pairs, geometry, hulls = pairs_of(made, scene_of(made))
    points, common = np.empty((2, 3)), 0
    for one, (a, b) in zip(made, pairs, strict=True):
        if distance_of(geometry[a], hulls, geometry[b], hulls, False, points) == 0.0:
            common += 1
            assert (points[0] == points[1]).all()
            for place in zip(one.geometry_arrays, one.positions, one.turns, points, strict=True):
                assert outside(*place) <= COMMON * one.size
    assert common > COUNT / 4


def test_a_common_point_beside_cylinders():
    """Entered by anything down to where nobody can tell. Corners on a rim make flat tetrahedra:
    also of those the point is found that is common to rounding.
    """
    rng = np.random.default_rng(28)
    depths = [10.0**-k for k in range(5, 12)]
    made = contacts(COUNT, rng, ('parallel', 'nearly', 'free'), depths, NEAR, (CYLINDER, MESH))
    pairs, geometry, hulls = pairs_of(made, scene_of(made))
    points = np.empty((2, 3))
    for one, (a, b) in zip(made, pairs, strict=True):
        if distance_of(geometry[a], hulls, geometry[b], hulls, False, points) == 0.0:
            for place in zip(one.geometry_arrays, one.positions, one.turns, points, strict=True):
                assert outside(*place) <= EXACT * one.size, one


def test_how_many_are_compared_is_told():
    """And of how many GJK alone does not tell: faces that touch along each other, say."""
    turn = Rotation.from_euler('z', 0.3)
    scene = Scene()
    drums = Shapes(
        np.array([2, 2, 2], np.uint8),
        np.array([[0, 0, 0], turn.apply([1, 0, 0.5]), [0.2, 0.1, 0.3]]),
        turn.as_quat()[None].repeat(3, axis=0),
        np.ones((3, 3)),
    )
    scene.update('test', ['a', 'b', 'c'], drums, stamp=1)
    assert (scene.stats()['pairs_compared'], scene.stats()['pairs_in_more_digits']) == (0, 0)
    assert len(scene.overlap_pairs()) == 3
    stats = scene.stats()
    assert stats['pairs_compared'] == 3
    assert 0 < stats['pairs_in_more_digits'] < 3


@pytest.mark.parametrize('gap', [1e-9, 1e-6, 0.3, 20.0])
def test_tolerances(gap):
    """A query grown by all of the gap but 1e-12 of the pair misses, by 1e-12 more it touches."""
    rng = np.random.default_rng(6)
    for one in contacts(100, rng, ('upright', 'parallel', 'nearly'), [gap], NEAR):
        if one.gap > 0.0:
            scene, off = Scene(), 1e-12 * max(one.size, one.gap)
            scene.update('test', ['it'], shape_of(one, 1), stamp=1)
            for beyond in (-off, off):
                found = scene.overlap_shape(shape_of(one, 0), tolerance=one.gap + beyond)
                assert bool(found) == (beyond > 0)


def shape_of(one, row):
    body = one.geometry_arrays[row]
    position, turn = one.positions[row : row + 1], one.turns[row : row + 1]
    if body.mesh is not None:
        return Shapes.of_meshes([body.mesh], position, turn)
    return Shapes(np.array([body.kind], np.uint8), position, turn, 2 * body.half[None])


@pytest.mark.parametrize(
    ('manners', 'gaps'), [(('free',), [0.1, 0.03]), (('upright', 'parallel'), [1e-10, 1e-12])]
)
def test_more_digits_are_seldom_needed(manners, gaps):
    made = contacts(300, np.random.default_rng(7), manners, gaps, (0.0,), (BOX, MESH))
    pairs, geometry, hulls = pairs_of(made, scene_of(made))
    found = np.empty(len(made), np.bool_)
    assert near_pairs(geometry, hulls, pairs, False, found) <= 0.1 * len(made)


@pytest.mark.parametrize('kinds', [(BOX, BOX), (BOX, MESH), (MESH, MESH), (CYLINDER, CYLINDER)])
@pytest.mark.parametrize('planar', [False, True])
def test_corners_next_to_each_other_whose_faces_lie_along_each_other(kinds, planar):
    """The way between two corners is short, those to the next corners are long, and nearly as
    far along it.

    Both are turned alike: what is between them along each axis of theirs is all that matters.
    """
    rng = np.random.default_rng(11)
    for _ in range(COUNT // 8):
        halves = 10.0 ** rng.uniform(-2, 0, (2, 3))
        if CYLINDER in kinds:
            halves[:, 1] = halves[:, 0]
        turn = rng.normal(size=4)
        if planar:
            turn[:2] = 0.0
        size = 2 * float(halves.max())
        way = 10.0 ** rng.uniform(-16, 0, 3) * rng.choice([-1.0, 1.0], 3)
        way[rng.integers(3)] = rng.choice([-1.0, 1.0])
        local = halves.sum(axis=0) * rng.choice([-1.0, 1.0], 3)
        if CYLINDER in kinds:
            angle = rng.uniform(-3, 3)
            local[:2] = np.array([math.cos(angle), math.sin(angle)]) * abs(local[0])
        local += way * rng.choice(GAPS) * size
        places = np.array([[0, 0, 0], Rotation.from_quat(turn).apply(local)])
        held = np.empty(2, object)
        held[:] = [
            Mesh(box_of_triangles(2 * half)) if kind == MESH else None
            for kind, half in zip(kinds, halves, strict=True)
        ]
        turns = np.array([turn, turn])
        scene = Scene(planar=planar)
        shapes = Shapes(np.array(kinds, np.uint8), places, turns, 2 * halves, held)
        assert scene.update('test', ['a', 'b'], shapes, stamp=1) == []
        gap = gap_along_axes(places, turn, halves, CYLINDER in kinds, planar)
        if abs(gap) >= DECIDED * size:
            assert len(scene.overlap_pairs()) == (gap < 0)
        found = [scene.clearance(name) for name in 'ab']
        assert found[0].distance == found[1].distance
        assert abs(found[0].distance - max(gap, 0.0)) <= EXACT * size
        if gap > 0:
            between = np.linalg.norm(found[0].point - found[0].other_point)
            assert abs(between - gap) <= 1e-14 * size


def gap_along_axes(places, turn, halves, round_ones, planar):
    """The distance of two boxes or cylinders of the same orientation, in 50 digits; negative: so
    deep.
    """
    with localcontext() as context:
        context.prec = DIGITS
        local = decimals(places[1]) @ matrix(turn)
        reach = [sum(decimals(pair)) for pair in halves.T]
        if round_ones:
            across = (local[0] ** 2 + local[1] ** 2).sqrt()
            beyond = [across - reach[0], abs(local[2]) - reach[2]]
        else:
            beyond = [abs(x) - most for x, most in zip(local, reach, strict=True)]
        if planar:
            beyond = beyond[: 1 if round_ones else 2]
        outside = [x for x in beyond if x > 0]
        return float(sum(x * x for x in outside).sqrt() if outside else max(beyond))


def test_upright_boxes_edge_to_edge():
    """Turned about z by angles that differ by anything from nothing to a right angle."""
    rng = np.random.default_rng(8)
    for angle in [0.0, *10.0 ** np.arange(-16.0, 0.0), math.pi / 4]:
        for gap in (1e-12, -1e-12, 3e-8):
            yaw = rng.uniform(-3, 3)
            turns = Rotation.from_euler('z', [[yaw], [yaw + angle]])
            # The corner of one towards the corner of the other, along its own diagonal.
            way = turns[0].apply([1, 1, 0]) / math.sqrt(2)
            ends = turns.apply([[1, 1, 0], [-1, -1, 0]])
            places = [[0, 0, 0], ends[0] - ends[1] + gap * way]
            scene = Scene()
            boxes = Shapes.boxes(places, [2, 2, 1], turns.as_quat())
            assert scene.update('test', ['a', 'b'], boxes, stamp=1) == []
            assert len(scene.overlap_pairs()) == (gap < 0)
            ways = [scene.clearance(name).distance for name in 'ab']
            assert ways[0] == ways[1] == pytest.approx(max(gap, 0.0), abs=4e-13)


def test_meshes_far_from_their_own_origin():
    """A mesh in world coordinates is where its triangles are."""
    cube = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
    triangles = np.concatenate([cube[[[f[:3], [f[0], *f[2:]]] for f in faces]].reshape(-1, 3, 3)])
    step = 2.0**-36  # 1.5e-11, to the digits of 8192
    for gap in (-step, step):
        meshes = [Mesh(triangles + np.array(at)) for at in ((8192, 0, 0), (8193 + gap, 0.5, 0.3))]
        scene = Scene()
        scene.update('test', ['a', 'b'], Shapes.of_meshes(meshes, np.zeros((2, 3))), stamp=1)
        assert len(scene.overlap_pairs()) == (gap < 0)
        assert scene.clearance('a').distance == pytest.approx(max(gap, 0.0), abs=1e-13)


def test_kinds_are_what_they_are_called():
    """The contacts that are made hold every kind of shape with every other."""
    made = contacts(400, np.random.default_rng(9), ('free',), [1e-3], (0.0,))
    seen = {tuple(sorted(body.kind for body in one.geometry_arrays)) for one in made}
    assert {(BOX, CYLINDER), (CYLINDER, CYLINDER), (CYLINDER, MESH), (MESH, MESH)} <= seen
    assert len(seen) == 15
