# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings are played, paused, stepped and wound back, and a bag reads as the node reads it."""

import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros import scenarios
from bvh_ros.view.recorded import draw, open_recording

BALL_GOES = 9.0  # s


@pytest.fixture
def warehouse():
    """Paused, at its beginning."""
    recording = open_recording(None)
    recording.playing = False
    return recording


def test_the_world_at_any_time(warehouse):
    for t in (3.0, 12.0, 3.0, 0.0, 14.9):
        warehouse.seek(t)
        assert warehouse.scene.get('forklift/0').position[0] == pytest.approx(4.0 + t)
        assert ('ball/0' in warehouse.scene) == (t < BALL_GOES)
        assert warehouse.now() == round(t * 1e9)
        assert warehouse.frame.t == pytest.approx(t)


def test_steps_go_from_frame_to_frame_and_around(warehouse):
    versions = {warehouse.version()}
    for number in range(1, 150):
        warehouse.step()
        assert warehouse.t == pytest.approx(number / scenarios.RATE)
        versions.add(warehouse.version())
    assert len(versions) == 150
    warehouse.step()
    assert warehouse.t == 0.0
    assert not warehouse.playing


def test_it_plays_in_its_own_time_and_stands_when_paused(warehouse):
    warehouse.playing, warehouse.speed = True, 5.0
    began = time.monotonic()
    warehouse.advance(began)
    before = warehouse.t
    warehouse.advance(time.monotonic() + 0.2)
    passed = 5.0 * min(time.monotonic() - began, 0.5)
    assert 5.0 * 0.2 - 0.01 <= warehouse.t - before <= passed + 0.01
    warehouse.playing = False
    stands = warehouse.t
    warehouse.advance(time.monotonic() + 0.05)
    assert warehouse.t == stands


def test_recorded_traffic(shared_data):
    path = shared_data / 'commonroad_ngsim' / 'USA_Peach-4_8_T-1.csv'
    recording = open_recording(path)
    assert len(recording.scene) == len(recording.frame.things)
    assert all(name.startswith(('car/', 'truck/')) for _, name in recording.scene.names())


@pytest.fixture
def bag(tmp_path):
    """Two messages of markers: one that lives for a second, and one that moves."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2', reason='rosbags is not installed')
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with rosbag2.Writer(tmp_path / 'bag', version=9) as writer:
        kind = 'visualization_msgs/msg/MarkerArray'
        connection = writer.add_connection('/world', kind, typestore=store)
        for t, x in ((0, 1.0), (2, 5.0)):
            markers = [Marker(ns='moves', id=1, type=Marker.CUBE)]
            markers[0].pose.position.x = x
            if t == 0:
                markers.append(Marker(ns='dies', id=1, type=Marker.SPHERE))
                markers[1].lifetime.sec = 1
            for marker in markers:
                marker.header.frame_id = 'odom'
                marker.scale.x = marker.scale.y = marker.scale.z = 1.0
            message = serialize_message(MarkerArray(markers=markers))
            writer.write(connection, 1_000_000_000 * (5 + t), message)
    return tmp_path / 'bag'


def test_a_bag_is_read_as_the_node_reads_it(ros_context, bag):
    recording = open_recording(bag)
    try:
        recording.playing = False
        assert recording.frame_id == 'odom'
        assert {name for _, name in recording.scene.names()} == {'moves/1', 'dies/1'}
        recording.seek(1.5)  # lifetimes end by the recording's clock
        assert {name for _, name in recording.scene.names()} == {'moves/1'}
        recording.step()
        assert recording.scene.get('moves/1').position[0] == 5.0
        assert recording.t == pytest.approx(2.0)
        recording.seek(0.5)
        assert recording.scene.get('moves/1').position[0] == 1.0
        assert 'dies/1' in recording.scene
    finally:
        recording.close()


@pytest.mark.slow
@pytest.mark.parametrize('source', ['warehouse', 'bag'])
def test_a_still_shows_rays_and_hits(ros_context, pyplot, source, bag, tmp_path):
    draw(tmp_path / 'still.png', None if source == 'warehouse' else bag)
    seen = np.rint(255 * pyplot.imread(tmp_path / 'still.png')[..., :3]).astype(int)
    hit = np.abs(seen - (214, 94, 0)).max(axis=2) < 3
    assert hit.sum() > 30
