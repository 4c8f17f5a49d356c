# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Earlier states of the world: a copy of the scene after each message, as far as is wanted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from bvh_ros.ros.sources.source import Source
    from bvh_ros.ros.world.large_changes import LargeChanges
    from bvh_ros.scene import Scene

COPIED_AT_ONCE = 10_000  # obstacles, some 5 ms


class Past:
    """Keeps what was known when.

    Parameters
    ----------
    changes : LargeChanges
        Has the scene.
    history : float
        So much of the past (s) is kept; 0: nothing, and nothing is copied.
    """

    def __init__(self, changes: LargeChanges, history: float) -> None:
        self._changes = changes
        self._kept: list[tuple[int, Scene]] = []  # newest stamp included, ns, and what was known
        self.length = round(history * 1e9)

    def note(self, source: Source, now: int) -> Iterator[None]:
        """Keep the scene as it is after a message of a source that came at `now` (ns on the node's
        clock); forget what is too old. Pause while a large scene is copied.
        """
        scene = self._changes.visible
        if not self.length or scene.interrupted:
            return
        if len(scene) < COPIED_AT_ONCE:
            copy = scene.copy()
        else:
            copy = yield from self._changes.read(source, scene.copy)
        stamp = min(copy.newest, now)  # no data are newer than now, whatever they say
        if self._kept and self._kept[-1][0] >= stamp:
            stamp = self._kept.pop()[0]
        self._kept.append((stamp, copy))
        # The last one before the time that is kept says what was known at its beginning.
        before = [k for k, (one, _) in enumerate(self._kept) if one <= stamp - self.length]
        del self._kept[: max(before, default=0)]

    def forget(self) -> None:
        """Forget all."""
        self._kept.clear()

    def states(self) -> tuple[NDArray[np.int64], list[Scene]]:
        """What was known, and since when (n,), ns; ascending."""
        stamps = np.array([stamp for stamp, _ in self._kept], np.int64)
        return stamps, [scene for _, scene in self._kept]
