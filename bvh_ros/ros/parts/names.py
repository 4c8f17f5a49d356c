# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`~/names`: which obstacle a node handle means."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import serialize_message

from bvh_ros.ros.parts.part import OnDemandPublisher

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.world.world import World

SLICE = 0.01  # seconds after which others get a turn
NAMES_AT_A_TIME = 1024
DONE = object()


class NamesPublisher(OnDemandPublisher):
    """Publishes the handle and name of every obstacle after some came or went.

    The message is put together from bytes that are kept for each obstacle: thousands of KeyValue
    objects a second would stop the queries for tens of milliseconds.
    """

    def __init__(self, node: Node, world: World) -> None:
        super().__init__(node, DiagnosticStatus, '~/names')
        self._world = world
        self._status = f'{node.get_fully_qualified_name().lstrip("/")}: names'
        self._population: tuple[int, int] | None = None
        self._pairs: dict[int, bytes] = {}  # by handle, ascending
        self._work: Iterator[None] | None = None  # a message that is being put together
        self._turn = node.create_guard_condition(self._go_on)
        self._close.append(lambda: node.destroy_guard_condition(self._turn))

    def message(self) -> None:
        """Begin to put together a DiagnosticStatus, unless no obstacle came or went."""
        if self._work is None and self._world.scene.population != self._population:
            self._population = self._world.scene.population
            self._work = self._tell()
            self._go_on()

    def _go_on(self) -> None:
        """Put together some of the message, and the rest after others had their turn."""
        end = time.perf_counter() + SLICE
        while self._work is not None and time.perf_counter() < end:
            if next(self._work, DONE) is DONE:
                self._work = None
        if self._work is not None:
            self._turn.trigger()

    def _tell(self) -> Iterator[None]:
        handles, slots = self._world.scene.newcomers(next(reversed(self._pairs), 0))
        for begin in range(0, len(handles), NAMES_AT_A_TIME):
            some = slice(begin, begin + NAMES_AT_A_TIME)
            for handle, name in self._world.scene.names_still_there(handles[some], slots[some]):
                self._pairs[handle] = pair(handle, name)
            yield
        known = np.fromiter(self._pairs, np.int64, len(self._pairs))
        for handle in known[~np.isin(known, self._world.scene.handles())].tolist():
            del self._pairs[handle]
        yield
        head = DiagnosticStatus(name=self._status, message=f'{len(self._pairs)} obstacles')
        # What is serialised ends with the number of values: none so far.
        before = serialize_message(head)[:-4]
        count = struct.pack('=I', len(self._pairs))
        self.send(b''.join((before, count, *self._pairs.values())))


def pair(handle: int, name: str) -> bytes:
    """Return a KeyValue as CDR, filled up to a multiple of four bytes as the next one needs."""
    return _string(str(handle)) + _string(name)


def _string(text: str) -> bytes:
    characters = text.encode() + b'\0'
    return struct.pack('=I', len(characters)) + characters + bytes(-len(characters) % 4)
