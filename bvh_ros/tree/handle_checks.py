# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Handles: whether they name boxes of a tree."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checks import FOREIGN, is_integer, refuse_masked, shown_short
from .jit.compiling import kernel
from .nodes import SLOT_MASK

LAST_INT64 = (1 << 63) - 1


@kernel
def _first_bad_handle(handles, given, seen, once):
    """(row, why): why 0 is none, 1 an unknown handle, 2 one given before although each must be
    given once.
    """
    for i in range(given.shape[0]):
        slot = given[i] & SLOT_MASK
        if given[i] < 0 or slot >= handles.shape[0] or handles[slot] != given[i]:
            return i, 1
        if once:
            if seen[slot]:
                return i, 2
            seen[slot] = True
    return -1, 0


def unknown(handle: Any) -> KeyError:
    """What is raised where a handle names no box."""
    return KeyError(f'handle {shown_short(handle)} names no box of this tree')


def handle(value: Any) -> int:
    """What may be a handle, else KeyError; what is no integer is none."""
    if is_integer(value) and not isinstance(value, bool) and 0 <= value <= LAST_INT64:
        return int(value)
    raise unknown(value)


def slots_of(handles: NDArray[np.int64], given: ArrayLike, once: bool = True) -> NDArray[np.int64]:
    """Slots of live handles; KeyError names the first unknown one, ValueError the first double one
    (with `once`).
    """
    try:
        array = np.asarray(given)
        refuse_masked(given, array)
    except FOREIGN as error:
        raise ValueError(f'handles must be integers of shape (n,): {error}') from None
    if array.shape == (0,):
        return np.empty(0, np.int64)
    if array.ndim != 1 or array.dtype.kind not in 'iu':
        raise ValueError(
            f'handles must be integers of shape (n,), not {array.dtype} of shape {array.shape}'
        )
    numbers = array.astype(np.int64)
    row, why = _first_bad_handle(
        handles, numbers, np.zeros(len(handles) if once else 0, np.bool_), once
    )
    if why == 1:
        raise KeyError(f'handle {array[row]} in row {row} names no box of this tree')
    if why == 2:
        raise ValueError(f'handles must be given once each: row {row} repeats {array[row]}')
    return numbers & SLOT_MASK
