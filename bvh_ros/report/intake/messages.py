# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages full of boxes, and one box beside them that shows which message is in."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.conversions import ray_clouds

Floats = NDArray[np.float64]

SIDES = (-5.0, 5.0)  # y of the box that tells one message from the other
BEACON_X = -10.0
EDGE = 0.2  # m
FIELDS = ('x', 'y', 'z', 'sx', 'sy', 'sz')


def centres(count: int, side: int) -> Floats:
    """Boxes in a cube of 100 m, the last of them beside it; they differ a little by side."""
    found = np.random.default_rng(0).uniform(0.0, 100.0, (count, 3)) + 0.05 * side
    found[-1] = BEACON_X, SIDES[side], 0.0
    return found


def marker_array(count: int, side: int) -> bytes:
    """A serialised MarkerArray of cubes of one namespace."""
    message = MarkerArray()
    for number, (x, y, z) in enumerate(centres(count, side).tolist()):
        marker = Marker(ns='boxes', id=number, type=Marker.CUBE)
        marker.header.frame_id = 'map'
        at, scale = marker.pose.position, marker.scale
        at.x, at.y, at.z = x, y, z
        scale.x = scale.y = scale.z = EDGE
        marker.pose.orientation.w = marker.color.a = 1.0
        message.markers.append(marker)
    return bytes(serialize_message(message))


def cloud(count: int, side: int, *, by_id: bool = False) -> PointCloud2:
    """A cloud of boxes with sizes, in float32; if wanted with an id each."""
    names: Sequence[str] = (*FIELDS, 'id') if by_id else FIELDS
    kinds = [(name, '<u4' if name == 'id' else '<f4') for name in names]
    table = np.empty(count, np.dtype(kinds))
    for name, column in zip(FIELDS, centres(count, side).T, strict=False):
        table[name] = column
    for name in FIELDS[3:]:
        table[name] = EDGE
    if by_id:
        table['id'] = np.arange(count)
    message = ray_clouds.table_cloud(table, 1, count, table['x'])
    message.header.frame_id = 'map'
    return message
