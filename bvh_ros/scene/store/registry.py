# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which slot each name owns, and the name of each slot."""

import functools
import random
from collections.abc import Callable, Collection
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...tree.access import INT64, touch
from ...tree.compiler import entry_point
from .groups import tally
from .name_hash import EMPTY, add_slots, discard_slots, find_slots
from .names import BARE, Families, split

Slots: TypeAlias = NDArray[np.int64]

UNKNOWN = EMPTY  # instead of a slot
_NOBODY = 0  # number of the prefix of a free slot, and of what was never heard of
_LOAD = 2  # places in the table for each slot


@functools.cache
def _find_slots() -> Callable[..., Any]:
    """The machine code of `find_slots`."""
    numbers = np.empty(0, np.int64)
    return entry_point(find_slots, *(numbers,) * 3, 0, *(numbers,) * 4)


class Registry:
    """Names to slots and back; each name owns one slot."""

    def __init__(self) -> None:
        self._count = 0
        self._number_of_prefix: dict[str, int] = {}
        self._prefixes = ['']  # by number, from 1
        self._members = [0]  # names of each prefix
        self._unused: list[int] = []  # numbers of prefixes without names
        # The name of each slot.
        self._prefix_of = np.empty(0, np.int64)
        self._number_of = np.empty(0, np.int64)
        self._table = np.full(1, EMPTY, np.int64)
        self._seed = random.getrandbits(62)  # nobody outside can choose names that collide

    def __len__(self) -> int:
        return self._count

    def find(self, names: Families) -> Slots:
        """Slots of names, UNKNOWN where there is none."""
        known = [self._number_of_prefix.get(prefix, _NOBODY) for prefix in names.prefixes]
        found = np.empty(len(names.numbers), INT64)
        if any(known):
            prefixes = np.array(known, INT64)
            _find_slots()(*self._hashed(), prefixes, names.family, names.numbers, found)
        else:
            found.fill(UNKNOWN)
        return found

    def slot(self, name: str) -> int:
        """Slot of one name, or UNKNOWN."""
        prefix, number = split(name)
        nought = np.zeros(1, np.int64)
        return int(self.find(Families([prefix], nought, nought + number))[0])

    def name(self, slot: int) -> str:
        """Name that owns a slot; KeyError if none does."""
        prefix = self._prefix_of.item(slot) if slot < len(self._prefix_of) else _NOBODY
        if prefix == _NOBODY:
            raise KeyError(slot)
        number = self._number_of.item(slot)
        return self._prefixes[prefix] if number == BARE else f'{self._prefixes[prefix]}{number}'

    def add(self, names: Families, slots: Slots) -> None:
        """Give new names, each there once, their slots."""
        if not len(slots):
            return
        self.grow(int(slots.max()) + 1)
        used = tally(names.family)
        numbers = np.zeros(len(names.prefixes), np.int64)
        for place, count in used.items():
            numbers[place] = self._join(names.prefixes[place], count)
        self._prefix_of[slots] = numbers[names.family]
        self._number_of[slots] = names.numbers
        self._count += len(slots)
        add_slots(*self._hashed(), slots)

    def copy(self, slots: Slots, copies: Slots) -> None:
        """Call further slots the same; their names still lead to the first ones."""
        self.grow(int(copies.max(initial=-1)) + 1)
        self._prefix_of[copies] = self._prefix_of[slots]
        self._number_of[copies] = self._number_of[slots]
        for prefix, count in tally(self._prefix_of[slots]).items():
            self._members[prefix] += count

    def discard(self, slots: Slots) -> None:
        """Forget the names of slots in use."""
        if not len(slots):
            return
        self._count -= discard_slots(*self._hashed(), slots)
        for prefix, count in tally(self._prefix_of[slots]).items():
            self._leave(prefix, count)
        self._prefix_of[slots] = _NOBODY

    def clear(self) -> None:
        """Forget all names."""
        seed = self._seed
        self.__init__()  # type: ignore[misc]
        self._seed = seed

    def leads_to(self, slots: Slots) -> Slots:
        """The slots that the names of some slots lead to."""
        found = np.empty(len(slots), np.int64)
        prefixes, family = self._prefix_of[slots], np.arange(len(slots))
        _find_slots()(*self._hashed(), prefixes, family, self._number_of[slots], found)
        return found

    def in_namespaces(self, namespaces: Collection[str]) -> Slots:
        """Slots of the names `namespace`/x, where x has no slash: a/b/7 is not in a."""
        inside = [
            number
            for prefix, number in self._number_of_prefix.items()
            if '/' in prefix and prefix.rpartition('/')[0] in namespaces
        ]
        return np.flatnonzero(np.isin(self._prefix_of, inside))

    def _join(self, prefix: str, count: int) -> int:
        """So many names of this prefix come; its number."""
        number = self._number_of_prefix.get(prefix)
        if number is None:
            if self._unused:
                number = self._unused.pop()
                self._prefixes[number] = prefix
            else:
                number = len(self._prefixes)
                self._prefixes.append(prefix)
                self._members.append(0)
            self._number_of_prefix[prefix] = number
        self._members[number] += count
        return number

    def _leave(self, number: int, count: int) -> None:
        self._members[number] -= count
        if self._members[number] == 0:
            del self._number_of_prefix[self._prefixes[number]]
            self._prefixes[number] = ''
            self._unused.append(number)

    def _hashed(self) -> tuple[Slots, Slots, Slots, int]:
        return self._table, self._prefix_of, self._number_of, self._seed

    def room_for(self, count: int) -> list[Slots]:
        """Larger arrays for `grow`; empty if there is no need. Another thread may ask."""
        room = self._larger(count)
        for array in room[:2]:
            touch(array)
        return room

    def grow(self, count: int, room: list[Slots] | None = None) -> None:
        """Make room for the slots below `count`."""
        old = len(self._prefix_of)
        if count <= old:
            return
        prefix_of, number_of, table = room or self._larger(count)
        prefix_of[:old], number_of[:old] = self._prefix_of, self._number_of
        entered = self._table[self._table != EMPTY]
        self._prefix_of, self._number_of, self._table = prefix_of, number_of, table
        add_slots(*self._hashed(), entered)

    def _larger(self, count: int) -> list[Slots]:
        """Arrays for the slots below `count`, at least twice as long, and a table for them; none
        if these will do.
        """
        old = len(self._prefix_of)
        if count <= old:
            return []
        capacity = max(count, 2 * old)
        places = max(1 << (_LOAD * capacity - 1).bit_length(), 16)
        columns = [np.zeros(capacity, np.int64) for _ in range(2)]
        return [*columns, np.full(places, EMPTY, np.int64)]
