# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long something takes, and how often it happens."""

from __future__ import annotations

import math
import time
from collections import deque
from typing import NamedTuple

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
        self._durations: deque[int] = deque(maxlen=MOST)
        self._count = 0
        self._longest = 0
        self._since = time.monotonic()

    def add(self, began: int) -> None:
        """Note that something that began at `began` (time.perf_counter_ns) is done."""
        took = time.perf_counter_ns() - began
        self._durations.append(took)
        self._count += 1
        self._longest = max(self._longest, took)

    def look(self) -> Summary:
        """Return what happened since the last look, and begin anew."""
        now = time.monotonic()
        rate = self._count / max(now - self._since, 1e-9)
        ordered = sorted(self._durations)
        median, p99 = (_quantile(ordered, share) for share in (0.5, 0.99))
        summary = Summary(rate, median, p99, self._longest / 1e6 if ordered else float('nan'))
        self._durations.clear()
        self._count, self._longest, self._since = 0, 0, now
        return summary


def _quantile(ordered: list[int], share: float) -> float:
    """The smallest duration (ms) that at least this share does not exceed."""
    if not ordered:
        return float('nan')
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)] / 1e6
