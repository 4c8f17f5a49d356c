# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of a sensor_msgs/PointCloud2, its data left where they are.

rclpy would make a Python object of every field that a message announces, before anybody can ask
whether a cloud has so many: half a second and forty times the bytes for a megabyte of them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

from bvh_ros.ros.cdr import reading

MOST_FIELDS = 256


@dataclass(frozen=True)
class Field:
    """A sensor_msgs/PointField."""

    name: str
    offset: int
    datatype: int
    count: int


class PointCloud(NamedTuple):
    """What a PointCloud2 says; `data` is a view of the message."""

    frame_id: str
    stamp: int  # ns
    height: int
    width: int
    fields: list[Field]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview


class _Reader:
    """Goes through the body of a message; ValueError where that ends too early."""

    def __init__(self, message: bytes) -> None:
        body, self._order = reading.body_of(message)
        self._body = body.data
        self._at = 0

    def numbers(self, kinds: str, size: int) -> tuple[int, ...]:
        """Numbers of one size."""
        begin = self._at + -self._at % size
        self._at = begin + size * len(kinds)
        if self._at > len(self._body):
            raise ValueError(f'the cloud {reading.REASONS[reading.TRUNCATED]}')
        return struct.unpack_from(self._order + kinds, self._body, begin)

    def octets(self) -> memoryview:
        """A sequence of bytes."""
        (length,) = self.numbers('I', 4)
        begin, self._at = self._at, self._at + length
        if self._at > len(self._body):
            raise ValueError(f'the cloud {reading.REASONS[reading.TRUNCATED]}')
        return self._body[begin : self._at]

    def text(self) -> str:
        """A string, without the zero byte at its end."""
        octets = self.octets()
        if octets and octets[-1] != 0:
            raise ValueError(f'the cloud {reading.REASONS[reading.UNTERMINATED]}')
        return bytes(octets[:-1]).decode('utf-8', 'replace')


def read(message: bytes) -> PointCloud:
    """Read a serialised PointCloud2.

    Raises
    ------
    ValueError
        If it is not one, or announces more than MOST_FIELDS fields.
    """
    reader = _Reader(message)
    seconds, rest = reader.numbers('iI', 4)
    frame_id = reader.text()
    height, width, count = reader.numbers('III', 4)
    if count > MOST_FIELDS:
        raise ValueError(f'the cloud has {count} fields, more than {MOST_FIELDS}')
    fields = []
    for _ in range(count):
        name, (offset,) = reader.text(), reader.numbers('I', 4)
        (datatype,), (size,) = reader.numbers('B', 1), reader.numbers('I', 4)
        fields.append(Field(name, offset, datatype, size))
    (is_bigendian,) = reader.numbers('B', 1)
    point_step, row_step = reader.numbers('II', 4)
    data = reader.octets()
    reader.numbers('B', 1)  # is_dense
    return PointCloud(
        frame_id,
        seconds * 1_000_000_000 + rest,
        *(height, width, fields, bool(is_bigendian), point_step, row_step, data),
    )
