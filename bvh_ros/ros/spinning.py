# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An executor that outlives what goes wrong: one message too many must not end the node."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from bvh_ros.ros.parts.refusals import explain
from bvh_ros.ros.private_rclpy import spin_once

if TYPE_CHECKING:
    from threading import Event

    from rclpy.node import Node

LOG_EVERY = 2.0  # seconds


class SturdyExecutor(SingleThreadedExecutor):
    """Serves on where a message or request cannot even be taken, say for want of memory.

    rclpy marks whoever is being served, and where taking fails leaves the mark for ever: no part
    of the node would be called again.
    """

    def __init__(self) -> None:
        super().__init__()
        self._logger = rclpy.logging.get_logger('bvh')

    def spin_until(self, ended: Event, node: Node) -> None:
        """Spin until the event is set and this is woken; what a callback raises is logged."""
        self._logger = node.get_logger()
        self.add_node(node)
        try:
            while not ended.is_set() and self.context.ok():
                self._attempt(spin_once, self, None, ended.is_set)
        finally:
            self.remove_node(node)

    def _take_subscription(self, sub: Any) -> Any:
        return self._attempt(super()._take_subscription, sub)

    def _take_service(self, srv: Any) -> Any:
        return self._attempt(super()._take_service, srv)

    def _take_waitable(self, waitable: Any) -> Any:
        return self._attempt(super()._take_waitable, waitable)

    def _attempt(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except ExternalShutdownException:
            raise
        except Exception as error:
            reason = explain(error)
        # The error is gone by now, and with it what it held in memory.
        with contextlib.suppress(Exception):  # there may be no memory for that either
            self._logger.error(reason, throttle_duration_sec=LOG_EVERY)
        return None
