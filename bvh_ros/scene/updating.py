# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From a message's rows to what can be applied.

Which rows are good, in canonical form, and why the others are refused.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.nodes import ALL
from . import registry, shapes
from .registry import UNKNOWN, Names, Numbered, Slots
from .shapes import Floats, Shapes

ERROR_PREFIX = 'error: '  # begins the replies that say why a request cannot be answered


class Refusal(NamedTuple):
    """A row that was not taken over; the obstacle of that name, if any, is as before."""

    row: int
    name: str
    reason: str


class Rows(NamedTuple):
    """Rows of one update; all arrays have the same length."""

    row: NDArray[np.int64]  # their number in the message
    slot: Slots  # UNKNOWN where the name is new
    shapes: Shapes
    shaped: NDArray[np.bool_]
    lo: Floats
    hi: Floats
    categories: NDArray[np.uint32]
    expires: NDArray[np.int64]

    def take(self, which: NDArray[Any]) -> 'Rows':
        """Some of the rows; the arrays themselves where that is all of them."""
        if which.dtype == np.bool_ and which.all():
            return self
        return Rows(
            self.row[which],
            self.slot[which],
            self.shapes.take(which),
            self.shaped[which],
            self.lo[which],
            self.hi[which],
            self.categories[which],
            self.expires[which],
        )


def column(name: str, value: ArrayLike, count: int, largest: int) -> NDArray[np.int64]:
    """One integer for all rows, or one a row, from 0 to `largest`."""
    array = np.asarray(value)
    if array.shape not in ((), (count,)) or array.dtype.kind not in 'iu':
        raise ValueError(f'{name} must be an integer or {count} integers, not {value!r}')
    if array.size and not 0 <= int(array.min()) <= int(array.max()) <= largest:
        raise ValueError(f'{name} must be from 0 to {largest}, not {value!r}')
    return np.broadcast_to(array.astype(np.int64), (count,))


def examine(
    names: Names,
    given: Shapes,
    slots: Slots,
    owners: NDArray[np.int64],
    source: int,
    expires: ArrayLike,
    categories: ArrayLike,
) -> tuple[Rows, dict[int, str | int]]:
    """The rows to apply, and the reason of each refused row: a sentence, or the number of the
    source that owns its name.

    Of several good rows with one name the last is applied: a message is read in order, and a later
    row modifies an earlier one's obstacle.
    """
    count = len(given.kind)
    lives = column('expires', expires, count, np.iinfo(np.int64).max)
    masks = column('categories', categories, count, ALL).astype(np.uint32)
    code = shapes.faults(given)
    reasons: dict[int, str | int] = {
        int(row): shapes.REASONS[code[row]] for row in np.flatnonzero(code)
    }
    reasons.update(_name_faults(names))
    if (slots != UNKNOWN).any():
        foreign = np.flatnonzero((slots != UNKNOWN) & (owners[slots] != source))
        reasons.update((int(row), int(owners[slots[row]])) for row in foreign)
    good = np.ones(count, np.bool_)
    good[list(reasons)] = False
    row = np.flatnonzero(good)
    rows = row if len(row) < count else slice(None)
    form, aligned = shapes.canonical(given.take(rows))
    with np.errstate(over='ignore', invalid='ignore'):
        lo, hi = shapes.bounds(form, aligned)
    found = Rows(row, slots[rows], form, ~aligned, lo, hi, masks[rows], lives[rows])
    if not (np.isfinite(lo).all() and np.isfinite(hi).all()):
        finite = np.asarray(np.isfinite(lo).all(axis=1) & np.isfinite(hi).all(axis=1))
        reasons.update((int(large), shapes.REASONS[shapes.TOO_LARGE]) for large in row[~finite])
        found = found.take(finite)
    last = registry.last_of_each(names, found.row)
    return found if len(last) == len(found.row) else found.take(np.isin(found.row, last)), reasons


def _name_faults(names: Names) -> dict[int, str]:
    reserved = f"names that begin with '{ERROR_PREFIX}' are reserved for error replies"
    if isinstance(names, Numbered):
        count = len(names.numbers) if names.prefix.startswith(ERROR_PREFIX) else 0
        return dict.fromkeys(range(count), reserved)
    faults = {}
    for row, name in enumerate(names):
        if not isinstance(name, str):
            raise ValueError(f'names must be strings: row {row} is {name!r}')
        if not name:
            faults[row] = 'its name is empty'
        elif name.startswith(ERROR_PREFIX):
            faults[row] = reserved
    return faults
