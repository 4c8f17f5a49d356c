# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of obstacles and the slots they own.

A name lives in one of two places. Names given as `Numbered` (100,000 points of a cloud) live in
the table of their prefix, as sorted arrays of numbers and slots, and become strings only when
somebody asks. All others live in a dictionary. So that 'p5' is one obstacle however it was given:
when a prefix has a table, every name made of this prefix and a number lives there.
"""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Slots: TypeAlias = NDArray[np.int64]

UNKNOWN = -1  # instead of a slot
_LARGEST = 10**18 - 1  # numbers of up to 18 digits fit an int64, whatever they are
_PLAIN_NUMBER = re.compile(r'(?<![0-9])(0|[1-9][0-9]{0,17})\Z')


class Numbered(NamedTuple):
    """Names `prefix` + number, not made into strings."""

    prefix: str
    numbers: NDArray[np.int64]


Names: TypeAlias = Sequence[str] | Numbered


def as_names(names: Names) -> Names:
    """Names as the registry stores them.

    A `Numbered` whose names could be split otherwise ('a1' and 5, 'a' and 15) as strings.
    """
    if not isinstance(names, Numbered):
        if isinstance(names, str):
            raise ValueError('names is one string, not a sequence of strings')
        return names
    numbers = np.asarray(names.numbers)
    if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in 'iu'):
        raise ValueError(
            f'names.numbers has shape {numbers.shape} and type {numbers.dtype}, not (n,) integers'
        )
    ambiguous = bool(names.prefix) and names.prefix[-1] in '0123456789'
    if ambiguous or (numbers.size and not 0 <= numbers.min() <= numbers.max() <= _LARGEST):
        return [names.prefix + str(number) for number in numbers.tolist()]
    return Numbered(names.prefix, numbers.astype(np.int64, copy=False))


def take(names: Names, rows: NDArray[np.int64]) -> Names:
    """The names of some rows."""
    if isinstance(names, Numbered):
        return Numbered(names.prefix, names.numbers[rows])
    return [names[row] for row in rows.tolist()]


def name_at(names: Names, row: int) -> str:
    """One name as a string."""
    return f'{names.prefix}{names.numbers[row]}' if isinstance(names, Numbered) else names[row]


def last_of_each(names: Names, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of ascending rows, those whose name does not come again in a later one."""
    if isinstance(names, Numbered):
        numbers = names.numbers[rows]
        if (numbers[1:] > numbers[:-1]).all():
            return rows
        _, places = np.unique(numbers[::-1], return_index=True)
        return rows[np.sort(len(rows) - 1 - places)]
    last = {names[row]: row for row in rows.tolist()}
    return rows if len(last) == len(rows) else np.array(sorted(last.values()), np.int64)


class _Table:
    """Slots of the names of one prefix, sorted by number."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self.numbers = np.empty(0, np.int64)
        self.slots = np.empty(0, np.int64)

    def find(self, numbers: NDArray[np.int64]) -> Slots:
        if np.array_equal(numbers, self.numbers):  # the next frame of the same cloud
            return self.slots.copy()
        if not len(self.numbers):
            return np.full(len(numbers), UNKNOWN, np.int64)
        places = np.minimum(np.searchsorted(self.numbers, numbers), len(self.numbers) - 1)
        return np.where(self.numbers[places] == numbers, self.slots[places], UNKNOWN)

    def add(self, numbers: NDArray[np.int64], slots: Slots) -> None:
        numbers = np.concatenate([self.numbers, numbers])
        slots = np.concatenate([self.slots, slots])
        if not (numbers[1:] > numbers[:-1]).all():
            order = np.argsort(numbers, kind='stable')
            numbers, slots = numbers[order], slots[order]
        self.numbers, self.slots = numbers, slots

    def discard(self, numbers: NDArray[np.int64]) -> None:
        keep = np.ones(len(self.numbers), np.bool_)
        keep[np.searchsorted(self.numbers, numbers)] = False
        self.numbers, self.slots = self.numbers[keep], self.slots[keep]


class Registry:
    """Names to slots and back; each name owns one slot."""

    def __init__(self) -> None:
        self._slot_of: dict[str, int] = {}
        self._text_of: dict[int, str] = {}
        self._tables: dict[str, _Table] = {}
        self._by_serial: dict[int, _Table] = {}
        self._serial_of: dict[str, int] = {}
        self._next_serial = 1
        # Per slot: the serial of its name's table (0: in the dictionary), and the number in it.
        self._table = np.empty(0, np.int64)
        self._number = np.empty(0, np.int64)

    def __len__(self) -> int:
        return len(self._slot_of) + sum(len(table.numbers) for table in self._tables.values())

    def _split(self, name: str) -> tuple[_Table, int] | None:
        """The table a name belongs to, if its prefix has one, and its number there."""
        match = _PLAIN_NUMBER.search(name) if self._tables else None
        table = self._tables.get(name[: match.start()]) if match else None
        return None if table is None or match is None else (table, int(match[1]))

    def find(self, names: Names) -> Slots:
        """Slots of names, UNKNOWN where there is none."""
        if isinstance(names, Numbered):
            table = self._tables.get(names.prefix)
            if table is not None:
                return table.find(names.numbers)
            if not self._slot_of:
                return np.full(len(names.numbers), UNKNOWN, np.int64)
            names = [names.prefix + str(number) for number in names.numbers.tolist()]
        return np.array([self.slot(name) for name in names], np.int64)

    def slot(self, name: str) -> int:
        """Slot of one name, or UNKNOWN."""
        split = self._split(name)
        if split is None:
            return self._slot_of.get(name, UNKNOWN)
        return int(split[0].find(np.array([split[1]]))[0])

    def name(self, slot: int) -> str:
        """Name that owns a slot; KeyError if none does."""
        serial = int(self._table[slot]) if slot < len(self._table) else 0
        return (
            f'{self._by_serial[serial].prefix}{self._number[slot]}'
            if serial
            else self._text_of[slot]
        )

    def add(self, names: Names, slots: Slots) -> None:
        """Give new names their slots."""
        if not len(slots):
            return
        self._grow(int(slots.max()) + 1)
        if isinstance(names, Numbered):
            self._add_numbered(names.prefix, names.numbers, slots)
            return
        split: dict[str, list[tuple[int, int]]] = {}
        for name, slot in zip(names, slots.tolist(), strict=True):
            place = self._split(name)
            if place is None:
                self._slot_of[name] = slot
                self._text_of[slot] = name
                self._table[slot] = 0
            else:
                split.setdefault(place[0].prefix, []).append((place[1], slot))
        for prefix, pairs in split.items():
            numbers, places = np.array(pairs, np.int64).T
            self._add_numbered(prefix, numbers, places)

    def _add_numbered(self, prefix: str, numbers: NDArray[np.int64], slots: Slots) -> None:
        table = self._tables.get(prefix)
        if table is None:
            table = self._open_table(prefix)
        table.add(numbers, slots)
        self._table[slots] = self._serial_of[prefix]
        self._number[slots] = numbers

    def _open_table(self, prefix: str) -> _Table:
        """A new table, with the names of this prefix that were in the dictionary."""
        table = self._tables[prefix] = _Table(prefix)
        serial = self._serial_of[prefix] = self._next_serial
        self._by_serial[serial] = table
        self._next_serial += 1
        moved = []
        for name in [name for name in self._slot_of if name.startswith(prefix)]:
            match = _PLAIN_NUMBER.fullmatch(name, len(prefix))
            if match:
                slot = self._slot_of.pop(name)
                del self._text_of[slot]
                moved.append((int(match[1]), slot))
        if moved:
            numbers, slots = np.array(moved, np.int64).T
            self._add_numbered(prefix, numbers, slots)
        return table

    def discard(self, slots: Slots) -> None:
        """Forget the names of slots in use."""
        serials = self._table[slots]
        for serial in np.unique(serials).tolist():
            mine = slots[serials == serial]
            if serial == 0:
                for slot in mine.tolist():
                    del self._slot_of[self._text_of.pop(slot)]
                continue
            table = self._by_serial[serial]
            table.discard(self._number[mine])
            if not len(table.numbers):
                del (
                    self._tables[table.prefix],
                    self._serial_of[table.prefix],
                    self._by_serial[serial],
                )
        self._table[slots] = 0

    def in_namespace(self, namespace: str) -> Iterator[Slots]:
        """Slots of the names `namespace`/x, where x has no slash: a/b/7 is not in a."""
        beginning = f'{namespace}/'

        def inside(name: str) -> bool:
            return name.startswith(beginning) and '/' not in name[len(beginning) :]

        for prefix, table in self._tables.items():
            if inside(prefix):  # then so is every name in it: numbers have no slash
                yield table.slots
        yield np.array([slot for name, slot in self._slot_of.items() if inside(name)], np.int64)

    def _grow(self, capacity: int) -> None:
        old = len(self._table)
        if capacity > old:
            room = max(capacity, 2 * old)
            self._table = np.concatenate([self._table, np.zeros(room - old, np.int64)])
            self._number = np.concatenate([self._number, np.zeros(room - old, np.int64)])
