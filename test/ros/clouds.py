# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds of points in any layout, and what is in one by its own account."""

from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import PointCloud2, PointField

CODES = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}


def cloud(
    columns: dict[str, ArrayLike | Sequence[Any]],
    *,
    kind: str = 'f8',
    kinds: dict[str, str] | None = None,
    big: bool = False,
    padding: int = 0,
    row_padding: int = 0,
    height: int = 1,
) -> PointCloud2:
    """These fields, each of its own type, with gaps between points and rows."""
    kinds = {name: (kinds or {}).get(name, kind) for name in columns}
    row = np.dtype([(name, ('>' if big else '<') + kinds[name]) for name in columns])
    width = len(next(iter(columns.values()))) // height
    step = row.itemsize + padding
    line = step * width + row_padding
    data = bytearray(b'\xaa' * (line * height))
    table = np.ndarray((height, width), row, data, strides=(line, step))
    for name, column in columns.items():
        table[name] = np.reshape(column, (height, width))
    return PointCloud2(
        height=height,
        width=width,
        fields=[field(name, row.fields[name][1], CODES[kinds[name]]) for name in columns],
        is_bigendian=big,
        point_step=step,
        row_step=line,
        data=array('B', data),
    )


def field(name: str, offset: int, datatype: int, count: int = 1) -> PointField:
    return PointField(name=name, offset=offset, datatype=datatype, count=count)


def table(message: Any) -> NDArray[np.void]:
    """The points of a cloud, read by numpy from its own description of itself."""
    kinds = {code: kind for kind, code in CODES.items()}
    dtype = np.dtype(
        {
            'names': [field.name for field in message.fields],
            'formats': ['<' + kinds[field.datatype] for field in message.fields],
            'offsets': [field.offset for field in message.fields],
            'itemsize': message.point_step,
        }
    )
    assert len(message.data) == message.row_step * message.height
    assert message.row_step == message.width * message.point_step
    return np.frombuffer(message.data, dtype)
