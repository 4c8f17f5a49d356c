# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Handles: whether they name boxes of a tree."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checks import FOREIGN, INT64, is_integer, refuse_masked, shown_short
from .compiler import entry_point, lean_kernel
from .nodes import SLOT_MASK

LAST_INT64 = (1 << 63) - 1


@lean_kernel
def _fill_slots(handles, given, taken, slots):
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
    """The machine code of `_fill_slots`."""
    numbers = np.empty(0, np.int64)
    return entry_point(_fill_slots, numbers, numbers, np.empty(0, np.bool_), numbers)


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
