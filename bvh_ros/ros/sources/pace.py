# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether large messages come faster than they can be applied in slices."""

from __future__ import annotations

import math


class Pace:
    """Compares a message with the one before it that was about as large or larger."""

    def __init__(self) -> None:
        self._size = 0  # bytes of the last large message
        self._came = -math.inf  # when it came, s
        self._took = 0.0  # s from then to its end, in slices
        self._measured = False  # whether it is in slices, and being applied

    def begin(self, size: int, came: float) -> bool:
        """Whether a message of so many bytes, which came then, has to be applied at once."""
        self._measured = False
        if 2 * size < self._size:
            return False
        hurry = came - self._came < self._took
        self._size, self._came, self._measured = size, came, not hurry
        return hurry

    def end(self, now: float) -> None:
        """Note that the message is applied."""
        if self._measured:
            self._took = now - self._came
