# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where obstacles are at other times than that of their last update.

They go on as they were told, for `max_prediction` seconds, and then stay where they are.
"""

import numpy as np
from numpy.typing import NDArray

from ..geometry.shapes import Floats
from .obstacles import Obstacles
from .registry import Slots

NOBODY = np.empty(0, np.int64)


def motions(held: Obstacles, slots: Slots) -> tuple[Floats, Floats]:
    """Velocities (m, ndim) of obstacles, and the times (m,) in s from which they hold."""
    return held.tree.velocities(held.columns.tree_handle[slots])


def ways(held: Obstacles, slots: Slots, at: Floats) -> Floats:
    """How far obstacles have gone at times (m,) in s since their last updates, (m, ndim)."""
    velocities, references = motions(held, slots)
    with np.errstate(over='ignore'):
        gone = velocities * np.minimum(at - references, held.max_prediction)[:, None]
    most = np.finfo(np.float64).max
    return np.clip(gone, -most, most)


def ways_in_space(held: Obstacles, slots: Slots, at: Floats) -> Floats:
    """`ways` of shape (m, 3)."""
    gone = ways(held, slots, at)
    return gone if held.tree.ndim == 3 else np.pad(gone, ((0, 0), (0, 1)))


def at_rest(held: Obstacles, last: float) -> Slots:
    """Slots of obstacles that have moved until some time before `last`, s: the tree knows no such
    end, so who asks it has to look at these alone.
    """
    if not held.moves or np.isinf(held.max_prediction):
        return NOBODY
    version, first = held.first_rest
    if version == held.tree.view().version and last <= first:
        return NOBODY
    version = held.tree.view().version
    slots = np.flatnonzero(held.columns.tree_handle >= 0)
    velocities, references = motions(held, slots)
    ends = np.where(velocities.any(axis=1), references + held.max_prediction, np.inf)
    held.first_rest = version, float(ends.min(initial=np.inf))
    return slots[ends < last]


def boxes_at(held: Obstacles, slots: Slots, at: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest corners, (m, ndim), of obstacles' boxes at times (m,) in s."""
    lo, hi = held.tree.boxes(held.columns.tree_handle[slots])
    gone = ways(held, slots, at)
    return lo + gone, hi + gone


def seen(held: Obstacles, slots: Slots, mask: np.uint32 | NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Which obstacles have a bit of the mask."""
    found: NDArray[np.bool_] = (held.columns.categories[slots] & mask) != 0
    return found
