# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of a visualization_msgs/MarkerArray as columns, one row a marker."""

from __future__ import annotations

import functools
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.cdr import reading
from bvh_ros.ros.cdr.reading import (
    TRUNCATED,
    aligned,
    same_bytes,
    sequence,
    skip,
    text,
    visible_text,
    whole_number,
)
from bvh_ros.tree.compiler import inlined, lean_kernel

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


class MarkerTable(NamedTuple):
    """n markers, one a row."""

    namespaces: list[str]  # the different ones, and for each row which of them
    namespace: Integers
    frame_ids: list[str]
    frame: Integers
    stamp: Integers  # (n,) ns
    id: Integers
    type: Integers
    action: Integers
    position: Floats  # (n, 3)
    orientation: Floats  # (n, 4) quaternions x, y, z, w
    scale: Floats  # (n, 3)
    lifetime: Integers  # (n,) ns
    points: Callable[[int], Floats]  # of a row, (k, 3)
    resource: Callable[[int], str]  # of a row, the URI of its mesh
    colours: Callable[[int], Floats]  # of a row's points, (k, 4), or none


# The definition that is decoded here, as the Python classes tell it; see `definitions.py`.
DEFINITION = {
    'visualization_msgs/MarkerArray': {'markers': 'sequence<visualization_msgs/Marker>'},
    'visualization_msgs/Marker': {
        'header': 'std_msgs/Header',
        'ns': 'string',
        'id': 'int32',
        'type': 'int32',
        'action': 'int32',
        'pose': 'geometry_msgs/Pose',
        'scale': 'geometry_msgs/Vector3',
        'color': 'std_msgs/ColorRGBA',
        'lifetime': 'builtin_interfaces/Duration',
        'frame_locked': 'boolean',
        'points': 'sequence<geometry_msgs/Point>',
        'colors': 'sequence<std_msgs/ColorRGBA>',
        'texture_resource': 'string',
        'texture': 'sensor_msgs/CompressedImage',
        'uv_coordinates': 'sequence<visualization_msgs/UVCoordinate>',
        'text': 'string',
        'mesh_resource': 'string',
        'mesh_file': 'visualization_msgs/MeshFile',
        'mesh_use_embedded_materials': 'boolean',
    },
    'std_msgs/Header': {'stamp': 'builtin_interfaces/Time', 'frame_id': 'string'},
    'builtin_interfaces/Time': {'sec': 'int32', 'nanosec': 'uint32'},
    'builtin_interfaces/Duration': {'sec': 'int32', 'nanosec': 'uint32'},
    'geometry_msgs/Pose': {
        'position': 'geometry_msgs/Point',
        'orientation': 'geometry_msgs/Quaternion',
    },
    'geometry_msgs/Point': dict.fromkeys('xyz', 'double'),
    'geometry_msgs/Quaternion': dict.fromkeys('xyzw', 'double'),
    'geometry_msgs/Vector3': dict.fromkeys('xyz', 'double'),
    'std_msgs/ColorRGBA': dict.fromkeys('rgba', 'float'),
    'sensor_msgs/CompressedImage': {
        'header': 'std_msgs/Header',
        'format': 'string',
        'data': 'sequence<uint8>',
    },
    'visualization_msgs/UVCoordinate': {'u': 'float', 'v': 'float'},
    'visualization_msgs/MeshFile': {'filename': 'string', 'data': 'sequence<uint8>'},
}

# What every marker has, as it stands in the message: sizes in bytes of the pieces that are copied.
STAMP, NUMBERS, PLACES, LIFETIME = 8, 12, 80, 8
COLOUR, POINT, UV = 16, 24, 8
FIXED_SIZE = STAMP + NUMBERS + PLACES + LIFETIME
# No marker is shorter: all of this, a colour, two flags, a second stamp and thirteen lengths.
SMALLEST = FIXED_SIZE + COLOUR + 2 + STAMP + 13 * 4

EMPTY = b'\0\1\0\0' + bytes(4)  # a message without markers

# Columns of the places that the kernel notes for each marker.
FRAME, FRAME_LENGTH, NEW_FRAME, SPACE, SPACE_LENGTH, NEW_SPACE, POINTS, POINT_COUNT = range(8)
RESOURCE, RESOURCE_LENGTH, COLUMNS = 8, 9, 10


@inlined
def _copy(data, begin, size, row, at):
    for place in range(size):
        row[at + place] = data[begin + place]


@inlined
def _read_text(data, at, big_endian, row, column, before):
    """Note where a text is, and whether it differs from the one of the marker before."""
    begin, length, end = visible_text(data, at, big_endian)
    differs = before[column + 1] != length or not same_bytes(data, before[column], begin, length)
    row[column], row[column + 1], row[column + 2] = begin, length, differs
    return end


@inlined
def _skip_texture(data, at, big_endian):
    """A CompressedImage: header, format and data."""
    at = skip(data, at, STAMP, 4)
    for _ in range(2):
        if at >= 0:
            at = text(data, at, big_endian)[2]
    return sequence(data, at, 1, 1, big_endian)[2] if at >= 0 else at


@inlined
def _skip_rest(data, at, big_endian, row):
    """Skip what comes after the points, but note where the mesh_resource is."""
    at = sequence(data, at, COLOUR, 4, big_endian)[2]
    at = text(data, at, big_endian)[2] if at >= 0 else at
    at = _skip_texture(data, at, big_endian) if at >= 0 else at
    at = sequence(data, at, UV, 4, big_endian)[2] if at >= 0 else at
    at = text(data, at, big_endian)[2] if at >= 0 else at
    if at >= 0:
        row[RESOURCE], row[RESOURCE_LENGTH], at = text(data, at, big_endian)
    at = text(data, at, big_endian)[2] if at >= 0 else at  # the mesh file's name
    at = sequence(data, at, 1, 1, big_endian)[2] if at >= 0 else at
    return skip(data, at, 1, 1) if at >= 0 else at


@inlined
def _read_fixed(data, at, row):
    """Copy what has one size, from the id to the lifetime; skip the flag after it."""
    begin = aligned(at, 4)
    places = aligned(begin + NUMBERS, 8)
    lifetime = places + PLACES + COLOUR
    end = lifetime + LIFETIME + 1
    if end > data.shape[0]:
        return TRUNCATED
    _copy(data, begin, NUMBERS, row, STAMP)
    _copy(data, places, PLACES, row, STAMP + NUMBERS)
    _copy(data, lifetime, LIFETIME, row, STAMP + NUMBERS + PLACES)
    return end


@lean_kernel
def read_markers(data, big_endian, fixed, places):
    """Read as many markers as there are rows; return where they end, or why they cannot be read
    and the number of the marker.
    """
    at = 4  # after the count
    for number in range(fixed.shape[0]):
        row = places[number]
        before = places[max(number - 1, 0)]
        end = skip(data, at, STAMP, 4)
        if end >= 0:
            _copy(data, end - STAMP, STAMP, fixed[number], 0)
            end = _read_text(data, end, big_endian, row, FRAME, before)
        if end >= 0:
            end = _read_text(data, end, big_endian, row, SPACE, before)
        if end >= 0:
            end = _read_fixed(data, end, fixed[number])
        if end >= 0:
            row[POINTS], row[POINT_COUNT], end = sequence(data, end, POINT, 8, big_endian)
        if end >= 0:
            end = _skip_rest(data, end, big_endian, row)
        if end < 0:
            return end, number
        at = end
    return at, fixed.shape[0]


def read(*messages: bytes) -> MarkerTable:
    """Read a serialised MarkerArray, or several as if they were one.

    Raises
    ------
    ValueError
        If one is none, as a whole: truncated, or with lengths that contradict its size. If several
        differ in their byte order.
    """
    bodies, orders = zip(*map(reading.body_of, messages), strict=True)
    order = orders[0]
    if orders.count(order) < len(orders):
        raise ValueError('of the messages, some have the other byte order')
    big_endian = order == '>'
    counts = [_count(data, big_endian) for data in bodies]
    fixed = np.empty((sum(counts), FIXED_SIZE), np.uint8)
    places = np.zeros((sum(counts), COLUMNS), np.int64)
    row = at = 0
    for data, count in zip(bodies, counts, strict=True):
        own = places[row : row + count]
        if count:
            own[0, [FRAME_LENGTH, SPACE_LENGTH]] = -1  # the first differs from what was before
        end, number = read_markers(data, big_endian, fixed[row : row + count], own)
        if end < 0:
            raise ValueError(f'marker {number} of {count} {reading.REASONS[end]}')
        if at:
            own[:, [FRAME, SPACE, POINTS, RESOURCE]] += at
        row, at = row + count, at + len(data)
    data = bodies[0] if len(bodies) == 1 else np.concatenate(bodies)
    return _table(data, order, fixed, places)


def _count(data: NDArray[np.uint8], big_endian: bool) -> int:
    """How many markers a body holds."""
    size = len(data) + reading.HEADER_SIZE
    if len(data) < 4:
        raise ValueError(f'the message has {size} bytes and no number of markers')
    count = int(whole_number(data, 0, big_endian))
    if count * SMALLEST > len(data):  # before anything is allocated
        raise ValueError(f'{count} markers do not fit in a message of {size} bytes')
    return count


def _table(
    data: NDArray[np.uint8], order: str, fixed: NDArray[np.uint8], places: Integers
) -> MarkerTable:
    columns = fixed.view(_fixed_type(order))[:, 0]
    frame_ids, frame = _texts(data, *places[:, FRAME : NEW_FRAME + 1].T)
    namespaces, namespace = _texts(data, *places[:, SPACE : NEW_SPACE + 1].T)
    return MarkerTable(
        namespaces=namespaces,
        namespace=namespace,
        frame_ids=frame_ids,
        frame=frame,
        stamp=reading.nanoseconds(columns['stamp']),
        id=columns['id'].astype(np.int64),
        type=columns['type'].astype(np.int64),
        action=columns['action'].astype(np.int64),
        position=columns['position'].astype(np.float64),
        orientation=columns['orientation'].astype(np.float64),
        scale=columns['scale'].astype(np.float64),
        lifetime=reading.nanoseconds(columns['lifetime']),
        points=partial(_points, data, order, places),
        resource=partial(_resource, data, places),
        colours=partial(_colours, data, order, places),
    )


@functools.cache
def _fixed_type(order: str) -> np.dtype[np.void]:
    time = reading.time_type(order)
    numbers = [(name, f'{order}i4') for name in ('id', 'type', 'action')]
    vectors = [('position', 3), ('orientation', 4), ('scale', 3)]
    placed = [(name, f'{order}f8', (size,)) for name, size in vectors]
    return np.dtype([('stamp', time), *numbers, *placed, ('lifetime', time)])


def _texts(
    data: NDArray[np.uint8], begin: Integers, length: Integers, new: Integers
) -> tuple[list[str], Integers]:
    """The different texts, and which of them each row has. Runs of one text are read once."""
    numbers: dict[str, int] = {}
    rows = np.flatnonzero(new)
    of_run = np.empty(len(rows), np.int64)
    spans = zip(begin[rows].tolist(), length[rows].tolist(), strict=True)
    for run, (start, size) in enumerate(spans):
        written = data[start : start + size].tobytes().decode('utf-8', 'replace')  # as rclpy does
        of_run[run] = numbers.setdefault(written, len(numbers))
    return list(numbers), of_run[np.cumsum(new) - 1]


def _points(data: NDArray[np.uint8], order: str, places: Integers, row: int) -> Floats:
    begin, count = places[row, [POINTS, POINT_COUNT]].tolist()
    found = np.frombuffer(data, f'{order}f8', 3 * count, begin)
    return found.astype(np.float64).reshape(-1, 3)


def _resource(data: NDArray[np.uint8], places: Integers, row: int) -> str:
    begin, length = places[row, [RESOURCE, RESOURCE_LENGTH]].tolist()
    return data[begin : begin + length].tobytes().decode('utf-8', 'replace')


def _colours(data: NDArray[np.uint8], order: str, places: Integers, row: int) -> Floats:
    begin, count = places[row, [POINTS, POINT_COUNT]].tolist()
    at = begin + count * POINT  # a multiple of four: what is next is the number of colours
    count = int(np.frombuffer(data, f'{order}u4', 1, at)[0])
    found = np.frombuffer(data, f'{order}f4', 4 * count, at + 4)
    return found.astype(np.float64).reshape(-1, 4)
