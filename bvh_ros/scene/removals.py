# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Taking obstacles away: those of some names, those whose time is over, or all."""

from collections.abc import Callable, Collection, Iterator

import numpy as np

from ..tree.dynamic_bvh import DynamicBVH
from ..tree.nodes import SLOT_MASK
from .store import updating
from .store.columns import Columns
from .store.groups import Groups
from .store.names import Names, as_families
from .store.registry import UNKNOWN, Registry, Slots

AT_A_TIME = 8192  # obstacles, about 10 ms


class Removals:
    """How obstacles leave a scene."""

    newest: int
    expired: int
    _tree: DynamicBVH
    _columns: Columns
    _registry: Registry
    _groups: Groups
    _next_expiry: int
    _any_shaped: bool
    _remove: Callable[[Slots], int]
    _note_next_expiry: Callable[[], None]
    __len__: Callable[[], int]

    def find(self, source: str, names: Names, namespaces: Collection[str] = ()) -> Slots:
        """Who of a source has one of these names, or one in these namespaces; for `discard`."""
        updating.text('source', source)
        slots = self._registry.find(as_families(names))
        slots = slots[slots != UNKNOWN]
        if len(namespaces):
            slots = np.concatenate((slots, self._registry.in_namespaces(set(namespaces))))
        slots = np.unique(slots)
        return self._columns.tree_handle[
            slots[self._columns.source[slots] == self._groups.source(source)]
        ]

    def discard(self, found: Slots) -> int:
        """Remove those that `find` found, as far as they are still there; return how many."""
        return self._remove(self._still_there(found))

    def discard_in_slices(self, found: Slots, besides: Names) -> Iterator[None]:
        """`discard`, with pauses, those who have none of the names `besides`."""
        if not len(found):
            return
        slots = self._registry.find(as_families(besides))
        kept = self._columns.tree_handle[slots[slots != UNKNOWN]]
        found = found[~np.isin(found, kept)]
        for begin in range(0, len(found), AT_A_TIME):
            self.discard(found[begin : begin + AT_A_TIME])
            yield

    def _still_there(self, found: Slots) -> Slots:
        slots = found & SLOT_MASK
        return slots[self._columns.tree_handle[slots] == found]

    def clear(self) -> int:
        """Remove all obstacles; return how many there were."""
        self.newest = 0
        count = len(self)
        self._remove(self._columns.used())
        return count

    def expire(self, now: int, most: int | None = None) -> int:
        """Remove the obstacles with 0 < expires <= now (ns); return how many there were.

        Costs nothing while none can be due. `most` is how many are removed one by one; where more
        are due, the others are still there, see `has_expired`.
        """
        if updating.whole_time('now', now) < self._next_expiry:
            return 0
        expires = self._columns.expires
        due = np.flatnonzero((expires > 0) & (expires <= now))
        removed = self._remove(due if len(due) == len(self._tree) else due[:most])
        self.expired += removed
        self._note_next_expiry()
        return removed

    def has_expired(self, now: int) -> bool:
        """Whether the time of some obstacle is over that is still there."""
        return now >= self._next_expiry

    def _remove_all(self) -> int:
        """Remove everything: not one by one."""
        count = len(self._tree)
        self._tree.clear()
        self._registry.clear()
        self._groups.clear()
        self._columns.clear()
        self._any_shaped = False
        return count
