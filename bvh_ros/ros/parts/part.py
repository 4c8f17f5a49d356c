# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A part of the node: what it opened on the node goes away with it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockType

from bvh_ros.ros.parts.replies import Replies
from bvh_ros.ros.qos import REPEATED, REQUESTS

if TYPE_CHECKING:
    from rclpy.node import Node


class NodePart:
    """Opens services, topics and timers on a node, and closes them again.

    Parameters
    ----------
    node : rclpy.node.Node
        Any node, managed or not.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self._close: list[Callable[[], object]] = []

    def service(self, kind: type, name: str, callback: Callable[..., Any], **given: Any) -> Any:
        """Create a service that lives as long as this part."""
        service = self.node.create_service(kind, name, callback, qos_profile=REQUESTS, **given)
        self._close += [
            partial(self.node.destroy_service, service),
            Replies(self.node, service).close,
        ]
        return service

    def repeated_service(self, kind: type, name: str, callback: Callable[..., Any]) -> None:
        """Create a best-effort service; its clients ask again if a reply is lost."""
        service = self.node.create_service(kind, name, callback, qos_profile=REPEATED)
        self._close.append(partial(self.node.destroy_service, service))

    def publisher(self, kind: type, topic: str, qos: Any, **given: Any) -> Any:
        """Create a publisher that lives as long as this part."""
        publisher = self.node.create_publisher(kind, topic, qos, **given)
        self._close.append(partial(self.node.destroy_publisher, publisher))
        return publisher

    def every(self, period: float, callback: Callable[[], Any]) -> None:
        """Call back every `period` seconds of real time, as long as this part lives.

        With simulated time, too: the callback has to run while nobody publishes /clock.
        """
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.node.create_timer(period, callback, clock=clock)
        self._close.append(partial(self.node.destroy_timer, timer))

    def destroy(self) -> None:
        """Close what was opened, the last first. Doing so twice does nothing more."""
        while self._close:
            self._close.pop()()
