# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From a message's rows to what can be applied.

Which rows are good, in canonical form, and why the others are refused.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.access import ALL, FIRST_TIME, INT64, LAST_TIME, checks, whole_ns
from ..tree.compiler import entry_point, lean_kernel
from .names import BARE, UNKNOWN, Families, Slots, last_of_each
from .results import Reasons
from .shapes.shadow import seen_from_above
from .shapes.shape import FINE, GEOMETRY, REASONS, Canonical, Floats, Records, Shapes, canonicalise

ERROR_PREFIX = 'error: '  # begins the replies that say why a request cannot be answered


class Rows(NamedTuple):
    """Rows of one update; all arrays have the same length."""

    row: NDArray[np.int64]  # their number in the message
    slot: Slots  # UNKNOWN where the name is new
    records: Records
    mesh: NDArray[np.object_] | None  # a Mesh, or what is seen of it, in the rows of that kind
    lo: Floats  # as the tree takes it
    hi: Floats
    categories: NDArray[np.uint32] | None  # None: as they are, and as the scene says of new ones
    stamp: NDArray[np.int64]
    expires: NDArray[np.int64]

    def take(self, which: NDArray[Any] | slice) -> 'Rows':
        """Some of the rows."""
        columns: Any = (None if column is None else column[which] for column in self)
        return Rows(*columns)


_NO_NUMBERS = np.empty(0, np.int64)
_FEW_NUMBERS = np.arange(64)  # whose part takes a quarter of the time of a new array
_FEW_NUMBERS.flags.writeable = False
_NO_ROWS = [  # planar or not
    Rows(
        *(_NO_NUMBERS, _NO_NUMBERS, np.empty(0, GEOMETRY), None, boxes, boxes, None),
        *(_NO_NUMBERS, _NO_NUMBERS),
    )
    for boxes in (np.empty((0, 3)), np.empty((0, 2)))
]


class Owner(NamedTuple):
    """The source of an update, and how the owners of obstacles are known."""

    number: int
    of_slot: NDArray[np.int64]
    name_of: Callable[[int], str]


def column(
    name: str, value: ArrayLike, count: int, largest: int, least: int = 0
) -> NDArray[np.int64]:
    """One integer for all rows, or one a row, from `least` to `largest`. If these are times in ns,
    they may also be floats in s.
    """
    exact: Any = value
    if type(exact) is int and least <= exact <= largest:  # much the most common
        same = np.zeros(count, INT64)
        if exact:
            same.fill(exact)
        return same
    try:
        array = np.asarray(value)
    except checks.FOREIGN:
        raise ValueError(f'{name} must be an integer or {count} integers') from None
    masked = isinstance(value, np.ma.MaskedArray)
    if not array.size:
        array = array.astype(np.int64)  # an empty list is of floats
    fits = array.shape in ((), (count,)) and not masked
    if fits and largest == LAST_TIME and array.dtype.kind == 'f':
        array = whole_ns(name, array, value)
    beyond = array.dtype == object and all(type(number) is int for number in array.flat)
    whole = beyond or array.dtype.kind in 'iu'  # numpy makes objects of integers beyond 64 bits
    if not fits or not whole:
        number = 'an integer (ns) or a float (s)' if largest == LAST_TIME else 'an integer'
        more = f', or {count} of them' if count > 1 else ''
        raise ValueError(
            f'{name} must be {number}{more}, not {array.dtype} of shape {array.shape}'
        )
    if array.size and not _spans(array, least, largest):
        wrong = int(array.min() if array.min() < least else array.max())
        raise ValueError(f'{name} must be from {least} to {largest}, not {wrong}')
    numbers = np.empty(count, np.int64)
    numbers[:] = array
    return numbers


def _spans(array: NDArray[Any], least: int, largest: int) -> bool:
    """Whether all numbers are from `least` to `largest`. What the type can't hold is not looked
    for: a look at one number takes numpy as long as all else of a column.
    """
    of_64_bits = array.dtype == np.int64
    above = (of_64_bits and least == FIRST_TIME) or least <= int(array.min())
    return above and ((of_64_bits and largest == LAST_TIME) or int(array.max()) <= largest)


def whole_time(name: str, value: Any) -> int:
    """A time in ns."""
    return column(name, value, 1, LAST_TIME, FIRST_TIME).item(0)


def text(name: str, value: Any) -> str:
    """A name of a source or a group."""
    if not isinstance(value, str):
        raise ValueError(f'{name} must be a string, not {type(value).__name__}')
    return value


@lean_kernel
def all_good(faults, names, slots, owners, owner):
    """(whether no row is refused for what an array can tell and no name comes twice, how many are
    known). names = (family, numbers).
    """
    family, numbers = names
    known = 0
    for i in range(slots.shape[0]):
        if faults[i] != FINE:
            return False, known
        if i > 0 and (
            family[i] < family[i - 1]
            or (family[i] == family[i - 1] and numbers[i] <= numbers[i - 1])
        ):
            return False, known
        if slots[i] != UNKNOWN:
            known += 1
            if owners[slots[i]] != owner:
                return False, known
    return True, known


@functools.cache
def _all_good() -> Callable[..., Any]:
    """The machine code of `all_good`."""
    numbers = np.empty(0, np.int64)
    return entry_point(
        all_good, np.empty(0, np.uint8), (numbers, numbers), numbers, numbers, UNKNOWN
    )


class Validated(NamedTuple):
    """Rows of a message that can be applied, and why the others cannot."""

    added: Rows
    known: Rows
    reasons: Reasons


def validate_rows(
    names: Families,
    shapes: Shapes,
    slots: Slots,
    owner: Owner,
    columns: tuple[ArrayLike, ArrayLike, ArrayLike | None],
    speeds: Floats | None,
    planar: bool,
) -> Validated:
    """The rows to apply. `columns` are stamps, expiries and categories, one for all or one a row;
    speeds, (n, 3), are the velocities that are given.

    Of several good rows with one name the last is applied: a message is read in order, and a later
    row modifies an earlier one's obstacle.
    """
    count = len(slots)
    stamps = column('stamp', columns[0], count, LAST_TIME, FIRST_TIME)
    lives = column('expires', columns[1], count, LAST_TIME)
    masks = None
    if columns[2] is not None:
        masks = column('categories', columns[2], count, ALL).astype(np.uint32)
    form = canonicalise(shapes, 2 if planar else 3)
    mesh = seen_from_above(shapes.mesh, form) if planar else shapes.mesh
    everyone = _FEW_NUMBERS[:count] if count <= len(_FEW_NUMBERS) else np.arange(count)
    records, lo, hi, faults = form
    # As Rows(...), which would take one more call of a function of Python's.
    fields = everyone, slots, records, mesh, lo, hi, masks, stamps, lives
    rows, reasons = tuple.__new__(Rows, fields), Reasons(count)
    good, known = _all_good()(faults, names[1:], slots, owner.of_slot, owner.number)
    wrong = None
    if speeds is not None and checks.first_not_finite(speeds) >= 0:
        good, wrong = False, np.logical_not(np.isfinite(speeds).all(axis=1))
    if good and not _refuse_names(names, reasons):
        if known == count:
            return Validated(_NO_ROWS[planar], rows, reasons)
        if known == 0:
            return Validated(rows, _NO_ROWS[planar], reasons)
    else:
        rows = rows.take(_taken(names, slots, form, owner, wrong, reasons))
    new = rows.slot == UNKNOWN
    return Validated(rows.take(new), rows.take(~new), reasons)


def _taken(
    names: Families,
    slots: Slots,
    form: Canonical,
    owner: Owner,
    wrong: NDArray[np.bool_] | None,
    reasons: Reasons,
) -> NDArray[np.int64]:
    """Which rows to apply; why the others are refused is added to the reasons. `wrong` are those
    whose velocity is not finite.
    """
    for fault in np.unique(form.faults[form.faults != FINE]).tolist():
        reasons.add(form.faults == fault, REASONS[fault])
    if wrong is not None:
        reasons.add(wrong, 'its velocity is not finite')
    _refuse_names(names, reasons)
    known = slots != UNKNOWN
    foreign = np.flatnonzero(known)
    foreign = foreign[owner.of_slot[slots[foreign]] != owner.number]
    others = owner.of_slot[slots[foreign]]
    for other in np.unique(others).tolist():
        reason = f"its name belongs to the source '{owner.name_of(other)}'"
        reasons.add(foreign[others == other], reason)
    return last_of_each(names, np.flatnonzero(reasons.good))


def _refuse_names(names: Families, reasons: Reasons) -> bool:
    """Whether any name is refused for its text."""
    prefixes = names.prefixes
    for one in prefixes:
        if not one or one.startswith(ERROR_PREFIX):
            break
    else:
        return False
    reserved = [place for place, one in enumerate(prefixes) if one.startswith(ERROR_PREFIX)]
    empty = [place for place, one in enumerate(prefixes) if not one]
    if reserved:
        reason = f"names that begin with '{ERROR_PREFIX}' are reserved for error replies"
        reasons.add(np.isin(names.family, reserved), reason)
    if empty:
        bad = np.isin(names.family, empty) & (names.numbers == BARE)
        reasons.add(bad, 'its name is empty')
    return True
