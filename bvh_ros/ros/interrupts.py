# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM end the node quietly and soon, whatever it is doing."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PATIENCE = 0.5  # seconds that a callback which is running gets to come to its end


class Interrupts:
    """Notes SIGINT and SIGTERM, and while the node starts ends the process at once.

    To be made before `rclpy.init`, which has to install no handlers of its own: they shut ROS down
    below whatever callback is running, and what that publishes or logs then fails. Spinning ends
    after the callback instead. Where that takes longer, a thread ends the process: Python's own
    handlers wait for the callback, too.

    Attributes
    ----------
    received : threading.Event
        Set by the first signal.
    wake : callable
        What ends a wait for messages. It is called in another thread, after `received` is set.
    """

    def __init__(self) -> None:
        self.received = threading.Event()
        self.wake: Callable[[], None] = lambda: None
        self._starting = False
        self._heard, self._told = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        os.set_blocking(self._heard, True)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
        # The number of every signal is written there as soon as it comes.
        signal.set_wakeup_fd(self._told, warn_on_full_buffer=False)
        threading.Thread(target=self._end_soon, name='interrupts', daemon=True).start()

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

    def end_if_received(self) -> None:
        """End the process after a signal, without Python's own end: that takes a second."""
        if self.received.is_set():
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)

    def _on_signal(self, _number: int, _frame: object) -> None:
        if self._starting:
            os._exit(0)

    def _end_soon(self) -> None:
        wanted = signal.SIGINT, signal.SIGTERM
        while os.read(self._heard, 1)[0] not in wanted:
            pass
        self.received.set()
        self.wake()
        time.sleep(PATIENCE)
        os._exit(0)
