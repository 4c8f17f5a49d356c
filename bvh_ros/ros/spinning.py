# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An executor that outlives what goes wrong: one message too many must not end the node."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from bvh_ros.ros.parts.refusals import explain
from bvh_ros.ros.private_rclpy import guard_taking, spin_once
from bvh_ros.ros.seldom import Seldom

if TYPE_CHECKING:
    from threading import Event

    from rclpy.node import Node


class SturdyExecutor(SingleThreadedExecutor):
    """Serves on where a message or request cannot even be taken, say for want of memory.

    rclpy marks whoever is being served, and where taking fails leaves the mark for ever: no part
    of the node would be called again.
    """

    def __init__(self) -> None:
        super().__init__()
        self._logger = rclpy.logging.get_logger('bvh')
        self._errors = Seldom(lambda text: self._logger.error(text))
        guard_taking(self, self._attempt)

    def spin_until(self, ended: Event, node: Node) -> None:
        """Spin until the event is set and this is woken; what a callback raises is logged."""
        self._logger = node.get_logger()
        self.add_node(node)
        try:
            while not ended.is_set() and self.context.ok():
                self._attempt(spin_once, self, None, ended.is_set)
                self._errors.log()
        finally:
            self.remove_node(node)

    def _attempt(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except ExternalShutdownException:
            raise
        except Exception as error:
            reason = explain(error)
        # The error is gone by now, and with it what it held in memory.
        self._errors.add(reason)
        return None
