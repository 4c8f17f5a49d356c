# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Earlier states of the world: a copy of the scene after each message, as far as is wanted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from bvh_ros.scene import Scene


class Past:
    """Keeps what was known when.

    Parameters
    ----------
    history : float
        So much of the past (s) is kept; 0: nothing, and nothing is copied.
    """

    def __init__(self, scene: Scene, history: float) -> None:
        self._scene = scene
        self._kept: list[tuple[int, Scene]] = []  # newest stamp included, ns, and what was known
        self.length = round(history * 1e9)

    def note(self, now: int) -> None:
        """Keep the scene as it is after a message that came at `now` (ns on the node's clock);
        forget what is too old.
        """
        if not self.length or self._scene.interrupted:
            return
        stamp = min(self._scene.newest, now)  # no data are newer than now, whatever they say
        if self._kept and self._kept[-1][0] >= stamp:
            stamp = self._kept.pop()[0]
        self._kept.append((stamp, self._scene.copy()))
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
