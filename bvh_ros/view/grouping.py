# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles by the beginning of their names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bvh_ros.scene import Scene, Shapes
from bvh_ros.view.worlds import Group


class Namespaces:
    """Knows the namespace of each handle; only newcomers are looked at."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._handles = np.empty(0, np.int64)  # ascending
        self._of = np.empty(0, np.int64)  # their namespaces' numbers

    def split(self, scene: Scene, groups: Sequence[Group]) -> list[tuple[str, Shapes]]:
        """Return namespaces and shapes; those of a group without handles go by their source."""
        self._learn(scene)
        found = []
        names = list(self._numbers)
        for source, shapes, handles in groups:
            if len(handles) != len(shapes.kind):
                found.append((source, shapes))
                continue
            numbers = self._of[np.searchsorted(self._handles, handles)]
            for number in np.unique(numbers).tolist():
                found.append((names[number], shapes.take(numbers == number)))
        return found

    def _learn(self, scene: Scene) -> None:
        present = np.isin(self._handles, scene.handles())
        self._handles, self._of = self._handles[present], self._of[present]
        new = scene.names(int(self._handles[-1]) if len(self._handles) else 0)
        numbers = [
            self._numbers.setdefault(namespace_of(name), len(self._numbers)) for _, name in new
        ]
        handles = np.array([handle for handle, _ in new], np.int64)
        self._handles = np.concatenate((self._handles, handles))
        self._of = np.concatenate((self._of, np.array(numbers, np.int64)))


def namespace_of(name: str) -> str:
    """`ns` of `ns/id` and of `ns/id#k`; `source` of `source#k`."""
    marker = name.partition('#')[0]
    return marker.rpartition('/')[0] or marker
