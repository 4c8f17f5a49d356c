# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that tests send, and what they read from those that come."""

from array import array
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetPlan
from numpy.typing import ArrayLike, NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros.clouds import cloud
from visualization_msgs.msg import Marker

__all__ = ['LATCHED', 'cloud', 'coordinates', 'get_plan', 'grid', 'marker', 'stamp', 'xyz']

SECOND = 1_000_000_000  # ns
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def stamp(nanoseconds: int) -> Time:
    """A builtin_interfaces/Time."""
    return Time(sec=nanoseconds // SECOND, nanosec=nanoseconds % SECOND)


def marker(
    number: int, at: Sequence[float] = (0, 0, 0), size: Sequence[float] = (1, 1, 1), **given: Any
) -> Marker:
    """A visualization_msgs/Marker."""
    message = Marker(
        ns=given.get('ns', 'a'),
        id=int(number),
        type=given.get('type', Marker.CUBE),
        action=given.get('action', Marker.ADD),
        mesh_resource=given.get('mesh', ''),
    )
    write(message.pose.position, at)
    write(message.pose.orientation, given.get('turn', (0, 0, 0, 1)))
    write(message.scale, size)
    message.header.frame_id = given.get('frame', 'map')
    message.header.stamp.sec = given.get('stamp', 0)
    lifetime = given.get('lifetime', 0.0)
    message.lifetime.sec, rest = int(lifetime), lifetime % 1
    message.lifetime.nanosec = int(rest * 1e9)
    message.points = [write(Point(), place) for place in given.get('points', ())]
    return message


def write(message: Any, numbers: Iterable[float]) -> Any:
    """Write numbers into the fields of a message, which is returned."""
    for field, number in zip(message.get_fields_and_field_types(), numbers, strict=True):
        setattr(message, field, float(number))
    return message


def get_plan(start: Sequence[float], goal: Sequence[float], **given: Any) -> GetPlan.Request:
    """A nav_msgs/GetPlan request."""
    request = GetPlan.Request(tolerance=float(given.get('tolerance', 0.0)))
    for stamped, place in ((request.start, start), (request.goal, goal)):
        write(stamped.pose.position, place)
        stamped.header.frame_id = given.get('frame', '')
    write(request.start.pose.orientation, given.get('turn', (0, 0, 0, 0)))
    return request


def grid(cells: ArrayLike, resolution: float = 1.0) -> OccupancyGrid:
    """A nav_msgs/OccupancyGrid of rows of cells, whose first cell begins at the origin."""
    cells = np.asarray(cells, np.int8)
    message = OccupancyGrid(data=array('b', cells.tobytes()))
    message.info.height, message.info.width = cells.shape
    message.info.resolution = resolution
    return message


def xyz(points: Iterable[Any]) -> NDArray[np.float64]:
    """Points or vectors as rows (n, 3)."""
    return np.array([coordinates(point) for point in points]).reshape(-1, 3)


def coordinates(of: Any) -> tuple[float, ...]:
    """The position of a stamped pose, or the numbers of a point, a vector or a quaternion."""
    of = of.pose.position if hasattr(of, 'pose') else of
    return tuple(getattr(of, field) for field in of.get_fields_and_field_types())
