# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Paths whose ways between the poses count, and footprints that are polygons, over ROS 2."""

import numpy as np
import pytest
from ros.messages import marker
from ros.patience import once_compiled
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation, Slerp

from bvh_ros.client import FREE, UNANSWERED, BvhError
from bvh_ros.scene import Scene, Shapes

pytestmark = pytest.mark.slow

# An L, of which one corner is not convex.
CORNERS = [[0.5, 0.3], [-0.4, 0.3], [-0.4, -0.3], [-0.1, -0.3], [-0.1, 0.1], [0.5, 0.1]]
HEIGHT = 0.8
COUNT = 60
RNG = np.random.default_rng(21)
CENTRE, SIZE = RNG.uniform(-6, 6, (COUNT, 3)), RNG.uniform(0.2, 1.5, (COUNT, 3))
CENTRE[:, 2] *= 0.1


@pytest.fixture(scope='module')
def world(start_node):
    world = start_node(
        {'footprint': str(CORNERS), 'footprint_height': HEIGHT, 'path_between': True}
    )
    world.show(*(marker(i, CENTRE[i], SIZE[i]) for i in range(COUNT)))
    return world


def parts_of(configure, corners):
    """The shapes that make up a footprint."""
    given = {'footprint': str(corners), 'footprint_height': HEIGHT}
    return configure(given).settings.footprint


def test_ways_are_as_a_scene_sees_them(world, client_of, configure):
    scene = Scene()
    names = [f'a/{i}' for i in range(COUNT)]
    scene.update('markers', names, Shapes.boxes(CENTRE, SIZE), stamp=1)
    count = 400
    places = np.cumsum(RNG.normal(0.0, 0.25, (count, 3)), axis=0)
    places[:, 2] *= 0.01
    turns = Rotation.from_euler('z', np.cumsum(RNG.normal(0.0, 0.4, (count, 1)), axis=0)).as_quat()
    hits = client_of(world).check_path(places, turns, between=True)
    parts = parts_of(configure, CORNERS)
    assert len(parts) == 2
    touches = np.zeros(count, bool)
    first = np.full(count, np.inf)
    for part in parts:
        touches |= scene.overlap_shape_many(part, places, turns)
        found = scene.sweep_shape_many(part, places[:-1], turns[:-1], places[1:], turns[1:])
        first[1:] = np.minimum(first[1:], found.t)
    np.testing.assert_array_equal(hits.distances <= 0.0, touches | np.isfinite(first))
    np.testing.assert_array_equal(hits.t[1:], np.where(np.isfinite(first), first, np.inf)[1:])
    assert hits.t[0] == (1.0 if touches[0] else np.inf)
    only = np.isfinite(first) & ~touches
    assert only.sum() > 2
    assert (hits.distances[only] == 0.0).all()
    assert (hits.obstacles[only] != FREE).all()
    # A way that is not free meets the footprint somewhere between its poses.
    for row in np.flatnonzero(only)[:5]:
        share = np.linspace(0.0, 1.0, 400)
        between = Slerp([0, 1], Rotation.from_quat(turns[row - 1 : row + 1]))(share).as_quat()
        line = places[row - 1] + share[:, None] * (places[row] - places[row - 1])
        near = [scene.overlap_shape_many(p, line, between, tolerance=1e-3) for p in parts]
        assert np.any(near)


def test_a_pose_that_is_none_spoils_the_way_from_it(world, client_of):
    places = np.array([[9.0, 9.0, 9.0], [np.nan, 9.0, 9.0], [9.0, 9.0, 9.0], [9.0, 9.5, 9.0]])
    hits = client_of(world).check_path(places, between=True)
    assert (hits.obstacles == UNANSWERED).tolist() == [False, True, True, False]
    assert np.isnan(hits.t[1:3]).all()


def test_without_path_between_it_is_an_error(start_node, client_of):
    client = client_of(start_node({'footprint': [0.3]}))
    assert client.check_path([[0, 0, 0]]).obstacles[0] == FREE
    with pytest.raises(BvhError, match='path_between of the node is off'):
        client.check_path([[0, 0, 0]], between=True)


def test_the_times_of_ways(start_node, client_of):
    """A crate drives across a robot's way between two poses, and away again."""
    world = start_node(
        {
            'footprint': '[[0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2], [0.2, -0.2]]',
            'planar': True,
            'path_between': True,
            'markers.predict': 'constant_velocity',
            'max_prediction': 20.0,
        }
    )
    client = client_of(world)
    first = client.node.get_clock().now().nanoseconds // 10**9 - 2
    for k, y in enumerate((-6.0, -4.0, -2.0)):  # 2 m/s
        world.markers(marker(1, (0.0, y, 0.0), (0.4, 0.4, 0.4), stamp=first + k))
        world.until(lambda y=y: bool(world.names('overlap', (-0.1, y, 0), (0.1, y + 0.01, 0))))
    later = (first + 2) * 10**9
    places = [[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    # It is in the middle when the robot is, after 1 s, or long gone.
    at = [later, later + 2 * 10**9]
    hits = once_compiled(lambda: client.check_path(places, at=at, between=True))
    assert hits.obstacles[1] != FREE
    assert 0.3 < hits.t[1] < 0.5
    hits = client.check_path(places, at=[later + 4 * 10**9, later + 6 * 10**9], between=True)
    assert hits.t.tolist() == [np.inf, np.inf]
    hits = client.check_path(places, at=[later + 6 * 10**9, later + 4 * 10**9], between=True)
    assert hits.obstacles[1] == UNANSWERED


def test_convex_parts_make_up_a_polygon(configure):
    rng = np.random.default_rng(3)
    for _ in range(40):
        count = int(rng.integers(4, 24))
        angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
        radii = rng.uniform(0.2, 2.0, count)
        corners = np.column_stack((radii * np.cos(angles), radii * np.sin(angles))).tolist()
        points = rng.uniform(-2.0, 2.0, (300, 2))
        inside = np.array([is_inside(corners, p) for p in points])
        covered = np.zeros(len(points), bool)
        for part in parts_of(configure, corners):
            (mesh,) = part.mesh
            hull = Delaunay((mesh.vertices + mesh.centre)[:, :2])
            covered |= hull.find_simplex(points) >= 0
        np.testing.assert_array_equal(inside, covered)


def is_inside(corners, point):
    """By counting the edges to the right."""
    x, y = point
    inside = False
    for (a, b), (c, d) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if (b > y) != (d > y) and x < a + (y - b) / (d - b) * (c - a):
            inside = not inside
    return inside
