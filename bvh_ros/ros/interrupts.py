# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM end the node quietly, whatever it is doing."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager


class Interrupts:
    """Notes SIGINT and SIGTERM, and while the node starts ends the process at once.

    To be made before `rclpy.init`, whose own handlers end the spinning and then call this one.
    """

    def __init__(self) -> None:
        self.received = False
        self._starting = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    @contextmanager
    def while_starting(self) -> Iterator[None]:
        """End the process at once: kernels take seconds, and the compiler swallows exceptions.

        Nobody has been promised anything yet, and nothing is left half done, because kernels
        reach their cache by renaming whole files.
        """
        self._starting = True
        try:
            yield
        finally:
            self._starting = False

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.received = True
        if self._starting:
            os._exit(0)
