# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds, grids, several sources, and sources that must have spoken."""

import math

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros.messages import LATCHED, cloud, grid, marker
from ros.simulation import REMAP, Simulation
from visualization_msgs.msg import MarkerArray

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


def test_a_cloud_replaces_the_one_before(clean):
    def skipped():
        return int(clean.status('source points').values['points skipped'])

    before = skipped()
    columns = {'x': [0, 10, math.nan], 'y': [0, 0, 0], 'z': [0, 0, 0]}
    clean.publish('points', cloud(columns, kind='f4'))
    clean.holds('points#0', 'points#1')
    assert skipped() == before + 1
    assert clean.names('raycast', (-9, 0.25, 0), (9, 0.25, 0)) == ['points#0']  # voxel 0.5
    assert clean.names('raycast', (-9, 0.26, 0), (9, 0.26, 0)) == []
    clean.publish('points', cloud({'x': [5], 'y': [0], 'z': [0]}))
    clean.holds('points#0')
    lying = cloud({'x': [5, 6], 'y': [0, 0], 'z': [0, 0]})
    lying.width = 3
    clean.publish('points', lying)
    clean.publish('left', MarkerArray(markers=[marker(1)]))
    clean.holds('points#0', 'left.a/1')  # refused, the old one is kept
    clean.publish('points', cloud({'x': [], 'y': [], 'z': []}))
    clean.holds('left.a/1')


def test_a_cloud_with_ids_updates_and_deletes(clean):
    def tracks(ids, x, size):
        zero = [0] * len(ids)
        sizes = dict.fromkeys(('sx', 'sy', 'sz'), size)
        return cloud({'x': x, 'y': zero, 'z': zero, **sizes, 'id': ids})

    clean.publish('tracks', tracks([7, 8], [0, 10], [1, 1]))
    clean.holds('tracks#7', 'tracks#8')
    clean.publish('tracks', tracks([8, 9], [20, 30], [1, 1]))
    clean.holds('tracks#7', 'tracks#8', 'tracks#9')
    assert clean.names('raycast_all', (0, 0, 0), (99, 0, 0)) == [
        'tracks#7',
        'tracks#8',
        'tracks#9',
    ]
    clean.publish('tracks', tracks([7, 9], [0, 31], [math.nan, 1]))
    clean.holds('tracks#8', 'tracks#9')


def test_a_grid_is_heard_by_late_joiners(clean):
    clean.publish('floor', grid([[0, 100, 100], [-1, 100, 100]]), qos=LATCHED)
    clean.holds('floor#0')
    assert clean.names('raycast', (1.5, 1.5, 9), (1.5, 1.5, 2.9)) == ['floor#0']
    assert clean.names('raycast', (0.5, 0.5, 9), (0.5, 0.5, -9)) == []
    lying = grid([[0] * 5])
    lying.info.width = 3
    clean.publish('floor', lying, qos=LATCHED)
    clean.publish('floor', grid([[100, 0, 0], [0, 0, 100]]), qos=LATCHED)
    clean.holds('floor#0', 'floor#1')


def test_sources_do_not_touch_each_other(clean):
    both = [marker(1)]
    clean.publish('left', MarkerArray(markers=both))
    clean.publish('right', MarkerArray(markers=both))
    clean.holds('left.a/1', 'a/1')
    clean.publish('points', cloud({'x': [5], 'y': [0], 'z': [0]}))
    clean.holds('left.a/1', 'a/1', 'points#0')
    clean.publish('left', MarkerArray(markers=[marker(0, ns='', action=3)]))
    clean.holds('a/1', 'points#0')
    clean.publish('points', cloud({'x': [], 'y': [], 'z': []}))
    clean.holds('a/1')


def test_the_same_name_from_a_second_source_is_refused(clean):
    clean.publish('left', MarkerArray(markers=[marker(1, ns='x')]))
    clean.holds('left.x/1')
    clean.publish('right', MarkerArray(markers=[marker(1, (50, 0, 0), ns='left.x')]))
    clean.publish('right', MarkerArray(markers=[marker(1, ns='y')]))
    clean.holds('left.x/1', 'y/1')
    assert clean.names('raycast', (50, 0, -9), (50, 0, 9)) == []
    assert "belongs to the source 'left'" in clean.said()


def test_best_effort_then_reliable(start_node):
    world = start_node()
    world.publishers['bvh/obstacles'] = world.node.create_publisher(
        MarkerArray, f'{world.namespace}/bvh/obstacles', BEST_EFFORT
    )
    # Again and again: what is best effort may be lost.
    world.until(lambda: world.markers(marker(1)) or world.everything() == {'a/1'})
    world.node.destroy_publisher(world.publishers.pop('bvh/obstacles'))

    def reliable_is_heard():
        world.markers(marker(2))  # again: one may fall between the two subscriptions
        return world.everything() == {'a/1', 'a/2'}

    world.until(reliable_is_heard)


def test_required_and_max_age(start_node):
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
    world.markers(marker(1))
    world.until(lambda: "'floor'" in answer()[0])
    world.publish('floor', grid([[0]]), qos=LATCHED)
    world.until(lambda: answer() == ['a/1'])
    simulation.at(100.4)
    assert answer() == ['a/1']
    simulation.at(100.6)
    assert 'max_age' in answer()[0]
    assert answer()[0].startswith('error: ')
    world.markers(marker(1, (math.nan, 0, 0)))  # refused: has not spoken again
    world.until(lambda: world.status('source markers').values['refused'] == '1')
    assert answer()[0].startswith('error: ')
    # An empty message says: nothing new.
    world.markers()
    world.until(lambda: answer() == ['a/1'])
    world.trigger('clear')  # an emptied world is not a free one
    assert answer()[0].startswith('error: ')
    simulation.destroy()
