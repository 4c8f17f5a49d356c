# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a tree has that knows velocities: where they are kept, and bounds over the times that are
asked for.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..entries import entry_points
from ..nodes import CHANGES, TURN, aligned_empty
from ..store.turns import IS_CHANGED, NOT_FINITE, REFUSED
from . import velocities
from .bounds import fit_nodes, moving_dtype
from .casting import no_motion
from .meeting import Moving

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

NOT_FITTED = -2  # no tree's version, nor ANY_VERSION
HORIZON = 1.0  # s: from one time on bounds are fitted to so many more
fit_entry = entry_points(fit_nodes, no_motion, np.empty(0, np.int64))


class Motion:
    """The velocities of a tree, and bounds of its nodes over the times that are asked for."""

    def __init__(self, ndim: int) -> None:
        self.kept = velocities.room_for(0, ndim)
        self.moving = no_motion(ndim)._replace(version=NOT_FITTED)

    def write(self, tree: Any, version: int, handles: Ids, rows: Floats, times: Floats) -> int:
        """Call `velocities.write`, with room for all slots."""
        capacity = len(tree.handles)
        if len(self.kept.owners) < capacity:
            self.kept = velocities.room_for(capacity, rows.shape[1], self.kept)
        kernel = velocities.write_entry(rows.shape[1])
        done: int = kernel(tree, version, self.kept, handles, rows, times)
        return done

    def packed(self, handles: Ids) -> dict[str, Any]:
        """`velocities.packed`."""
        return velocities.packed(self.kept, handles)

    # ---- bounds

    def ask(self, tree: Any, spans: Callable[[], tuple[float, float]], call: Any) -> Any:
        """What call(arrays, moving) returns, it or its first value not negative, with bounds that
        hold for what is asked. `spans` tells the times: (first, last).
        """
        while True:
            done = call(tree.view().tree, self.moving)
            why = done[0] if isinstance(done, tuple) else done
            if why >= 0:
                return done
            if why == NOT_FINITE:
                raise ValueError('a row was changed while it was read')
            self.fit(tree, *spans())

    def fit(self, tree: Any, first: float, last: float) -> None:
        """Fit bounds of the tree as it is now to this time, at whose ends they are tight. Has it
        been asked for others since it changed, they are fitted to a longer time that holds both.
        RuntimeError if it is being changed.
        """
        arrays, ndim, before = tree.view().tree, tree.ndim, self.moving
        version = arrays.state.item(CHANGES)
        if before.version == version:
            if arrays.state.item(TURN) < 0:
                raise RuntimeError(IS_CHANGED)
            first, last = min(first, before.start), max(last, before.stop)
            more = 0.5 * (last - first)
            first, last = first - more, last + more
        elif first == last:
            last = first + max(HORIZON, 2.0**-40 * abs(first))
        nodes = aligned_empty(len(arrays.nodes), moving_dtype(ndim))
        order = np.empty(len(arrays.nodes), np.int64)
        moving = Moving(*self.kept, nodes, float(first), float(last), version)
        if fit_entry(ndim)(arrays, moving, order) == REFUSED:
            raise RuntimeError(IS_CHANGED)
        self.moving = moving

    @property
    def nbytes(self) -> int:
        """Memory of all."""
        return sum(array.nbytes for array in (*self.kept, self.moving.nodes))
