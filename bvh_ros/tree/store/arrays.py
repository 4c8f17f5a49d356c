# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all methods need of a tree: its arrays, whose turn it is, and the snapshot that batches of
rays share.
"""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import changing
from ..build import building
from ..nodes import CHANGES, COUNT, LAST_SERIAL, OWES, ROOT, SHAPES, SLOT_MASK, STATE_PLACES, TURN
from ..wide import snapshot as wide
from .storage import Storage, allocate, inherit
from .turns import ANY_VERSION, IS_CHANGED, IS_QUERIED, QUERIED

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]
# What kernels that query take first: nodes, exact boxes (where nodes are fat), handles by slot,
# the state and the version of the tree.
View = tuple[NDArray[Any], NDArray[Any], Ids, Ids, int]
NO_ROWS, NO_MASKS = np.empty(0, np.int64), np.empty(0, np.uint32)


class Arrays:
    """The storage of a tree. Any number of threads may read it while none changes it."""

    _ndim: int
    _margin: float
    _sibling_search: str
    _storage: Storage
    # Version of the nodes, rays cast since, the snapshot if there is one: written together.
    _wide: tuple[int, int, wide.Snapshot | None]

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
        view = self.view()
        count = view[3].item(COUNT)
        self.check_unchanged(view)
        return count

    def arrays(self) -> tuple[Any, ...]:
        """What kernels read: nodes, exact boxes (where nodes are fat), handles by slot, the root.

        To be read only, and only until the tree changes: these are the tree's own arrays.
        """
        nodes, tight, handles, state, _ = self.view()
        return nodes, tight, handles, state.item(ROOT)

    @property
    def state(self) -> NDArray[np.int64]:
        """Its root and what it counts, see `nodes`: kernels that count rays write there."""
        return self._settled().state

    @property
    def _nodes(self) -> NDArray[Any]:
        return self._settled().nodes

    @property
    def _heights(self) -> NDArray[np.int16]:
        return self._settled().heights

    @property
    def _tight(self) -> NDArray[Any]:
        return self._settled().tight

    @property
    def _handles(self) -> Ids:
        return self._settled().handles

    @property
    def _state(self) -> NDArray[np.int64]:
        """What of the state a file holds."""
        return self._settled().state[:STATE_PLACES]

    # ---- turns

    def view(self) -> View:
        """The tree as it is now, for a query of several steps."""
        nodes, _, tight, handles, state, heirs, _ = self._storage
        if heirs:
            nodes, _, tight, handles, state, _, _ = self._settled()
        return nodes, tight, handles, state, state.item(CHANGES)

    def _view_and_heights(self) -> tuple[View, NDArray[np.int16]]:
        nodes, heights, tight, handles, state, _, _ = self._settled()
        return (nodes, tight, handles, state, state.item(CHANGES)), heights

    def check_unchanged(self, view: View) -> None:
        """RuntimeError if what was read since the view was taken may not fit together."""
        _, _, _, state, version = view
        if state.item(TURN) < 0 or state.item(CHANGES) != version:
            raise RuntimeError(IS_CHANGED)

    def _settled(self) -> Storage:
        """The storage of now: what a growth has left undone is done."""
        storage = self._storage
        while storage.heirs:
            heir = storage.heirs[0]
            if inherit(*storage[:5], *heir[:5]) != 0:
                break  # it is just being changed: that change is the one that is refused
            self._storage = storage = heir
        return storage

    def _replace_storage(self, storage: Storage, capacity: int, fat: bool) -> None:
        """Let larger arrays, or others, take the place of these."""
        storage.heirs.append(allocate(self.ndim, capacity, fat))
        if self._settled() is storage:
            raise RuntimeError(IS_CHANGED)

    def _reserve(self, storage: Storage, more: int) -> None:
        """Make room for so many more boxes, at least doubling."""
        old, need = len(storage.handles), storage.state.item(COUNT) + more
        capacity = min(max(need, 2 * old), SLOT_MASK + 1)
        if need > capacity:
            raise ValueError(f'lo and hi are too many: a tree holds at most {SLOT_MASK + 1} boxes')
        self._replace_storage(storage, capacity, len(storage.tight) > 0)

    def _make_way(self, reason: int, storage: Storage, more: int = 0) -> None:
        """Take away what a change was refused for; RuntimeError if it is another thread."""
        if reason == changing.FULL:
            self._reserve(storage, more)
        elif reason == changing.OWING:
            self._change_many(changing.SETTLE)
        elif reason == changing.NO_NUMBERS:
            raise ValueError(f'lo and hi are too many: a tree can name {LAST_SERIAL} insertions')
        elif reason == QUERIED and storage.process != os.getpid():
            # In a forked process a query that was under way in the parent never ends.
            self._replace_storage(storage, len(storage.handles), len(storage.tight) > 0)
        else:
            raise RuntimeError(IS_QUERIED if reason == QUERIED else IS_CHANGED)

    def _change_many(
        self,
        how: int,
        rows: Ids = NO_ROWS,
        boxes: tuple[Floats, Floats, Floats] | None = None,
        masks: NDArray[np.uint32] = NO_MASKS,
        version: int = ANY_VERSION,
        shares: tuple[float, float] = (0.0, 0.0),
    ) -> int:
        """Call the kernel of this name, with all the memory that it may want."""
        if boxes is None:
            boxes = (np.empty((0, self.ndim)),) * 3
        more = len(rows) if how == changing.INSERT else 0
        order = np.empty(2 * len(rows) if how == changing.MOVE else 0, np.int64)
        while True:
            storage = self._settled()
            now = storage.state.item(CHANGES) if version == ANY_VERSION else version
            room = building.room_to_build(storage.state.item(COUNT) + more)
            done: int = changing.change_many(
                *storage[:5],
                now,
                how,
                rows,
                boxes,
                masks,
                self.margin,
                self.sibling_search == 'branch_and_bound',
                shares,
                order,
                room,
            )
            if done >= 0:
                return done
            self._make_way(done, storage, more)

    def _settle(self) -> None:
        """See to what an interrupted change of one box still owes."""
        if self._settled().state.item(OWES):
            self._change_many(changing.SETTLE)

    # ---- the snapshot

    def _snapshot_for(self, count: int, view: View) -> wide.Snapshot | None:
        """The wide snapshot of the tree as it is, if the rays since the last change, `count` more
        now, are worth building it.

        Threads that ask at the same time may each build one: none waits for another.
        """
        state = view[3]
        shape, boxes = state.item(SHAPES), state.item(COUNT)
        of, rays, snapshot = self._wide
        if of != shape:
            rays, snapshot = 0, None
        rays += count
        enough = max(wide.RAYS_PER_BOX * boxes, wide.LEAST_RAYS)
        if snapshot is None and boxes > 1 and rays >= enough:
            snapshot = wide.take_snapshot(view)
            if snapshot is None:  # nor will there be one before the tree changes
                rays = -(2**62)
        self._wide = shape, rays, snapshot
        return snapshot
