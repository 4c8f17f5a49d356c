# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From a message's rows to what can be applied.

Which rows are good, in canonical form, and why the others are refused.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree.nodes import ALL
from ..geometry import shapes
from ..geometry.polygon import outlined
from ..geometry.shapes import Floats, Shapes
from ..refusals import Reasons
from .names import BARE, Families, last_of_each
from .registry import UNKNOWN, Slots

ERROR_PREFIX = 'error: '  # begins the replies that say why a request cannot be answered


class Formed(NamedTuple):
    """The good ones among `total` shapes, in canonical form."""

    total: int
    row: NDArray[np.int64]  # (m,) their numbers, ascending; what follows has a row for each
    shapes: Shapes
    shaped: NDArray[np.bool_]  # anything but an axis-aligned box
    lo: Floats
    hi: Floats
    reasons: Reasons  # what is wrong with the others

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


def canonicalise(given: Shapes, planar: bool) -> Formed:
    """Look at shapes alone: nothing here depends on the world."""
    count = len(given.kind)
    code = shapes.faults(given)
    reasons = Reasons(count)
    for fault in np.unique(code[code != shapes.FINE]).tolist():
        reasons.add(code == fault, shapes.REASONS[fault])
    row = np.flatnonzero(code == shapes.FINE)
    canonicalise, aligned = shapes.canonical(given if len(row) == count else given.take(row))
    with np.errstate(over='ignore', invalid='ignore'):
        lo, hi = shapes.bounds(canonicalise, aligned)
    if planar:
        canonicalise = outlined(canonicalise)
    formed = Formed(count, row, canonicalise, ~aligned, lo, hi, reasons)
    if not (np.isfinite(lo).all() and np.isfinite(hi).all()):
        finite = np.asarray(np.isfinite(lo).all(axis=1) & np.isfinite(hi).all(axis=1))
        reasons.add(row[~finite], shapes.REASONS[shapes.TOO_LARGE])
        formed = formed.take(finite)
    return formed


def validate_rows(
    names: Families,
    given: Formed,
    slots: Slots,
    owners: NDArray[np.int64],
    source: int,
    columns: tuple[ArrayLike, ArrayLike, ArrayLike | None],
    source_name: Callable[[int], str],
) -> Rows:
    """The rows to apply; `given.reasons` says why the others are refused. `columns` are stamps,
    expiries and categories, one for all or one a row.

    Of several good rows with one name the last is applied: a message is read in order, and a later
    row modifies an earlier one's obstacle.
    """
    count = given.total
    stamps = column('stamp', columns[0], count, TIMES.max, TIMES.min)
    lives = column('expires', columns[1], count, TIMES.max)
    masks = None
    if columns[2] is not None:
        masks = column('categories', columns[2], count, ALL).astype(np.uint32)
    _refuse_names(names, given.reasons)
    known = slots != UNKNOWN
    if known.any():
        foreign = np.flatnonzero(known & (owners[slots] != source))
        owner = owners[slots[foreign]]
        for other in np.unique(owner).tolist():
            reason = f"its name belongs to the source '{source_name(other)}'"
            given.reasons.add(foreign[owner == other], reason)
    given = given.take(given.reasons.good[given.row])
    row = given.row
    last = last_of_each(names, row)
    if len(last) < len(row):
        given = given.take(np.isin(row, last))
        row = given.row
    at = row if len(row) < count else slice(None)
    _, _, canonicalise, shaped, lo, hi, _ = given
    masks = None if masks is None else masks[at]
    return Rows(row, slots[at], canonicalise, shaped, lo, hi, masks, stamps[at], lives[at])


def _refuse_names(names: Families, reasons: Reasons) -> None:
    prefixes = names.prefixes
    reserved = [place for place, one in enumerate(prefixes) if one.startswith(ERROR_PREFIX)]
    empty = [place for place, one in enumerate(prefixes) if not one]
    if reserved:
        reason = f"names that begin with '{ERROR_PREFIX}' are reserved for error replies"
        reasons.add(np.isin(names.family, reserved), reason)
    if empty:
        bad = np.isin(names.family, empty) & (names.numbers == BARE)
        reasons.add(bad, 'its name is empty')
