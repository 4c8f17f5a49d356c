# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds, grids, several sources, and sources that must have spoken."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros.simulation import REMAP, Simulation
from visualization_msgs.msg import MarkerArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture(scope='module')
def several(start_node):
    """A node with a source of each type, and two that share a topic's kind."""
    return start_node(
        {
            'sources': ['left', 'right', 'points', 'tracks', 'floor'],
            'left': {'type': 'MarkerArray', 'topic': 'left', 'prefix': 'left.'},
            'right': {'type': 'visualization_msgs/MarkerArray', 'topic': 'right'},
            'points': {'type': 'PointCloud2', 'topic': 'points', 'voxel': 0.5},
            'tracks': {'type': 'PointCloud2', 'topic': 'tracks'},
            'floor': {'type': 'OccupancyGrid', 'topic': 'floor', 'z_max': 3.0},
        }
    )


@pytest.fixture
def clean(several):
    several.trigger('clear')
    return several


def holds(world, *names):
    world.until(lambda: world.everything() == set(names))


def test_a_cloud_replaces_the_one_before(clean, messages):
    columns = {'x': [0, 10, math.nan], 'y': [0, 0, 0], 'z': [0, 0, 0]}
    clean.publish('points', messages.cloud(columns, kind='f4'))
    holds(clean, 'points#0', 'points#1')
    assert clean.names('raycast', (-9, 0.25, 0), (9, 0.25, 0)) == ['points#0']  # voxel 0.5
    assert clean.names('raycast', (-9, 0.26, 0), (9, 0.26, 0)) == []
    clean.publish('points', messages.cloud({'x': [5], 'y': [0], 'z': [0]}))
    holds(clean, 'points#0')
    lying = messages.cloud({'x': [5, 6], 'y': [0, 0], 'z': [0, 0]})
    lying.width = 3
    clean.publish('points', lying)
    clean.publish('left', MarkerArray(markers=[messages.marker(1)]))
    holds(clean, 'points#0', 'left.a/1')  # refused, the old one is kept
    clean.publish('points', messages.cloud({'x': [], 'y': [], 'z': []}))
    holds(clean, 'left.a/1')


def test_a_cloud_with_ids_updates_and_deletes(clean, messages):
    def tracks(ids, x, size):
        zero = [0] * len(ids)
        sizes = dict.fromkeys(('sx', 'sy', 'sz'), size)
        return messages.cloud({'x': x, 'y': zero, 'z': zero, **sizes, 'id': ids})

    clean.publish('tracks', tracks([7, 8], [0, 10], [1, 1]))
    holds(clean, 'tracks#7', 'tracks#8')
    clean.publish('tracks', tracks([8, 9], [20, 30], [1, 1]))
    holds(clean, 'tracks#7', 'tracks#8', 'tracks#9')
    assert clean.names('raycast_all', (0, 0, 0), (99, 0, 0)) == [
        'tracks#7',
        'tracks#8',
        'tracks#9',
    ]
    clean.publish('tracks', tracks([7, 9], [0, 31], [math.nan, 1]))
    holds(clean, 'tracks#8', 'tracks#9')


def test_a_grid_is_heard_by_late_joiners(clean):
    grid = OccupancyGrid()
    grid.info.width, grid.info.height, grid.info.resolution = 3, 2, 1.0
    grid.data = [0, 100, 100, -1, 100, 100]
    clean.publish('floor', grid, qos=LATCHED)
    holds(clean, 'floor#0')
    assert clean.names('raycast', (1.5, 1.5, 9), (1.5, 1.5, 2.9)) == ['floor#0']
    assert clean.names('raycast', (0.5, 0.5, 9), (0.5, 0.5, -9)) == []
    grid.data = [0] * 5
    clean.publish('floor', grid, qos=LATCHED)
    grid.data = [100, 0, 0, 0, 0, 100]
    clean.publish('floor', grid, qos=LATCHED)
    holds(clean, 'floor#0', 'floor#1')


def test_sources_do_not_touch_each_other(clean, messages):
    both = [messages.marker(1)]
    clean.publish('left', MarkerArray(markers=both))
    clean.publish('right', MarkerArray(markers=both))
    holds(clean, 'left.a/1', 'a/1')
    clean.publish('points', messages.cloud({'x': [5], 'y': [0], 'z': [0]}))
    holds(clean, 'left.a/1', 'a/1', 'points#0')
    clean.publish('left', MarkerArray(markers=[messages.marker(0, ns='', action=3)]))
    holds(clean, 'a/1', 'points#0')
    clean.publish('points', messages.cloud({'x': [], 'y': [], 'z': []}))
    holds(clean, 'a/1')


def test_the_same_name_from_a_second_source_is_refused(clean, messages):
    clean.publish('left', MarkerArray(markers=[messages.marker(1, ns='x')]))
    holds(clean, 'left.x/1')
    clean.publish('right', MarkerArray(markers=[messages.marker(1, (50, 0, 0), ns='left.x')]))
    clean.publish('right', MarkerArray(markers=[messages.marker(1, ns='y')]))
    holds(clean, 'left.x/1', 'y/1')
    assert clean.names('raycast', (50, 0, -9), (50, 0, 9)) == []
    assert "belongs to the source 'left'" in clean.said()


def test_best_effort_then_reliable(start_node, messages):
    world = start_node()
    world.publishers['bvh/obstacles'] = world.node.create_publisher(
        MarkerArray, f'{world.namespace}/bvh/obstacles', BEST_EFFORT
    )
    # Again and again: what is best effort may be lost.
    world.until(lambda: world.markers(messages.marker(1)) or world.everything() == {'a/1'})
    world.node.destroy_publisher(world.publishers.pop('bvh/obstacles'))

    def reliable_is_heard():
        world.markers(messages.marker(2))  # again: one may fall between the two subscriptions
        return world.everything() == {'a/1', 'a/2'}

    world.until(reliable_is_heard)


def test_required_and_max_age(start_node, messages):
    world = start_node(
        {
            'use_sim_time': True,
            'sources': ['markers', 'floor'],
            'markers': {'required': True, 'max_age': 0.5},
            'floor': {'type': 'OccupancyGrid', 'topic': 'floor', 'required': True},
        },
        remap=REMAP,
    )
    simulation = Simulation(world)
    simulation.at(100.0)

    def answer():
        return world.names('raycast', (0, 0, -9), (0, 0, 9))

    assert 'has not spoken' in answer()[0]
    world.markers(messages.marker(1))
    world.until(lambda: "'floor'" in answer()[0])
    grid = OccupancyGrid()
    grid.info.width = grid.info.height = 1
    grid.info.resolution = 1.0
    grid.data = [0]
    world.publish('floor', grid, qos=LATCHED)
    world.until(lambda: answer() == ['a/1'])
    simulation.at(100.4)
    assert answer() == ['a/1']
    simulation.at(100.6)
    assert 'max_age' in answer()[0]
    assert answer()[0].startswith('error: ')
    world.markers(messages.marker(1, (math.nan, 0, 0)))  # refused: has not spoken again
    world.until(lambda: world.status('source markers').values['refused'] == '1')
    assert answer()[0].startswith('error: ')
    # An empty message says: nothing new.
    world.markers()
    world.until(lambda: answer() == ['a/1'])
    world.trigger('clear')  # an emptied world is not a free one
    assert answer()[0].startswith('error: ')
    simulation.destroy()


@pytest.mark.slow
def test_planar(start_node, messages):
    world = start_node({'planar': True})
    world.markers(messages.marker(1, (5, 0, 100)), messages.marker(2, (5, 9, 0), type=3))
    world.until(lambda: world.everything() == {'a/1', 'a/2'})
    (pose,) = world.plan('raycast', (0, 0, 7), (9, 0, -50)).poses
    at = pose.pose.position
    assert (pose.header.frame_id, at.x, at.y, at.z) == ('a/1', 4.5, 0, 7)
    assert world.names('overlap', (4, -1, 0), (6, 1, 0)) == ['a/1']
    assert world.names('raycast', (0, 9.4, 0), (9, 9.4, 0)) == ['a/2']


@pytest.mark.slow
def test_more_than_max_obstacles_are_refused_and_the_rest_kept(start_node, messages):
    world = start_node({'max_obstacles': 3})
    world.markers(*(messages.marker(i, (2 * i, 0, 0)) for i in range(5)))
    world.until(lambda: len(world.everything()) == 3)
    assert 'full' in world.said()
    assert np.all([name in world.everything() for name in ('a/0', 'a/1', 'a/2')])
