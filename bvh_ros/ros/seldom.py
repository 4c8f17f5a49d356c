# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lines for the log that may come by the thousand. rclpy's own throttle swallows the last one."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

LOG_EVERY = 2.0  # seconds


class Seldom:
    """Says the latest of several texts, and how many there were.

    Parameters
    ----------
    say : callable
        Takes a line. A function of its own for each severity: rclpy's loggers allow one a place.
    """

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say
        self._text = ''
        self._unsaid = 0
        self._again = -float('inf')

    def add(self, text: str, count: int = 1) -> None:
        """Say this, now or later; never raises."""
        self._text = text
        self._unsaid += count
        self.log()

    def log(self) -> None:
        """Say what is not said yet, if the last line is long enough ago; never raises.

        To be called now and then: what comes last is to be in the log, too.
        """
        if not self._unsaid or time.monotonic() < self._again:
            return
        more = f' ({self._unsaid - 1} more since the last report)' if self._unsaid > 1 else ''
        with contextlib.suppress(Exception):  # there may be no memory to say so
            self._say(self._text + more)
        self._unsaid, self._again = 0, time.monotonic() + LOG_EVERY
