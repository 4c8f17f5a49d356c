# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The velocities of boxes, beside the tree.

Each stands at the slot of its box together with the box's handle: so those of boxes that are gone
are nobody's, and no change of the tree has to know of them.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..entries import entry_points
from ..jit.compiling import lean_kernel
from ..nodes import NONE, SLOT_MASK
from ..store.turns import begin_change, end_change


class Velocities(NamedTuple):
    """Arrays by slot; the last row of two of them is zero, see `meeting.Moving`."""

    owners: NDArray[np.int64]
    velocities: NDArray[np.float64]
    references: NDArray[np.float64]


def room_for(capacity: int, ndim: int, old: Velocities | None = None) -> Velocities:
    """Arrays for so many slots, with what smaller ones hold."""
    new = Velocities(
        np.full(capacity, NONE, np.int64), np.zeros((capacity + 1, ndim)), np.zeros(capacity + 1)
    )
    if old is not None:
        for there, here in zip(old, new, strict=True):
            here[: len(old.owners)] = there[: len(old.owners)]
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
        kept.owners[slot] = handles[i]
        kept.references[slot] = references[i if references.shape[0] > 1 else 0]
        for axis in range(velocities.shape[1]):
            kept.velocities[slot, axis] = velocities[i, axis]
    end_change(tree.state, True)
    return np.int64(0)


def packed(kept: Velocities, handles: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """What a file holds: those of living boxes."""
    count = min(len(kept.owners), len(handles))
    owners = kept.owners[:count]
    live = np.flatnonzero((owners == handles[:count]) & (owners >= 0))
    return {
        'moving': kept.owners[live],
        'velocities': kept.velocities[live],
        'references': kept.references[live],
    }


_IDS, _ROWS = np.empty(0, np.int64), np.empty((0, 3))
write_entry = entry_points(
    write, 0, Velocities(_IDS, _ROWS, np.empty(0)), _IDS, _ROWS, np.empty(0)
)
