# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the world whose making takes time that grows with it."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bvh_ros.ros.world.world import World

SHARE = 0.01  # of the time may go into surveys
TURN = 0.01  # seconds after which the rest is left for the next look
DONE = object()


class SceneStatistics:
    """Looks at the whole world, so seldom that it takes at most a hundredth of the time, and with
    many views bit by bit.

    The cost of a tree of 10^6 boxes takes 40 ms: such a world is looked at every four seconds.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._work: Iterator[None] | None = None
        self._spent = 0.0  # s on the look that is being taken
        self._figures: dict[str, Any] = {}
        self._seen = dict.fromkeys((view.name for view in world.views), 0)
        self._taken = -float('inf')
        self._due = -float('inf')

    def look(self) -> tuple[dict[str, Any], dict[str, int]]:
        """Return the figures of the scene, and how many obstacles each view shows."""
        began = time.monotonic()
        if self._work is None and began >= self._due:
            self._work, self._spent = self._take(), 0.0
        while self._work is not None:
            if next(self._work, DONE) is DONE:
                self._work, self._taken = None, time.monotonic()
                spent = self._spent + self._taken - began
                self._due = self._taken + spent / SHARE
            elif self._figures and time.monotonic() - began > TURN:
                break
        now = time.monotonic()
        self._spent += now - began
        return {**self._figures, 'age of these figures': f'{now - self._taken:.1f} s'}, self._seen

    def _take(self) -> Iterator[None]:
        if self._world.scene.interrupted:
            return  # nobody knows what it holds
        seen = {}
        for view in self._world.views:
            seen[view.name] = self._world.scene.count(view.mask)
            yield
        self._figures, self._seen = self._take_figures(), seen

    def _take_figures(self) -> dict[str, Any]:
        scene = self._world.scene
        stats = scene.stats()
        tree = stats['tree']
        return {
            **{f'obstacles of {name}': count for name, count in stats['sources'].items()},
            'height': stats['height'],
            'cost': f'{stats["cost"]:.4g}',
            'cost over that of the last build': _ratio(stats['cost'], tree['cost_when_built']),
            'turned or round obstacles': stats['shaped'],
            'different meshes': stats['meshes'],
            'obstacles with a lifetime': stats['mortal'],
            'bytes of the tree': tree['bytes'] + tree['snapshot_bytes'],
            'bytes of the scene': stats['bytes'],
            'pairs of true shapes compared': stats['pairs_compared'],
            'of these with more digits': stats['pairs_in_more_digits'],
            'node handles left': stats['node_handles_left'],
        }


def resident_bytes() -> int | None:
    """Return how much memory this process occupies; None where the system does not say."""
    try:
        pages = int(Path('/proc/self/statm').read_text().split()[1])
    except OSError:
        return None
    return pages * resource.getpagesize()


def _ratio(cost: float, when_built: float) -> str:
    return f'{cost / when_built:.3f}' if when_built > 0.0 else 'never built at once'
