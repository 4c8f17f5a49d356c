# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clearances and sweeps through the Python client: what a scene of the same obstacles says."""

import numpy as np
import pytest
from ros.parts.mixed_world import FACING, PARAMETERS, PLACE, fill, same_scene
from ros.patience import once_compiled
from scipy.spatial.transform import Rotation
from turns import unit_quaternions

from bvh_ros.client import FREE, UNANSWERED, BvhError, BvhTimeoutError
from bvh_ros.ros.access import has_typed_services
from bvh_ros.scene import ShapeKind, Shapes

ROWS = 60
RNG = np.random.default_rng(7)
PLACES = RNG.uniform(-7, 7, (ROWS, 3))
TURNS = unit_quaternions(RNG.normal(size=(ROWS, 4)))
SIZES = np.tile((0.5, 0.5, 0.8), (ROWS, 1))
KINDS = np.arange(ROWS, dtype=np.uint8) % 4
SIZES[KINDS == ShapeKind.SPHERE, 2] = 0.5
SHAPES = Shapes(KINDS, PLACES, TURNS, SIZES)
GOALS = PLACES + RNG.normal(0.0, 1.0, (ROWS, 3))

needs_services = pytest.mark.skipif(
    not has_typed_services(), reason='bvh_msgs is not built: pip install ./bvh_msgs'
)


@pytest.fixture(scope='module')
def filled(start_node):
    world = start_node(PARAMETERS)
    fill(world)
    return world


@pytest.fixture
def client(filled, client_of):
    return client_of(filled)


@needs_services
@pytest.mark.slow
@pytest.mark.parametrize('signed', [False, True])
def test_clearances_are_those_of_a_scene(client, signed):
    scene, reach = same_scene(), np.linspace(0.1, 9.0, ROWS)
    found = once_compiled(lambda: client.clearance_many(SHAPES, reach, 2, signed=signed))
    handles, *expected = scene.clearance_many(SHAPES, reach, 2, signed)
    names = client.names(found.obstacles)
    assert 0 < len(names) < ROWS
    for row, handle in enumerate(handles.tolist()):
        own = int(found.obstacles[row])
        assert own == FREE if handle == FREE else names[own] == scene.name_of(handle)
    for mine, others in zip(found[1:], expected, strict=True):
        np.testing.assert_array_equal(mine, others)


def in_lidar(points):
    return FACING.inv().apply(points - PLACE)


@needs_services
@pytest.mark.slow
@pytest.mark.parametrize('frame_id', ['', 'lidar'])
def test_sweeps_are_those_of_a_scene(client, frame_id):
    scene, goal_turns, tolerance = same_scene(), TURNS[::-1], np.linspace(0.0, 0.2, ROWS)
    shapes, goals, turns = SHAPES, GOALS, goal_turns
    if frame_id:
        there, turns = ((FACING.inv() * Rotation.from_quat(q)).as_quat() for q in (TURNS, turns))
        shapes = SHAPES._replace(position=in_lidar(PLACES), orientation=there)
        goals = in_lidar(GOALS)
    given = {'resolution': 1e-3, 'frame_id': frame_id}
    found = once_compiled(
        lambda: client.sweep_shape_many(shapes, goals, turns, tolerance, **given)
    )
    names = client.names(found.obstacles)
    for row in range(ROWS):
        shape = Shapes(KINDS[[row]], np.zeros((1, 3)), [[0, 0, 0, 1]], SIZES[[row]])
        ways = PLACES[[row]], TURNS[[row]], GOALS[[row]], goal_turns[[row]]
        one = scene.sweep_shape_many(shape, *ways, tolerance[row], resolution=1e-3)
        if frame_id:  # turned there and back again
            np.testing.assert_allclose(found.t[row], one.t[0], atol=1e-6)
            continue
        met = one.handles[0] != FREE
        assert names.get(int(found.obstacles[row])) == (
            scene.name_of(one.handles[0]) if met else None
        )
        for mine, others in zip(found[1:], one[1:], strict=True):
            np.testing.assert_array_equal(mine[row], others[0])
    assert 0 < np.isfinite(found.t).sum() < ROWS


@needs_services
@pytest.mark.slow
def test_another_frame_is_that_of_the_answers(client):
    balls = Shapes.spheres(in_lidar(PLACES), 0.1)
    found = once_compiled(lambda: client.clearance_many(balls, frame_id='lidar'))
    _, distances, _, points = same_scene().clearance_many(Shapes.spheres(PLACES, 0.1))
    np.testing.assert_allclose(found.distances, distances, atol=1e-9)
    apart = distances > 0  # else any common point is right
    np.testing.assert_allclose(found.obstacle_points[apart], in_lidar(points)[apart], atol=1e-9)


@needs_services
@pytest.mark.slow
def test_what_has_no_answer_never_looks_free(client):
    bad = SHAPES._replace(position=np.where(np.arange(ROWS)[:, None] == 1, np.nan, PLACES))
    found = once_compiled(lambda: client.clearance_many(bad))
    assert found.obstacles[1] == UNANSWERED
    assert np.isnan(found.distances[1])
    assert np.isfinite(np.delete(found.distances, 1)).all()
    ways = once_compiled(lambda: client.sweep_shape_many(bad, GOALS))
    assert ways.obstacles[1] == UNANSWERED
    assert np.isnan(ways.t[1])
    with pytest.raises(BvhError, match='centre is not finite'):
        client.clearance_many(bad.take([1]))
    with pytest.raises(BvhError, match='mars'):
        client.clearance_many(SHAPES, frame_id='mars')
    with pytest.raises(BvhError, match='no source predicts'):
        client.clearance_many(SHAPES, at=1)
    assert len(client.clearance_many(SHAPES.take([])).obstacles) == 0


@needs_services
def test_arguments_that_do_not_fit(client, client_of):
    with pytest.raises(ValueError, match='until needs at'):
        client.sweep_shape_many(SHAPES, GOALS, until=2)
    with pytest.raises(ValueError, match='goal_positions'):
        client.sweep_shape_many(SHAPES, GOALS[1:])
    with pytest.raises(ValueError, match='several nodes'):
        client_of(['/a', '/b']).clearance_many(SHAPES)


@needs_services
def test_a_node_without_the_services_is_an_error_in_time(client_of):
    nobody = client_of('/nobody/bvh', timeout=0.1)
    with pytest.raises(BvhTimeoutError, match='query/clearance'):
        nobody.clearance_many(SHAPES)


def test_without_the_package_the_error_names_it(client_of, monkeypatch):
    monkeypatch.setitem(__import__('sys').modules, 'bvh_msgs', None)
    with pytest.raises(BvhError, match='bvh_msgs'):
        client_of('/nobody/bvh', timeout=0.1).clearance_many(SHAPES)
