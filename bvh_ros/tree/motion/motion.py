# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a tree has that knows velocities: where they are kept, and bounds over the times that are
asked for.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..entries import entry_points
from ..jit.intrinsics import CACHE_LINE
from ..nodes import CHANGES, COUNT, TURN, View, aligned_empty
from ..store.turns import IS_CHANGED, NOT_FINITE, REFUSED
from . import velocities
from .bounds import fit_nodes, moving_dtype
from .casting import no_motion
from .few_casting import FEW
from .meeting import Moving
from .sweeping import Sweep, swept

Floats = NDArray[np.float64]
Ids = NDArray[np.int64]

NOT_FITTED = -2  # no tree's version, nor ANY_VERSION
HORIZON = 1.0  # s: from one time on bounds are fitted to so many more
# Batches for which sweeping a snapshot pays: so many rays a box.
RAYS_PER_BOX = 0.05
# How many times as long as what is asked for its span may be for a large batch.
LONGER = 1.5
fit_entry = entry_points(fit_nodes, no_motion, np.empty(0, np.int64))


class Wanted(NamedTuple):
    """How many rays wanted a sweep of a span of time, and the sweep, once it is made."""

    version: int
    """Of the tree."""
    start: float
    stop: float
    rays: int
    made: bool = False
    sweep: Sweep | None = None
    enough: float = 0.0
    """Rays for which boxes were to be swept at once."""


class Motion:
    """The velocities of a tree, and bounds of its nodes over the times that are asked for."""

    def __init__(self, ndim: int, nanoseconds: bool = False) -> None:
        self.kept = velocities.room_for(0, ndim)
        self.moving = no_motion(ndim)._replace(version=NOT_FITTED, nanoseconds=nanoseconds)
        self._no_nodes = self.moving.nodes
        self._wanted = Wanted(NOT_FITTED, 0.0, 0.0, 0)

    def write(self, tree: Any, version: int, handles: Ids, rows: Floats, times: Floats) -> int:
        """Call `velocities.write`, with room for all slots."""
        capacity = len(tree.handles)
        if len(self.kept) <= capacity:
            self.kept = velocities.room_for(capacity, rows.shape[1], self.kept)
        kernel = velocities.write_entry(rows.shape[1])
        done: int = kernel(tree, version, self.kept, handles, rows, times)
        return done

    def packed(self, handles: Ids) -> dict[str, Any]:
        """`velocities.packed`."""
        return velocities.packed(self.kept, handles)

    # ---- bounds

    def ask(
        self, tree: Any, spans: Callable[[], tuple[tuple[float, float], bool]], call: Any
    ) -> Any:
        """What call(arrays, moving) returns, it or its first value not negative, with bounds that
        hold for what is asked. `spans` tells the times: ((first, last), ...).
        """
        while True:
            done = call(tree.view().tree, self.moving)
            why = done[0] if isinstance(done, tuple) else done
            if why >= 0:
                return done
            if why == NOT_FINITE:
                raise ValueError('a row was changed while it was read')
            self.fit(tree, *spans()[0])

    def fitted(self, tree: Any, version: int, first: float, last: float) -> Moving:
        """Bounds of a version of the tree that hold for this time."""
        moving = self.moving
        if moving.version != version or not moving.start <= first <= last <= moving.stop:
            return self.fit(tree, first, last)
        return moving

    def fit(self, tree: Any, first: float, last: float) -> Moving:
        """Fit bounds of the tree as it is now to this time, at whose ends they are tight. Has it
        been asked for others since it changed, they are fitted to a longer time that holds both.
        RuntimeError if it is being changed.
        """
        arrays, ndim, before = tree.view().tree, tree.ndim, self.moving
        version = arrays.state.item(CHANGES)
        if before.version == version:
            if arrays.state.item(TURN) < 0:
                raise RuntimeError(IS_CHANGED)
            # Further than that the way that the times go, as they may go on.
            earlier, later = first < before.start, last > before.stop
            first, last = min(first, before.start), max(last, before.stop)
            more = 0.5 * (last - first)
            first, last = first - more * earlier, last + more * later
        elif first == last:
            last = first + max(HORIZON, 2.0**-40 * abs(first))
        # Processors fetch two cache lines together, if the first of them is an even one.
        nodes = aligned_empty(len(arrays.nodes), moving_dtype(ndim), 2 * CACHE_LINE)
        order = np.empty(len(arrays.nodes), np.int64)
        span = float(first), float(last)
        moving = Moving(self.kept, nodes, *span, version, before.nanoseconds)
        if fit_entry(ndim)(arrays, moving, order) == REFUSED:
            raise RuntimeError(IS_CHANGED)
        self.moving = moving
        return moving

    def swept_for(self, tree: Any, view: View, count: int, span: Any) -> Sweep | None:
        """What is swept for rays, so many, whose times lie in a span; None while that does not pay
        or would not help. The rays of small batches wait until they are enough for one together.
        """
        (first, last), wanted = span, self._wanted
        sweep = self.ready_sweep(count, first, last) if wanted.version == view.version else None
        if sweep is not None:
            return sweep
        rest = tree.snapshot_for(count, view)
        if rest is None:
            return None
        enough = RAYS_PER_BOX * view.tree.state.item(COUNT)
        known = wanted.version == view.version
        covered = known and wanted.start <= first and last <= wanted.stop
        if covered and wanted.made:
            if count < enough or wanted.stop - wanted.start <= LONGER * (last - first):
                return None  # it did not help
            known = False
        if not known or (wanted.made and not covered):
            wanted = Wanted(view.version, first, last, 0)
        rays, start, stop = wanted.rays + count, first, last
        if count < enough:
            start, stop = min(first, wanted.start), max(last, wanted.stop)
        made = rays >= enough
        if made:
            sweep = swept(view.tree, self.known(view, start, stop), rest)
        self._wanted = Wanted(view.version, start, stop, rays, made, sweep, enough)
        return sweep

    def ready_sweep(self, count: int, one: float, other: float) -> Sweep | None:
        """The sweep that is made, of whatever version of the tree, if it serves so many rays from
        one time to the other.
        """
        _, start, stop, _, _, sweep, enough = self._wanted
        if sweep is None or not (start <= one <= stop and start <= other <= stop):
            return None
        if count < enough or stop - start <= LONGER * abs(other - one):
            return sweep
        return None

    def few_sweep(self, count: int) -> Sweep | None:
        """The sweep that is made, of whatever version of the tree and span, if it serves so many
        rays, and they are few.
        """
        _, _, _, _, _, sweep, enough = self._wanted
        return sweep if count < FEW and count < enough else None

    def known(self, view: View, start: float, stop: float) -> Moving:
        """What is known of the motion of a tree, for a span, without bounds."""
        told = self.kept, self._no_nodes, start, stop, view[1], self.moving.nanoseconds
        return tuple.__new__(Moving, told)

    @property
    def nbytes(self) -> int:
        """Memory of all."""
        sweep = self._wanted.sweep
        more = 0 if sweep is None else sweep.nbytes
        return self.kept.nbytes + self.moving.nodes.nbytes + more
