# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Random questions to the running node, each answer held against brute force.

A reply says which frame it knows of: its header's stamp is that of the newest update included.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.srv import GetPlan
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from ..scenes import Floats
from .scene import SIDE, UNDECIDED, Scene, scene_at

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
