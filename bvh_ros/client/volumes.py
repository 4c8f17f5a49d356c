# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Points, boxes and poses that are asked about, and messages of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import PointCloud2

from bvh_ros.client.batch import LAST_STAMP, as_rows, column, times
from bvh_ros.ros.conversions import query_clouds
from bvh_ros.ros.conversions.query_clouds import Boxes, Points

REAL = np.dtype(np.float64)


def points(places: ArrayLike, max_distance: ArrayLike, mask: ArrayLike) -> Points:
    """Return n points; ValueError where the shapes do not fit together."""
    where = as_rows('points', places)
    count = len(where)
    reaches = column('max_distance', np.asarray(max_distance, np.float64), count)
    masks = column('mask', np.asarray(mask, np.uint32), count)
    return Points(where, reaches, masks)


def boxes(
    centers: ArrayLike,
    sizes: ArrayLike,
    orientations: ArrayLike | None,
    tolerance: ArrayLike,
    mask: ArrayLike,
) -> Boxes:
    """Return n boxes; ValueError where the shapes do not fit together."""
    where = as_rows('centers', centers)
    count = len(where)
    return Boxes(
        where,
        as_rows('sizes', sizes, count),
        _turns(orientations, count),
        column('tolerance', np.asarray(tolerance, np.float64), count),
        column('mask', np.asarray(mask, np.uint32), count),
    )


def poses(positions: ArrayLike, orientations: ArrayLike | None) -> tuple[NDArray, NDArray]:
    """Return places and orientations of n poses; ValueError where the shapes do not fit
    together.
    """
    places = as_rows('positions', positions)
    return places, _turns(orientations, len(places))


def cloud(asked: Points | Boxes) -> PointCloud2:
    """Return a cloud of points or boxes."""
    return query_clouds.questions_cloud(asked, REAL)


def path(places: NDArray, turns: NDArray, when: ArrayLike | None = None) -> Path:
    """Return a path of poses, each with its stamp, ns; ValueError if these are none."""
    message, count = Path(), len(places)
    stamps = np.zeros(count, np.int64) if when is None else times('at', when, count)
    if count and not 0 <= stamps.min() <= stamps.max() < LAST_STAMP:
        raise ValueError('at must be what a stamp can hold')
    for place, turn, stamp in zip(places.tolist(), turns.tolist(), stamps.tolist(), strict=True):
        stamped = PoseStamped()
        stamped.header.stamp.sec, stamped.header.stamp.nanosec = divmod(stamp, 10**9)
        at, facing = stamped.pose.position, stamped.pose.orientation
        at.x, at.y, at.z = place
        facing.x, facing.y, facing.z, facing.w = turn
        message.poses.append(stamped)
    return message


def _turns(orientations: ArrayLike | None, count: int) -> Any:
    if orientations is None:
        return np.tile((0.0, 0.0, 0.0, 1.0), (count, 1))
    return as_rows('orientations', orientations, count, 4)
