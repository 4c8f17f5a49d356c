# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The memory of a process over time."""

import time
from pathlib import Path

import numpy as np

from ..plots import Line

WARM_UP = 0.5  # of the run: what is allocated once is not growth


class Memory:
    """Samples the resident memory of a process, on Linux.

    Parameters
    ----------
    pid : int
        The process.
    """

    def __init__(self, pid: int) -> None:
        self._status = Path(f'/proc/{pid}/status')
        self._began = time.monotonic()
        self._seconds: list[float] = []
        self._megabytes: list[float] = []

    def look(self) -> None:
        """Sample once; FileNotFoundError if the process has ended."""
        for line in self._status.read_text(encoding='ascii').splitlines():
            if line.startswith('VmRSS:'):
                self._seconds.append(time.monotonic() - self._began)
                self._megabytes.append(int(line.split()[1]) / 1024)

    def minutes(self) -> float:
        """How long this process has been watched."""
        return self._seconds[-1] / 60.0

    def last(self) -> float:
        """MB now."""
        return self._megabytes[-1]

    def after_warm_up(self) -> float:
        """MB when the growth begins to count."""
        return self._megabytes[int(WARM_UP * len(self._megabytes))]

    def growth(self) -> float:
        """MB an hour: slope of a straight line through all after the warm-up (least squares)."""
        first = int(WARM_UP * len(self._megabytes))
        if len(self._megabytes) - first < 2:
            return 0.0
        slope, _ = np.polyfit(self._seconds[first:], self._megabytes[first:], 1)
        return float(3600.0 * slope)

    def curve(self) -> Line:
        """Minutes and MB."""
        return Line([second / 60.0 for second in self._seconds], self._megabytes)
