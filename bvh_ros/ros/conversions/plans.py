# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""GetPlan requests to plain numbers, and answers to GetPlan replies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from std_msgs.msg import Header

from bvh_ros.ros.conversions import nanoseconds, rotations
from bvh_ros.ros.world.frames import Transform
from bvh_ros.scene import SceneHit
from bvh_ros.tree.access import checks

ERROR = 'error: '  # begins the frame_id of a reply that is no answer

Vector = tuple[float, float, float]


class Query(NamedTuple):
    """A request in the node's frame."""

    start: Vector
    goal: Vector
    orientation: rotations.Quaternion  # of the box
    tolerance: float  # m


def query(
    request: Any, into_node: Callable[[str, int], Transform | None], *, oriented: bool
) -> Query:
    """Read a nav_msgs/srv/GetPlan request.

    Parameters
    ----------
    into_node : callable
        From a frame and a stamp to the transform into the node's frame, or None.
    oriented : bool
        Whether the request's orientation matters: for boxes it does, for segments it does not.

    Raises
    ------
    ValueError
        If the request cannot be answered, with the reason.
    """
    tolerance = request.tolerance
    if not (math.isfinite(tolerance) and tolerance >= 0.0):
        raise ValueError(f'tolerance must be finite and at least 0, not {tolerance:g}')
    start, goal = _position('start', request.start), _position('goal', request.goal)
    turn = rotations.IDENTITY
    if oriented:
        turn = _turn('start', request.start)
    for_start = into_node(request.start.header.frame_id, nanoseconds(request.start.header.stamp))
    for_goal = into_node(request.goal.header.frame_id, nanoseconds(request.goal.header.stamp))
    if for_start is not None:
        start, turn = _vector(for_start.points(start)), _moved(for_start, turn)
    if for_goal is not None:
        goal = _vector(for_goal.points(goal))
    return Query(start, goal, turn, tolerance)


def of_point(request: Any, query: Query) -> Query:
    """Return the query as one about its start; ValueError if it has a goal of its own."""
    start, goal = request.start.pose.position, request.goal.pose.position
    place = goal.x, goal.y, goal.z
    if any(place) and place != (start.x, start.y, start.z):
        raise ValueError('goal.pose.position must be zero, or that of start: a point is asked for')
    return query._replace(goal=query.start)


class Replies:
    """Writes answers into Paths, with PoseStamped objects that are used again and again.

    To make one takes 10 us, as long as the ray itself. rclpy has sent a reply before it calls
    anybody again.
    """

    def __init__(self) -> None:
        self._poses: list[PoseStamped] = []

    def fill(self, plan: Path, hits: Sequence[SceneHit], frame_id: str, newest: int) -> None:
        """Write the answer to a query into a Path.

        Parameters
        ----------
        hits : sequence of SceneHit
            One pose each, in this order.
        frame_id : str
            The node's frame.
        newest : int
            Time of the newest update that the answer knows of, ns.
        """
        _set_header(plan.header, frame_id, newest)
        self._poses += [PoseStamped() for _ in range(len(hits) - len(self._poses))]
        poses = self._poses[: len(hits)]
        for pose, hit in zip(poses, hits, strict=True):
            turn = rotations.from_normal(*hit.normal.tolist())
            set_pose(pose, hit.name, hit.stamp, hit.point.tolist(), turn)
        plan.poses = poses


def fill_error(plan: Path, request: Any, reason: str, frame_id: str, now: int) -> None:
    """Write the reply that never looks free: one pose at `start` whose name says what is wrong."""
    _set_header(plan.header, frame_id, now)
    at = request.start.pose.position
    place = tuple(c if math.isfinite(c) else 0.0 for c in (at.x, at.y, at.z))
    pose = PoseStamped()
    set_pose(pose, ERROR + reason, now, place, rotations.IDENTITY)
    plan.poses = [pose]


def _set_header(header: Header, frame_id: str, stamp: int) -> None:
    header.frame_id = frame_id
    header.stamp.sec, header.stamp.nanosec = divmod(stamp, 1_000_000_000)


def set_pose(
    stamped: PoseStamped, name: str, stamp: int, place: Sequence[float], turn: rotations.Quaternion
) -> None:
    """Write a pose; `name` is its frame_id, `stamp` in ns."""
    _set_header(stamped.header, name, stamp)
    position, orientation = stamped.pose.position, stamped.pose.orientation
    position.x, position.y, position.z = place
    orientation.x, orientation.y, orientation.z, orientation.w = turn


def _position(what: str, stamped: Any) -> Vector:
    at = stamped.pose.position
    place = (at.x, at.y, at.z)
    if not all(map(math.isfinite, place)):
        raise ValueError(f'{what}.pose.position is not finite')
    return place


def _turn(what: str, stamped: Any) -> rotations.Quaternion:
    q = stamped.pose.orientation
    turn = (q.x, q.y, q.z, q.w)
    if not any(turn):  # an unset field
        return rotations.IDENTITY
    if not all(map(math.isfinite, turn)):
        raise ValueError(f'{what}.pose.orientation is not finite')
    if not checks.are_unit(*turn):
        raise ValueError(f'{what}.pose.orientation has length {math.hypot(*turn):g}, not 1')
    return turn


def _moved(transform: Transform, turn: rotations.Quaternion) -> rotations.Quaternion:
    x, y, z, w = transform.orientations(turn).tolist()
    return x, y, z, w


def _vector(values: Iterable[float]) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
