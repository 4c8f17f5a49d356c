# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlap queries: exactly among axis-aligned boxes, elsewhere against fcl and brute force."""

import csv
import math
from fractions import Fraction

import fcl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene.reference import geometry_arrays, random_shapes, widest_gap
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Scene, ShapeKind, Shapes
from bvh_ros.tree.query import within

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
    scene = Scene()
    scene.update(
        'test', [str(i) for i in range(len(boxes))], Shapes.boxes(position, size), stamp=1
    )
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


def test_a_wall_exactly_as_far_away_as_the_tolerance(monkeypatch):
    """Right to the last digit, and few rational numbers however many voxels it has."""
    made = []
    monkeypatch.setattr(within, 'Fraction', lambda x: made.append(x) or Fraction(x))
    rng = np.random.default_rng(4)
    for gaps, tolerance in (([5.0, 0, 0], 5.0), ([0.3, 0.4, 0], 0.5), ([0, 0, 0.1], 0.1)):
        lo = np.tile(gaps, (20_000, 1)) - np.where(np.equal(gaps, 0.0), rng.random((20_000, 3)), 0)
        lo = np.nextafter(lo, lo + rng.integers(-1, 2, lo.shape))
        query = np.array([-1.0, -1.0, -1.0]), np.zeros(3)
        found = within.boxes_within(lo, lo + 1.0, *query, tolerance)
        squares = [
            sum(max(Fraction(x), Fraction(0)) ** 2 for x in row) for row in lo[:400].tolist()
        ]
        assert found[:400].tolist() == [square <= Fraction(tolerance) ** 2 for square in squares]
        assert 0 < found.sum() < len(found)
    assert len(made) < 1000


@pytest.mark.parametrize('tolerance', [0.0, 0.25])
def test_turned_boxes_overlap_as_python_fcl_says(tolerance):
    rng = np.random.default_rng(11)
    shapes = random_shapes(rng, 300, reach=4.0)
    scene = Scene()
    scene.update('test', [str(i) for i in range(300)], shapes, stamp=1)
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


@pytest.mark.parametrize('planar', [False, True])
def test_ball_queries_equal_brute_force(planar):
    rng = np.random.default_rng(12)
    shapes = random_shapes(rng, 60)
    world = geometry_arrays(shapes)
    scene = Scene(planar=planar)
    scene.update('test', [str(i) for i in range(60)], shapes, stamp=1)
    touching = 0
    for _ in range(60):
        centre, radius = rng.uniform(-4, 4, 3), float(rng.choice([0.0, 0.5, 2.0, 4.0]))
        found = {hit.name: hit for hit in scene.overlap(centre, centre, tolerance=radius)}
        for i, solid in enumerate(world):
            distance = (solid.distances_from_above if planar else solid.distances)(centre[None])[0]
            hit = found.get(str(i))
            assert (hit is not None) == (distance <= radius) or abs(distance - radius) < 1e-9
            if hit is not None:
                touching += 1
                assert hit.t == pytest.approx(distance, abs=1e-9)
                away = centre - hit.point
                assert np.linalg.norm(away) == pytest.approx(distance, abs=1e-9)
                assert (solid.distances_from_above if planar else solid.distances)(
                    hit.point[None]
                )[0] < 1e-9
                if distance > 1e-6:
                    assert hit.normal == pytest.approx(away / distance, abs=1e-6)
                elif distance == 0.0:
                    assert hit.normal.tolist() == [0.0, 0.0, 0.0]
    assert touching > 100


@pytest.mark.parametrize('tolerance', [0.0, 0.2])
def test_rectangles_seen_from_above_equal_a_search_for_a_separating_line(tolerance):
    """Two convex sets are as far apart as the best line between them says."""
    rng = np.random.default_rng(13)
    shapes = random_shapes(rng, 80)
    world = geometry_arrays(shapes)
    scene = Scene(planar=True)
    scene.update('test', [str(i) for i in range(80)], shapes, stamp=1)
    touching = 0
    for _ in range(25):
        yaw, size = rng.uniform(-4, 4), rng.uniform(0.01, 3, 3)
        turn = (
            np.array([0, 0, math.sin(yaw / 2), math.cos(yaw / 2)])
            if rng.random() < 0.8
            else np.zeros(4)
        )
        centre = rng.uniform(-5, 5, 3)
        start, goal = corners_of(centre, unit(turn), size)
        start[2], goal[2] = rng.uniform(-9, 9, 2)
        found = {hit.name: hit for hit in scene.overlap(start, goal, turn, tolerance)}
        matrix = Rotation.from_quat(unit(turn)).as_matrix()
        for i, solid in enumerate(world):
            gap = gap_from_above(solid, centre, matrix, size / 2)
            hit = found.get(str(i))
            assert (hit is not None) == (gap <= tolerance) or abs(gap - tolerance) < 1e-6, (i, gap)
            touching += hit is not None
            if hit is not None:
                assert hit.t == pytest.approx(
                    solid.distances_from_above(centre[None])[0], abs=1e-6
                )
                assert hit.point[2] == start[2]
    assert touching > 100


def gap_from_above(solid, centre, matrix, half):
    def both(normals):
        return solid.reach(normals) + np.abs(normals @ matrix[:2, :2]) @ half[:2]

    return widest_gap((centre - solid.position)[None, :2], both)[0]


def test_recorded_scenes_overlap_as_python_fcl_says_on_all_pairs(shared_data):
    with (shared_data / 'manipulation_scenes' / 'scenes.csv').open() as file:
        rows = list(csv.DictReader(file))
    pairs = together = 0
    for name in sorted({row['scene'] for row in rows}):
        mine = [row for row in rows if row['scene'] == name]
        kinds = [ShapeKind[row['shape'].upper()] for row in mine]
        position, size, turn = (
            np.array([[float(row[key]) for key in keys] for row in mine])
            for keys in (('cx', 'cy', 'cz'), ('sx', 'sy', 'sz'), ('qx', 'qy', 'qz', 'qw'))
        )
        scene = Scene()
        names = [row['object'] for row in mine]
        assert (
            scene.update('scene', names, Shapes(np.array(kinds), position, turn, size), stamp=1)
            == []
        )
        objects = [
            as_fcl(*row) for row in zip(kinds, position, map(unit, turn), size, strict=True)
        ]
        for i in (i for i, kind in enumerate(kinds) if kind == ShapeKind.BOX):
            start, goal = corners_of(position[i], unit(turn[i]), size[i])
            found = {hit.name for hit in scene.overlap(start, goal, turn[i])}
            for j in range(len(mine)):
                pairs += 1
                expected = fcl.collide(objects[i], objects[j]) > 0
                together += expected
                if (names[j] in found) != expected:
                    # Boards that share a face: rounding of the corners decides.
                    assert 0 <= abs(fcl.distance(objects[i], objects[j])) < 1e-6, (
                        name,
                        names[i],
                        names[j],
                    )
    assert pairs > 500
    assert together > 100
