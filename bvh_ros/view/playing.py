# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A world by a clock of its own: it can be played, paused and stepped through."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Hashable, Iterator

from bvh_ros.scene import Scene
from bvh_ros.view.worlds import ShownWorld

SECOND = 1_000_000_000  # ns
MOST_PASSED = 0.5  # seconds: what takes longer to show is not caught up with

Moment = tuple[float, Callable[[int], object]]  # s, and what happens then; takes that time in ns


class Recording(ShownWorld):
    """A world that goes on as it was recorded, by its own clock.

    Attributes
    ----------
    t : float
        Seconds since the beginning.
    seconds : float
        How long it is.
    playing : bool
        At the end it begins anew.
    speed : float
        Times real time.
    """

    def __init__(self, title: str, scene: Scene, seconds: float) -> None:
        super().__init__(title, scene)
        self.t, self.seconds = 0.0, seconds
        self.playing, self.speed = True, 1.0
        self._happened = 0  # moments
        self._began = 0  # times
        self._shown_at = time.monotonic()
        self._next: Moment | None = None
        self._moments: Iterator[Moment] = iter(())

    @abstractmethod
    def moments(self) -> Iterator[Moment]:
        """Yield what happens, from the beginning, when the world is empty."""

    @abstractmethod
    def clear(self) -> None:
        """Empty the world."""

    def restart(self) -> None:
        """Go to the first moment."""
        self.clear()
        self._began += 1
        self.t, self._moments = 0.0, self.moments()
        self._next = next(self._moments, None)
        self.seek(0.0)

    def seek(self, t: float) -> None:
        """Go to a time; backwards means from the beginning."""
        if t < self.t:
            self.restart()
        self.t = t
        while self._next is not None and self._next[0] <= t:
            when, happen = self._next
            happen(round(when * SECOND))
            self._happened += 1
            self._next = next(self._moments, None)
        self.scene.expire(round(t * SECOND))

    def step(self) -> None:
        """Pause, and go to the next moment, from the last to the first."""
        self.playing = False
        if self._next is None:
            self.restart()
        else:
            self.seek(self._next[0])

    def advance(self, until: float) -> None:
        """Play on."""
        super().advance(until)
        passed, self._shown_at = time.monotonic() - self._shown_at, time.monotonic()
        if self.playing and self._next is None:
            self.restart()
        elif self.playing:
            self.seek(self.t + self.speed * min(passed, MOST_PASSED))

    def version(self) -> Hashable:
        """Another one after each moment."""
        return self._began, self._happened, self.scene.expired

    def now(self) -> int:
        """Return the time in the recording."""
        return round(self.t * SECOND)
