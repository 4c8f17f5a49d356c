# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From a message's rows to what can be applied.

Which rows are good, in canonical form, and why the others are refused.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.nodes import ALL
from . import shapes
from .names import BARE, Families, last_of_each
from .polygon import outlined
from .registry import UNKNOWN, Slots
from .shapes import Floats, Shapes

ERROR_PREFIX = 'error: '  # begins the replies that say why a request cannot be answered


class Refusal(NamedTuple):
    """A row that was not taken over; the obstacle of that name, if any, is as before."""

    row: int
    name: str
    reason: str


class Formed(NamedTuple):
    """The good ones among `total` shapes, in canonical form; what is wrong with the others."""

    total: int
    row: NDArray[np.int64]  # (m,) their numbers, ascending; what follows has a row for each
    shapes: Shapes
    shaped: NDArray[np.bool_]  # anything but an axis-aligned box
    lo: Floats
    hi: Floats
    faults: dict[int, str]  # by number of the row

    def take(self, which: NDArray[Any]) -> 'Formed':
        """Some of the good ones; the arrays themselves where that is all of them."""
        if which.dtype == np.bool_ and which.all():
            return self
        return self._replace(
            row=self.row[which],
            shapes=self.shapes.take(which),
            shaped=self.shaped[which],
            lo=self.lo[which],
            hi=self.hi[which],
        )


class Rows(NamedTuple):
    """Rows of one update; all arrays have the same length."""

    row: NDArray[np.int64]  # their number in the message
    slot: Slots  # UNKNOWN where the name is new
    shapes: Shapes
    shaped: NDArray[np.bool_]
    lo: Floats
    hi: Floats
    categories: NDArray[np.uint32] | None  # None: as they are, and as the scene says of new ones
    stamp: NDArray[np.int64]
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
            None if self.categories is None else self.categories[which],
            self.stamp[which],
            self.expires[which],
        )


TIMES = np.iinfo(np.int64)  # what a time in ns can be


def column(
    name: str, value: ArrayLike, count: int, largest: int, least: int = 0
) -> NDArray[np.int64]:
    """One integer for all rows, or one a row, from `least` to `largest`."""
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(f'{name} must be an integer or {count} integers') from None
    masked = isinstance(value, np.ma.MaskedArray)
    if array.shape not in ((), (count,)) or masked or array.dtype.kind not in 'iu':
        raise ValueError(
            f'{name} must be an integer of 64 bits or {count} of them, '
            f'not {array.dtype} of shape {array.shape}'
        )
    if array.size and not least <= int(array.min()) <= int(array.max()) <= largest:
        wrong = int(array.min() if array.min() < least else array.max())
        raise ValueError(f'{name} must be from {least} to {largest}, not {wrong}')
    return np.broadcast_to(array.astype(np.int64), (count,))


def whole_time(name: str, value: Any) -> int:
    """A time in ns."""
    return int(column(name, value, 1, TIMES.max, TIMES.min)[0])


def text(name: str, value: Any) -> str:
    """A name of a source or a group."""
    if not isinstance(value, str):
        raise ValueError(f'{name} must be a string, not {type(value).__name__}')
    return value


def form(given: Shapes, planar: bool) -> Formed:
    """Look at shapes alone: nothing here depends on the world."""
    count = len(given.kind)
    code = shapes.faults(given)
    faults = {int(row): shapes.REASONS[code[row]] for row in np.flatnonzero(code)}
    row = np.flatnonzero(code == shapes.FINE)
    form, aligned = shapes.canonical(given if len(row) == count else given.take(row))
    with np.errstate(over='ignore', invalid='ignore'):
        lo, hi = shapes.bounds(form, aligned)
    if planar:
        form = outlined(form)
    formed = Formed(count, row, form, ~aligned, lo, hi, faults)
    if not (np.isfinite(lo).all() and np.isfinite(hi).all()):
        finite = np.asarray(np.isfinite(lo).all(axis=1) & np.isfinite(hi).all(axis=1))
        faults.update((int(large), shapes.REASONS[shapes.TOO_LARGE]) for large in row[~finite])
        formed = formed.take(finite)
    return formed


def examine(
    names: Families,
    given: Formed,
    slots: Slots,
    owners: NDArray[np.int64],
    source: int,
    columns: tuple[ArrayLike, ArrayLike, ArrayLike | None],
) -> tuple[Rows, dict[int, str | int]]:
    """The rows to apply, and the reason of each refused row: a sentence, or the number of the
    source that owns its name. `columns` are stamps, expiries and categories, one for all or one a
    row.

    Of several good rows with one name the last is applied: a message is read in order, and a later
    row modifies an earlier one's obstacle.
    """
    count = given.total
    stamps = column('stamp', columns[0], count, TIMES.max, TIMES.min)
    lives = column('expires', columns[1], count, TIMES.max)
    masks = None
    if columns[2] is not None:
        masks = column('categories', columns[2], count, ALL).astype(np.uint32)
    reasons: dict[int, str | int] = {**given.faults, **_name_faults(names)}
    known = slots != UNKNOWN
    if known.any():
        foreign = np.flatnonzero(known & (owners[slots] != source))
        reasons.update((int(row), int(owners[slots[row]])) for row in foreign)
    good = np.ones(count, np.bool_)
    good[list(reasons)] = False
    given = given.take(good[given.row])
    row = given.row
    last = last_of_each(names, row)
    if len(last) < len(row):
        given = given.take(np.isin(row, last))
        row = given.row
    at = row if len(row) < count else slice(None)
    _, _, form, shaped, lo, hi, _ = given
    masks = None if masks is None else masks[at]
    found = Rows(row, slots[at], form, shaped, lo, hi, masks, stamps[at], lives[at])
    return found, reasons


def _name_faults(names: Families) -> dict[int, str]:
    faults: dict[int, str] = {}
    for place, prefix in enumerate(names.prefixes):
        if prefix.startswith(ERROR_PREFIX):
            reason = f"names that begin with '{ERROR_PREFIX}' are reserved for error replies"
            bad = names.family == place
        elif not prefix:
            reason, bad = 'its name is empty', (names.family == place) & (names.numbers == BARE)
        else:
            continue
        faults.update(dict.fromkeys(np.flatnonzero(bad).tolist(), reason))
    return faults
