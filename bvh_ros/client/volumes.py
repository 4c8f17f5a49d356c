# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of points, boxes and paths."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from bvh_ros.client.batch import as_rows, column
from bvh_ros.ros.conversions import query_clouds
from bvh_ros.ros.conversions.query_clouds import Boxes, Points

REAL = np.dtype(np.float64)


def points(places: ArrayLike, max_distance: ArrayLike, mask: ArrayLike) -> PointCloud2:
    """Return a cloud of points; ValueError where the shapes do not fit together."""
    where = as_rows('points', places)
    count = len(where)
    reaches = column('max_distance', np.asarray(max_distance, np.float64), count)
    masks = column('mask', np.asarray(mask, np.uint32), count)
    return query_clouds.questions_cloud(Points(where, reaches, masks), REAL)


def boxes(
    centers: ArrayLike,
    sizes: ArrayLike,
    orientations: ArrayLike | None,
    tolerance: ArrayLike,
    mask: ArrayLike,
) -> PointCloud2:
    """Return a cloud of boxes; ValueError where the shapes do not fit together."""
    where = as_rows('centers', centers)
    count = len(where)
    asked = Boxes(
        where,
        as_rows('sizes', sizes, count),
        _turns(orientations, count),
        column('tolerance', np.asarray(tolerance, np.float64), count),
        column('mask', np.asarray(mask, np.uint32), count),
    )
    return query_clouds.questions_cloud(asked, REAL)


def path(positions: ArrayLike, orientations: ArrayLike | None) -> Path:
    """Return a path; ValueError where the shapes do not fit together."""
    places = as_rows('positions', positions)
    turns, message = _turns(orientations, len(places)), Path()
    for place, turn in zip(places.tolist(), turns.tolist(), strict=True):
        stamped = PoseStamped()
        at, facing = stamped.pose.position, stamped.pose.orientation
        at.x, at.y, at.z = place
        facing.x, facing.y, facing.z, facing.w = turn
        message.poses.append(stamped)
    return message


def _turns(orientations: ArrayLike | None, count: int) -> Any:
    if orientations is None:
        return np.tile((0.0, 0.0, 0.0, 1.0), (count, 1))
    return as_rows('orientations', orientations, count, 4)
