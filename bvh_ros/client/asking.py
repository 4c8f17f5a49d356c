# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Asking a question again until an answer comes: packets get lost on a bad link."""

from __future__ import annotations

import time
from collections.abc import Callable

LEAST = 0.02  # seconds between asking for the first and for the second time, ...
MOST = 1.0  # ... at least and at most
GROWTH = 1.5  # of this time, from one repetition to the next, ...
GROWN = 10.0  # ... up to so many times


class Patience:
    """Seconds after which an answer counts as lost: the retransmission timer of RFC 6298.

    It follows the times in which answers have come, so that a busy node is not asked again and
    again while its answers are only late.
    """

    def __init__(self) -> None:
        self._mean = self._deviation = 0.0

    @property
    def seconds(self) -> float:
        """How long to wait before the second request."""
        return min(max(self._mean + 4.0 * self._deviation, LEAST), MOST)

    def learn(self, seconds: float) -> None:
        """Take into account that an answer came so long after its request."""
        if self._mean == 0.0:
            self._mean, self._deviation = seconds, 0.5 * seconds
        self._deviation += (abs(seconds - self._mean) - self._deviation) / 4.0
        self._mean += (seconds - self._mean) / 8.0


class Question:
    """A question on its way. Whoever waits for the answer calls `ask_if_due` now and then.

    Parameters
    ----------
    ask : callable
        Sends the request for the n-th time, from 0.
    patience : Patience
        Of the questions of this kind.
    work : float
        Seconds that the answer may take beside.
    """

    def __init__(self, ask: Callable[[int], None], patience: Patience, work: float = 0.0) -> None:
        self._ask, self._patience, self._work = ask, patience, work
        self._count, self._asked, self._due = 0, 0.0, 0.0

    def ask_if_due(self) -> float:
        """Ask, if it is time to; return the seconds until the next time."""
        now = time.monotonic()
        if now >= self._due:
            wait = self._patience.seconds * min(GROWTH**self._count, GROWN)
            self._asked, self._due = now, now + wait + self._work
            self._ask(self._count)
            self._count += 1
        return max(self._due - now, 0.0)

    def answered(self) -> None:
        """Learn how long the answer took, since the latest request."""
        self._patience.learn(max(time.monotonic() - self._asked - self._work, 0.0))
