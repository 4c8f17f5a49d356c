# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of obstacles without a Python string a name.

Every name is a prefix and a number: 'cloud#17' is 'cloud#' and 17. Ten thousand names of a message
have few prefixes, so they are a short list of strings and two arrays. A name that does not end in
a plain number is all prefix. There is one way to split a name, so that 'p5' is one obstacle
however it was given.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...tree.access import INT64
from ...tree.compiler import lean_kernel

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
    family, numbers = [], []
    for name in names:
        if not isinstance(name, str):
            raise ValueError(f'names must be strings: row {len(family)} is {name!r}')
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
