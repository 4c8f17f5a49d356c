# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A very large update in slices, between which the scene can be asked.

A half applied update must not open a gap: the third point of one cloud may stand where the
seventh stands in the next. So what moves leaves a shadow where it was, and all shadows go, with
whatever the update does not name, only when the whole update is in. Until then the world holds
what either message says, never less.
"""

from collections.abc import Callable, Generator, Iterator

import numpy as np

from .refusals import Refusals
from .store.obstacles import Obstacles
from .store.registry import Slots
from .updates import NONE, Part, Sliced, Updates

# Fewer rows than this are applied at once, in 30 to 80 ms: slices and their shadows take ten times
# as long in all.
AT_ONCE = 120_000
SLICE = 1024  # rows, 2 to 5 ms


class SlicedUpdates:
    """Updates that pause."""

    def __init__(self, held: Obstacles, updates: Updates) -> None:
        self._held = held
        self._updates = updates

    def in_slices(
        self,
        source: str,
        group: str,
        total: int,
        parts: Callable[[int], Iterator[Part]],
        *,
        whole: bool,
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
            Makes the parts, of at most so many rows each; the next is made when the one before
            is applied.
        whole : bool
            `replace`, and not only `update`. Until the last slice the scene holds old and new
            obstacles, so up to twice `max_obstacles`; at the end `max_obstacles` holds.
        at_once : bool
            Do not pause: ten times faster in all.

        Raises
        ------
        ValueError, OverflowError
            As `update`; what is applied by then stays.
        """
        self._updates.require_memory(total)
        sliced = not at_once and self._is_large(source, group, total, whole)
        length = SLICE if sliced else max(total, 1)
        if length >= total:
            (part,) = parts(length)
            return self._updates.apply(source, group, part, whole=whole)
        refusals = Refusals()
        self._updates.remove_orphans()
        running = Sliced(total, self._members(source, group) if whole else None)
        self._updates.under_way.add(running)
        row = 0
        try:
            for part in parts(length):
                running.left -= len(part.shapes.kind)
                refused = self._updates.apply(source, group, part, sliced=running)
                refusals.extend(refused, first=row)
                row += len(part.shapes.kind)
                yield
            leaving = self._updates.leaving(running)
            yield from self._remove_in_slices(np.append(self._shadows(running), leaving))
        finally:
            self._updates.under_way.discard(running)
            if not self._held.change.unfinished:
                self._held.remove(self._shadows(running))
        return refusals

    def _members(self, source: str, group: str) -> Slots:
        """Handles in the tree of the members of a group, but for shadows."""
        columns, slots = self._held.columns, self._held.members(source, group)
        return columns.tree_handle[slots[~columns.shadow[slots]]]

    def _is_large(self, source: str, group: str, total: int, whole: bool) -> bool:
        if total < AT_ONCE:
            return False
        # With less room it has to be known first what goes, to know what may come.
        return not whole or total <= self._updates.room() + len(self._members(source, group))

    def _remove_in_slices(self, slots: Slots) -> Iterator[None]:
        handles = self._held.columns.tree_handle[slots]
        for begin in range(0, len(slots), SLICE):
            # Meanwhile some may have expired, and others may have their slots.
            self._held.remove(self._held.still_there(handles[begin : begin + SLICE]))
            yield

    def _shadows(self, running: Sliced) -> Slots:
        return self._held.still_there(np.concatenate([NONE, *running.shadows]))
