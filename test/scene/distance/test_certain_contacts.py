# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts of everything with everything, edges and faces along each other above all.

Decisions are right from a gap or depth of 1e-12 of the pair on, distances to 1e-13, and the same
from either side; a common point lies in both. `contacts` measures the truth in 50 digits.
"""

import numpy as np
import pytest
from scene.distance.contacts import (
    BOX,
    CYLINDER,
    MESH,
    answers,
    contacts,
    farthest_outside,
    shapes_of,
    touches_within,
)
from scene.reference import scene_of
from scipy.spatial.transform import Rotation
from tree.reference import effort

from bvh_ros.scene import Mesh, Shapes

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
    for one in made:
        touching, found, back = answers(one, planar)
        if found.distance != back.distance:
            yield 'another distance from the other side', one
        points, others = ([side.point, side.other_point] for side in (found, back))
        if (np.subtract(points, others[::-1])[:, : 2 if planar else 3] != 0.0).any():
            yield 'other points from the other side', one
        if touching != (one.gap < 0) and abs(one.gap) >= DECIDED * one.size:
            yield 'wrong decision', one
        if abs(found.distance - max(one.gap, 0.0)) > EXACT * one.size:
            yield f'wrong distance {found.distance}', one
        if farthest_outside(one, found, planar) > COMMON * one.size:
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
    common = 0
    for one in made:
        _, found, _ = answers(one)
        if found.distance == 0.0:
            common += 1
            assert (found.point == found.other_point).all()
            assert farthest_outside(one, found) <= COMMON * one.size
    assert common > COUNT / 4


def test_a_common_point_beside_cylinders():
    """Entered by anything down to where nobody can tell. Corners on a rim make flat tetrahedra:
    also of those the point is found that is common to rounding.
    """
    rng = np.random.default_rng(28)
    depths = [10.0**-k for k in range(5, 12)]
    made = contacts(COUNT, rng, ('parallel', 'nearly', 'free'), depths, NEAR, (CYLINDER, MESH))
    for one in made:
        _, found, _ = answers(one)
        if found.distance == 0.0:
            assert farthest_outside(one, found) <= EXACT * one.size, one


def test_how_many_are_compared_is_told():
    """And of how many GJK alone does not tell: faces that touch along each other, say."""
    turn = Rotation.from_euler('z', 0.3)
    drums = Shapes(
        np.array([2, 2, 2], np.uint8),
        np.array([[0, 0, 0], turn.apply([1, 0, 0.5]), [0.2, 0.1, 0.3]]),
        turn.as_quat()[None].repeat(3, axis=0),
        np.ones((3, 3)),
    )
    scene = scene_of(drums, names=['a', 'b', 'c'])
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
            off = 1e-12 * max(one.size, one.gap)
            for beyond in (-off, off):
                assert touches_within(one, one.gap + beyond) == (beyond > 0)


@pytest.mark.parametrize(
    ('manners', 'gaps'), [(('free',), [0.1, 0.03]), (('upright', 'parallel'), [1e-10, 1e-12])]
)
def test_more_digits_are_seldom_needed(manners, gaps):
    made = contacts(300, np.random.default_rng(7), manners, gaps, (0.0,), (BOX, MESH))
    needed = 0
    for one in made:
        scene = scene_of(shapes_of(one))
        scene.overlap_pairs()
        needed += scene.stats()['pairs_in_more_digits']
    assert needed <= 0.1 * len(made)


def test_meshes_far_from_their_own_origin():
    """A mesh in world coordinates is where its triangles are."""
    cube = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
    triangles = np.concatenate([cube[[[f[:3], [f[0], *f[2:]]] for f in faces]].reshape(-1, 3, 3)])
    step = 2.0**-36  # 1.5e-11, to the digits of 8192
    for gap in (-step, step):
        meshes = [Mesh(triangles + np.array(at)) for at in ((8192, 0, 0), (8193 + gap, 0.5, 0.3))]
        scene = scene_of(Shapes.of_meshes(meshes, np.zeros((2, 3))), names=['a', 'b'])
        assert len(scene.overlap_pairs()) == (gap < 0)
        assert scene.clearance('a').distance == pytest.approx(max(gap, 0.0), abs=1e-13)


def test_kinds_are_what_they_are_called():
    """The contacts that are made hold every kind of shape with every other."""
    made = contacts(400, np.random.default_rng(9), ('free',), [1e-3], (0.0,))
    seen = {tuple(sorted(body.kind for body in one.geometry_arrays)) for one in made}
    assert {(BOX, CYLINDER), (CYLINDER, CYLINDER), (CYLINDER, MESH), (MESH, MESH)} <= seen
    assert len(seen) == 15
