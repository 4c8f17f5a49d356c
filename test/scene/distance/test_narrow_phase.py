# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts whose gaps are known, in numbers and by construction; near-parallel edges."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Scene, ShapeKind, Shapes
from bvh_ros.scene.distance.gjk import Core, gap_bounds

BOX, SPHERE, CYLINDER = ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CYLINDER


def core(half, turn=None, centre=(0, 0, 0)):
    """As `gjk` describes it: half sizes, axes in rows, centre."""
    axes = np.eye(3) if turn is None else np.asarray(turn).T
    return np.vstack([half, axes, centre]).astype(float)


def bounds_of(box, cylinder):
    return gap_bounds(Core(box, False, None), Core(cylinder, True, None), math.nan, np.empty(9))


@pytest.mark.parametrize(
    ('half', 'centre', 'expected'),
    [
        ((1, 1, 1), (0, 0, 3), 0.0),  # on the cap
        ((1, 1, 1), (0, 0, 3.25), 0.25),
        ((5, 5, 1), (4, 4, 3.5), 0.5),  # a wide plate over the cap
        ((1, 1, 1), (2, 0, 0), 0.0),  # at the side
        ((1, 1, 1), (2.5, 0, 0), 0.5),
        ((1, 1, 1), (3, 3, 0), 2 * 2**0.5 - 1),  # edge to side
        ((1, 1, 1), (2 + 3, 0, 3 + 4), 5.0),  # edge to rim
        ((9, 9, 9), (0, 0, 0), 0.0),  # all inside
        ((9, 9, 0.01), (0, 0, 0), 0.0),  # through a plate, no edge near
        ((0.1, 0.1, 9), (0, 0, 0), 0.0),  # a rod through the cylinder
        ((0, 0, 0), (3, 0, 0), 2.0),  # a point
    ],
)
def test_distances_of_a_box_and_a_cylinder(half, centre, expected):
    """A cylinder of radius 1 and half height 2."""
    low, high = bounds_of(core(half, None, centre), core((1, 1, 2)))
    assert (max(low, 0.0), high) == pytest.approx((expected, expected), abs=1e-13)


def alternating_projections(half, turn, centre, radius, height):
    """To and fro between two convex sets (von Neumann): a bound that sinks to the distance."""
    point = centre.copy()
    for _ in range(4000):
        across = np.linalg.norm(point[:, :2], axis=1)
        on = point * np.minimum(1.0, radius / np.maximum(across, 1e-300))[:, None]
        on[:, 2] = np.clip(point[:, 2], -height, height)
        local = np.einsum('nij,ni->nj', turn, on - centre)
        point = np.einsum('nij,nj->ni', turn, np.clip(local, -half, half)) + centre
    return np.linalg.norm(point - on, axis=1)


def test_bounds_hold_the_distance_that_alternating_projections_find():
    rng = np.random.default_rng(4)
    half, (radius, height) = rng.uniform(0.02, 1, (400, 3)), rng.uniform(0.02, 1, (2, 400))
    turn = Rotation.random(400, random_state=4).as_matrix()
    turn[:100] = Rotation.from_euler('z', rng.uniform(-3, 3, (100, 1))).as_matrix()
    centre = rng.normal(size=(400, 3)) * 1.2
    expected = alternating_projections(half, turn, centre, radius, height)
    bounds = np.array(
        [
            bounds_of(core(a, t, c), core((r, r, h)))
            for a, t, c, r, h in zip(half, turn, centre, radius, height, strict=True)
        ]
    )
    apart = bounds[:, 0] > 0
    assert 100 < np.count_nonzero(apart) < 350
    assert bounds[apart, 1] == pytest.approx(expected[apart], abs=1e-6)
    assert (bounds[:, 1] <= expected + 1e-11).all()
    assert np.diff(bounds[apart], axis=1).max() < 1e-11
    assert expected[~apart].max() < 1e-3


def scene_of(kinds, positions, turns, sizes):
    scene = Scene()
    rows = Shapes(
        np.array(kinds, np.uint8), *(np.array(a, float) for a in (positions, turns, sizes))
    )
    names = [str(i) for i in range(len(kinds))]
    assert scene.update('test', names, rows, stamp=1) == []
    return scene


def quaternion(rotation):
    return rotation.as_quat()


@pytest.mark.parametrize('gap', [-1e-3, -1e-13, 0.0, 1e-13, 1e-9, 1e-3])
@pytest.mark.parametrize('kind', [BOX, SPHERE, CYLINDER])
def test_a_shape_on_a_turned_box(kind, gap):
    """Put on a face with a gap, both turned anyhow: apart from some 1e-14 m on."""
    rng = np.random.default_rng([int(kind), int(-math.log10(abs(gap) or 1))])
    for _ in range(30):
        base, size = Rotation.random(random_state=rng), rng.uniform(0.1, 1, 3)
        reach = rng.uniform(0.1, 1, 3)
        if kind != BOX:
            reach[1] = reach[0]
        if kind == SPHERE:
            reach[2] = reach[0]
        spin = base * Rotation.from_euler('x', rng.uniform(-3, 3))
        offset = rng.uniform(-0.5, 0.5, 3) * size
        offset[0] = size[0] / 2 + reach[0] / 2 + gap
        places = [rng.uniform(-1, 1, 3)]
        places.append(places[0] + base.apply(offset))
        scene = scene_of([BOX, kind], places, [quaternion(base), quaternion(spin)], [size, reach])
        assert (scene.overlap_pairs() == [('0', '1')]) == (gap <= 0.0)


@pytest.mark.parametrize('angle', [0.0, 1e-16, 1e-13, 1e-10, 1e-7, 1e-4, 0.5])
@pytest.mark.parametrize('gap', [-1e-10, 1e-10])
def test_crossed_beams(angle, gap):
    """Long edges, nearly parallel or crossing: only their cross product keeps them apart."""
    lean = Rotation.from_euler('z', math.pi / 4)
    upper = Rotation.from_euler('y', angle) * lean
    # Beams along z whose edges meet on the x axis.
    half = math.sqrt(0.5)
    places = [(0, 0, 0), (2 * half + gap, 0, 0)]
    scene = scene_of([BOX, BOX], places, [lean.as_quat(), upper.as_quat()], [(1, 1, 4)] * 2)
    # Turning about y brings the ends of the upper beam nearer.
    closest = 2 * half + gap - (half * math.cos(angle) + 2 * math.sin(angle)) - half
    assert (scene.overlap_pairs() == [('0', '1')]) == (closest <= 0 or gap < 0)


def test_crosswise_edges():
    """Two beams that cross at right angles, each on its edge: no face keeps them apart."""
    low = Rotation.from_euler('x', math.pi / 4)
    high = Rotation.from_euler('z', math.pi / 2) * low
    for gap in (-1e-12, 1e-12):
        places = [(0, 0, 0), (0, 0, 2 * math.sqrt(0.5) + gap)]
        turns = [low.as_quat(), high.as_quat()]
        scene = scene_of([BOX, BOX], places, turns, [(6, 1, 1)] * 2)
        assert len(scene.overlap_pairs()) == (gap < 0)
