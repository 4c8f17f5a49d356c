# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Input made sound before it reaches a kernel, or one plain sentence why not."""

import functools
import math
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .compiler import entry_point, kernel, lean_kernel
from .nodes import ALL, SLOT_MASK

Floats = NDArray[np.float64]

EVERY = np.uint32(ALL)
NUMBER = int, float, np.number  # what is surely one for all rows
FLOAT64, INT64, UINT32 = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.uint32)
BOOL = np.dtype(np.bool_)
# Defaults: one value for all rows.
FOREVER, NOTHING, EVERYTHING = np.array([np.inf]), np.zeros(1), np.array([EVERY])

RAY_ARGUMENTS = 'origins', 'directions'
SHORTEST, LONGEST = 0.99**2, 1.01**2  # squares of the lengths of quaternions of length 1

# What others' objects raise when they are converted to numbers; warnings made errors, too. A
# signal handler's exception, say a TimeoutError, is not about the argument.
FOREIGN: tuple[type[Exception], ...] = (
    *(TypeError, ValueError, ArithmeticError, RuntimeError),
    *(LookupError, AttributeError, BufferError, Warning),
)


@kernel
def first_not_finite(values):
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            if not np.isfinite(values[i, j]):
                return i
    return -1


def are_unit(x: Any, y: Any, z: Any, w: Any) -> Any:
    """Whether quaternions (floats or arrays) have length 1, to within 1 %."""
    square = x * x + y * y + z * z + w * w
    return (square >= SHORTEST) & (square <= LONGEST)


def rotations(name: str, array: Floats) -> None:
    """Refuse rows (n, 4) that are no quaternions of length 1, to within 1 %. No kernel: clients
    have none to compile.
    """
    row = -1
    if len(array) == 1:
        if not are_unit(*array[0].tolist()):
            row = 0
    elif len(array):
        x, y, z, w = (array * array).T  # a fifth of the time of `are_unit`
        squares = x + y + z + w
        if not (squares.min() >= SHORTEST and squares.max() <= LONGEST):
            row = int(np.argmin((squares >= SHORTEST) & (squares <= LONGEST)))
    if row >= 0:
        finite(name, array)
        raise ValueError(
            f'{name} must be quaternions x, y, z, w of length 1 (bvh_ros.quaternions makes them '
            f'from angles): row {row} is {array[row].tolist()}'
        )


def floats(name: str, value: ArrayLike) -> Floats:
    """An own, writable, C-ordered float64 copy: kernels then meet one array type only, and never
    the caller's memory.
    """
    try:
        array = np.array(value, order='C')
        kind = type(value)
        if kind is not np.ndarray and (array.ndim > 1 or kind not in (list, tuple)):
            refuse_masked(value, array)
        if array.dtype is FLOAT64:  # much the most common: not worth two more calls
            return array
        if array.dtype.kind not in 'biufO':
            raise TypeError(f'they are of type {array.dtype}')
        if array.dtype.kind == 'O' and any(isinstance(x, (str, bytes)) for x in array.flat):
            raise TypeError('they are words')
        with np.errstate(over='ignore'):  # to inf, which is not finite
            return array.astype(np.float64)
    except FOREIGN as error:
        reason: object = error
        if hasattr(value, 'as_quat'):  # a Rotation of scipy
            reason = 'quaternions are x, y, z, w: give its as_quat()'
        raise ValueError(f'{name} must be real numbers: {reason}') from None


def refuse_masked(value: Any, array: NDArray[Any]) -> None:
    """numpy takes the numbers under a mask for numbers. (A masked one among plain ones becomes
    NaN.)
    """
    rows = value if array.ndim > 1 and isinstance(value, (list, tuple)) else (value,)
    for row in rows:
        if isinstance(row, np.ma.MaskedArray) and np.ma.is_masked(row):
            raise ValueError('some are masked')


def unless_refused(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """As `floats`, but an array of another shape as it is: it will be refused, and a view can
    claim far more rows than there is memory for.
    """
    if isinstance(value, np.ndarray) and value.shape != shape:
        return value
    return floats(name, value)


def with_z(name: str, value: ArrayLike) -> Floats:
    """Coordinates x, y, z of a world that is seen from above: z may be left out, and is 0 then.

    Only the last axis is looked at, so the caller still has to check the shape.
    """
    array = value if isinstance(value, np.ndarray) else floats(name, value)
    width = array.shape[-1] if array.ndim in (1, 2) else 0
    if width == 2:
        array = floats(name, array)
        return np.concatenate((array, np.zeros((*array.shape[:-1], 1))), axis=-1)
    if width != 3 and array.size:
        raise ValueError(f'{name} must have 2 or 3 coordinates, not shape {array.shape}')
    return array


def vector(name: str, value: ArrayLike, ndim: int, planar: bool = False) -> Floats:
    """As `point`, but the caller's memory where that is of the same array type, and not known to
    be finite: for kernels that read it and see to that.
    """
    if (
        type(value) is np.ndarray
        and value.dtype is FLOAT64
        and value.shape == (ndim,)
        and value.flags.carray
    ):
        return value
    if planar:
        value = with_z(name, value)
    array = unless_refused(name, value, (ndim,))
    if array.shape != (ndim,):
        raise ValueError(f'{name} must have shape ({ndim},), not {array.shape}')
    return array


def point(name: str, value: ArrayLike, ndim: int, planar: bool = False) -> Floats:
    """A finite point or vector of shape (ndim,); `planar`: see `with_z`."""
    if planar:
        value = with_z(name, value)
    array = unless_refused(name, value, (ndim,))
    if array.shape != (ndim,):
        raise ValueError(f'{name} must have shape ({ndim},), not {array.shape}')
    for coordinate in array.tolist():
        if not math.isfinite(coordinate):
            raise ValueError(f'{name} must be finite, not {array.tolist()}')
    return array


def points(name: str, value: ArrayLike, ndim: int, count: int | None = None) -> Floats:
    """Finite points or vectors of shape (n, ndim); n is `count` where given."""
    array = copied_rows(name, value, ndim, count)
    finite(name, array)
    return array


def copied_rows(
    name: str, value: ArrayLike, ndim: int, count: int | None, planar: bool = False
) -> Floats:
    """As `points`, not known to be finite. `planar`: see `with_z`."""
    array = rows(name, value, ndim, count, planar)
    return array.copy() if array is value else array


def rows(
    name: str, value: ArrayLike, ndim: int, count: int | None = None, planar: bool = False
) -> Floats:
    """As `points`, neither copied nor known to be finite: that is left to the kernel that
    reads each row once, and to `finite`.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT64 and value.ndim == 2:
        many, axes = value.shape
        if axes == ndim and (count is None or many == count) and value.flags.carray:
            return value
    if planar:
        value = with_z(name, value)
    if isinstance(value, np.ndarray):
        _rows(name, value, ndim, count)  # before it is copied
    return _rows(name, floats(name, value), ndim, count)


def rows_or_one(
    name: str, value: ArrayLike, ndim: int, count: int, planar: bool = False
) -> Floats:
    """As `rows`, or one for all, (1, ndim), of shape (ndim,)."""
    if not isinstance(value, np.ndarray):
        value = floats(name, value)
    if value.ndim == 1 and value.size:
        value, count = value[None], 1
    return rows(name, value, ndim, count, planar)


def edge_lengths(name: str, value: ArrayLike, count: int, planar: bool = False) -> Floats:
    """Sizes of boxes, (count, 3), or one for all, (1, 3); one number is that of a cube."""
    if isinstance(value, NUMBER):
        value = np.full(3, limit(name, value))
    return rows_or_one(name, value, 3, count, planar)


def both(
    names: tuple[str, str], first: ArrayLike, second: ArrayLike, ndim: int, planar: bool = False
) -> tuple[Floats, Floats]:
    """`rows` of two arrays of as many rows, in half the time. One of them may be one row for
    all.
    """
    if (
        type(first) is type(second) is np.ndarray
        and first.dtype is second.dtype is FLOAT64
        and first.ndim == 2
        and first.shape == second.shape
        and first.shape[1] == ndim
        and first.flags.carray
        and second.flags.carray
    ):
        return first, second
    if planar:
        first, second = with_z(names[0], first), with_z(names[1], second)
    if _is_row(first, ndim):
        every = rows(names[1], second, ndim)
        return np.tile(floats(names[0], first), (len(every), 1)), every
    every = rows(names[0], first, ndim)
    if _is_row(second, ndim):
        return every, np.tile(floats(names[1], second), (len(every), 1))
    return every, rows(names[1], second, ndim, len(every))


def points_of_both(
    names: tuple[str, str], first: ArrayLike, second: ArrayLike, ndim: int, planar: bool = False
) -> tuple[Floats, Floats]:
    """As `both`, but copies that are known to be finite."""
    one, other = both(names, first, second, ndim, planar)
    one, other = one.copy(), other.copy()
    finite(names[0], one)
    finite(names[1], other)
    return one, other


def _is_row(value: ArrayLike, ndim: int) -> bool:
    """Whether this is one row of numbers."""
    if isinstance(value, np.ndarray):
        return value.shape == (ndim,)
    return (
        isinstance(value, (list, tuple))
        and len(value) == ndim
        and all(isinstance(number, (float, int, np.number)) for number in value)
    )


def _rows(name: str, array: Floats, ndim: int, count: int | None) -> Floats:
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, ndim)
    if array.ndim != 2 or array.shape[1] != ndim or (count is not None and len(array) != count):
        wanted = 'n' if count is None else count
        raise ValueError(f'{name} must have shape ({wanted}, {ndim}), not {array.shape}')
    return array


def finite(name: str, array: Floats) -> None:
    """Refuse rows that are not finite."""
    row = first_not_finite(array)
    if row >= 0:
        raise ValueError(f'{name} must be finite: row {row} is {array[row].tolist()}')


def mask(value: Any) -> np.uint32:
    """One mask of 32 bits."""
    if value is ALL:  # the default, and much the most common: not worth a microsecond
        return EVERY
    number = value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value
    if isinstance(number, bool) or not is_integer(number) or not 0 <= number <= ALL:
        raise ValueError(f'mask must be an integer from 0 to {ALL}, not {shown_short(value)}')
    return np.uint32(number)


def masks(value: Any, count: int) -> NDArray[np.uint32]:
    """A mask a row, from one for all or an array of shape (count,)."""
    if type(value) is int:
        same = np.empty(count, UINT32)  # a third of the time of np.full
        same.fill(mask(value))
        return same
    try:
        array = np.asarray(value)
        refuse_masked(value, array)
    except FOREIGN as error:
        raise ValueError(f'mask must be integers: {error}') from None
    if array.ndim == 0:
        return np.full(count, mask(array[()]), np.uint32)
    if array.shape != (count,) or (array.dtype.kind not in 'iu' and array.size):
        raise ValueError(
            f'mask must be an integer or have shape ({count},) of integers, '
            f'not {array.shape} of {array.dtype}'
        )
    bad = np.flatnonzero((array < 0) | (array > ALL))
    if bad.size:
        raise ValueError(f'mask must be from 0 to {ALL}: row {bad[0]} is {array[bad[0]]}')
    return array.astype(np.uint32)


def masks_or_one(value: Any, count: int) -> NDArray[np.uint32]:
    """A mask a row, or an array of one for all."""
    return EVERYTHING if value is ALL else masks(value, 1 if isinstance(value, NUMBER) else count)


def one(name: str, value: Any) -> float:
    """One number, from whatever `floats` takes."""
    array = unless_refused(name, value, ())
    if array.shape != ():
        raise ValueError(f'{name} must be one number, not of shape {array.shape}')
    return float(array)


def is_integer(value: Any) -> bool:
    """Whether it is one of Python or numpy; to numpy, a duration is one, too, but not to us."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, np.timedelta64)


def shown_short(value: Any) -> str:
    """What was given, in a sentence."""
    try:
        shown = ' '.join(repr(value).split())  # arrays write several lines
    except FOREIGN:
        return f'a {type(value).__name__}'
    return shown if len(shown) < 80 else f'{shown[:60]}...'


def flag(name: str, value: Any) -> bool:
    """True or False."""
    if value is False or value is True:
        return value
    if (is_integer(value) or isinstance(value, np.bool_)) and value in (0, 1):
        return bool(value)
    raise ValueError(f'{name} must be True or False, not {shown_short(value)}')


def path(name: str, value: Any) -> str:
    """The path of a file."""
    try:
        file = os.fsdecode(value)
        if '\0' not in file:
            return file
        raise ValueError(f'{name} must not hold a NUL')
    except TypeError:
        raise ValueError(f'{name} must be the path of a file, not {shown_short(value)}') from None


def limit(name: str, value: Any) -> float:
    """A distance >= 0 that may be inf."""
    number = value if type(value) is float else one(name, value)
    if not number >= 0.0:
        raise ValueError(f'{name} must not be negative or NaN, not {number}')
    return number


@functools.lru_cache(64)
def only(number: float) -> Floats:
    """An array of one number, to be read only; of the same numbers the same."""
    return np.array([number])


def limits(name: str, value: Any, count: int) -> Floats:
    """A distance >= 0 a row, from one for all or an array of shape (count,); inf is allowed."""
    array = unless_refused(name, value, (count,))
    if array.ndim == 0:
        return np.full(count, limit(name, array[()]))
    if array.shape != (count,):
        raise ValueError(f'{name} must be a number or have shape ({count},), not {array.shape}')
    bad = np.flatnonzero(~(array >= 0.0))
    if bad.size:
        raise ValueError(f'{name} must not be negative or NaN: row {bad[0]} is {array[bad[0]]}')
    return array


def limits_or_one(name: str, value: Any, count: int) -> Floats:
    """A distance >= 0 a row, or an array of one for all."""
    if type(value) is float and value >= 0.0:
        return FOREVER if value == math.inf else only(value)
    return limits(name, value, 1 if isinstance(value, NUMBER) else count)


def lengths_or_one(name: str, value: Any, count: int) -> Floats:
    """As `limits_or_one`, but finite."""
    if type(value) is float and 0.0 <= value < math.inf:
        return NOTHING if value == 0.0 else only(value)
    lengths = limits_or_one(name, value, count)
    endless = np.flatnonzero(lengths == np.inf)
    if len(endless):
        raise ValueError(f'{name} must be finite: row {endless[0]} is inf')
    return lengths


def whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """An integer of at least `least` and at most `most`."""
    if type(value) is int and value >= least and (most is None or value <= most):
        return value
    if isinstance(value, bool) or not is_integer(value) or value < least:
        raise ValueError(
            f'{name} must be an integer of at least {least}, not {shown_short(value)}'
        )
    if most is not None and value > most:
        raise ValueError(f'{name} must be at most {most}, not {shown_short(value)}')
    return int(value)


def iterator(name: str, value: Any) -> Iterator[Any]:
    """What iterates over a value."""
    try:
        return iter(value)
    except FOREIGN:
        raise ValueError(f'{name} must be a sequence, not {shown_short(value)}') from None


def strings(name: str, value: Any) -> set[str]:
    """The strings in a collection."""
    found, wrong = set[str](), isinstance(value, str)
    for one in () if wrong else iterator(name, value):
        if not isinstance(one, str):
            wrong = True
            break
        found.add(one)
    if wrong:
        raise ValueError(f'{name} must be a collection of strings, not {shown_short(value)}')
    return found


def whole_or_none(name: str, value: Any, least: int) -> int | None:
    """An integer of at least `least`, or None."""
    return None if value is None else whole(name, value, least)


def capacity(name: str, value: Any) -> int:
    """A number of boxes that a tree can hold, and not none."""
    return whole(name, value, 1, SLOT_MASK + 1)


# ---- boxes


@lean_kernel
def first_no_box(lo, hi):
    """The first row of lo and hi, (n, ndim) float64, that is not finite or has lo > hi; else -1"""
    low, high = lo.reshape(lo.size), hi.reshape(lo.size)
    # Without a way out of the loop it is one of vectors.
    good = True
    for i in range(low.size):
        good &= (-np.inf < low[i]) & (low[i] <= high[i]) & (high[i] < np.inf)
    if good:
        return -1
    for i in range(lo.shape[0]):
        for j in range(lo.shape[1]):
            if not (-np.inf < lo[i, j] <= hi[i, j] < np.inf):
                return i
    return -1


@functools.cache
def _first_entry() -> Callable[..., Any]:
    """The machine code of `first_no_box`."""
    return entry_point(first_no_box, np.empty((0, 3)), np.empty((0, 3)))


def boxes(
    lo: ArrayLike, hi: ArrayLike, ndim: int, count: int | None = None
) -> tuple[Floats, Floats]:
    """Rows of boxes: finite, lo <= hi on every axis."""
    low = copied_rows('lo', lo, ndim, count)
    high = copied_rows('hi', hi, ndim, len(low))
    row = _first_entry()(low, high)
    if row >= 0:
        finite('lo', low)
        finite('hi', high)
        raise ValueError(
            f'lo must not exceed hi: row {row} has lo {low[row].tolist()} '
            f'and hi {high[row].tolist()}'
        )
    return low, high


def box(lo: ArrayLike, hi: ArrayLike, ndim: int) -> tuple[Floats, Floats]:
    """One box: finite, lo <= hi on every axis."""
    low, high = point('lo', lo, ndim), point('hi', hi, ndim)
    if not (low <= high).all():
        raise ValueError(f'lo must not exceed hi: lo is {low.tolist()} and hi is {high.tolist()}')
    return low, high


def is_pair(value: Any) -> bool:
    """Whether it may be a box, as (lo, hi), rather than a point."""
    if type(value) is np.ndarray:
        return value.ndim == 2
    return (
        type(value) in (list, tuple)
        and len(value) == 2
        and (type(value[0]) in (list, tuple) or getattr(value[0], 'ndim', 0) == 1)
    )


def pair(name: str, value: ArrayLike, ndim: int) -> tuple[Floats, Floats]:
    """A box as (lo, hi), finite, lo <= hi."""
    array = unless_refused(name, value, (2, ndim))
    if array.shape != (2, ndim):
        raise ValueError(f'{name} must have shape ({ndim},) or (2, {ndim}), not {array.shape}')
    finite(name, array)
    low, high = array
    if not (low <= high).all():
        raise ValueError(f'{name} must not have lo {low.tolist()} beyond hi {high.tolist()}')
    return low, high


def few_enough(lo: ArrayLike) -> None:
    """Refuse more boxes than a tree can hold, before they are copied."""
    if isinstance(lo, np.ndarray) and lo.ndim > 1 and len(lo) > SLOT_MASK:
        capacity('the number of rows of lo', max(len(lo), 1))


def no_box(lo: ArrayLike, hi: ArrayLike, ndim: int) -> ValueError:
    """What is raised where a kernel says that these are no box."""
    box(lo, hi, ndim)
    return were_changed()


def were_changed() -> ValueError:
    """What is raised where a kernel was given other numbers than are there now."""
    return ValueError('lo and hi were changed while they were read')


# ---- handles: whether they name boxes of a tree


LAST_INT64 = (1 << 63) - 1


@lean_kernel
def fill_slots(handles, given, taken, slots):
    """Fill in the slot of each handle, all int64 (n,): (row, why) of the first bad one. why 0 is
    none, 1 an unknown handle, 2 one given before; `taken` is empty where that is allowed.
    """
    for i in range(given.shape[0]):
        number = given[i]
        slot = number & SLOT_MASK
        if number < 0 or slot >= handles.shape[0] or handles[slot] != number:
            return i, 1
        if taken.shape[0] > 0:
            if taken[slot]:
                return i, 2
            taken[slot] = True
        slots[i] = slot
    return -1, 0


@functools.cache
def _slots_entry() -> Callable[..., Any]:
    """The machine code of `fill_slots`."""
    numbers = np.empty(0, np.int64)
    return entry_point(fill_slots, numbers, numbers, np.empty(0, np.bool_), numbers)


def unknown(handle: Any) -> KeyError:
    """What is raised where a handle names no box."""
    return KeyError(f'handle {shown_short(handle)} names no box of this tree')


def handle(value: Any) -> int:
    """What may be a handle, else KeyError; what is no integer is none."""
    if type(value) is not int and (isinstance(value, bool) or not is_integer(value)):
        raise unknown(value)
    if 0 <= value <= LAST_INT64:
        return int(value)
    raise unknown(value)


def slots_of(handles: NDArray[np.int64], given: ArrayLike, once: bool = True) -> NDArray[np.int64]:
    """Slots of live handles; KeyError names the first unknown one, ValueError the first double one
    (with `once`).
    """
    given_handles = numbers('handles', given)
    slots = np.empty(len(given_handles), INT64)
    taken = np.zeros(len(handles) if once else 0, np.bool_)
    row, why = _slots_entry()(handles, given_handles, taken, slots)
    if why == 0:
        return slots
    number = np.asarray(given)[row]
    if why == 1:
        raise KeyError(f'handle {number} in row {row} names no box of this tree')
    raise ValueError(f'handles must be given once each: row {row} repeats {number}')


def array_of(name: str, given: ArrayLike) -> NDArray[Any]:
    """What is given, as an array of any type."""
    try:
        array = np.asarray(given)
        refuse_masked(given, array)
    except FOREIGN as error:
        raise ValueError(f'{name} must be integers of shape (n,): {error}') from None
    return array


def numbers(name: str, given: ArrayLike) -> NDArray[np.int64]:
    """Handles as the kernel takes them: the caller's memory where that is of this array type."""
    if type(given) is np.ndarray and given.dtype is INT64 and given.ndim == 1:
        return given if given.flags.carray else given.copy()
    array = array_of(name, given)
    if array.shape == (0,):
        return np.empty(0, np.int64)
    if array.ndim != 1 or array.dtype.kind not in 'iu':
        raise ValueError(
            f'{name} must be integers of shape (n,), not {array.dtype} of shape {array.shape}'
        )
    return array.astype(np.int64)


# ---- times: a moment is a float in seconds or an integer in nanoseconds, as of `time.time()` and
# `time.time_ns()`; a pace is in seconds, of whatever type


FIRST_TIME, LAST_TIME = -(1 << 63), (1 << 63) - 1  # what a time in ns can be


def whole_ns(name: str, seconds: Floats, given: Any) -> NDArray[np.int64]:
    """Times in s as the nearest whole ns; the array was made of what is given."""
    refuse_mixed(name, given)
    last = LAST_TIME // 10**9
    # Of a shorter type the limit and the product would be rounded to that type.
    seconds = seconds.astype(np.promote_types(seconds.dtype, np.float64))
    if not (np.abs(seconds) <= last).all():
        raise ValueError(f'{name} must be finite, and at most {last} s')
    whole = np.floor(seconds)  # the rest is exact, and so small that its product is rounded once
    rest = np.rint((seconds - whole) * 1e9).astype(np.int64)
    return np.asarray(whole.astype(np.int64) * 10**9 + rest)


def refuse_mixed(name: str, given: Any) -> None:
    """ValueError where some times are integers, ns, and others are not: numpy makes floats of all,
    and these are seconds.
    """
    if isinstance(given, (list, tuple)):
        whole = [isinstance(one, (int, np.integer)) for one in given]
        if any(whole) and not all(whole):
            raise ValueError(f'{name} must be all integers (ns) or all floats (s)')


def _in_seconds(name: str, value: Any, shape: tuple[int, ...]) -> Floats:
    """As `unless_refused`, with integers of a moment brought to seconds."""
    array = unless_refused(name, value, shape)
    if name != 'pace' and array.shape in ((), shape):
        given = np.asarray(value)
        refuse_mixed(name, value)
        if given.dtype.kind in 'iu':
            return np.asarray(given.astype(np.longdouble) / 10**9, np.float64)
    return array


def moment(name: str, value: Any) -> float:
    """One finite number."""
    number = value if type(value) is float else one(name, _in_seconds(name, value, ()))
    if not math.isfinite(number):
        raise ValueError(f'{name} must be finite, not {number}')
    return number


def times(name: str, value: Any, count: int) -> Floats:
    """As `moments`, but not known to be finite, and the caller's memory where that is of the same
    array type: for kernels that read it and see to that. With no row they see nothing.
    """
    if type(value) is float and count:
        return only(value)
    if (
        type(value) is np.ndarray
        and value.dtype is FLOAT64
        and value.shape == (count,)
        and value.flags.carray
    ):
        return value
    return moments(name, value, count)


def moments(name: str, value: ArrayLike, count: int | None) -> Floats:
    """One for all as shape (1,), or shape (count,); finite. `count` None: only one."""
    if count is None or type(value) is float:
        return np.array([moment(name, value)])
    array = _in_seconds(name, value, (count,))
    if array.ndim == 0:
        return np.array([moment(name, array[()])])
    if array.shape != (count,):
        raise ValueError(f'{name} must be a number or have shape ({count},), not {array.shape}')
    if first_not_finite(array[None]) >= 0:
        bad = np.flatnonzero(~np.isfinite(array))
        raise ValueError(f'{name} must be finite: row {bad[0]} is {array[bad[0]]}')
    return array
