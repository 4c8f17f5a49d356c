# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of a sensor_msgs/PointCloud2, its data left where they are.

rclpy would make a Python object of every field that a message announces, before anybody can ask
whether a cloud has so many: half a second and forty times the bytes for a megabyte of them.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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


# ---- The bytes of a PointCloud2 as named columns, and what is wrong with a cloud that lies


# sensor_msgs/msg/PointField datatypes
DATATYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}


def structured(cloud: Any, wanted: Collection[str]) -> NDArray[np.void]:
    """Return the cloud's rows as a structured view of its bytes, shape (height, width).

    Parameters
    ----------
    cloud : sensor_msgs/PointCloud2
        Of either byte order, with gaps wherever it likes.
    wanted : collection of str
        The fields to read; others are left alone, whatever they are.

    Raises
    ------
    ValueError
        If sizes, steps and data disagree, or a field lies outside its point.
    """
    width, height, point_step, row_step = (
        cloud.width,
        cloud.height,
        cloud.point_step,
        cloud.row_step,
    )
    dtype = _row_type(cloud.fields, wanted, point_step, '>' if cloud.is_bigendian else '<')
    length = len(cloud.data)
    if width * height == 0:
        if length:
            raise ValueError(
                f'a cloud of {width} x {height} points carries {length} bytes of data'
            )
        return np.empty((height, width), dtype)
    if not point_step:  # else no number of points would be too many
        raise ValueError(f'point_step is 0 for {width} x {height} points')
    if row_step < width * point_step:
        raise ValueError(
            f'row_step {row_step} is less than width * point_step = {width * point_step}'
        )
    if length != row_step * height:
        raise ValueError(
            f'data has {length} bytes, row_step * height = {row_step} * {height} '
            f'promises {row_step * height}'
        )
    return np.ndarray((height, width), dtype, buffer=cloud.data, strides=(row_step, point_step))


def columns(points: NDArray[np.void], names: Sequence[str]) -> NDArray[np.float64]:
    """Return the named fields as an (n, len(names)) float64 array."""
    table = np.empty((points.size, len(names)))
    for column, name in enumerate(names):
        table[:, column] = points[name].ravel()
    return table


def all_or_none(names: Sequence[str], wanted: Sequence[str]) -> bool:
    """Return whether all wanted fields are there; ValueError if only some are."""
    missing = [name for name in wanted if name not in names]
    if missing and len(missing) < len(wanted):
        have = ', '.join(name for name in wanted if name in names)
        raise ValueError(f'the cloud has {have} but not {", ".join(missing)}')
    return not missing


def widest(points: NDArray[np.void]) -> np.dtype[np.floating[Any]]:
    """Return float32 or float64, the widest type among the fields of questions; ValueError if one
    is neither, or the mask no unsigned integer.
    """
    kinds = {name: points.dtype[name] for name in points.dtype.names or ()}
    mask = kinds.pop('mask', None)
    for name, kind in kinds.items():
        if kind.kind != 'f':
            raise ValueError(f"field '{name}' is {kind.name}; it has to be float32 or float64")
    if mask is not None and mask.kind != 'u':
        raise ValueError(f"field 'mask' is {mask.name}; it has to be an unsigned integer")
    return np.dtype(f'f{max(kind.itemsize for kind in kinds.values())}')


def _row_type(
    fields: Sequence[Any], wanted: Collection[str], point_step: int, endian: str
) -> np.dtype[np.void]:
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    for field in fields:
        if field.name not in wanted:
            continue
        if field.name in names:
            raise ValueError(f"field '{field.name}' is there twice")
        if field.datatype not in DATATYPES:
            raise ValueError(f"field '{field.name}' has the unknown datatype {field.datatype}")
        if field.count > 1:
            raise ValueError(f"field '{field.name}' has count {field.count} instead of 1")
        kind = endian + DATATYPES[field.datatype]
        if field.offset + np.dtype(kind).itemsize > point_step:
            raise ValueError(
                f"field '{field.name}' at offset {field.offset} ends outside its point "
                f'of {point_step} bytes'
            )
        names.append(field.name)
        formats.append(kind)
        offsets.append(field.offset)
    return np.dtype(
        {'names': names, 'formats': formats, 'offsets': offsets, 'itemsize': point_step}
    )
