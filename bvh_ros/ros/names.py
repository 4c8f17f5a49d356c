# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`~/names`: which obstacle a node handle means."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import serialize_message

from bvh_ros.ros.watched import Watched

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.scene import Scene


class NamesPublisher(Watched):
    """Publishes the handle and name of every obstacle after some came or went.

    The message is put together from bytes that are kept for each obstacle: thousands of KeyValue
    objects a second would stop the queries for tens of milliseconds.

    Parameters
    ----------
    node : rclpy.node.Node
    scene : Scene
    """

    def __init__(self, node: Node, scene: Scene) -> None:
        super().__init__(node, DiagnosticStatus, '~/names')
        self._scene = scene
        self._status = f'{node.get_fully_qualified_name().lstrip("/")}: names'
        self._population: tuple[int, int] | None = None
        self._pairs: dict[int, bytes] = {}  # by handle, ascending

    def message(self) -> bytes | None:
        """Return the serialised DiagnosticStatus, or None if nobody came or went."""
        if self._scene.population == self._population:
            return None
        self._population = self._scene.population
        newest = next(reversed(self._pairs), 0)
        fresh = {handle: pair(handle, name) for handle, name in self._scene.names(after=newest)}
        known = self._pairs | fresh
        self._pairs = {handle: known[handle] for handle in self._scene.handles().tolist()}
        head = DiagnosticStatus(name=self._status, message=f'{len(self._pairs)} obstacles')
        # What is serialised ends with the number of values: none so far.
        before = serialize_message(head)[:-4]
        return b''.join((before, struct.pack('=I', len(self._pairs)), *self._pairs.values()))


def pair(handle: int, name: str) -> bytes:
    """Return a KeyValue as CDR, filled up to a multiple of four bytes as the next one needs."""
    return _string(str(handle)) + _string(name)


def _string(text: str) -> bytes:
    characters = text.encode() + b'\0'
    return struct.pack('=I', len(characters)) + characters + bytes(-len(characters) % 4)
