# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Balls, boxes, points and paths over ROS 2: each row is what a scene of the same obstacles says,
and what is no answer says so.
"""

import math

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from ros.clouds import table
from ros.messages import cloud
from ros.parts.mixed_world import FACING, PARAMETERS, PLACE, SHAPES, fill, same_scene
from ros.patience import PATIENCE, once_compiled
from sensor_msgs.msg import PointCloud2
from turns import unit_quaternions

from bvh_ros.client import FREE, UNANSWERED, BvhError
from bvh_ros.scene import NO_NODE, NodeScene, Shapes

pytestmark = pytest.mark.slow

ASKED = 1034  # from 1024 rows on several threads share them
RNG = np.random.default_rng(17)
FOOTPRINT = [0.8, 0.5, 0.4]
GIVEN = {**PARAMETERS, 'footprint': FOOTPRINT, 'nearest_limit': 5, 'threads': 2}


@pytest.fixture(scope='module')
def world(start_node):
    world = start_node(GIVEN)
    fill(world)
    return world


@pytest.fixture(scope='module')
def scene():
    """The same world; its view sees every other one."""
    return same_scene()


@pytest.fixture(params=['all', 'even'])
def client(request, world, client_of):
    """A client, and what of the world it sees."""
    view = request.param == 'even'
    client = client_of(f'{world.name}/even' if view else world)
    client.mask = 2 if view else 1
    return client


def same(found, expected):
    np.testing.assert_array_equal(np.asarray(found), np.asarray(expected))


def test_balls(client, scene):
    origins, directions = RNG.uniform(-8, 8, (ASKED, 3)), RNG.normal(size=(ASKED, 3))
    t_max, radius = RNG.uniform(1, 6, ASKED), RNG.choice([0.0, 0.2, 0.7], ASKED)
    hits = once_compiled(lambda: client.raycast_many(origins, directions, t_max, radius=radius))
    expected = scene.raycast_many(
        origins, directions, t_max, client.mask, radius=radius.astype(np.float64)
    )
    for found, column in zip(hits, expected, strict=True):
        same(found, column)
    assert 0.05 < (hits.obstacles != FREE).mean() < 0.95
    t_max[7], radius[9], radius[11] = math.inf, -1.0, math.nan
    radius[7] = 0.5
    hits = client.raycast_many(origins, directions, t_max, radius=radius)
    assert np.flatnonzero(hits.obstacles == UNANSWERED).tolist() == [7, 9, 11]
    assert np.isnan(hits.t[[7, 9, 11]]).all()


def test_boxes(client, scene):
    centers, sizes = RNG.uniform(-7, 7, (ASKED, 3)), RNG.uniform(0, 1.5, (ASKED, 3))
    turns, tolerance = unit_quaternions(RNG.normal(size=(ASKED, 4))), RNG.choice([0.0, 0.3], ASKED)
    told = once_compiled(lambda: client.overlap_many(centers, sizes, turns, tolerance))
    expected = scene.overlap_many(centers, sizes, turns, tolerance, client.mask, 'hits')
    same(told.obstacles, expected.handles)
    same(told.counts, expected.counts)
    same(told.distances, expected.distances)
    same(told.points, expected.points)
    assert 0.02 < (told.counts > 0).mean() < 0.9
    centers[3], sizes[5], turns[6, 2], tolerance[8] = math.nan, -1.0, math.inf, math.nan
    sizes[9] = 1.7e308
    told = client.overlap_many(centers, sizes, turns, tolerance)
    bad = [3, 5, 6, 8, 9]
    assert np.flatnonzero(told.obstacles == UNANSWERED).tolist() == bad
    assert (told.counts[bad] == UNANSWERED).all()
    assert np.isnan(told.distances[bad]).all()
    good = np.delete(np.arange(ASKED), bad)
    same(told.counts[good], expected.counts[good])


def test_points(client, scene):
    points, reach = RNG.uniform(-8, 8, (ASKED, 3)), RNG.choice([0.1, 1.0, math.inf], ASKED)
    told = once_compiled(lambda: client.nearest_many(points, reach))
    handles, distances, where = scene.nearest_many(points, 1, reach, client.mask)
    same(told.obstacles, handles[:, 0])
    same(told.distances, distances[:, 0])
    same(told.points, where[:, 0])
    near = handles[:, 0] != NO_NODE
    lengths = np.linalg.norm(told.normals, axis=1)
    assert np.allclose(lengths, near & (distances[:, 0] > 0))
    back = where[near, 0] + distances[near] * told.normals[near]
    assert np.allclose(back, points[near])
    points[4, 1], reach[6] = math.inf, -1.0
    told = client.nearest_many(points, reach)
    assert np.flatnonzero(told.obstacles == UNANSWERED).tolist() == [4, 6]
    assert np.isnan(told.distances[[4, 6]]).all()


def test_paths(client, scene):
    places, turns = RNG.uniform(-7, 7, (ASKED, 3)), unit_quaternions(RNG.normal(size=(ASKED, 4)))
    told = once_compiled(lambda: client.check_path(places, turns))
    shapes = Shapes.boxes(places, FOOTPRINT, turns)
    handles, distances, mine, points = scene.clearance_many(shapes, mask=client.mask, signed=True)
    same(told.obstacles, handles)
    same(told.distances, distances)
    same(told.points, points)
    assert 0.02 < (told.distances < 0).mean() < 0.9
    same(told.normals, (mine - points) / distances[:, None])
    # What goes the way out is free, and what goes less far is not.
    for share, free in ((1.001, True), (0.999, False)):
        out = shapes._replace(position=places - share * distances[:, None] * told.normals)
        rows = np.flatnonzero(distances < 0)
        for row in rows:
            one = NodeScene()
            there = np.array([told.obstacles[row] - 1])
            one.update('t', ['x'], SHAPES.take(there), stamp=1)
            touches = one.overlap_shape(out.take([row]))
            assert bool(touches) != free
    places[2] = math.nan
    told = client.check_path(places, turns)
    assert np.flatnonzero(told.obstacles == UNANSWERED).tolist() == [2]


@pytest.mark.usefixtures('patient_client')
def test_in_another_frame(world, scene, client_of):
    client = client_of(world)
    points = RNG.uniform(-8, 8, (50, 3))
    local, turns = FACING.inv().apply(points - PLACE), FACING.inv().as_quat()[None]
    near = once_compiled(lambda: client.nearest_many(local, frame_id='lidar'))
    expected = scene.nearest_many(points)
    same(near.obstacles, expected[0][:, 0])
    assert np.allclose(near.distances, expected[1][:, 0])
    assert np.allclose(FACING.apply(near.points) + PLACE, expected[2][:, 0])
    back = FACING.apply(near.points + near.distances[:, None] * near.normals) + PLACE
    assert np.allclose(back[near.distances > 0], points[near.distances > 0])
    turned = np.repeat(turns, 50, axis=0)  # unturned in the node's frame
    told = once_compiled(lambda: client.overlap_many(local, [1, 2, 3], turned, frame_id='lidar'))
    same(told.counts, scene.overlap_many(points, [1, 2, 3], want='count'))
    path = once_compiled(lambda: client.check_path(local, turned, frame_id='lidar'))
    clear = scene.clearance_many(Shapes.boxes(points, FOOTPRINT), signed=True)
    assert np.allclose(path.distances, clear[1], atol=1e-9)
    with pytest.raises(BvhError, match='mars'):
        client.nearest_many(points, frame_id='mars')
    with pytest.raises(BvhError, match='mars'):
        client.check_path(points, frame_id='mars')


def replies(world, asked, told, message):
    """What is told of a message that no client of ours would send."""
    heard = world.heard(PointCloud2, told)
    world.until(lambda: world.node.count_publishers(f'{world.name}/{told}'))
    world.until_found()
    world.publish(f'bvh/{asked}', message)
    world.until(lambda: heard)
    return table(heard[0])


def test_clouds_that_say_too_little(world):
    for asked, told, names in (('points', 'nearest_hits', 'xy'), ('boxes', 'box_hits', 'xyz')):
        asks = cloud({name: np.zeros(3) for name in [*names, 'sx', 'a', 'b', 'c']})
        rows = replies(world, asked, told, asks)
        assert rows['obstacle'].tolist() == [UNANSWERED] * 3
        assert np.isnan(rows['distance']).all()
    path = Path()
    path.header.frame_id = 'map'
    for frame in ('', 'map', 'lidar'):
        path.poses.append(PoseStamped())
        path.poses[-1].header.frame_id = frame
    rows = replies(world, 'paths', 'path_hits', path)
    assert (rows['obstacle'] == UNANSWERED).tolist() == [False, False, True]


def test_nearest_as_a_service(client, scene, world):
    for point in RNG.uniform(-8, 8, (20, 3)):
        hits = once_compiled(lambda p=point: client.nearest(p))
        expected = scene.nearest(point, 5, mask=client.mask)
        assert [hit.name for hit in hits] == [hit.name for hit in expected]
        assert [hit.point for hit in hits] == [tuple(hit.point.tolist()) for hit in expected]
        reach = float(np.float32(expected[2].t))
        few = scene.nearest(point, 5, reach, client.mask) if reach else expected
        assert [hit.name for hit in client.nearest(point, reach)] == [hit.name for hit in few]
    zero = world.plan('nearest', (1, 2, 3), (0, 0, 0)).poses
    assert [pose.header.frame_id for pose in zero] == [
        hit.name for hit in scene.nearest([1, 2, 3], 5)
    ]
    (error,) = world.names('nearest', (1, 2, 3), (1, 2, 4))
    assert error.startswith('error: goal')
    (error,) = world.names('nearest', (1, 2, math.nan), (0, 0, 0))
    assert error.startswith('error: ')


@pytest.mark.usefixtures('patient_client')
def test_an_incomplete_world(start_node, client_of):
    client = client_of(start_node({'markers.required': True, 'footprint': [0.3]}))
    client.wait_until_ready(PATIENCE)
    with pytest.raises(BvhError, match='has not spoken yet'):
        client.nearest([0, 0, 0])
    for ask in (
        lambda: client.nearest_many([[0, 0, 0]]),
        lambda: client.overlap_many([[0, 0, 0]], [1, 1, 1]),
        lambda: client.check_path([[0, 0, 0]]),
        lambda: client.raycast_many([[0, 0, 0]], [[1, 0, 0]], 1.0, radius=0.1),
    ):
        with pytest.raises(BvhError, match='has not spoken yet'):
            ask()


def test_what_paths_need_is_compiled_at_the_start(configure):
    """And is then no longer to be compiled when somebody asks."""
    for given, has_paths in (
        ({'footprint': [0.3]}, True),
        ({'footprint': [0.3], 'batch': False}, False),
        ({}, False),
    ):
        server = configure(given)
        for wholly in (False, True):
            names = [job.name for job in server.jobs(wholly=wholly)]
            assert names.count('paths') == has_paths
            assert wholly == ('nearest' in names)
