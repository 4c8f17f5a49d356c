# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the queries need of a tree: its arrays, and the snapshot that batches of rays share."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import checks, wide
from .nodes import COUNT, NONE, ROOT

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]


def in_threads(work: Callable[[int, int], Any], count: int, threads: int) -> list[Any]:
    """Do work(start, stop) over `count` rows in as many pieces as threads.

    Kernels release the GIL.
    """
    threads = max(1, min(checks.whole('threads', threads, 1), count))
    if threads == 1:
        return [work(0, count)]
    edges = [count * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, edges[:-1], edges[1:]))


class Arrays:
    """The storage of a tree. Any number of threads may read it while none changes it."""

    ndim: int
    _nodes: NDArray[Any]
    _heights: NDArray[np.int16]
    _tight: NDArray[Any]
    _handles: Ids
    _state: NDArray[np.int64]
    _changes: int
    _lock: Lock
    _snapshot: wide.Snapshot | None
    _snapshot_of: int
    _rays_since: int

    def __len__(self) -> int:
        """How many boxes there are."""
        return int(self._state[COUNT])

    def _tree(self) -> tuple[Any, ...]:
        return self._nodes, self._tight, self._handles, int(self._state[ROOT])

    def _boxes_only(self) -> tuple[Any, ...]:
        return self._nodes, self._tight, int(self._state[ROOT])

    def _to_handles(self, slots: Ids) -> Ids:
        return np.where(slots >= 0, self._handles[slots], NONE)

    def _snapshot_for(self, count: int) -> wide.Snapshot | None:
        """The wide snapshot of the tree as it is, if the rays since the last change, `count` more
        now, are worth building it.
        """
        with self._lock:
            if self._snapshot_of != self._changes:
                self._snapshot, self._snapshot_of, self._rays_since = None, self._changes, 0
            self._rays_since += count
            if self._snapshot is None and self._rays_since >= max(
                wide.RAYS_PER_BOX * len(self), wide.LEAST_RAYS
            ):
                root = int(self._state[ROOT])
                if len(self) > 1:
                    self._snapshot = wide.take_snapshot(self._nodes, root)
            return self._snapshot
