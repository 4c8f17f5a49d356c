# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiling what a configuration needs, in several processes, and how far that has come."""

from __future__ import annotations

import gc
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from typing import TextIO

from bvh_ros.ros.compile_jobs import Job
from bvh_ros.tree.compiler import Workers, fork_ahead, kernel_cache

AT_LEAST = 0.05  # of a job is left, however long it runs


def prepare() -> None:
    """Fork processes that compile, if this is a first start: before ROS has threads."""
    if kernel_cache.is_first_use():
        fork_ahead()


class Compilation:
    """Runs jobs, first where they are compiled, then here, where what was compiled is loaded.

    Where all of it has been compiled before, or cannot be kept, it is run here only.

    Parameters
    ----------
    jobs : sequence of Job
        Those that the first answers wait for come first.
    count : int, optional
        Of processes; by default one a processor.
    """

    def __init__(self, jobs: Sequence[Job], count: int = 0) -> None:
        self._began = time.monotonic()
        self._percent = 0
        self._left = {*range(len(jobs))}
        self._jobs = jobs
        missing = [n for n in self._left if not kernel_cache.is_noted(jobs[n].key)]
        self.seconds = sum(jobs[n].seconds for n in missing)  # about, on one processor
        self._missing = sorted(missing)
        self._workers: Workers | None = None
        if missing and kernel_cache.cache_folder() is not None:
            self._workers = Workers([jobs[n].run for n in self._missing], count)

    @property
    def is_done(self) -> bool:
        """Whether every kernel is here."""
        return not self._left

    @property
    def has_begun_to_answer(self) -> bool:
        """Whether what the first answers need is here."""
        return not any(self._jobs[n].early for n in self._left)

    def go_on(self, timeout: float = 0.0) -> None:
        """Load what has been compiled since; wait for something at most so many seconds."""
        if self.is_done:
            return
        if self._workers is None:
            self._run(min(self._left))
            return
        for number in sorted(self._left - {*self._missing}):
            self._run(number)
        for index, _reason in self._workers.ended(timeout):
            self._run(self._missing[index])  # compiles what failed there, or raises why

    def end(self) -> None:
        """Leave the rest."""
        if self._workers is not None:
            self._workers.end()

    def percent(self) -> int:
        """How far it has come; never less than before."""
        if not self._missing or self.is_done:
            return 100
        used, remaining = sum(self._used().values()), sum(self._remaining().values())
        self._percent = max(self._percent, int(100.0 * used / (used + remaining)))
        return self._percent

    def time_left(self) -> float:
        """About how many seconds are left, by the pace up to now."""
        remaining = self._remaining()
        if not remaining:
            return 0.0
        count = self._workers.count if self._workers else 1
        left = max(sum(remaining.values()) / count, *remaining.values())
        used = sum(self._used().values()) / count
        spent = time.monotonic() - self._began
        return left * (spent / used if used > 1.0 else 1.0)

    def in_words(self) -> str:
        """Say all of this in a line."""
        left = self.time_left()
        return f'compiling: {self.percent()} %, about {left:.0f} s left ({self.current()})'

    def current(self) -> str:
        """What is being compiled."""
        return ', '.join(self._jobs[n].name for n in self._running())

    def _running(self) -> list[int]:
        if self._workers is None:
            return sorted(self._left)[:1]
        return [self._missing[index] for index in self._workers.running]

    def _used(self) -> dict[int, float]:
        """Processor seconds of each job that was begun elsewhere."""
        used = self._workers.used() if self._workers else {}
        return {self._missing[index]: seconds for index, seconds in used.items()}

    def _remaining(self) -> dict[int, float]:
        """About how many processor seconds each job still takes, if all are as much slower than
        expected as the slowest one up to now.
        """
        used = self._used()
        slower = max([1.0, *(used[n] / self._jobs[n].seconds for n in used)])
        remaining = {}
        for number in self._left & {*self._missing}:
            seconds, spent = slower * self._jobs[number].seconds, used.get(number, 0.0)
            remaining[number] = max(seconds - spent, AT_LEAST * seconds)
        return remaining

    def _run(self, number: int) -> None:
        self._jobs[number].run()
        # A full collection of garbage goes through all that the compiler holds: 0.1 s, in which
        # the node answers nobody. That is there for good.
        gc.freeze()
        if number in self._missing:
            kernel_cache.note(self._jobs[number].key)
        self._left.discard(number)


# Shows how far compiling has come: a bar on a terminal, else a line now and then.

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
