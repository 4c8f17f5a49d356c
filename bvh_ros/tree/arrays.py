# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the queries need of a tree: its arrays, and the snapshot that batches of rays share."""

import functools
import os
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

PIECES_A_THREAD = 4


def in_threads(
    work: Callable[[int, int], Any], count: int, threads: int, together: int = 1
) -> list[Any]:
    """Do work(start, stop) over `count` rows, shared among so many threads; results in the order
    of the rows.

    Kernels release the GIL. There are more pieces than threads, and whoever is done takes the
    next: a thread that the machine interrupts then does not hold up the others. But rows that
    gain from so many of them `together` are not parted for that.
    """
    threads = max(1, min(checks.whole('threads', threads, 1), count))
    if threads == 1:
        return [work(0, count)]
    pieces = max(threads, min(PIECES_A_THREAD * threads, count // together))
    edges = [count * i // pieces for i in range(pieces + 1)]
    waiting = iter(range(pieces))
    results: list[Any] = [None] * pieces

    def take() -> None:
        for piece in waiting:
            results[piece] = work(edges[piece], edges[piece + 1])

    # This thread is one of them: it is awake already.
    others = [_workers(threads - 1).submit(take) for _ in range(threads - 1)]
    take()
    for other in others:
        other.result()
    return results


@functools.cache
def _workers(threads: int) -> ThreadPoolExecutor:
    """Kept for the life of the process: starting threads costs as much as casting 1,000 rays."""
    return ThreadPoolExecutor(threads, 'bvh_ros')


if hasattr(os, 'register_at_fork'):  # a child has the pool, but not its threads
    os.register_at_fork(after_in_child=_workers.cache_clear)


class Arrays:
    """The storage of a tree. Any number of threads may read it while none changes it."""

    _ndim: int
    _margin: float
    _sibling_search: str
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

    @property
    def ndim(self) -> int:
        """2 or 3."""
        return self._ndim

    @property
    def margin(self) -> float:
        """By how much boxes in the tree are grown on every side, m."""
        return self._margin

    @property
    def sibling_search(self) -> str:
        """How an insertion looks for the best sibling."""
        return self._sibling_search

    def __len__(self) -> int:
        """How many boxes there are."""
        return int(self._state[COUNT])

    def arrays(self) -> tuple[Any, ...]:
        """What kernels read: nodes, exact boxes (where nodes are fat), handles by slot, the root.

        To be read only, and only until the tree changes: these are the tree's own arrays.
        """
        return self._nodes, self._tight, self._handles, int(self._state[ROOT])

    @property
    def state(self) -> NDArray[np.int64]:
        """Its root and what it counts, see `nodes`: kernels that count rays write there."""
        return self._state

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
                if self._snapshot is None:  # nor will there be one before the tree changes
                    self._rays_since = -(2**62)
            return self._snapshot
