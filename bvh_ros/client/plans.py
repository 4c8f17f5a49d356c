# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plain numbers to GetPlan requests, and GetPlan replies to hits."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import NamedTuple

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan

from bvh_ros.client.errors import BvhError

ERROR = 'error: '  # begins the frame_id of a reply that is no answer
COMPILING = 'compiling: '  # then begins the reason of a node that will answer soon

Vector = tuple[float, float, float]


class Hit(NamedTuple):
    """One obstacle in an answer."""

    name: str
    point: Vector  # on the obstacle, in the node's frame, m
    normal: Vector  # outward, unit length; +x where the node has no direction to give
    stamp: int  # last update of the obstacle, ns; where `until` was told, the time of contact


def request(
    start: Sequence[float],
    goal: Sequence[float],
    tolerance: float,
    frame_id: str,
    orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
    times: tuple[int | None, int | None] = (None, None),
) -> GetPlan.Request:
    """Return a request; `times` (ns) are those of start and goal. ValueError if a place or an
    orientation has the wrong length.
    """
    asked = GetPlan.Request()
    asked.start = _pose(start, orientation, frame_id)
    asked.goal = _pose(goal, (0.0, 0.0, 0.0, 1.0), frame_id)
    for stamped, stamp in zip((asked.start, asked.goal), times, strict=True):
        if stamp is not None:
            stamped.header.stamp = _time(stamp)
    asked.tolerance = float(tolerance)
    return asked


def _time(stamp: int) -> Time:
    """A time of a request; ValueError if none can be written so."""
    try:
        seconds, nanoseconds = divmod(operator.index(stamp), 1_000_000_000)
    except TypeError:
        raise ValueError(f'a time must be a whole number of ns, not {stamp!r:.50}') from None
    if not (stamp > 0 and seconds < 1 << 31):
        raise ValueError(f'a time must be above 0 and below 2^31 s, not {stamp} ns')
    return Time(sec=seconds, nanosec=nanoseconds)


def _pose(place: Sequence[float], orientation: Sequence[float], frame_id: str) -> PoseStamped:
    if len(place) not in (2, 3) or len(orientation) != 4:
        raise ValueError('a place has 2 or 3 coordinates and an orientation 4')
    stamped = PoseStamped()
    stamped.header.frame_id = frame_id
    at, turn = stamped.pose.position, stamped.pose.orientation
    at.x, at.y, at.z = (float(c) for c in (*place, 0.0)[:3])
    turn.x, turn.y, turn.z, turn.w = (float(c) for c in orientation)
    return stamped


def all_hits(reply: GetPlan.Response) -> list[Hit]:
    """Return the hits of a reply, in its order; BvhError with the reason if it is no answer."""
    hits = [_hit(stamped) for stamped in reply.plan.poses]
    if hits and hits[0].name.startswith(ERROR):
        raise BvhError(hits[0].name[len(ERROR) :])
    return hits


def first_hit(reply: GetPlan.Response) -> Hit | None:
    """Return the first hit of a reply, or None; BvhError with the reason if it is no answer."""
    hits = all_hits(reply)
    return hits[0] if hits else None


def _hit(stamped: PoseStamped) -> Hit:
    at, turn, stamp = stamped.pose.position, stamped.pose.orientation, stamped.header.stamp
    return Hit(
        stamped.header.frame_id,
        (at.x, at.y, at.z),
        _turned_x(turn.x, turn.y, turn.z, turn.w),
        stamp.sec * 1_000_000_000 + stamp.nanosec,
    )


def _turned_x(x: float, y: float, z: float, w: float) -> Vector:
    """Return +x turned by a unit quaternion: the normal that the node put into it."""
    return (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w))
