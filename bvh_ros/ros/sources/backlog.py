# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that wait: every change is needed, but of those that say everything only the newest.

A publisher of large clouds that is faster than the node must make it neither late nor large.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

TOGETHER = 64  # messages
KEPT = 10  # messages that say everything; the newest may yet be refused


class Backlog:
    """A queue that drops what newer messages make needless.

    Parameters
    ----------
    says_everything : callable
        Whether a message does.
    joins : callable
        Takes a message and what belongs to it; whether it may be handed over with those before.
    """

    def __init__(
        self, says_everything: Callable[[Any], bool], joins: Callable[[Any, Any], bool]
    ) -> None:
        self.superseded = 0
        self._says_everything = says_everything
        self._joins = joins
        self._waiting: deque[tuple[Any, Any, bool]] = deque()
        self._whole = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, message: Any, more: Any) -> None:
        """Append a message, with what belongs to it."""
        whole = self._says_everything(message)
        self._waiting.append((message, more, whole))
        self._whole += whole
        while self._whole > KEPT or (self._whole == KEPT and not self._waiting[0][2]):
            self.superseded += 1
            self._whole -= self._waiting.popleft()[2]

    def next(self) -> tuple[list[Any], Any]:
        """Take out the oldest message and those that join it, and what belongs to the oldest."""
        message, more, whole = self._waiting.popleft()
        self._whole -= whole
        messages = [message]
        while self._waiting and len(messages) < TOGETHER and self._joins(*self._waiting[0][:2]):
            message, _, whole = self._waiting.popleft()
            self._whole -= whole
            messages.append(message)
        return messages, more
