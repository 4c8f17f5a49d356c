# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Requests that cannot be answered never look free."""

import math

import pytest
from ros.messages import coordinates, get_plan, marker

SERVICES = ['raycast', 'raycast_all', 'overlap']
BAD = {
    'NaN start': {'start': (math.nan, 0, 0)},
    'infinite start': {'start': (0, math.inf, 0)},
    'as infinite below': {'start': (0, 1, -math.inf)},
    'NaN goal': {'goal': (0, 0, math.nan)},
    'segment too long': {'start': (-1.7e308, 0, 0), 'goal': (1.7e308, 0, 0)},
    'unknown frame': {'frame': 'mars'},
    'negative tolerance': {'tolerance': -1e-30},
    'NaN tolerance': {'tolerance': math.nan},
    'infinite tolerance': {'tolerance': math.inf},
}


@pytest.mark.parametrize('service', SERVICES)
@pytest.mark.parametrize('what', BAD)
def test_error_reply(world, service, what):
    given = {'start': (1.0, 2.0, 3.0), 'goal': (4.0, 5.0, 6.0), **BAD[what]}
    plan = world.plan(service, given.pop('start'), given.pop('goal'), **given)
    (pose,) = plan.poses
    assert pose.header.frame_id.startswith('error: ')
    assert plan.header.frame_id == 'map'
    start = BAD[what].get('start', (1, 2, 3))
    assert coordinates(pose) == tuple(c if math.isfinite(c) else 0 for c in start)
    assert pose.pose.orientation.w == 1


def test_start_and_goal_in_different_frames(world):
    request = get_plan((0, 0, 0), (1, 0, 0))
    request.goal.header.frame_id = 'mars'
    (pose,) = world.call('raycast', request).plan.poses
    assert 'mars' in pose.header.frame_id
    request.goal.header.frame_id = 'map'  # the node's own
    assert world.call('raycast', request).plan.poses == []


def test_errors_are_logged_and_do_not_end_the_node(world):
    assert world.names('raycast', (0, 0, 0), (1, 0, 0)) == []
    world.until(lambda: 'query refused' in world.said())
    assert 'Traceback' not in world.said()


def test_triggers(world):
    world.markers(marker(1), marker(2, (5, 0, 0)))
    world.until(lambda: len(world.everything()) == 2)
    assert world.trigger('validate').success
    assert world.trigger('rebuild').success
    reply = world.trigger('clear')
    assert reply.success
    assert '2' in reply.message
    assert world.everything() == set()
    assert world.trigger('validate').success


@pytest.mark.parametrize(
    'turn',
    [
        (math.inf, 0, 0, 1),
        (0, 0, -math.inf, 0),
        (0, 0, 0, math.nan),
        (0, 0, 90, 0),
        (0, 0, 0.1, 0),
    ],
)
def test_orientations_that_are_none(world, turn):
    (name,) = world.names('overlap', (0, 0, 0), (1, 1, 1), turn=turn)
    assert name.startswith('error: ')


def test_strange_but_legal_requests(world):
    world.markers(marker(1))
    world.until(lambda: world.everything() == {'a/1'})
    for turn in ((0, 0, 0, 0), (0, 0, 0, 1.009), (0, 0, 0, 0.991)):
        assert world.names('overlap', (0, 0, 0), (1, 1, 1), turn=turn) == ['a/1']
    assert world.names('raycast', (0, 0, 0), (0, 0, 0)) == ['a/1']  # all fields unset: a point
    assert world.names('raycast', (-1e150, 0, 0), (1e150, 0, 0)) == ['a/1']
    assert world.names('raycast', (1e300, 0, 0), (1e300, 1, 0), tolerance=1e30) == []
    world.trigger('clear')
