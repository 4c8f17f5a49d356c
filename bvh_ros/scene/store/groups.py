# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sources, which own obstacles, and groups of obstacles that are replaced together."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NOBODY = 0  # number of the source and group of a free slot, and of what was never heard of


def tally(numbers: NDArray[np.int64]) -> dict[int, int]:
    """How often each number is there."""
    if len(numbers) == 1 or (len(numbers) and (numbers == numbers[0]).all()):
        return {int(numbers[0]): len(numbers)}
    different, times = np.unique(numbers, return_counts=True)
    return dict(zip(different.tolist(), times.tolist(), strict=True))


@dataclass
class Group:
    """Obstacles of one source that one message replaces; '' is for all that has no other group."""

    number: int
    source: str
    name: str
    members: int = 0


class Groups:
    """Counts members of groups and sources, so that what is empty costs nothing."""

    def __init__(self) -> None:
        self._sources: dict[str, int] = {}
        self._groups: dict[tuple[str, str], Group] = {}
        self._by_number: dict[int, Group] = {}
        self._last = NOBODY

    def source(self, name: str) -> int:
        """Number of a source."""
        return self._sources.get(name, NOBODY)

    def source_name(self, number: int) -> str:
        """The source with this number."""
        return next(name for name, known in self._sources.items() if known == number)

    def number(self, source: str, name: str) -> int:
        """Number of a group."""
        group = self._groups.get((source, name))
        return group.number if group else NOBODY

    def members(self, source: str, name: str) -> int:
        """How many obstacles a group has ('': all that the source owns)."""
        if not name:
            return self.by_source().get(source, 0)
        group = self._groups.get((source, name))
        return group.members if group else 0

    def group(self, number: int) -> Group:
        """The group with this number."""
        return self._by_number[number]

    def open(self, source: str, name: str) -> tuple[int, int]:
        """The numbers of a source and its group, made if need be."""
        number = self._sources.setdefault(source, len(self._sources) + NOBODY + 1)
        group = self._groups.get((source, name))
        if group is None:
            self._last += 1
            group = self._groups[source, name] = Group(self._last, source, name)
            self._by_number[group.number] = group
        return number, group.number

    def join(self, source: str, name: str, count: int) -> None:
        """So many obstacles enter an open group."""
        self._groups[source, name].members += count

    def leave(self, numbers: NDArray[np.int64]) -> None:
        """One obstacle left each of these groups; a group that is empty then is forgotten."""
        for number, count in tally(numbers).items():
            group = self._by_number[number]
            group.members -= count
            if group.members == 0:
                del self._by_number[number], self._groups[group.source, group.name]

    def clear(self) -> None:
        """Everybody left."""
        self._groups.clear()
        self._by_number.clear()

    def by_source(self) -> dict[str, int]:
        """Number of obstacles of each source that ever had one."""
        counts = dict.fromkeys(self._sources, 0)
        for group in self._groups.values():
            counts[group.source] += group.members
        return counts
