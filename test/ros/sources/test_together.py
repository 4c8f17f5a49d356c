# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small messages that come often: applied as one, and the node sleeps while they come."""

import math
import os
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

import rclpy
from geometry_msgs.msg import Point
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from ros.patience import PATIENCE
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.config.parameters import SourceSettings
from bvh_ros.ros.qos import DEPTH, Delivery
from bvh_ros.ros.sources import create_source, subscribing
from bvh_ros.ros.sources.subscribing import FollowingSubscription
from bvh_ros.ros.spinning import SturdyExecutor
from bvh_ros.ros.world.frames import Frames
from bvh_ros.scene import NodeScene

CUBE, SPHERE, CUBE_LIST, TRIANGLE_LIST, UNKNOWN = 1, 2, 6, 11, 99
ADD, DELETE, DELETE_ALL = 0, 2, 3
BROKEN = b'\x00\x01\x00\x00\x07\x00\x00\x00'  # seven markers, and no byte of them


@st.composite
def markers(draw):
    """Of few names, so that they undo each other; one in four cannot be used."""
    marker = Marker(ns=draw(st.sampled_from(['a', 'b', ''])), id=draw(st.integers(0, 2)))
    marker.action = draw(st.sampled_from([ADD, ADD, ADD, DELETE, DELETE_ALL]))
    marker.type = draw(st.sampled_from([CUBE, CUBE, SPHERE, CUBE_LIST, TRIANGLE_LIST, UNKNOWN]))
    marker.header.frame_id = draw(st.sampled_from(['map', 'map', 'map', 'mars']))
    marker.pose.position.x = draw(st.sampled_from([0.0, 1.0, 2.0, math.nan]))
    marker.pose.orientation.w = 1.0
    size = draw(st.sampled_from([1.0, 0.5, 2.0, -1.0]))
    marker.scale.x = marker.scale.y = marker.scale.z = size
    corners = [Point(x=1.0 * k, y=1.0 * (k == 1), z=1.0 * (k == 2)) for k in range(3)]
    marker.points = draw(st.sampled_from([[], corners[:1], corners, [Point(x=math.nan)]]))
    return marker


serialised = st.one_of(
    st.builds(
        lambda some: serialize_message(MarkerArray(markers=some)), st.lists(markers(), max_size=3)
    ),
    st.just(BROKEN),
)


def standing(source):
    """What a source's scene holds, by name."""
    held = [source.scene.get(name) for _, name in source.scene.names()]
    return {it.name: (it.kind, *it.position, *it.orientation, *it.size) for it in held}


@pytest.fixture(scope='module')
def node(ros_context):
    found = rclpy.create_node('together')
    yield found
    found.destroy_node()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.lists(serialised, min_size=1, max_size=6), max_size=4))
def test_several_messages_at_once_are_as_good_as_one_by_one(node, groups):
    options = {'predict': 'none', 'meshes': 'convex'}
    told = SourceSettings('s', 'MarkerArray', 't', '', False, 0.0, options)
    frames = Frames('map')
    alone, joined = (create_source(node, told, NodeScene(), frames) for _ in range(2))
    for group in groups:
        for message in group:
            alone.receive([message])
        joined.receive(group)
        for source in (alone, joined):
            source.finish()  # what took longer than a turn
        assert standing(joined) == standing(alone)
        assert joined.has_spoken == alone.has_spoken
    assert joined.messages == alone.messages


def test_a_busy_topic_wakes_nobody_and_is_heard_by_who_asks(ros_context, monkeypatch):
    monkeypatch.setattr(subscribing, 'TURN', math.inf)  # however long the machine pauses
    node = rclpy.create_node('busy')
    executor = SturdyExecutor()
    executor.add_node(node)
    heard, topic = [], f'busy_{os.getpid()}'
    subscription = FollowingSubscription(
        node, MarkerArray, topic, heard.extend, Delivery(together=True, raw=True)
    )
    publisher = node.create_publisher(MarkerArray, topic, QoSProfile(depth=DEPTH))
    sent = []

    def publish():
        marker = Marker(id=len(sent))
        sent.append(serialize_message(MarkerArray(markers=[marker])))
        publisher.publish(sent[-1])
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))

    def spin_until(condition):
        ends = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < ends
            executor.spin_once(0.001)

    spin_until(publisher.get_subscription_count)
    for _ in range(3):
        ends = time.monotonic() + PATIENCE
        while not executor.resting:
            assert time.monotonic() < ends
            publish()
            executor.spin_once(0)
        before = len(heard)
        publish()
        assert len(heard) == before
        subscription.catch_up()
        assert heard == sent
        spin_until(lambda: not executor.resting)  # nothing comes any more
        publish()
        spin_until(lambda: len(heard) == len(sent))
        assert heard == sent
    subscription.destroy()
    executor.remove_node(node)
    executor.shutdown()
    node.destroy_node()


def test_several_messages_read_as_one(messages):
    from bvh_ros.ros.cdr import marker_array

    many = [messages.marker(i, (i, 0, 0), ns=f'n{i // 2}') for i in range(7)]
    for marker in many[2:5]:
        marker.type = CUBE_LIST
        marker.points = [Point(x=1.0 * marker.id, y=2.0)] * marker.id
        marker.header.frame_id += 'x' * marker.id  # so that lengths differ
        marker.mesh_resource = f'file:///{marker.id}'
    parts = [many[:1], [], many[1:4], many[4:]]
    raws = [serialize_message(MarkerArray(markers=part)) for part in parts]
    whole = marker_array.read(serialize_message(MarkerArray(markers=many)))
    read = marker_array.read(*raws)
    for name, found, wanted in zip(whole._fields[:-3], read[:-3], whole[:-3], strict=True):
        assert np.array_equal(found, wanted), name
    for row in range(len(many)):
        assert np.array_equal(read.points(row), whole.points(row))
        assert np.array_equal(read.colours(row), whole.colours(row))
        assert read.resource(row) == many[row].mesh_resource
    with pytest.raises(ValueError, match='7 markers do not fit'):
        marker_array.read(raws[0], BROKEN, raws[2])


def test_what_came_before_a_clear_goes(world, messages, ros):
    node, _ = ros
    topic = f'{world.namespace}/bvh/obstacles'
    publisher = node.create_publisher(MarkerArray, topic, QoSProfile(depth=DEPTH))
    first = MarkerArray(markers=[messages.marker(0, (0, 0, 0))])

    def is_heard():
        publisher.publish(first)  # again: before both ends have found each other it is lost
        return world.everything() == {'a/0'}

    world.until(is_heard)
    for turn in range(20):
        for k in range(40):
            publisher.publish(MarkerArray(markers=[messages.marker(k, (k, turn, 0))]))
        world.trigger('clear')  # the same thread sends it, the same one there receives it
        assert world.everything() == set()
    node.destroy_publisher(publisher)
