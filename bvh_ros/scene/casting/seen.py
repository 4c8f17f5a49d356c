# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When rays and swept balls go, and what they meet."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.shapes import Floats
from ..store.registry import Slots


class Met(NamedTuple):
    """Hits, by ray and in the order in which they are met."""

    rows: Slots
    slots: Slots
    ts: Floats
    points: Floats
    """Shape (m, 3)."""
    normals: Floats

    def take(self, which: NDArray[np.int64]) -> 'Met':
        """Some of them."""
        columns: Any = (column[which] for column in self)
        return Met(*columns)


class Times(NamedTuple):
    """When rays start, s, and how many seconds pass a unit of t; shape (n,) each."""

    at: Floats
    pace: Floats

    def ends(self, t_max: Floats) -> Floats:
        """When rays end, s; inf where they never do."""
        with np.errstate(over='ignore', invalid='ignore'):
            return np.where(self.pace > 0.0, self.at + self.pace * t_max, self.at)
