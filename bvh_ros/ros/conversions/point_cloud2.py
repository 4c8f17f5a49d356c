# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A PointCloud2 as boxes, without a loop over its points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.scene import Refusal, ShapeKind, Shapes

# sensor_msgs/msg/PointField datatypes
DATATYPES = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
CENTRE = ('x', 'y', 'z')
SIZE = ('sx', 'sy', 'sz')
ORIENTATION = ('qx', 'qy', 'qz', 'qw')


class Boxes(NamedTuple):
    """The boxes of one cloud."""

    numbers: NDArray[np.int64]  # (n,) row in the cloud, or id
    shapes: Shapes  # (n,)
    deleted: NDArray[np.int64]  # ids whose size is NaN
    by_id: bool  # has ids: updates these; otherwise replaces everything
    skipped: int  # points with a NaN coordinate
    refusals: list[Refusal]


def boxes(cloud: Any, *, voxel: float) -> Boxes:
    """Read the boxes of a cloud.

    Parameters
    ----------
    cloud : sensor_msgs/PointCloud2
        Fields x, y, z (centre, m) and optionally sx, sy, sz (full edge lengths, m), qx, qy, qz,
        qw and id, each of any numeric type.
    voxel : float
        Edge length of every box where the cloud has no sizes.

    Raises
    ------
    ValueError
        If the cloud contradicts itself; nothing of it can be trusted then.
    """
    n = cloud.width * cloud.height
    points = structured(cloud)
    names = points.dtype.names or ()
    by_id = 'id' in names
    if n == 0:
        return _nothing(by_id)
    has_size = _all_or_none(names, SIZE)
    has_orientation = _all_or_none(names, ORIENTATION)
    if not _all_or_none(names, CENTRE):
        raise ValueError('the cloud has no fields x, y, z')
    centre = columns(points, CENTRE)
    size = columns(points, SIZE) if has_size else np.full((n, 3), voxel)
    turn = columns(points, ORIENTATION) if has_orientation else np.zeros((n, 4))
    numbers = np.arange(n, dtype=np.int64)
    deleted = np.empty(0, dtype=np.int64)
    usable = np.ones(n, dtype=bool)
    refusals: list[Refusal] = []
    if by_id:
        numbers, usable, refusals = _ids(points['id'].ravel())
        gone = usable & np.isnan(size).any(axis=1)
        deleted = numbers[gone]
        usable &= ~gone
    unknown = usable & np.isnan(centre).any(axis=1)
    rows = np.flatnonzero(usable & ~unknown)
    shapes = Shapes(
        np.full(len(rows), ShapeKind.BOX, dtype=np.uint8), centre[rows], turn[rows], size[rows]
    )
    return Boxes(numbers[rows], shapes, deleted, by_id, int(unknown.sum()), refusals)


def structured(cloud: Any) -> NDArray[np.void]:
    """Return the cloud's rows as a read-only structured view of its bytes, shape (height, width).

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
    dtype = _row_type(cloud.fields, point_step, '>' if cloud.is_bigendian else '<')
    length = len(cloud.data)
    if width * height == 0:
        if length:
            raise ValueError(
                f'a cloud of {width} x {height} points carries {length} bytes of data'
            )
        return np.empty((height, width), dtype)
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


def _row_type(fields: Sequence[Any], point_step: int, endian: str) -> np.dtype[np.void]:
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    for field in fields:
        if field.name not in (*CENTRE, *SIZE, *ORIENTATION, 'id'):
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


def _all_or_none(names: Sequence[str], wanted: Sequence[str]) -> bool:
    missing = [name for name in wanted if name not in names]
    if missing and len(missing) < len(wanted):
        have = ', '.join(name for name in wanted if name in names)
        raise ValueError(f'the cloud has {have} but not {", ".join(missing)}')
    return not missing


def _ids(values: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.bool_], list[Refusal]]:
    """Return the ids as integers, which rows to use, and the rows refused."""
    refusals: list[Refusal] = []
    good = np.ones(len(values), dtype=bool)
    if values.dtype.kind == 'f':
        # Doubles beyond 2^53 no longer tell neighbouring ids apart.
        with np.errstate(invalid='ignore'):
            good = (values == np.rint(values)) & (np.abs(values) <= 2.0**53)
        for row in np.flatnonzero(~good):
            refusals.append(Refusal(int(row), '', f'id {values[row]} is not a whole number'))
    ids = np.where(good, values, 0).astype(np.int64)
    last = _last_of_each(ids, good)
    if last is not None:
        for row in np.flatnonzero(good & ~last):
            reason = f'id {ids[row]} comes again in this cloud; the last one counts'
            refusals.append(Refusal(int(row), str(ids[row]), reason))
        good &= last
    return ids, good, refusals


def _last_of_each(ids: NDArray[np.int64], good: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Return which rows are the last of their id, or None if no id repeats."""
    rows = np.flatnonzero(good)
    unique, first_from_behind = np.unique(ids[rows][::-1], return_index=True)
    if len(unique) == len(rows):
        return None
    last = np.zeros(len(ids), dtype=bool)
    last[rows[::-1][first_from_behind]] = True
    return last


def _nothing(by_id: bool) -> Boxes:
    empty = np.empty(0, dtype=np.int64)
    shapes = Shapes(
        np.empty(0, dtype=np.uint8), np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 3))
    )
    return Boxes(empty, shapes, empty, by_id, 0, [])
