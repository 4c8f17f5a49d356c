# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ask a running bvh node from Python: plain numbers in, plain numbers out.

```python
client = BvhClient(node)
client.wait_until_ready()
hit = client.raycast((0, 0, 1), (10, 0, 1))
print('free' if hit is None else f'{hit.name} at {hit.point}')
```
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

ERROR = 'error: '  # begins the frame_id of a reply that is no answer
POLL = 0.02  # seconds between two looks for the services

Vector = tuple[float, float, float]
Answer = TypeVar('Answer')


class BvhError(RuntimeError):
    """The node could not answer; the text is the node's reason."""


class BvhTimeoutError(BvhError):
    """No answer came in time."""


class Hit(NamedTuple):
    """One obstacle in an answer."""

    name: str
    point: Vector  # on the obstacle, in the node's frame, m
    normal: Vector  # outward, unit length; +x where the node has no direction to give
    stamp: int  # last update of the obstacle, ns


class BvhClient:
    """Calls the services of one bvh node.

    The plain calls wait for the answer, whether the node is being spun in another thread or not
    at all. They must not be used inside a callback of the same executor, which could then never
    receive the answer: use the `_async` forms there.

    Parameters
    ----------
    node : rclpy.node.Node
        Your node.
    name : str
        Name of the bvh node, with its namespace if that is not your own: `/robot1/bvh`.
    timeout : float
        Seconds that a plain call waits for its answer unless it is told otherwise.
    """

    def __init__(self, node: Node, name: str = 'bvh', *, timeout: float = 5.0) -> None:
        self.node = node
        self.name = name
        self.timeout = timeout
        # A group of their own: a callback that awaits an answer keeps the group it is in busy.
        self._group = ReentrantCallbackGroup()
        self._raycast = self._client('raycast')
        self._raycast_all = self._client('raycast_all')
        self._overlap = self._client('overlap')
        self._executor: SingleThreadedExecutor | None = None
        self._spinning = threading.Lock()

    def wait_until_ready(self, timeout: float = 60.0) -> None:
        """Wait until the node offers its services.

        Raises
        ------
        BvhTimeoutError
            If it does not in time; the first start on a machine compiles for about a minute.
        """
        deadline = time.monotonic() + timeout
        clients = (self._raycast, self._raycast_all, self._overlap)
        while not all(client.service_is_ready() for client in clients):
            if time.monotonic() > deadline:
                raise BvhTimeoutError(f"no services of '{self.name}' after {timeout:g} s")
            time.sleep(POLL)

    def raycast(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> Hit | None:
        """Return the first obstacle on the way from `start` to `end`, or None: the way is free.

        Parameters
        ----------
        start, end : sequence of 2 or 3 floats
            Metres; z is 0 if left out.
        radius : float
            Of a ball swept along the way; 0 is a thin ray.
        frame_id : str
            Frame of the coordinates, by default the node's.
        timeout : float, optional
            Seconds to wait for the answer.

        Raises
        ------
        BvhError
            If the node cannot answer, with its reason; BvhTimeoutError if it does not.
        """
        request = _request(start, end, radius, frame_id)
        return _first(self._call(self._raycast, request, timeout))

    def raycast_all(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return every obstacle on the way, nearest first; otherwise like `raycast`."""
        request = _request(start, end, radius, frame_id)
        return _all(self._call(self._raycast_all, request, timeout))

    def overlap(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        tolerance: float = 0.0,
        *,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return every obstacle that touches a box, nearest to the box's centre first.

        Parameters
        ----------
        corner, opposite : sequence of 2 or 3 floats
            Opposite corners of the box; the same twice for a ball.
        orientation : sequence of 4 floats
            Directions of the box's axes as a quaternion x, y, z, w.
        tolerance : float
            Metres by which the box is grown all round, its corners rounded.
        frame_id, timeout
            As for `raycast`.

        Raises
        ------
        BvhError
            If the node cannot answer, with its reason; BvhTimeoutError if it does not.
        """
        request = _request(corner, opposite, tolerance, frame_id, orientation)
        return _all(self._call(self._overlap, request, timeout))

    def raycast_async(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        frame_id: str = '',
    ) -> Future:
        """Ask as `raycast` does; return a future of its result, for use inside callbacks."""
        return self._ask(self._raycast, _request(start, end, radius, frame_id), _first)

    def raycast_all_async(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        frame_id: str = '',
    ) -> Future:
        """Ask as `raycast_all` does; return a future of its result."""
        return self._ask(self._raycast_all, _request(start, end, radius, frame_id), _all)

    def overlap_async(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        tolerance: float = 0.0,
        *,
        frame_id: str = '',
    ) -> Future:
        """Ask as `overlap` does; return a future of its result."""
        request = _request(corner, opposite, tolerance, frame_id, orientation)
        return self._ask(self._overlap, request, _all)

    def _client(self, service: str) -> Client:
        return self.node.create_client(
            GetPlan, f'{self.name}/{service}', callback_group=self._group
        )

    def _ask(
        self, client: Client, request: GetPlan.Request, read: Callable[[Any], Answer]
    ) -> Future:
        answer = Future(executor=self.node.executor)

        def finish(reply: Future) -> None:
            try:
                answer.set_result(read(reply.result()))
            except Exception as error:
                answer.set_exception(error)

        client.call_async(request).add_done_callback(finish)
        return answer

    def _call(
        self, client: Client, request: GetPlan.Request, timeout: float | None
    ) -> GetPlan.Response:
        timeout = self.timeout if timeout is None else timeout
        executor = self.node.executor
        if executor is None or executor is self._executor:
            reply = client.call_async(request)
            self._spin_until(reply, timeout)
        else:
            arrived = threading.Event()
            reply = client.call_async(request)
            reply.add_done_callback(lambda _reply: arrived.set())
            arrived.wait(timeout)
        if not reply.done():
            client.remove_pending_request(reply)
            raise BvhTimeoutError(f'{client.srv_name} did not answer within {timeout:g} s')
        return reply.result()

    def _spin_until(self, reply: Future, timeout: float) -> None:
        """Spin the node ourselves; nobody else does.

        The executor is kept: adding the node to one for each call costs ten times the call. Nor is
        its `spin_until_future_complete` used, which leaves more tasks behind than it runs, so that
        each call takes longer than the one before.
        """
        deadline = time.monotonic() + timeout
        with self._spinning:
            if self._executor is None:
                self._executor = SingleThreadedExecutor(context=self.node.context)
            self._executor.add_node(self.node)
            while not reply.done() and (left := deadline - time.monotonic()) > 0.0:
                self._executor.spin_once(left)


def _request(
    start: Sequence[float],
    goal: Sequence[float],
    tolerance: float,
    frame_id: str,
    orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
) -> GetPlan.Request:
    request = GetPlan.Request()
    request.start = _pose(start, orientation, frame_id)
    request.goal = _pose(goal, (0.0, 0.0, 0.0, 1.0), frame_id)
    request.tolerance = float(tolerance)
    return request


def _pose(place: Sequence[float], orientation: Sequence[float], frame_id: str) -> PoseStamped:
    if len(place) not in (2, 3) or len(orientation) != 4:
        raise ValueError('a place has 2 or 3 coordinates and an orientation 4')
    stamped = PoseStamped()
    stamped.header.frame_id = frame_id
    at, turn = stamped.pose.position, stamped.pose.orientation
    at.x, at.y, at.z = (float(c) for c in (*place, 0.0)[:3])
    turn.x, turn.y, turn.z, turn.w = (float(c) for c in orientation)
    return stamped


def _all(reply: GetPlan.Response) -> list[Hit]:
    hits = [_hit(stamped) for stamped in reply.plan.poses]
    if hits and hits[0].name.startswith(ERROR):
        raise BvhError(hits[0].name[len(ERROR) :])
    return hits


def _first(reply: GetPlan.Response) -> Hit | None:
    hits = _all(reply)
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
