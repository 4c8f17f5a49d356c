# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The decoder of MarkerArrays reads what rclpy reads, and nothing beyond the message."""

import contextlib
import math
import os
import struct

import numpy as np
import pytest
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Path
from rclpy.serialization import deserialize_message, serialize_message
from ros.cdr.cdr_reference import encode, offsets
from ros.messages import coordinates, marker, write, xyz
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray, UVCoordinate

from bvh_ros.ros.cdr import definitions, marker_array, path, reading
from bvh_ros.ros.conversions import nanoseconds
from bvh_ros.ros.sources.marker_array import MarkerTable

LONG = os.environ.get('BVH_ROS_LONG_TESTS') == '1'
int32 = st.integers(-(2**31), 2**31 - 1)
number = st.floats(width=64)
texts = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=9)
bytes_ = st.binary(max_size=7).map(list)
colours = st.builds(ColorRGBA, r=st.floats(0, 1, width=32))
times = {'sec': int32, 'nanosec': st.integers(0, 2**32 - 1)}


@st.composite
def markers(draw):
    """A marker with every field that has a size of its own filled at random."""
    found = draw(
        st.builds(
            Marker,
            ns=texts,
            id=int32,
            type=st.integers(-1, 13),
            action=st.integers(-1, 4),
            frame_locked=st.booleans(),
            lifetime=st.builds(Duration, **times),
            points=st.lists(st.builds(Point, x=number, y=number, z=number), max_size=3),
            colors=st.lists(colours, max_size=3),
            texture_resource=texts,
            uv_coordinates=st.lists(st.builds(UVCoordinate), max_size=3),
            text=texts,
            mesh_resource=texts,
        )
    )
    found.header.frame_id, found.header.stamp = draw(texts), draw(st.builds(Time, **times))
    found.texture.header.frame_id, found.texture.format = draw(texts), draw(texts)
    found.texture.data, found.mesh_file.data = draw(bytes_), draw(bytes_)
    found.mesh_file.filename = draw(texts)
    for part, count in ((found.pose.position, 3), (found.scale, 3), (found.pose.orientation, 4)):
        write(part, [draw(number) for _ in range(count)])
    return found


arrays = st.builds(MarkerArray, markers=st.lists(markers(), max_size=5))


def table(markers):
    """The columns of visualization_msgs/Marker objects."""
    namespaces, frame_ids = {}, {}
    numbers = np.empty((7, len(markers)), np.int64)
    places = np.empty((len(markers), 10))
    for row, each in enumerate(markers):
        parts = each.pose.position, each.pose.orientation, each.scale
        places[row] = [number for part in parts for number in coordinates(part)]
        numbers[:, row] = (
            namespaces.setdefault(each.ns, len(namespaces)),
            frame_ids.setdefault(each.header.frame_id, len(frame_ids)),
            nanoseconds(each.header.stamp),
            *(each.id, each.type, each.action),
            nanoseconds(each.lifetime),
        )
    namespace, frame, stamp, number, kind, action, lifetime = numbers

    def colours(row):
        return np.reshape([coordinates(colour) for colour in markers[row].colors], (-1, 4))

    return MarkerTable(
        *(list(namespaces), namespace, list(frame_ids), frame),
        *(stamp, number, kind, action),
        *(places[:, :3], places[:, 3:7], places[:, 7:], lifetime),
        *(lambda row: xyz(markers[row].points), lambda row: markers[row].mesh_resource, colours),
    )


def assert_same(read, by_rclpy):
    for name, found, wanted in zip(read._fields[:-3], read[:-3], by_rclpy[:-3], strict=True):
        if isinstance(wanted, list):
            assert found == wanted, name
        else:
            assert found.dtype == wanted.dtype, name
            np.testing.assert_array_equal(found, wanted, name)
    for row in range(len(by_rclpy.id)):
        assert np.array_equal(read.points(row), by_rclpy.points(row), equal_nan=True)
        assert np.array_equal(read.colours(row), by_rclpy.colours(row), equal_nan=True)
        assert read.resource(row) == by_rclpy.resource(row)


@settings(max_examples=2000 if LONG else 150)
@given(arrays)
def test_a_message_reads_as_rclpy_reads_it(message):
    raw = serialize_message(message)
    expected = deserialize_message(raw, MarkerArray)
    # So the reference encodes well; padding is whatever was in memory, NaN is not itself.
    assert repr(deserialize_message(encode(message), MarkerArray)) == repr(expected)
    for read in (marker_array.read(raw), marker_array.read(encode(message, big_endian=True))):
        assert_same(read, table(expected.markers))


def typical(count=3):
    """Markers in which every string and sequence has something in it."""
    found = []
    for k in range(count):
        marker = Marker(ns=f'ns{k // 2}', id=k, type=6, texture_resource='t', text='x')
        marker.header.frame_id = 'map'
        marker.points = [Point(x=1.0 * k), Point(y=2.0)]
        marker.colors = [ColorRGBA()]
        marker.uv_coordinates = [UVCoordinate()]
        marker.texture.header.frame_id, marker.texture.format = 'f', 'png'
        marker.texture.data, marker.mesh_file.data = [1, 2, 3], [4]
        marker.mesh_resource, marker.mesh_file.filename = 'm', 'n'
        found.append(marker)
    return MarkerArray(markers=found)


def test_several_messages_read_as_one():
    many = [marker(i, (i, 0, 0), ns=f'n{i // 2}') for i in range(7)]
    for k in (2, 3, 4):  # their lengths differ
        given = {'points': [(k, 2, 0)] * k, 'frame': 'map' + 'x' * k, 'mesh': f'file:///{k}'}
        many[k] = marker(k, (k, 0, 0), ns=f'n{k // 2}', type=Marker.CUBE_LIST, **given)
    parts = [many[:1], [], many[1:4], many[4:]]
    raws = [serialize_message(MarkerArray(markers=part)) for part in parts]
    assert_same(marker_array.read(*raws), table(many))
    broken = b'\x00\x01\x00\x00\x07\x00\x00\x00'  # seven markers, and no byte of them
    with pytest.raises(ValueError, match='7 markers do not fit'):
        marker_array.read(raws[0], broken, raws[2])


def reason(message):
    """Why a message is refused; empty if it is not."""
    try:
        marker_array.read(message)
    except ValueError as error:
        return str(error)
    return ''


def test_every_truncated_message_is_refused():
    raw = serialize_message(typical())
    end = len(encode(typical()))
    marker_array.read(raw[:end])
    for size in range(end):
        assert reason(raw[:size])


@pytest.mark.parametrize('lie', [2**32 - 1, 2**31, 2**31 - 1, 2**24, 10_000])
def test_every_length_that_lies_is_refused(lie):
    message = typical()
    raw = serialize_message(message)
    lengths = offsets(message, 'visualization_msgs/MarkerArray')
    assert len(lengths) == 1 + 3 * 13
    for field, place in lengths:
        lying = raw[:place] + struct.pack('<I', lie) + raw[place + 4 :]
        assert 'marker' in reason(lying), field


def test_strings_must_end_with_their_only_zero_byte():
    message = typical()
    raw = serialize_message(message)
    for field, place in offsets(message, 'visualization_msgs/MarkerArray'):
        (length,) = struct.unpack_from('<I', raw, place)
        kind = field.rpartition('.')[2]
        if kind in ('markers', 'points', 'colors', 'uv_coordinates', 'data'):
            continue
        end = place + 4 + length
        assert 'without the zero byte' in reason(raw[: end - 1] + b'!' + raw[end:]), field
        if kind == 'ns':
            assert 'zero byte inside' in reason(raw[: end - 2] + b'\0' + raw[end - 1 :]), field


@pytest.mark.parametrize('header', ['0002', '0003', '0007', '0009', '0101', 'ffff'])
def test_another_encoding_is_refused(header):
    with pytest.raises(ValueError, match=f'0x{header}'):
        marker_array.read(bytes.fromhex(header) + b'\0\0' + bytes(4))


def test_names_that_are_strange_but_legal():
    message = typical(4)
    names = ['', 'x' * 2**20, 'ß€𝄞', 'error: x']
    for one, name in zip(message.markers, names, strict=True):
        one.ns, one.scale.x = name, math.nan
    assert marker_array.read(serialize_message(message)).namespaces == names
    broken = serialize_message(message).replace('ß'.encode(), b'\xff\xfe')
    expected = deserialize_message(broken, MarkerArray)
    assert marker_array.read(broken).namespaces == [one.ns for one in expected.markers]


def mutated(raw, random):
    """A few bytes changed, cut or moved; numbers are often those that lengths lie with."""
    data = bytearray(raw)
    for _ in range(random.integers(1, 4)):
        place = int(random.integers(0, len(data)))
        choice = random.integers(0, 5)
        if choice == 0:
            data[place] = random.integers(0, 256)
        elif choice == 1:
            number = random.choice([0, 1, 2**31, 2**32 - 1, 2**16, 2**29 + 1])
            struct.pack_into('<I', data, min(place & ~3, len(data) - 4), int(number))
        elif choice == 2 and len(data) > 8:
            del data[place:]
            data += bytes(max(0, 8 - len(data)))
        elif choice == 3:
            del data[place : place + int(random.integers(1, 9))]
            data += bytes(max(0, 8 - len(data)))
        else:
            data[1] ^= 1  # the other byte order
    return bytes(data)


def outcome(message):
    """What the decoder says of a message, as something to compare."""
    try:
        found = marker_array.read(message)
    except ValueError as error:
        return str(error)
    lists = [
        given(row).tobytes()
        for row in range(len(found.id))
        for given in (found.points, found.colours)
    ]
    lists += [found.resource(row) for row in range(len(found.id))]
    return [part if isinstance(part, list) else part.tobytes() for part in found[:-3]] + lists


def test_mutated_messages_are_read_or_refused_and_nothing_beyond_them():
    """The kernel sees the message inside a larger array whose rest must not matter."""
    random = np.random.default_rng(20)
    raws = [serialize_message(typical(count)) for count in (0, 1, 3)]
    raws += [encode(typical(2), big_endian=True)]
    refused = 0
    body_of = reading.body_of
    with pytest.MonkeyPatch.context() as patch:
        for _ in range(1_000_000 if LONG else 20_000):
            message = mutated(raws[random.integers(0, len(raws))], random)
            outcomes = []
            for poison in (0x00, 0xFF):
                inside = np.frombuffer(message + bytes([poison]) * 64, np.uint8)

                def poisoned(given, inside=inside):
                    body, order = body_of(given)
                    return inside[4 : 4 + len(body)], order

                patch.setattr(reading, 'body_of', poisoned)
                outcomes.append(outcome(message))
            assert outcomes[0] == outcomes[1], message.hex()
            refused += isinstance(outcomes[0], str)
    assert refused > 1000


def test_the_definition_is_compared_field_by_field(monkeypatch):
    expected = marker_array.DEFINITION
    assert definitions.difference(MarkerArray, expected) == ''
    newer = {**Marker.get_fields_and_field_types(), 'weight': 'double'}
    monkeypatch.setattr(Marker, 'get_fields_and_field_types', classmethod(lambda cls: newer))
    assert definitions.difference(MarkerArray, expected) == 'visualization_msgs/Marker'
    turned = dict(reversed(Point.get_fields_and_field_types().items()))
    monkeypatch.undo()
    monkeypatch.setattr(Point, 'get_fields_and_field_types', classmethod(lambda cls: turned))
    assert definitions.difference(MarkerArray, expected) == 'geometry_msgs/Point'


@st.composite
def paths(draw):
    """A path whose poses name its own frame, another one or none."""
    found = Path()
    found.header.frame_id, found.header.stamp = draw(texts), draw(st.builds(Time, **times))
    for _ in range(draw(st.integers(0, 4))):
        stamped = PoseStamped()
        stamped.header.frame_id = draw(st.sampled_from(['', 'other', found.header.frame_id]))
        stamped.header.stamp = draw(st.builds(Time, **times))
        for part, count in ((stamped.pose.position, 3), (stamped.pose.orientation, 4)):
            write(part, [draw(number) for _ in range(count)])
        found.poses.append(stamped)
    return found


@given(paths(), st.data())
@settings(max_examples=500 if LONG else 60, deadline=None)
def test_paths_are_read_as_rclpy_reads_them(message, data):
    serialised = serialize_message(message)
    found, own = path.read(serialised), message.header.frame_id
    poses = [stamped.pose for stamped in message.poses]
    frames = [stamped.header.frame_id for stamped in message.poses]
    stamps = [nanoseconds(stamped.header.stamp) for stamped in message.poses]
    elsewhere = [frame not in ('', own) for frame in frames]
    assert (found.frame_id, found.stamp) == (own, nanoseconds(message.header.stamp))
    assert (found.stamps.tolist(), found.elsewhere.tolist()) == (stamps, elsewhere)
    places = [coordinates(pose.position) for pose in poses]
    turns = [coordinates(pose.orientation) for pose in poses]
    np.testing.assert_array_equal(found.positions, np.reshape(places, (-1, 3)))
    np.testing.assert_array_equal(found.orientations, np.reshape(turns, (-1, 4)))
    cut = data.draw(st.integers(0, len(serialised) - 4))
    if poses:
        with pytest.raises(ValueError, match=r'path|pose|bytes'):
            path.read(serialised[:cut])
    flipped = bytearray(serialised)
    flipped[data.draw(st.integers(0, len(flipped) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    with contextlib.suppress(ValueError):  # it may be another path, but nothing else is raised
        path.read(bytes(flipped))


def test_a_path_that_announces_poses_it_has_not_takes_no_memory():
    begin = path.EMPTY[:4] + bytes(12)
    with pytest.raises(ValueError, match='4294967295 poses do not fit'):
        path.read(begin + b'\xff' * 4 + bytes(1000))
