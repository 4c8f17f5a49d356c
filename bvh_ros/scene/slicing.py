# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A very large update in slices, between which the scene can be asked.

A half applied update must not open a gap: the third point of one cloud may stand where the
seventh stands in the next. So what moves leaves a shadow where it was, and all shadows go, with
whatever the update does not name, only when the whole update is in. Until then the world holds
what either message says, never less.

Nothing between two pauses grows with the scene, but for a look at columns of numbers.
"""

from collections.abc import Callable, Generator, Iterator

import numpy as np

from ..tree.access import SLOT_MASK
from .names import UNKNOWN, Slots, as_families
from .results import Refusals
from .rows import text
from .store import Obstacles
from .updates import NONE, Part, Sliced, Updates

# An update is applied at once among fewer obstacles than this, or if it has a tenth of the rows:
# that takes at most 30 ms. Slices and their shadows take up to ten times as long in all.
AT_ONCE = 15_000
SLICE = 256  # rows, 1 to 5 ms
# Of rows with meshes of their own, 35 us each: in slices they take no longer.
COSTLY_AT_ONCE, COSTLY_SLICE = 256, 64
Parts = Callable[[int], Iterator[Part]]


class SlicedUpdates:
    """Updates that pause."""

    def __init__(self, store: Obstacles, updates: Updates) -> None:
        self._store = store
        self._updates = updates

    def in_slices(
        self,
        source: str,
        group: str,
        total: int,
        parts: Parts,
        *,
        whole: bool,
        costly: bool = False,
        at_once: bool = False,
    ) -> Generator[None, None, Refusals]:
        """Apply `total` rows and pause now and then; return the refusals at the end.

        Parameters
        ----------
        source, group : str
            As for `replace`.
        total : int
            Number of rows.
        parts : callable
            Makes the parts, of so many rows each but the last; the next is made when the one
            before is applied. Called twice if there may be too many: first to see the names.
        whole : bool
            `replace`, and not only `update`. Until the last slice the scene holds old and new
            obstacles, so up to twice `max_obstacles`; at the end `max_obstacles` holds.
        costly : bool
            Rows take as long as meshes do.
        at_once : bool
            Do not pause: ten times faster in all.

        Raises
        ------
        ValueError, OverflowError
            As `update`; what is applied by then stays.
        """
        self._updates.require_memory(total)
        if at_once or not self.is_long(source, total, whole=whole, costly=costly, group=group):
            (part,) = parts(max(total, 1))
            return self._updates.apply(source, group, part, whole=whole)
        length = COSTLY_SLICE if costly else SLICE
        self._updates.remove_orphans()
        replaced = self._members(source, group) if whole else None
        running = Sliced(source, group, self._store.next_node_handle, total, replaced)
        self._updates.under_way.add(running)
        refusals, row = Refusals(), 0
        try:
            yield from self._store.make_room(total)
            if replaced is not None and total > self._updates.room_beside(running) + len(replaced):
                yield from self._survey(running, parts(length))
            for part in parts(length):
                running.left -= running.new.pop() if running.surveyed else len(part.shapes.kind)
                refused = self._updates.apply(source, group, part, sliced=running)
                refusals.extend(refused, first=row)
                row += len(part.shapes.kind)
                yield
            leaving = self._updates.leaving(running)
            yield from self._remove_in_slices(np.append(self._shadows(running), leaving))
            self._store.newest = max(self._store.newest, running.newest)
        finally:
            self._updates.under_way.discard(running)
            if not self._store.change.unfinished:
                self._store.remove(self._shadows(running))
        return refusals

    def _members(self, source: str, group: str) -> Slots:
        """Handles in the tree of the members of a group, but for shadows."""
        columns, slots = self._store.columns, self._store.members(source, group)
        return columns.tree_handle[slots[~columns.shadow[slots]]]

    def is_long(
        self, source: str, total: int, *, whole: bool, costly: bool = False, group: str = ''
    ) -> bool:
        """Whether `in_slices` pauses."""
        text('source', source), text('group', group)
        going = self._store.groups.members(source, group) if whole else 0
        among = max(total + len(self._store), going)
        long = 10 * max(total, going) >= AT_ONCE and among >= AT_ONCE
        return long or (costly and total >= COSTLY_AT_ONCE)

    def _survey(self, running: Sliced, parts: Iterator[Part]) -> Iterator[None]:
        """Find the obstacles that will stay, go and come, where not all may come."""
        handles, new = self._members(running.source, running.group), running.new
        named = np.zeros(len(self._store.columns.tree_handle), np.bool_)
        for part in parts:
            slots = self._store.registry.find(as_families(part.names))
            known = slots != UNKNOWN
            named[slots[known & (slots < len(named))]] = True  # others may have come meanwhile
            new.append(len(slots) - int(np.count_nonzero(known)))
            yield
        new.reverse()
        running.replaced = handles[~named[handles & SLOT_MASK]]
        running.stays = len(handles) - len(running.replaced)
        running.left, running.surveyed = sum(new), True

    def _remove_in_slices(self, slots: Slots) -> Iterator[None]:
        handles = self._store.columns.tree_handle[slots]
        for begin in range(0, len(slots), SLICE):
            # Meanwhile some may have expired, and others may have their slots.
            self._store.remove(self._store.still_there(handles[begin : begin + SLICE]))
            yield

    def _shadows(self, running: Sliced) -> Slots:
        return self._store.still_there(np.concatenate([NONE, *running.shadows]))
