# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replies whose client is found late."""

from __future__ import annotations

import time
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.clock import Clock, ClockType

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.service import Service
    from rclpy.timer import Timer

AGAIN_AFTER = 0.4, 1.0, 3.0
"""Seconds between one attempt and the next. DDS announces a reader anew every second."""
LOOK_EVERY = 0.1  # seconds


class Late(NamedTuple):
    """A reply that is not delivered.

    Attributes
    ----------
    due : float
        When to try again, on the monotonic clock.
    attempts : int
        That failed.
    response, header
        As rclpy sends them.
    """

    due: float
    attempts: int
    response: Any
    header: Any


class Replies:
    """Sends the replies of a service, and once more those whose client was not found.

    A client asks as soon as it knows the node, which may not know the reader of its replies yet:
    news of that comes by packets of its own. rmw_fastrtps waits 0.1 s for them, then drops the
    reply, and rclpy warns. On a loaded machine the first request of a client remained unanswered.

    Parameters
    ----------
    node : rclpy.node.Node
        Serves; its executor tries again.
    service : rclpy.service.Service
        From now on sends this way.
    """

    def __init__(self, node: Node, service: Service) -> None:
        self._node = node
        self._name = service.srv_name
        self._send = service.send_response
        self._late: list[Late] = []
        self._timer: Timer | None = None
        service.send_response = self.send

    def send(self, response: Any, header: Any) -> None:
        """Send a reply now, or as soon as its client is found."""
        self._try(Late(0.0, 0, response, header))

    def close(self) -> None:
        """Try no more."""
        self._late.clear()
        self._stop_looking()

    def _try(self, late: Late) -> None:
        if self._is_sent(late):
            return
        if late.attempts == len(AGAIN_AFTER):
            self._node.get_logger().warning(
                f'a reply of {self._name} is lost: its client asked, but cannot be reached'
            )
            return
        due = time.monotonic() + AGAIN_AFTER[late.attempts]
        self._late.append(late._replace(due=due, attempts=late.attempts + 1))
        if self._timer is None:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = self._node.create_timer(LOOK_EVERY, self._look, clock=clock)

    def _is_sent(self, late: Late) -> bool:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter('always', RuntimeWarning)
            self._send(late.response, late.header)
        return not any('failed to send response' in str(one.message) for one in said)

    def _look(self) -> None:
        """Try one: an attempt that fails takes 0.1 s, in which nobody else is served."""
        late = min(self._late, key=lambda one: one.due)
        if late.due <= time.monotonic():
            self._late.remove(late)
            self._try(late)
        if not self._late:
            self._stop_looking()

    def _stop_looking(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
