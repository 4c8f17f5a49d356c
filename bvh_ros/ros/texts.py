# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Texts in log lines and errors, and how often they are logged."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

LONGEST_NAME = 80  # characters
LONGEST_LINE = 500


def shortened(text: str, most: int = LONGEST_NAME) -> str:
    """Return a text that fits into a line: its beginning, and how long it was, if it is longer.

    >>> shortened('a' * 1000, 4)
    'aaaa... (1000 characters)'
    """
    begin = text[:most]
    if not begin.isprintable():
        begin = repr(begin)[1:-1]
    return begin if len(text) <= most else f'{begin}... ({len(text)} characters)'


def as_line(error: Exception) -> str:
    """Return what an exception says, in one line."""
    return shortened(' '.join(str(error)[: 2 * LONGEST_LINE].split()), LONGEST_LINE)


def seconds(ns: int) -> str:
    """Return a time of at least 0 in seconds, to the last nanosecond: what is too late by one is.

    >>> seconds(1_500_000_001), seconds(1_500_000_000), seconds(0)
    ('1.500000001', '1.5', '0')
    """
    whole, rest = divmod(ns, 1_000_000_000)
    return f'{whole}.{rest:09d}'.rstrip('0').rstrip('.')


# Lines for the log that may come by the thousand. rclpy's own throttle swallows the last one.

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
