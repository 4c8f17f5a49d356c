# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles that come and go on a MarkerArray topic."""

import math

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, ARROW, TRIANGLE_LIST = 2, 3, 6, 7, 0, 11
DELETE, DELETE_ALL = 2, 3


@pytest.fixture
def clean(world, messages):
    """The shared node, emptied, and the maker of markers."""
    world.trigger('clear')
    return world, messages.marker


def holds(world, *names):
    world.until(lambda: world.everything() == set(names))


def test_add_modify_delete(clean):
    world, marker = clean
    world.markers(marker(1), marker(2, (5, 0, 0)), marker(3, (9, 0, 0), ns='b/c'))
    holds(world, 'a/1', 'a/2', 'b/c/3')
    world.markers(marker(1, (0, 50, 0)))
    world.until(lambda: world.names('raycast', (0, 50, -9), (0, 50, 9)) == ['a/1'])
    assert world.names('raycast', (0, 0, -9), (0, 0, 9)) == []
    world.markers(marker(2, action=DELETE), marker(7, action=DELETE))
    holds(world, 'a/1', 'b/c/3')


def test_delete_all_of_a_namespace_and_of_everything(clean):
    world, marker = clean
    names = ['a', 'a/b', 'ab', 'c']
    world.markers(*(marker(1, (i, 0, 0), ns=ns) for i, ns in enumerate(names)))
    holds(world, 'a/1', 'a/b/1', 'ab/1', 'c/1')
    world.markers(marker(0, ns='a', action=DELETE_ALL))
    holds(world, 'a/b/1', 'ab/1', 'c/1')  # a/b is another namespace
    world.markers(marker(0, ns='', action=DELETE_ALL), marker(5))
    holds(world, 'a/5')


def test_lifetime(clean):
    world, marker = clean
    before = int(world.status('world').values['expired'])
    world.markers(marker(1, lifetime=0.4), marker(2))
    world.until(lambda: int(world.status('world').values['expired']) == before + 1)
    assert world.everything() == {'a/2'}


def test_bad_markers_harm_nothing(clean):
    world, marker = clean
    world.markers(marker(1, (1, 0, 0)), marker(2, (3, 0, 0)))
    holds(world, 'a/1', 'a/2')
    bad = [
        marker(1, (math.nan, 0, 0)),
        marker(2, (3, 0, 0), (1, math.inf, 1)),
        marker(3, size=(1, -1, 1)),
        marker(4, turn=(math.nan, 0, 0, 1)),
        marker(5, type=ARROW),
        marker(6, frame='mars'),
        marker(7, size=(1, 2, 3), type=SPHERE),
        marker(8, size=(1, 2, 3), type=CYLINDER),
        marker(9, action=77),
        marker(10, ns='error: a'),
        marker(11, lifetime=-1.0),
    ]
    world.markers(*bad, marker(12, (5, 0, 0)))
    holds(world, 'a/1', 'a/2', 'a/12')
    assert world.names('raycast_all', (0, 0, 0), (9, 0, 0)) == ['a/1', 'a/2', 'a/12']
    assert world.trigger('validate').success


def test_round_shapes(clean):
    world, marker = clean
    world.markers(
        marker(1, (0, 0, 0), (2, 2, 2), type=SPHERE),
        marker(2, (0, 10, 0), (2, 2, 6), type=CYLINDER),
        marker(3, (0, 20, 0), (2, 2, 2), turn=(0, 0, math.sin(0.4), math.cos(0.4))),
    )
    holds(world, 'a/1', 'a/2', 'a/3')
    for y, corner_free in ((0, True), (10, True), (20, True)):
        # Each bounding box has a corner that the shape does not fill.
        hits = world.names('raycast', (0.95, y + 0.95, 0.9), (0.95, y + 0.95, 0.95))
        assert (hits == []) == corner_free
    (pose,) = world.plan('raycast', (-9, 0.6, 0), (9, 0.6, 0)).poses
    assert math.isclose(pose.pose.position.x, -0.8, abs_tol=1e-12)


def test_lists(clean):
    world, marker = clean
    points = [(0, 0, 0), (10, 0, 0), (20, 0, 0)]
    world.markers(marker(1, (0, 5, 0), type=CUBE_LIST, points=points))
    holds(world, 'a/1#0', 'a/1#1', 'a/1#2')
    assert world.names('raycast', (10, 5, -9), (10, 5, 9)) == ['a/1#1']
    world.markers(marker(1, type=SPHERE_LIST, points=points[:1]))  # shrinks
    holds(world, 'a/1#0')
    world.markers(marker(1))  # becomes a single marker
    holds(world, 'a/1')
    world.markers(marker(1, type=CUBE_LIST, points=points))  # and a list again
    holds(world, 'a/1#0', 'a/1#1', 'a/1#2')
    world.markers(marker(1, size=(1, math.nan, 1), type=CUBE_LIST))
    world.markers(marker(9, (0, 50, 0)))
    holds(world, 'a/1#0', 'a/1#1', 'a/1#2', 'a/9')  # a refused update keeps the old one
    world.markers(marker(1, action=DELETE))
    holds(world, 'a/9')
    world.markers(marker(1, type=CUBE_LIST, points=points), marker(0, action=DELETE_ALL))
    holds(world)


def test_order_within_one_message(clean):
    world, marker = clean
    world.markers(
        marker(1, (0, 0, 0)),
        marker(1, action=DELETE),
        marker(2, (1, 0, 0)),
        marker(0, ns='', action=DELETE_ALL),
        marker(3, (2, 0, 0)),
        marker(3, (3, 0, 0)),
    )
    holds(world, 'a/3')
    assert world.names('raycast', (3, 0, -9), (3, 0, 9)) == ['a/3']


def test_a_list_of_triangles_is_one_solid(clean):
    world, marker = clean
    corners = [(0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 0, 2)]
    faces = ((0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2))
    points = [corners[i] for face in faces for i in face]
    world.markers(marker(1, (20, 0, 0), type=TRIANGLE_LIST, points=points))
    holds(world, 'a/1')
    hit = world.plan('raycast', (20.5, 0.5, 9), (20.5, 0.5, -9)).poses[0]
    assert math.isclose(hit.pose.position.z, 1.0, abs_tol=1e-9)
    assert world.names('raycast', (21.2, 1.2, 9), (21.2, 1.2, -9)) == []  # in its box, beside it
    assert world.names('raycast', (21.2, 1.2, 9), (21.2, 1.2, -9), tolerance=0.5) == ['a/1']
    assert world.names('overlap', (20.1, 0.1, 0.1), (20.2, 0.2, 0.2)) == ['a/1']  # inside
    world.markers(marker(1, (20, 0, 0), type=TRIANGLE_LIST, points=points[:-3]))  # open: refused
    world.markers(marker(2, (9, 0, 0)))
    holds(world, 'a/1', 'a/2')
