# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shows how far compiling has come: a bar on a terminal, else a line now and then."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from bvh_ros.ros.compilation import Compilation

WIDTH = 24  # characters of the bar
EVERY = 60.0  # seconds between two lines
CLEAR = '\r\x1b[K'


class Progress:
    """Tells people what they wait for.

    Parameters
    ----------
    say : callable
        Takes a line, where there is no terminal.
    terminal : text file, optional
        By default standard error, if that is one.
    """

    def __init__(self, say: Callable[[str], object], terminal: TextIO | None = None) -> None:
        self._say = say
        if terminal is None and sys.stderr.isatty():
            terminal = sys.stderr
        self._terminal = terminal
        self._said_at = time.monotonic()
        self._began = self._said_at

    def begin(self, compilation: Compilation) -> None:
        """Say what is about to happen, if there is something to wait for."""
        if compilation.seconds:
            self._said_at = time.monotonic()
            self._say(
                f'first start here: compiling, about {compilation.time_left():.0f} s; later '
                'starts take a second or two'
            )

    def show(self, compilation: Compilation) -> None:
        """Show it as it is now."""
        if self._terminal is not None:
            columns = shutil.get_terminal_size().columns
            self._terminal.write(CLEAR + _bar(compilation)[: columns - 1])
            self._terminal.flush()
        elif time.monotonic() - self._said_at > EVERY:
            self._said_at = time.monotonic()
            self._say(compilation.in_words())

    def end(self, compilation: Compilation) -> None:
        """Say that it is done."""
        if self._terminal is not None:
            self._terminal.write(CLEAR)
            self._terminal.flush()
        if compilation.seconds:
            self._say(f'compiled in {time.monotonic() - self._began:.0f} s')


def _bar(compilation: Compilation) -> str:
    filled = WIDTH * compilation.percent() // 100
    return f'[{"#" * filled}{"." * (WIDTH - filled)}] {compilation.in_words()}'
