# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts of everything with everything, edges and faces along each other above all.

Decisions are right from a gap or depth of 1e-12 of the pair on, distances to 1e-13, and the same
from either side; a common point lies in both. `contacts` measures the truth in 50 digits.
"""

import math
import os

import numpy as np
import pytest
from scene.distance.contacts import BOX, CYLINDER, MESH, contacts, outside, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Scene, Shapes
from bvh_ros.scene.distance.clearance import gap as distance_of
from bvh_ros.scene.distance.gjk import CORE_ROWS, SLACK, WAY_ROOM, gap_bounds
from bvh_ros.scene.distance.narrow_phase import fill_core, largest_length, near_pairs
from bvh_ros.scene.distance.sure_gap import certain
from bvh_ros.scene.geometry.hull import hull_of

LONG = os.environ.get('BVH_ROS_LONG_TESTS') == '1'
COUNT = 200_000 if LONG else 400  # of each of five kinds
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


def pairs_of(made, scene):
    """Slots (n, 2), and what the kernels read."""
    slots = [scene._registry.slot(str(i)) for i in range(2 * len(made))]
    return np.array(slots).reshape(-1, 2), scene._columns.geometry, scene._columns.hulls()


def faults(made, planar):
    """What is answered wrong: (fault, contact)."""
    pairs, geometry, hulls = pairs_of(made, scene_of(made, planar))
    found, points = np.empty((2, len(made)), np.bool_), np.empty((2, 2, 3))
    for side, order in enumerate((pairs, pairs[:, ::-1].copy())):
        near_pairs(geometry, hulls, order, planar, found[side])
    for k, one in enumerate(made):
        pair = geometry[pairs[k]]
        distance = distance_of(pair[0], pair[1], hulls, planar, points[0])
        if distance != distance_of(pair[1], pair[0], hulls, planar, points[1]):
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
        if distance_of(geometry[a], geometry[b], hulls, False, points) == 0.0:
            common += 1
            assert (points[0] == points[1]).all()
            for place in zip(one.geometry_arrays, one.positions, one.turns, points, strict=True):
                assert outside(*place) <= COMMON * one.size
    assert common > COUNT / 4


def test_a_common_point_beside_cylinders():
    """Entered by anything down to where nobody can tell."""
    rng = np.random.default_rng(10)
    depths = [10.0**-k for k in range(5, 12)]
    made = contacts(COUNT, rng, ('parallel', 'nearly', 'free'), depths, NEAR, (CYLINDER, MESH))
    pairs, geometry, hulls = pairs_of(made, scene_of(made))
    points = np.empty((2, 3))
    for one, (a, b) in zip(made, pairs, strict=True):
        if distance_of(geometry[a], geometry[b], hulls, False, points) == 0.0:
            for place in zip(one.geometry_arrays, one.positions, one.turns, points, strict=True):
                assert outside(*place) <= COMMON * one.size, one


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


@pytest.mark.skipif(not LONG, reason='compiles the parts of the kernels once more')
def test_how_often_more_digits_are_needed():
    """Seldom: of pairs anyhow next to each other, and of contacts down to 1e-12."""
    rng = np.random.default_rng(7)
    for manners, gaps in ((('free',), [0.1, 0.03]), (('upright', 'parallel'), [1e-10, 1e-12])):
        made = contacts(300, rng, manners, gaps, (0.0,), (BOX, MESH))
        pairs, geometry, hulls = pairs_of(made, scene_of(made))
        open_ones = 0
        for pair in geometry[pairs]:
            cores, origin = np.empty((2, CORE_ROWS, 3)), pair[0]['position']
            exponent = math.frexp(max(largest_length(shape, origin) for shape in pair))[1]
            for shape, core in zip(pair, cores, strict=True):
                fill_core(shape, origin, exponent, False, core)
            vertices = [hull_of(hulls, shape) for shape in pair]
            bounds = gap_bounds(
                *(cores[0], False, vertices[0], cores[1], False, vertices[1]),
                *(math.nan, np.empty(WAY_ROOM)),
            )
            open_ones += not certain(*bounds, SLACK, True)
        print(f'{manners}: {open_ones} of {len(made)} need more digits')
        assert open_ones <= 0.05 * len(made)


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
