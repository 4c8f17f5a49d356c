# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of messages hold what the messages do, and nothing is read beyond their bytes."""

import random

import numpy as np
import pytest
from geometry_msgs.msg import Point, PoseStamped, Transform, Twist, Vector3
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from ros.cdr.cdr_reference import encode
from shape_msgs.msg import SolidPrimitive
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.cdr.any_message import Columns, exercise, gather, plan_of, walk

numbers = st.floats(width=64)
texts = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=9)
vectors = st.builds(Vector3, x=numbers, y=numbers, z=numbers)
ways = st.builds(
    MultiDOFJointTrajectory,
    joint_names=st.lists(texts, max_size=3),
    points=st.lists(
        st.builds(
            MultiDOFJointTrajectoryPoint,
            transforms=st.lists(st.builds(Transform, translation=vectors), max_size=3),
            velocities=st.lists(st.builds(Twist, linear=vectors), max_size=3),
        ),
        max_size=4,
    ),
)
WAY = plan_of(
    MultiDOFJointTrajectory,
    ('joint_names', 'points.transforms', 'points.velocities', 'points.time_from_start'),
)


def values(*several):
    """Numbers of vectors and quaternions as rows."""
    return [getattr(each, axis) for each in several for axis in each.get_fields_and_field_types()]


@settings(max_examples=200, deadline=None)
@given(ways, st.booleans(), st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))
def test_loops_in_loops(way, big_endian, sec, nanosec):
    for point in way.points:
        point.time_from_start.sec, point.time_from_start.nanosec = sec, nanosec
    columns = Columns(encode(way, big_endian), WAY)
    assert columns.texts('joint_names.') == way.joint_names
    assert columns.counts('joint_names').tolist() == [len(way.joint_names)]
    given = [point.transforms for point in way.points]
    assert columns.counts('points.transforms').tolist() == [*map(len, given)]
    expected = [values(each.translation, each.rotation) for some in given for each in some]
    found = columns.numbers('points.transforms')
    np.testing.assert_array_equal(found, np.reshape(expected, (-1, 7)))
    expected = [values(v.linear, v.angular) for point in way.points for v in point.velocities]
    found = columns.numbers('points.velocities')
    np.testing.assert_array_equal(found, np.reshape(expected, (-1, 6)))
    stamps = columns.stamps('points.time_from_start')
    assert stamps.tolist() == [sec * 10**9 + nanosec] * len(way.points)


FIELDS = 'markers.header', 'markers.pose', 'markers.points', 'markers.ns', 'markers.type'
MARKERS = plan_of(MarkerArray, (*FIELDS, 'markers.mesh_file.data'))


def some_markers(count):
    markers = [Marker(ns=f'n{k}', type=k, text='x' * k) for k in range(count)]
    for k, marker in enumerate(markers):
        marker.header.frame_id, marker.pose.position.x = 'é' * k, 0.5 * k
        marker.points = [Point(x=float(i), y=float(k)) for i in range(k % 3)]
        marker.mesh_file.data = [*range(k % 5)]
    return MarkerArray(markers=markers)


@pytest.mark.parametrize('big_endian', [False, True])
def test_more_rows_than_there_is_room_for_at_first(big_endian):
    message = some_markers(200)
    columns = Columns(encode(message, big_endian), MARKERS)
    assert columns.texts('markers.ns') == [each.ns for each in message.markers]
    assert columns.texts('markers.header.frame_id') == ['é' * k for k in range(200)]
    assert columns.numbers('markers.type').tolist() == [[k] for k in range(200)]
    assert columns.numbers('markers.pose')[:, 0].tolist() == [0.5 * k for k in range(200)]
    expected = [[p.x, p.y, p.z] for each in message.markers for p in each.points]
    assert columns.numbers('markers.points').tolist() == expected
    assert columns.counts('markers.points').tolist() == [k % 3 for k in range(200)]
    data = columns.numbers('markers.mesh_file.data')[:, 0].tolist()
    assert data == [i for k in range(200) for i in range(k % 5)]


def test_a_sequence_with_a_bound_and_numbers_of_one_byte():
    plan = plan_of(SolidPrimitive, ('type', 'dimensions'))
    columns = Columns(serialize_message(SolidPrimitive(type=3, dimensions=[1.5, 2.5])), plan)
    assert columns.numbers('type').tolist() == [[3]]
    assert columns.numbers('dimensions').tolist() == [[1.5], [2.5]]


def test_every_message_that_is_cut_off_is_refused():
    whole = encode(some_markers(4))
    Columns(whole, MARKERS)
    for length in range(len(whole)):
        with pytest.raises(ValueError, match=r'beyond the end|too few'):
            Columns(whole[:length], MARKERS)


def test_lengths_that_lie_are_refused_or_read_within_the_message():
    rng, whole, refused = random.Random(3), encode(some_markers(9)), 0
    for _ in range(3000):
        data = bytearray(whole)
        for _ in range(rng.randrange(1, 3)):
            at = rng.randrange(4, len(data) - 4)
            data[at : at + 4] = rng.choice((b'\xff' * 4, b'\0\0\0\0', rng.randbytes(4)))
        try:
            columns = Columns(bytes(data), MARKERS)
        except ValueError:
            refused += 1
        else:
            assert columns.numbers('markers.points').nbytes < len(data)
    assert refused > 1000


def test_a_text_with_a_zero_inside_is_refused_where_it_is_wanted():
    message = PoseStamped()
    message.header.frame_id = 'abcd'
    plan, whole = plan_of(PoseStamped, ('header.frame_id',)), encode(message)
    assert Columns(whole, plan).texts('header.frame_id') == ['abcd']
    broken = whole.replace(b'abcd', b'ab\0d')
    with pytest.raises(ValueError, match=r"'header.frame_id' has a text with a zero byte inside"):
        Columns(broken, plan)
    Columns(broken, plan_of(PoseStamped, ('header.stamp',)))  # nobody will see it


def test_a_field_that_there_is_not_is_named():
    with pytest.raises(ValueError, match=r"PoseStamped is defined here without 'header.seq'"):
        plan_of(PoseStamped, ('header.seq',))


def test_the_kernels_are_compiled_once():
    """What a node compiles at its start is what every message needs."""
    exercise()
    for big_endian in (False, True):
        columns = Columns(encode(some_markers(2), big_endian), MARKERS)
        assert columns.numbers('markers.points').tolist() == [[0.0, 1.0, 0.0]]
    assert len(walk.signatures) == len(gather.signatures) == 1
