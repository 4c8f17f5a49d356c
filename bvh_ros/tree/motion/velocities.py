# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The velocities of boxes, beside the tree.

Each stands at the slot of its box together with the box's handle: so those of boxes that are gone
are nobody's, and no change of the tree has to know of them.
"""

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compiler import lean_kernel
from ..entries import entry_points
from ..nodes import NONE, SLOT_MASK
from ..store.turns import begin_change, end_change


@functools.cache
def velocity_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a slot: whose velocity it is, m/s, and when the box is where it was told to be,
    s. Who has the slot since has none.
    """
    velocity = 'velocity', np.float64, (ndim,)
    return np.dtype([('owner', np.int64), ('reference', np.float64), velocity])


def room_for(capacity: int, ndim: int, old: NDArray[Any] | None = None) -> NDArray[Any]:
    """Records for so many slots, and a last one for who has no velocity, with what smaller ones
    hold.
    """
    new = np.zeros(capacity + 1, velocity_dtype(ndim))
    new['owner'] = NONE
    if old is not None:
        new[: len(old) - 1] = old[:-1]
    return new


@lean_kernel
def write(tree, version, kept, handles, velocities, references):
    """Write velocities, (n, ndim), and references, (n,) or one for all, of the boxes of `handles`;
    0, or why not.
    """
    refused = begin_change(tree.state, version)
    if refused != 0:
        return np.int64(refused)
    for i in range(handles.shape[0]):
        slot = handles[i] & SLOT_MASK
        here = kept[slot]
        here.owner, here.reference = handles[i], references[i if references.shape[0] > 1 else 0]
        for axis in range(velocities.shape[1]):
            here.velocity[axis] = velocities[i, axis]
    end_change(tree.state, True)
    return np.int64(0)


def told_to(
    kept: NDArray[Any], handles: NDArray[np.int64], slots: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(velocities, references) of the boxes of slots; zeros where a box has none."""
    rows = kept[np.minimum(slots, len(kept) - 1)]
    told = rows['owner'] == handles[slots]
    return np.where(told[:, None], rows['velocity'], 0.0), np.where(told, rows['reference'], 0.0)


def packed(kept: NDArray[Any], handles: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """What a file holds: those of living boxes."""
    count = min(len(kept) - 1, len(handles))
    owners = kept['owner'][:count]
    live = kept[np.flatnonzero((owners == handles[:count]) & (owners >= 0))]
    names = {'moving': 'owner', 'velocities': 'velocity', 'references': 'reference'}
    return {name: np.ascontiguousarray(live[field]) for name, field in names.items()}


_IDS, _ROWS = np.empty(0, np.int64), np.empty((0, 3))
write_entry = entry_points(
    *(write, 0, lambda ndim: np.empty(0, velocity_dtype(ndim)), _IDS, _ROWS, np.empty(0))
)
