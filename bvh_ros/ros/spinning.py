# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An executor that outlives what goes wrong: one message too many must not end the node."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.event_handler import EventHandler
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.timer import Timer

from bvh_ros.ros.parts.refusals import explain
from bvh_ros.ros.private_rclpy import guard_taking, spin_once
from bvh_ros.ros.seldom import Seldom

if TYPE_CHECKING:
    from threading import Event

    from rclpy.node import Node

EVENTS_EVERY = 0.1  # seconds: what publishers and subscribers ask of each other can wait
ALL_EVENTS = 0.001  # seconds


class SturdyExecutor(SingleThreadedExecutor):
    """Serves on where a message or request cannot even be taken, say for want of memory.

    rclpy marks whoever is being served, and where taking fails leaves the mark for ever: no part
    of the node would be called again.
    """

    def __init__(self) -> None:
        super().__init__()
        self.resting: set[object] = set()  # entities that wake nobody for a while
        self._events_seen = 0.0  # s
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

    def can_execute(self, entity: Any) -> bool:
        """Return whether the next round waits for this entity, too.

        Each one costs a round 4 us, and there are some eighty. So rounds leave out what is not to
        wake anybody: what rests, timers that are stopped and, most of the time, events.
        """
        if (
            entity in self.resting
            or (isinstance(entity, EventHandler) and not self._looks_at_events())
            or (isinstance(entity, Timer) and entity.is_canceled())
        ):
            return False
        return bool(super().can_execute(entity))

    def _looks_at_events(self) -> bool:
        """Now and then, for as long as a round takes to ask for all of them."""
        now = time.monotonic()
        if now - self._events_seen >= EVENTS_EVERY:
            self._events_seen = now
        return now - self._events_seen < ALL_EVENTS

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
