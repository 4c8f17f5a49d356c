# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Taking obstacles away: those of some names, those whose time is over, or all."""

from collections.abc import Collection, Iterator

import numpy as np

from .store import updating
from .store.columns import NEVER
from .store.names import Names, as_families
from .store.obstacles import Obstacles
from .store.registry import UNKNOWN, Slots

AT_A_TIME = 8192  # obstacles, about 10 ms


class Removals:
    """How obstacles leave a scene."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self.expired = 0
        """How many obstacles `expire` has removed so far."""

    def remove(self, source: str, names: Names) -> int:
        """Remove obstacles of this source by name; return how many there were.

        Names it does not own are left alone.
        """
        return self.discard(self.find(source, names))

    def remove_group(self, source: str, group: str) -> int:
        """Remove the obstacles of a group ('': all that the source owns).

        Return how many there were.
        """
        updating.text('source', source), updating.text('group', group)
        return self._held.remove(self._held.members(source, group))

    def remove_namespace(self, source: str, namespace: str | None = None) -> int:
        """Remove the source's obstacles named `namespace`/x, where x has no slash; None: all.

        Return how many there were.
        """
        if namespace is None:
            return self.remove_group(source, '')
        updating.text('namespace', namespace)
        return self.discard(self.find(source, [], {namespace}))

    def find(self, source: str, names: Names, namespaces: Collection[str] = ()) -> Slots:
        """Who of a source has one of these names, or one in these namespaces; for `discard`."""
        updating.text('source', source)
        slots = self._held.registry.find(as_families(names))
        slots = slots[slots != UNKNOWN]
        if len(namespaces):
            slots = np.concatenate((slots, self._held.registry.in_namespaces(set(namespaces))))
        if len(slots) > 1:
            slots = np.unique(slots)
        return self._held.columns.tree_handle[
            slots[self._held.columns.source[slots] == self._held.groups.source(source)]
        ]

    def discard(self, found: Slots) -> int:
        """Remove those that `find` found, as far as they are still there; return how many."""
        once = np.unique(found) if len(found) > 1 else found
        return self._held.remove(self._held.still_there(once))

    def discard_in_slices(self, found: Slots, besides: Names) -> Iterator[None]:
        """`discard`, with pauses, those who have none of the names `besides`."""
        if not len(found):
            return
        slots = self._held.registry.find(as_families(besides))
        kept = self._held.columns.tree_handle[slots[slots != UNKNOWN]]
        found = found[~np.isin(found, kept)]
        if len(found) <= AT_A_TIME:
            self.discard(found)
            return
        for begin in range(0, len(found), AT_A_TIME):
            self.discard(found[begin : begin + AT_A_TIME])
            yield

    def expire(self, now: int, most: int | None = None) -> int:
        """Remove the obstacles with 0 < expires <= now (ns); return how many there were.

        Costs nothing while none can be due. `most` is how many are removed one by one; where more
        are due, the others are still there, see `has_expired`.
        """
        if updating.whole_time('now', now) < self._held.next_expiry:
            return 0
        expires = self._held.columns.expires
        due = np.flatnonzero((expires > 0) & (expires <= now))
        removed = self._held.remove(due if len(due) == len(self._held.tree) else due[:most])
        self.expired += removed
        self._held.note_next_expiry()
        return removed

    def has_expired(self, now: int) -> bool:
        """Whether the time of some obstacle is over that is still there."""
        return updating.whole_time('now', now) >= self._held.next_expiry

    def shift_expiries(self, by: int) -> None:
        """The caller's clock jumped by so many ns: what an obstacle has left to live stays."""
        by = updating.whole_time('by', by)
        expires = self._held.columns.expires
        mortal = expires > 0
        # Never 0, which is for ever, nor later than can be told.
        times = np.minimum(expires[mortal], min(NEVER - by, NEVER)) + by
        with self._held.change:
            expires[mortal] = np.maximum(times, 1)
            self._held.note_next_expiry()
