# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of obstacles, the slot that each name owns, and the groups that it belongs to."""

import functools
import random
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..tree.access import INT64, checks, touch
from ..tree.compiler import entry_point, inlined, lean_kernel

# ---- Names of obstacles without a Python string a name.
#
# Every name is a prefix and a number: 'cloud#17' is 'cloud#' and 17. Ten thousand names of a
# message have few prefixes, so they are a short list of strings and two arrays. A name that does
# not end in a plain number is all prefix. There is one way to split a name, so that 'p5' is one
# obstacle however it was given.

Integers: TypeAlias = NDArray[np.int64]

BARE = -1  # instead of a number: the prefix is the whole name
_DIGITS = '0123456789'
_MOST_DIGITS = 18  # so many fit an int64, whatever they are
LARGEST = 10**_MOST_DIGITS


class Numbered(NamedTuple):
    """Names `prefix` + number, not made into strings."""

    prefix: str
    numbers: Integers


class Families(NamedTuple):
    """Names `prefixes[family]` + number, not made into strings."""

    prefixes: Sequence[str]
    family: Integers
    numbers: Integers

    def __len__(self) -> int:
        return len(self.numbers)

    def text(self, row: int) -> str:
        """One name as a string."""
        number = int(self.numbers[row])
        prefix = self.prefixes[self.family[row]]
        return prefix if number == BARE else f'{prefix}{number}'

    def texts(self) -> Iterator[str]:
        """All names as strings."""
        return map(self.text, range(len(self)))

    def take(self, rows: Integers | slice) -> 'Families':
        """The names of some rows."""
        return Families(self.prefixes, self.family[rows], self.numbers[rows])


Names: TypeAlias = Sequence[str] | Numbered | Families


def split(name: str) -> tuple[str, int]:
    """Prefix and number of a name."""
    prefix = name.rstrip(_DIGITS)
    digits = name[len(prefix) :]
    if not digits or len(digits) > _MOST_DIGITS or (digits[0] == '0' and len(digits) > 1):
        return name, BARE
    return prefix, int(digits)


def as_families(names: Names) -> Families:
    """Names as the registry compares them.

    Raises
    ------
    ValueError
        If they are not strings, or not integers.
    """
    if type(names) is list:  # the commonest
        return _from_strings(names)
    if isinstance(names, Families):
        numbers = _integers(names.numbers)
        family, prefixes = _integers(names.family, 'family'), names.prefixes
        if family.shape != numbers.shape:
            raise ValueError(f'names.family has shape {family.shape}, not {numbers.shape}')
    elif isinstance(names, Numbered):
        numbers, prefixes = _integers(names.numbers), [names.prefix]
        family = np.zeros(len(numbers), np.int64)
    else:
        return _from_strings(names)
    known, plain = in_range(family, numbers, len(prefixes))
    if not known:
        raise ValueError(f'names.family must be from 0 to {len(prefixes) - 1}')
    if not all(isinstance(prefix, str) for prefix in prefixes):
        raise ValueError('the prefixes of names must be strings')
    if plain and not any(prefix[-1:].isdigit() for prefix in prefixes):
        return Families(prefixes, family, numbers)
    # 'a1' and 5, 'a' and 15 are one name; only Families know names without a number.
    if isinstance(names, Families):
        return _from_strings([*names.texts()])
    return _from_strings([f'{names.prefix}{number}' for number in numbers.tolist()])


@lean_kernel
def in_range(family, numbers, count):
    """(whether every family is one of so many, whether every number is one that `split` gives)"""
    known = plain = True
    for row in range(family.shape[0]):
        known &= 0 <= family[row] < count
        plain &= 0 <= numbers[row] < LARGEST
    return known, plain


def last_of_each(names: Families, rows: Integers) -> Integers:
    """Of ascending rows, those whose name does not come again in a later one."""
    family, numbers = names.family[rows], names.numbers[rows]
    step, onward = np.diff(family), np.diff(numbers)
    if ((step > 0) | ((step == 0) & (onward > 0))).all():
        return rows
    order = np.lexsort((numbers, family))  # stable: of equal names the last row comes last
    same = (np.diff(family[order]) == 0) & (np.diff(numbers[order]) == 0)
    if not same.any():
        return rows
    return rows[np.sort(order[~np.append(same, False)])]


def _integers(numbers: Integers, what: str = 'numbers') -> Integers:
    array = np.asarray(numbers)
    masked = isinstance(numbers, np.ma.MaskedArray)
    if array.ndim != 1 or masked or (array.size and array.dtype.kind not in 'iu'):
        raise ValueError(
            f'names.{what} has shape {array.shape} and type {array.dtype}, not (n,) integers'
        )
    if array.dtype.kind == 'u' and array.size and array.max() > np.iinfo(np.int64).max:
        raise ValueError(f'names.{what} must be integers of 64 bits')
    return array if array.dtype == np.int64 and array.flags.carray else array.astype(np.int64)


def _from_strings(names: Sequence[str]) -> Families:
    if isinstance(names, str):
        raise ValueError('names is one string, not a sequence of strings')
    if not isinstance(names, (list, Collection)):
        raise ValueError(f'names must be a sequence of strings, not {type(names).__name__}')
    prefixes: dict[str, int] = {}
    family, numbers = list[int](), list[int]()
    for name in checks.iterator('names', names):
        if not isinstance(name, str):
            shown = checks.shown_short(name)
            raise ValueError(f'names must be strings: row {len(family)} is {shown}')
        prefix = name.rstrip(_DIGITS)
        digits = name[len(prefix) :]
        if digits and digits[0] != '0' and len(digits) <= _MOST_DIGITS:  # `split`, called seldom
            numbers.append(int(digits))
        else:
            prefix, number = split(name)
            numbers.append(number)
        family.append(prefixes.setdefault(prefix, len(prefixes)))
    # An array of a list takes two to four times as long as one of zeros.
    kinds = np.array(family, INT64) if len(prefixes) > 1 else np.zeros(len(family), INT64)
    return Families(list(prefixes), kinds, np.array(numbers, INT64))


# ---- A hash table from names (number of the prefix, number) to slots.
#
# Open addressing with linear probing. The table holds slots only: what a slot is called stands
# in two arrays beside it. An entry is taken out by moving later ones of its cluster up (Knuth,
# The Art of Computer Programming, vol. 3, 6.4, algorithm R), so that the table never fills with
# tombstones.

EMPTY = -1


@inlined
def _home(prefix, number, seed, mask):
    """Where the search for a name begins.

    Sixteen neighbouring numbers lie side by side, because messages bring them in order; what is
    above is scattered, so that no stride of the numbers makes long clusters.
    """
    word = (number >> 4) * -7046029254386353131 + (prefix + seed) * 0x2545F4914F6CDD1D
    word ^= word >> 29
    word *= -4658895280553007687
    word ^= word >> 32
    return ((word << 4) | ((number + prefix) & 15)) & mask


@inlined
def _place(table, prefix_of, number_of, seed, prefix, number):
    """The place of a name in the table, or the empty one where it belongs."""
    mask = table.shape[0] - 1
    place = _home(prefix, number, seed, mask)
    while True:
        slot = table[place]
        if slot == EMPTY or (prefix_of[slot] == prefix and number_of[slot] == number):
            return place
        place = (place + 1) & mask


@lean_kernel
def find_slots(table, prefix_of, number_of, seed, prefixes, family, numbers, found):
    """Write the slot of each name, prefixes[family] + number, to `found`, EMPTY where there is
    none.
    """
    for row in range(family.shape[0]):
        prefix = prefixes[family[row]]
        place = _place(table, prefix_of, number_of, seed, prefix, numbers[row])
        found[row] = table[place]


@lean_kernel
def add_slots(table, prefix_of, number_of, seed, slots):
    """Enter slots whose names stand in the arrays and are not in the table."""
    for slot in slots:
        place = _place(table, prefix_of, number_of, seed, prefix_of[slot], number_of[slot])
        table[place] = slot


@lean_kernel
def discard_slots(table, prefix_of, number_of, seed, slots):
    """Take out those of the slots that are in the table; return how many these are."""
    mask = table.shape[0] - 1
    count = 0
    for slot in slots:
        gap = _place(table, prefix_of, number_of, seed, prefix_of[slot], number_of[slot])
        if table[gap] != slot:
            continue
        table[gap] = EMPTY
        count += 1
        place = (gap + 1) & mask
        while table[place] != EMPTY:
            other = table[place]
            home = _home(prefix_of[other], number_of[other], seed, mask)
            # It may move up unless its home lies cyclically between the gap and its place.
            if (place - home) & mask >= (place - gap) & mask:
                table[gap] = other
                table[place] = EMPTY
                gap = place
            place = (place + 1) & mask
    return count


# ---- Sources, which own obstacles, and groups of obstacles that are replaced together.

NO_OWNER = 0  # the source and group of a free slot, and the number of unknown ones


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
        self._last = NO_OWNER

    def source(self, name: str) -> int:
        """Number of a source."""
        return self._sources.get(name, NO_OWNER)

    def source_name(self, number: int) -> str:
        """The source with this number."""
        return next(name for name, known in self._sources.items() if known == number)

    def number(self, source: str, name: str) -> int:
        """Number of a group."""
        group = self._groups.get((source, name))
        return group.number if group else NO_OWNER

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
        number = self._sources.setdefault(source, len(self._sources) + NO_OWNER + 1)
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
        """Forget all groups."""
        self._groups.clear()
        self._by_number.clear()

    def by_source(self) -> dict[str, int]:
        """Number of obstacles of each source that ever had one."""
        counts = dict.fromkeys(self._sources, 0)
        for group in self._groups.values():
            counts[group.source] += group.members
        return counts


# ---- Which slot each name owns, and the name of each slot.

Slots: TypeAlias = NDArray[np.int64]

UNKNOWN = EMPTY  # instead of a slot
_NO_OWNER = 0  # number of the prefix of a free slot, and of what was never heard of
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
        self._seed = random.getrandbits(62)  # so names that collide cannot be chosen from outside

    def __len__(self) -> int:
        return self._count

    def find(self, names: Families) -> Slots:
        """Slots of names, UNKNOWN where there is none."""
        known = [self._number_of_prefix.get(prefix, _NO_OWNER) for prefix in names.prefixes]
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
        prefix = self._prefix_of.item(slot) if slot < len(self._prefix_of) else _NO_OWNER
        if prefix == _NO_OWNER:
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
        self._prefix_of[slots] = _NO_OWNER

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
