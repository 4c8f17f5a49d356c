# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for an answer, whoever spins the node."""

from __future__ import annotations

import threading
import time

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future


class Waiting:
    """Waits for futures, whether the node is being spun in another thread or not at all."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._executor: SingleThreadedExecutor | None = None
        self._spinning = threading.Lock()

    def until_done(self, answer: Future, timeout: float) -> bool:
        """Return whether the answer came within `timeout` seconds."""
        executor = self._node.executor
        if executor is None or executor is self._executor:
            self._spin_until(answer, timeout)
        else:
            arrived = threading.Event()
            answer.add_done_callback(lambda _answer: arrived.set())
            arrived.wait(timeout)
        return bool(answer.done())

    def _spin_until(self, answer: Future, timeout: float) -> None:
        """Spin the node ourselves; nobody else does.

        The executor is kept: adding the node to one for each call costs ten times the call. Nor is
        its `spin_until_future_complete` used, which leaves more tasks behind than it runs, so that
        each call takes longer than the one before.
        """
        deadline = time.monotonic() + timeout
        with self._spinning:
            if self._executor is None:
                self._executor = SingleThreadedExecutor(context=self._node.context)
            self._executor.add_node(self._node)
            while not answer.done() and (left := deadline - time.monotonic()) > 0.0:
                self._executor.spin_once(left)
