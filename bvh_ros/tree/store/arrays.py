# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all methods need of a tree: its arrays, whose turn it is, and the snapshot that batches of
rays share.
"""

import contextlib
import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import changing, checks
from ..batch.snapshot import (
    LEAST_RAYS,
    LOOSE_VISITS_PER_BOX,
    RAYS_PER_BOX,
    Snapshot,
    patched,
    take_snapshot,
)
from ..build.building import Room, leave_room, spare_room
from ..moving import Change, Policy
from ..nodes import (
    CHANGES,
    COUNT,
    LAST_SERIAL,
    OWES,
    REBUILDS,
    RECENT_PLACES,
    ROOT,
    SLOT_MASK,
    TURN,
    WRITTEN,
    Tree,
    View,
)
from .storage import READ_ONLY, Storage, allocate, inherit_entry, touch
from .turns import ANY_VERSION, CHANGED, IS_CHANGED, IS_QUERIED, QUERIED

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]
IS_READ_ONLY = 'the tree is mapped from a file and read-only: load it without mmap to change it'
# Why a change of one box is refused, where that is no fault of the arguments.
MENDED = QUERIED, CHANGED, changing.FULL, changing.OWING, changing.NO_NUMBERS
NO_ROWS, NO_MASKS = np.empty(0, np.int64), np.empty(0, np.uint32)
# Room to build in is kept after a change of so few rows: to get it anew takes as long as the rest.
FEW_ROWS = 64


def touched(ndim: int, capacity: int, fat: bool) -> Storage:
    """Storage that waits to be filled, in memory that is there already."""
    storage = allocate(ndim, capacity, fat)
    for array in storage.tree[:-1]:
        touch(array)
    return storage


class Arrays:
    """The storage of a tree. Any number of threads may read it while none changes it."""

    _ndim: int
    _margin: float
    _sibling_search: str
    _thorough: bool
    _storage: Storage
    # `state[WRITTEN]` when it was last looked at; the snapshot if there is one, and rays cast
    # without one, or how often rays visited its loose nodes; the arrays that it was taken of. All
    # are written together.
    _wide: tuple[int, int, Snapshot | None, Tree | None]
    _room: Room | None  # written only by the thread whose turn it is, and by few changes

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
        view = self._view()
        count = view.tree.state.item(COUNT)
        self._check_unchanged(view)
        return count

    def _arrays(self) -> tuple[Any, ...]:
        """What kernels read: nodes, exact boxes (where nodes are fat), handles by slot, the root.

        To be read only, and only until the tree changes: these are the tree's own arrays.
        """
        tree = self._view().tree
        return tree.nodes, tree.tight, tree.handles, tree.state.item(ROOT)

    def _slots(self, handles: ArrayLike) -> Ids:
        """Slots of live handles, in an array of the same shape: small numbers, each of one box, by
        which a caller may keep in arrays what he knows of the boxes. A slot is given again once
        its box is removed. KeyError if a handle names no box.
        """
        given = checks.array_of('handles', handles)
        flat = checks.slots_of(self._view().tree.handles, given.reshape(-1), once=False)
        return flat.reshape(given.shape)

    def _slot(self, handle: int) -> int:
        """`_slots` of one handle."""
        number, handles = checks.handle(handle), self._settled().tree.handles
        slot = number & SLOT_MASK
        if slot < len(handles) and handles.item(slot) == number:
            return slot
        raise checks.unknown(handle)

    @property
    def _state(self) -> NDArray[np.int64]:
        """Its root and what it counts, see `nodes`: kernels that count rays write there."""
        return self._settled().tree.state

    # ---- turns

    def _view(self) -> View:
        """The tree as it is now, for a query of several steps."""
        storage = self._storage
        tree = self._settled().tree if storage.heirs else storage.tree
        return tuple.__new__(View, (tree, tree.state.item(CHANGES)))

    def _latest(self) -> View:
        """The tree for the first kernel of a query, whichever version that meets."""
        storage = self._storage
        return self._settled().latest if storage.heirs else storage.latest

    def _check_unchanged(self, view: View) -> None:
        """RuntimeError if what was read since the view was taken may not fit together."""
        state = view.tree.state
        if state.item(TURN) < 0 or state.item(CHANGES) != view.version:
            raise RuntimeError(IS_CHANGED)

    def _settled(self) -> Storage:
        """The storage of now: what a growth has left undone is done."""
        storage = self._storage
        while storage.heirs:
            heir = storage.heirs[0]
            if inherit_entry(self._ndim)(storage.tree, heir.tree) != 0:
                break  # it is just being changed: that change is the one that is refused
            self._wide = 0, 0, None, None
            self._storage = storage = heir
        return storage

    def _replace_storage(self, storage: Storage, capacity: int, fat: bool) -> None:
        """Let larger arrays, or others, take the place of these."""
        if storage.process == READ_ONLY:
            raise ValueError(IS_READ_ONLY)
        self._succeed(storage, allocate(self.ndim, capacity, fat))

    def _succeed(self, storage: Storage, heir: Storage) -> None:
        storage.heirs.append(heir)
        if self._settled() is storage:
            raise RuntimeError(IS_CHANGED)

    def _room_for(self, count: int) -> Storage | None:
        """Memory for so many boxes in all, for `_move_into`; None if there is enough. Fresh memory
        takes longer to get than to fill, so another thread may ask for it.
        """
        tree = self._storage.tree
        if count <= len(tree.handles):
            return None
        capacity = min(max(count, 2 * len(tree.handles)), SLOT_MASK + 1)
        return touched(self.ndim, capacity, len(tree.tight) > 0)

    def _move_into(self, room: Storage | None) -> None:
        """Move into what `_room_for` returned, unless there is as much room by now."""
        storage = self._settled()
        if room is not None and len(room.tree.handles) > len(storage.tree.handles):
            self._succeed(storage, room)

    def _reserve(self, storage: Storage, more: int) -> None:
        """Make room for so many more boxes, at least doubling."""
        old, need = len(storage.tree.handles), storage.tree.state.item(COUNT) + more
        capacity = min(max(need, 2 * old), SLOT_MASK + 1)
        if need > capacity:
            raise ValueError(f'lo and hi are too many: a tree holds at most {SLOT_MASK + 1} boxes')
        self._replace_storage(storage, capacity, len(storage.tree.tight) > 0)

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
            tree = storage.tree
            self._replace_storage(storage, len(tree.handles), len(tree.tight) > 0)
        else:
            raise RuntimeError(IS_QUERIED if reason == QUERIED else IS_CHANGED)

    def _change(self, kernel: Any, *arguments: Any) -> int:
        """Call a kernel until nothing that can be mended is in its way; what it returned then."""
        while True:
            storage = self._settled()
            done: int = kernel(storage.tree, *arguments)
            if done >= 0 or done not in MENDED:
                return done
            self._make_way(done, storage, 1)

    def _settle_soon(self) -> None:
        """The change is done. What it owes now is done at once, or by the next one."""
        with contextlib.suppress(RuntimeError, MemoryError):
            self._settle()

    def _keep_exact_boxes(self) -> None:
        """From the first predicted displacement on, fat and exact boxes differ even where the
        margin is zero.
        """
        storage = self._settled()
        while not len(storage.tree.tight):
            self._replace_storage(storage, len(storage.tree.handles), True)
            storage = self._settled()

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
        order = np.empty(2 * len(rows) if how == changing.MOVE else 0, np.int32)
        change = Change(rows, *boxes, masks, order)
        policy = Policy(self._margin, self._thorough, *shares)
        kernel = changing.many_entry(self._ndim)
        while True:
            storage = self._settled()
            state = storage.tree.state
            now = state.item(CHANGES) if version == ANY_VERSION else version
            count, rebuilds, room = state.item(COUNT) + more, state.item(REBUILDS), self._room
            if room is None or len(room.made) < count:
                room = spare_room(count)
            done: int = kernel(storage.tree, now, how, change, policy, room)
            # A build of a whole tree writes to all of the room: memory that a tree had better
            # not keep.
            few = 0 < len(rows) <= FEW_ROWS and state.item(REBUILDS) == rebuilds
            self._room = room if few else None
            if not few:
                leave_room(room)
            if done >= 0:
                return done
            self._make_way(done, storage, more)

    def _settle(self) -> None:
        """See to what an interrupted change of one box still owes."""
        if self._settled().tree.state.item(OWES):
            self._change_many(changing.SETTLE)

    # ---- the snapshot

    def _snapshot_for(self, count: int, view: View) -> Snapshot | None:
        """The wide snapshot of the tree as it is, if the rays since it was last outdated, `count`
        more now, are worth building it. Few changes are patched, as long as what that costs the
        rays is not worth building it again.

        Threads that ask at the same time may each build one: none waits for another.
        """
        state = view.tree.state
        written = state.item(WRITTEN)
        of, rays, snapshot, tree = self._wide
        if snapshot is not None and of == written and tree is view.tree and not snapshot.loose:
            return snapshot
        boxes = state.item(COUNT)
        if tree is not view.tree:  # a query of outgrown arrays patches nothing of the new ones
            of, rays, snapshot = written, 0, None
        if of != written:
            if snapshot is not None:
                snapshot = patched(snapshot, view)
                rays = rays if snapshot else 0
            elif rays < 0 or written - of > RECENT_PLACES:
                rays = 0
        if snapshot is None:
            rays += count
            enough = max(RAYS_PER_BOX * boxes, LEAST_RAYS)
        else:
            rays += count * snapshot.loose
            enough = LOOSE_VISITS_PER_BOX * boxes
        if rays >= enough and boxes > 1 and (snapshot is None or snapshot.loose):
            rays, snapshot = 0, take_snapshot(view)
            if snapshot is None:  # nor will there be one before the tree changes
                rays = -(2**62)
        self._wide = written, rays, snapshot, view.tree
        return snapshot
