# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A PointCloud2 as boxes, without a loop over its points."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions.cloud_fields import all_or_none, columns, structured
from bvh_ros.scene import Refusal, ShapeKind, Shapes

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
    points = structured(cloud, (*CENTRE, *SIZE, *ORIENTATION, 'id'))
    names = points.dtype.names or ()
    by_id = 'id' in names
    if n == 0:
        return _nothing(by_id)
    has_size = all_or_none(names, SIZE)
    has_orientation = all_or_none(names, ORIENTATION)
    if not all_or_none(names, CENTRE):
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
