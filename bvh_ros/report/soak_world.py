# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The world of the soak: its boxes, the process that publishes them, and checked questions.

Run: python -m bvh_ros.report.soak_world NAMESPACE publishes until it is ended.
"""

import re
import struct
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.srv import GetPlan
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from .scenes import Floats

# ---- A thousand boxes that move, turn, come and go, and who meets what, by brute force.


BOXES = 1000
SIDE = 40.0  # m, of the cube that holds the centres
ABSENT, CYCLE = 20, 200  # frames: each box is away for 20 of 200
UNDECIDED = 1e-7  # m: closer to touching than this, rounding may decide either way

_RNG = np.random.default_rng(5)
_BASE = _RNG.uniform(0.0, SIDE, (BOXES, 3))
_REACH = _RNG.uniform(-4.0, 4.0, (BOXES, 3))  # m, of the swing
_PACE = _RNG.uniform(0.005, 0.03, (BOXES, 1))  # radians a frame
_TURN = np.where(np.arange(BOXES) % 2 == 0, 0.0, _RNG.uniform(-0.05, 0.05, BOXES))
HALF = _RNG.uniform(0.2, 1.2, (BOXES, 3))
"""Half edge lengths, m."""


class Scene(NamedTuple):
    """The boxes of one frame; those that are away have a place, too."""

    present: np.ndarray  # (n,) bool
    centre: Floats  # (n, 3) m
    yaw: Floats  # (n,) radians; every second box is never turned

    def local(self, points: Floats) -> Floats:
        """Points or directions (n, 3), one a box, in the boxes' own axes."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        x, y, z = points.T
        return np.column_stack((c * x + s * y, c * y - s * x, z))

    def entries(self, start: Floats, way: Floats, grown: float) -> Floats:
        """Where on start + t * way, 0 to 1, each box is entered; inf where it is not met."""
        half = HALF + grown
        origin, along = self.local(start - self.centre), self.local(np.tile(way, (BOXES, 1)))
        with np.errstate(divide='ignore'):
            one, other = (-half - origin) / along, (half - origin) / along
        enter = np.maximum(np.minimum(one, other).max(axis=1), 0.0)
        leave = np.minimum(np.maximum(one, other).min(axis=1), 1.0)
        return np.where(self.present & (enter <= leave), enter, np.inf)

    def closest(self, point: Floats) -> Floats:
        """The point (n, 3) of each box that is closest to a point (3,)."""
        x, y, z = np.clip(self.local(point - self.centre), -HALF, HALF).T
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return self.centre + np.column_stack((c * x - s * y, s * x + c * y, z))

    def distances(self, point: Floats) -> Floats:
        """Distance of each box from a point: 0 inside, inf for those that are away."""
        distance = np.linalg.norm(self.closest(point) - point, axis=1)
        return np.where(self.present, distance, np.inf)

    def gaps(self, centre: Floats, half: Floats) -> Floats:
        """How far an aligned box and each box are apart along the axis that parts them most.

        Negative where they overlap. The boxes are upright prisms, so x, y, z and the boxes' own
        two horizontal axes are enough (separating axes).
        """
        offset = centre - self.centre
        c, s = np.abs(np.cos(self.yaw)), np.abs(np.sin(self.yaw))
        own = np.abs(self.local(offset))
        along = np.abs(offset)
        gaps = [
            along[:, 0] - half[0] - c * HALF[:, 0] - s * HALF[:, 1],
            along[:, 1] - half[1] - s * HALF[:, 0] - c * HALF[:, 1],
            along[:, 2] - half[2] - HALF[:, 2],
            own[:, 0] - HALF[:, 0] - c * half[0] - s * half[1],
            own[:, 1] - HALF[:, 1] - s * half[0] - c * half[1],
        ]
        return np.where(self.present, np.max(gaps, axis=0), np.inf)


def scene_at(frame: int) -> Scene:
    """The world of one frame; there is nothing before frame 0."""
    phase = (frame + 13 * np.arange(BOXES)) % CYCLE
    return Scene(
        (phase >= ABSENT) & (frame >= 0), _BASE + _REACH * np.sin(_PACE * frame), _TURN * frame
    )


# ---- Random questions to the running node, each answer held against brute force.


TIMEOUT = 10.0  # seconds
SERVICES = ('raycast', 'raycast_all', 'overlap')
REPORTED = 1e-6  # m: a reported point may be this far from where it belongs


class Answer(NamedTuple):
    """What became of one question."""

    frame: int  # the newest that the answer knows of, -1 if none
    took: float  # seconds
    fault: str  # empty where the answer is right


class Found(NamedTuple):
    """A reply's poses, read."""

    boxes: list[int]
    points: Floats  # (k, 3)


class Asker:
    """Asks the services of a node in turn, at random places.

    Parameters
    ----------
    node : Node
        In the namespace of the bvh node.
    hear : callable
        Given every message on /diagnostics, as they come in while waiting for answers.
    """

    def __init__(self, node: Node, hear: Callable[[DiagnosticArray], None]) -> None:
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._clients = {name: node.create_client(GetPlan, f'bvh/{name}') for name in SERVICES}
        node.create_subscription(DiagnosticArray, '/diagnostics', hear, 10)
        self._rng = np.random.default_rng()
        self._turn = 0

    def ask(self) -> Answer:
        """Ask the next question."""
        self._turn += 1
        if self._turn % 2:
            service = SERVICES[self._turn % 4 // 2]
            start, goal = self._rng.uniform(-4.0, SIDE + 4.0, (2, 3))
            fault = partial(ray_fault, start=start, goal=goal, first=service == 'raycast')
            return self._judged(service, start, goal, 0.0, fault)
        centre = self._rng.uniform(0.0, SIDE, 3)
        if self._turn % 4:
            half = self._rng.uniform(0.1, 4.0, 3)
            low, high = centre - half, centre + half
            return self._judged('overlap', low, high, 0.0, partial(box_fault, low=low, high=high))
        radius = float(np.float32(self._rng.uniform(0.1, 5.0)))  # tolerance is a float32
        fault = partial(ball_fault, centre=centre, radius=radius)
        return self._judged('overlap', centre, centre, radius, fault)

    def _judged(
        self,
        service: str,
        start: Floats,
        goal: Floats,
        tolerance: float,
        fault: Callable[[Scene, Found], str],
    ) -> Answer:
        began = time.perf_counter()
        reply = self._call(service, start, goal, tolerance)
        took = time.perf_counter() - began
        if reply is None:
            return Answer(-1, took, f'{service}: no answer within {TIMEOUT:g} s')
        frame = reply.plan.header.stamp.sec - 1
        names = [pose.header.frame_id for pose in reply.plan.poses]
        if names and names[0].startswith('error: '):
            return Answer(-1, took, f'{service}: {names[0]}')
        places = [pose.pose.position for pose in reply.plan.poses]
        points = np.array([(at.x, at.y, at.z) for at in places]).reshape(-1, 3)
        found = Found([int(name.rpartition('/')[2]) for name in names], points)
        what = fault(scene_at(frame), found)
        where = f'frame {frame}, {service} {start.tolist()} {goal.tolist()} {tolerance!r}'
        return Answer(frame, took, f'{where}: {what}' if what else '')

    def _call(self, service: str, start: Floats, goal: Floats, tolerance: float) -> Any:
        request = GetPlan.Request(tolerance=tolerance)
        for stamped, place in ((request.start, start), (request.goal, goal)):
            at = stamped.pose.position
            at.x, at.y, at.z = place.tolist()
        client = self._clients[service]
        future = client.call_async(request)
        deadline = time.monotonic() + TIMEOUT
        while not future.done() and (left := deadline - time.monotonic()) > 0.0:
            self._executor.spin_once(left)
        if future.done():
            return future.result()
        client.remove_pending_request(future)
        return None


def ray_fault(scene: Scene, found: Found, start: Floats, goal: Floats, first: bool) -> str:
    """Say what is wrong with the answer of a raycast, first hit or all."""
    way = goal - start
    may = scene.entries(start, way, UNDECIDED)
    must = scene.entries(start, way, -UNDECIDED)
    length = float(np.linalg.norm(way))
    reached = (found.points - start) @ way / length  # m along the way
    off = np.linalg.norm(found.points - start - reached[:, None] * way / length, axis=1)
    if (off > REPORTED).any():
        return 'a point is not on the segment'
    early, late = length * may[found.boxes], length * must[found.boxes]
    if (reached < early - REPORTED).any() or (reached > late + REPORTED).any():
        return 'a point is not where its box is entered'
    if not first:
        return _set_fault(found, np.isfinite(may), np.isfinite(must)) or _order_fault(reached)
    if not found.boxes:
        return 'free, but something is in the way' if np.isfinite(must).any() else ''
    return 'something else comes first' if must.min() * length < reached[0] - REPORTED else ''


def ball_fault(scene: Scene, found: Found, centre: Floats, radius: float) -> str:
    """Say what is wrong with the answer of an overlap with a ball."""
    distance = scene.distances(centre)
    fault = _set_fault(found, distance <= radius + UNDECIDED, distance <= radius - UNDECIDED)
    return fault or _nearest_fault(scene, found, centre)


def box_fault(scene: Scene, found: Found, low: Floats, high: Floats) -> str:
    """Say what is wrong with the answer of an overlap with an aligned box."""
    centre = 0.5 * (low + high)
    gap = scene.gaps(centre, 0.5 * (high - low))
    return _set_fault(found, gap <= UNDECIDED, gap <= -UNDECIDED) or _nearest_fault(
        scene, found, centre
    )


def _nearest_fault(scene: Scene, found: Found, centre: Floats) -> str:
    """Each point is its box's closest to the query's centre, and the nearest comes first."""
    off = np.abs(found.points - scene.closest(centre)[found.boxes])
    if (off > REPORTED).any():
        return "a point is not its box's closest"
    return _order_fault(np.linalg.norm(found.points - centre, axis=1))


def _set_fault(found: Found, may: np.ndarray, must: np.ndarray) -> str:
    answered = np.zeros(len(may), np.bool_)
    answered[found.boxes] = True
    if answered.sum() < len(found.boxes):
        return 'a box is named twice'
    if (must & ~answered).any():
        return f'box {np.flatnonzero(must & ~answered)[0]} is missing'
    return (
        f'box {np.flatnonzero(answered & ~may)[0]} is too much' if (answered & ~may).any() else ''
    )


def _order_fault(values: Floats) -> str:
    return 'the order is wrong' if (np.diff(values) < -REPORTED).any() else ''


# ---- The process that publishes the soak's world until it is ended.


RATE = 30.0  # frames a second
TOPIC = 'bvh/obstacles'
STAMP, ID, X = 0x1D0FACED, 0x0B0EAC71, -1.2345678901234567e89  # occur nowhere else


class Frames:
    """Makes the MarkerArray of a frame, as serialised bytes.

    rclpy takes 42 ms to serialise a thousand markers, longer than a frame lasts. So one message is
    serialised, and its numbers are overwritten in place.
    """

    def __init__(self) -> None:
        serialised = _serialised()
        self._bytes = np.frombuffer(serialised, np.uint8).copy()
        self._stamps = _places(serialised, struct.pack('<i', STAMP), 4)
        # An id is followed by type and action, a place by orientation and size.
        self._ids = _places(serialised, struct.pack('<i', ID), 4)
        self._poses = _places(serialised, struct.pack('<d', X), 80)

    def message(self, frame: int) -> bytes:
        """Frame number `frame`, stamped with as many seconds and one."""
        scene = scene_at(frame)
        order = np.argsort(~scene.present, kind='stable')  # deletions come last
        zero = np.zeros(BOXES)
        turn = (zero, zero, np.sin(scene.yaw / 2), np.cos(scene.yaw / 2))
        table = np.column_stack((scene.centre, *turn, 2.0 * HALF))[order]
        actions = np.where(scene.present, Marker.ADD, Marker.DELETE)[order, None]
        self._write(self._stamps, np.full((BOXES, 1), 1 + frame))
        self._write(self._ids, order[:, None])
        self._write(self._ids + 8, actions)
        self._write(self._poses, table)
        return self._bytes.tobytes()

    def _write(self, places: NDArray[np.int64], values: NDArray[Any]) -> None:
        kind = '<i4' if values.dtype.kind == 'i' else '<f8'
        self._bytes[places] = values.astype(kind).view(np.uint8).reshape(places.shape)


def _places(serialised: bytes, mark: bytes, size: int) -> NDArray[np.int64]:
    """(n, size) indices of the bytes that begin with a mark, one row a marker."""
    starts = np.array([found.start() for found in re.finditer(re.escape(mark), serialised)])
    return starts[:, None] + np.arange(size)


def _serialised() -> bytes:
    """A MarkerArray with marks where frames differ."""
    array = MarkerArray()
    for _ in range(BOXES):
        marker = Marker(ns='soak', id=ID, type=Marker.CUBE)
        marker.header.frame_id = 'map'
        marker.header.stamp.sec = STAMP
        marker.pose.position.x = X
        array.markers.append(marker)
    return bytes(serialize_message(array))


def main(namespace: str) -> None:
    """Publish frame after frame; a late one is followed by the next at once."""
    rclpy.init(args=[])
    node = rclpy.create_node('soak_publisher', namespace=namespace)
    publisher = node.create_publisher(MarkerArray, TOPIC, 10)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    frames, frame, began = Frames(), 0, time.monotonic()
    while rclpy.ok():
        message = frames.message(frame)
        time.sleep(max(0.0, began + frame / RATE - time.monotonic()))
        publisher.publish(message)
        frame += 1


if __name__ == '__main__':
    main(*sys.argv[1:])
