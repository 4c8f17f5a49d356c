# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small messages that come often: applied as one, and the node sleeps while they come."""

import math

from geometry_msgs.msg import Point
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from ros.messages import marker, write
from ros.sources.changes import source_of
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.access import DEPTH, Frames
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
    write(marker.scale, [draw(st.sampled_from([1.0, 0.5, 2.0, -1.0]))] * 3)
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


@settings(max_examples=100, deadline=None)
@given(st.lists(st.lists(serialised, min_size=1, max_size=6), max_size=4))
def test_several_messages_at_once_are_as_good_as_one_by_one(groups):
    into_node = Frames('map').into_node
    alone, joined = (source_of(NodeScene(), into_node) for _ in range(2))
    for group in groups:
        for message in group:
            alone.receive([message])
        joined.receive(group)
        for source in (alone, joined):
            source.finish()  # what took longer than a turn
        assert standing(joined) == standing(alone)
        assert joined.has_spoken == alone.has_spoken
    assert joined.messages == alone.messages


def test_what_came_before_a_clear_goes(world, ros):
    node, _ = ros
    topic = f'{world.namespace}/bvh/obstacles'
    publisher = node.create_publisher(MarkerArray, topic, QoSProfile(depth=DEPTH))
    first = MarkerArray(markers=[marker(0, (0, 0, 0))])

    def is_heard():
        publisher.publish(first)  # again: before both ends have found each other it is lost
        return world.everything() == {'a/0'}

    world.until(is_heard)
    for turn in range(20):
        for k in range(40):
            publisher.publish(MarkerArray(markers=[marker(k, (k, turn, 0))]))
        world.trigger('clear')  # the same thread sends it, the same one there receives it
        assert world.everything() == set()
    node.destroy_publisher(publisher)
