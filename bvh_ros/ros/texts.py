# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Texts in log lines and errors, how often they are logged; what was refused, what it took."""

from __future__ import annotations

import contextlib
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import islice
from typing import NamedTuple, Protocol

from bvh_ros.scene import Refusal

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


# What was refused, how often and why: counted, logged without flooding, shown in diagnostics.

LISTED = 100  # refused rows that are kept with their reasons, the latest


def explain(error: Exception) -> str:
    """Return what went wrong inside; never raises."""
    if isinstance(error, MemoryError):
        return 'there is not enough memory'
    try:
        return f'internal error: {error!r}'
    except Exception:  # from its own text
        return f'internal error: {type(error).__name__}'


def why(error: Exception) -> str:
    """Return why something is not done: a ValueError says so, all else went wrong inside."""
    return str(error) if isinstance(error, ValueError) else explain(error)


class Logger(Protocol):
    """The part of a rclpy logger that is used here."""

    def warning(self, message: str) -> object:
        """Log a warning."""


class Refused:
    """Counts refusals of one kind and remembers the last reason.

    Parameters
    ----------
    what : str
        What was refused, as the log says it: `query`, `source 'markers'`.
    """

    def __init__(self, logger: Logger, what: str) -> None:
        self.count = 0
        self.last = ''
        self._rows: deque[str] = deque(maxlen=LISTED)
        self._row_count = 0
        self._seldom = Seldom(lambda reason: logger.warning(f'{what} refused: {reason}'))

    def add(self, reason: str, count: int = 1) -> None:
        """Count `count` refusals for one reason; never raises."""
        self.count += count
        self.last = shortened(reason, LONGEST_LINE)
        self._seldom.add(self.last, count)

    def log(self) -> None:
        """Log what is not logged yet; to be called now and then."""
        self._seldom.log()

    def add_rows(self, refusals: Sequence[Refusal]) -> None:
        """Count the rows of an update that were refused."""
        if refusals:
            self._row_count += len(refusals)
            lines = [_in_words(refusal) for refusal in islice(refusals, LISTED)]
            self._rows.extend(lines)
            self.add(lines[0], len(refusals))

    def rows(self) -> dict[str, object]:
        """Return the latest rows with their reasons, and how many are not among them."""
        return {
            'refused rows': '\n'.join(self._rows),
            'refused rows not listed': self._row_count - len(self._rows),
        }


def _in_words(refusal: Refusal) -> str:
    what = f"'{shortened(refusal.name)}'" if refusal.name else f'row {refusal.row}'
    return shortened(f'{what}: {refusal.reason}', LONGEST_LINE)


# How long things took, and how often they were done, for diagnostics.

MOST = 4096  # durations kept between two looks; of more, the latest


class Summary(NamedTuple):
    """What happened since the last look."""

    rate: float  # a second
    median: float  # ms, NaN if nothing happened
    p99: float  # ms
    longest: float  # ms


class Timings:
    """Durations between two looks."""

    def __init__(self) -> None:
        self.durations: deque[int] = deque(maxlen=MOST)
        self._count = 0
        self._longest = 0
        self._since = time.monotonic()

    def add(self, began: int) -> None:
        """Note that something that began at `began` (time.perf_counter_ns) is done."""
        took = time.perf_counter_ns() - began
        self.durations.append(took)
        self._count += 1
        self._longest = max(self._longest, took)

    def look(self) -> Summary:
        """Return what happened since the last look, and begin anew."""
        now = time.monotonic()
        rate = self._count / max(now - self._since, 1e-9)
        ordered = sorted(self.durations)
        median, p99 = (_quantile(ordered, share) for share in (0.5, 0.99))
        summary = Summary(rate, median, p99, self._longest / 1e6 if ordered else float('nan'))
        self.durations.clear()
        self._count, self._longest, self._since = 0, 0, now
        return summary


def _quantile(ordered: list[int], share: float) -> float:
    """The smallest duration (ms) that at least this share does not exceed."""
    if not ordered:
        return float('nan')
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)] / 1e6
