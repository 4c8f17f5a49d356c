# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that are worked for only while somebody listens."""

from __future__ import annotations

import time
from abc import abstractmethod
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile

from bvh_ros.ros.parts.part import NodePart

if TYPE_CHECKING:
    from rclpy.node import Node

PERIOD = 1.0  # seconds
TELL = 2  # times that a newcomer is told: it may find us a moment after we found it


class OnDemandPublisher(NodePart):
    """Publishes at most once a second, latched, and only while there are subscribers.

    What is latched reaches only who asks for it. Others would wait until something changes: when
    somebody new subscribes, the last message is published again.
    """

    def __init__(self, node: Node, kind: type, topic: str) -> None:
        super().__init__(node)
        self.is_watched = False
        self._published_at = -PERIOD
        self._last: Any = None
        self._to_tell = 0  # times that the last message is still to be said again
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self._publish, clock=steady, autostart=False)
        self._close.append(partial(node.destroy_timer, self._timer))
        self._publisher = self.publisher(
            kind,
            topic,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
            event_callbacks=PublisherEventCallbacks(matched=self._on_matched),
        )

    @abstractmethod
    def message(self) -> Any:
        """Return the next message, or its bytes; None if there is nothing new."""

    def _on_matched(self, status: Any) -> None:
        if status.current_count == 0:
            self.is_watched = False
            self._timer.cancel()
            return
        if status.current_count_change > 0:
            self._to_tell = TELL
        if not self.is_watched:
            self.is_watched = True
            self._timer.reset()
            if time.monotonic() - self._published_at >= PERIOD:
                self._publish()

    def _publish(self) -> None:
        message = self.message()
        if message is None and self._to_tell > 0:
            message = self._last
        if message is not None:
            self.send(message)

    def send(self, message: Any) -> None:
        """Publish a message, which is the newest from now on."""
        self._to_tell -= self._to_tell > 0
        self._last = message
        self._published_at = time.monotonic()
        self._publisher.publish(message)
