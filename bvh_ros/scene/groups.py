# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sources, which own obstacles, and groups of obstacles that are replaced together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NOBODY = 0  # source and group of a free slot


@dataclass
class Group:
    """The obstacles of one source that one message replaces; the group '' of a source is for all that has no group of its own."""

    serial: int
    source: str
    name: str
    members: int = 0


class Groups:
    """Counts members of groups and sources, so that what is empty costs nothing."""

    def __init__(self) -> None:
        self._sources: dict[str, int] = {}
        self._groups: dict[tuple[str, str], Group] = {}
        self._by_serial: dict[int, Group] = {}
        self._next_serial = NOBODY + 1

    def source(self, name: str) -> int:
        """Number of a source, the same for ever."""
        return self._sources.setdefault(name, len(self._sources) + NOBODY + 1)

    def source_name(self, source: int) -> str:
        return next(name for name, number in self._sources.items() if number == source)

    def group(self, source: str, name: str) -> Group:
        """The group, opened if need be."""
        group = self._groups.get((source, name))
        if group is None:
            group = self._groups[source, name] = Group(self._next_serial, source, name)
            self._by_serial[group.serial] = group
            self._next_serial += 1
        return group

    def of(self, serial: int) -> Group:
        return self._by_serial[serial]

    def leave(self, serials: NDArray[np.int64]) -> None:
        """Obstacles of these groups were removed or went to another group; an empty group is forgotten."""
        if not len(serials):
            return
        if (serials == serials[0]).all():
            pairs = [(int(serials[0]), len(serials))]
        else:
            pairs = [
                (int(serial), int(count))
                for serial, count in zip(*np.unique(serials, return_counts=True), strict=True)
            ]
        for serial, count in pairs:
            self._by_serial[serial].members -= count
            self.close_if_empty(self._by_serial[serial])

    def close_if_empty(self, group: Group) -> None:
        if group.members == 0:
            self._by_serial.pop(group.serial, None)
            self._groups.pop((group.source, group.name), None)

    def members(self, source: str, name: str) -> int:
        group = self._groups.get((source, name))
        return group.members if group else 0

    def by_source(self) -> dict[str, int]:
        """Number of obstacles of each source that has been heard of."""
        counts = dict.fromkeys(self._sources, 0)
        for group in self._groups.values():
            counts[group.source] += group.members
        return counts
