# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How many obstacles a node has, and between which corners, as its diagnostics tell."""

from __future__ import annotations

import time
from typing import NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from bvh_ros.ros.parts.diagnostics import HIGHEST, LOWEST

Vector = tuple[float, float, float]


class Extent(NamedTuple):
    """Where the obstacles are."""

    number: int
    low: Vector
    high: Vector

    def middle(self) -> Vector:
        """The point halfway."""
        x, y, z = (0.5 * (low + high) for low, high in zip(self.low, self.high, strict=True))
        return x, y, z

    def in_words(self) -> str:
        """Say how many there are, and where."""
        low, high = (
            '({:.1f}, {:.1f}, {:.1f})'.format(*corner) for corner in (self.low, self.high)
        )
        return f'{self.number} obstacles between {low} and {high}'


class Watch:
    """Listens to the diagnostics of one node, on a node of its own.

    Parameters
    ----------
    node : rclpy.node.Node
        Gives the context and the namespace.
    name : str
        Of the bvh node, in that namespace or with its own.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.extent: Extent | None = None  # as last reported; None while there are no obstacles
        self._node = rclpy.create_node('watch', namespace=node.get_namespace())
        self._status = f'{self._node.resolve_service_name(name).lstrip("/")}: world'
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._same = 0  # times in a row that nothing had changed
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._receive, 10)

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()

    def wait(self, until: float) -> None:
        """Listen until then (time.monotonic), and at least to what waits."""
        self._executor.spin_once(0.0)
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(left)

    def until_quiet(self, timeout: float) -> None:
        """Listen until there are obstacles and they do not change any more."""
        deadline = time.monotonic() + timeout
        self._same = 0
        while self._same < 2 and time.monotonic() < deadline:
            self._executor.spin_once(0.1)

    def _receive(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._status:
                values = {pair.key: pair.value for pair in status.values}
                extent = _extent(values)
                self._same = self._same + 1 if extent is not None and extent == self.extent else 0
                self.extent = extent


def _extent(values: dict[str, str]) -> Extent | None:
    if LOWEST not in values:
        return None
    low, high = ([float(text) for text in values[key].split(',')] for key in (LOWEST, HIGHEST))
    return Extent(int(values['obstacles']), _vector(low), _vector(high))


def _vector(corner: list[float]) -> Vector:
    x, y, *rest = corner
    return x, y, rest[0] if rest else 0.0
