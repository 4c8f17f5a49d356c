# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Room that questions write to, and that is kept for the next ones."""

from collections.abc import Callable
from typing import Generic, TypeVar

Room = TypeVar('Room')


class Spare(Generic[Room]):
    """Rooms that nobody uses. Who asks takes one, and gives it back when all that was written
    there is read (or loses it to an error, and it is gone). A thread's own would not do: a signal
    handler, or what collects garbage, asks in the middle of another question of its thread.
    """

    def __init__(self, make: Callable[[], Room]) -> None:
        self._make = make
        self._free: list[Room] = []
        self.give = self._free.append

    def take(self) -> Room:
        """A room that is nobody else's."""
        try:
            return self._free.pop()  # one step: no other thread gets the same
        except IndexError:
            return self._make()
