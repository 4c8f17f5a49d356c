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
from .store.updating import Rows
from .updates import Part, Replacement, Updates

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
        running = Replacement(source, group, total)
        row = 0
        if whole:
            self._updates.under_way.append(running)
        try:
            for part in parts(length):
                running.left -= len(part.shapes.kind)
                refused = self._updates.apply(
                    *(source, group, part), named=running.named, before_moves=self._leave_shadows
                )
                refusals.extend(refused, first=row)
                row += len(part.shapes.kind)
                yield
            yield from self._remove_in_slices(
                self._updates.leaving(running) if whole else self._shadows(source)
            )
        finally:
            if whole:
                self._updates.under_way.remove(running)
            self._held.remove(self._shadows(source))
        return refusals

    def _is_large(self, source: str, group: str, total: int, whole: bool) -> bool:
        if total < AT_ONCE:
            return False
        # With less room it has to be known first what goes, to know what may come.
        mine = self._held.members(source, group)
        return not whole or total <= self._updates.room() + len(mine)

    def _remove_in_slices(self, slots: Slots) -> Iterator[None]:
        handles = self._held.columns.tree_handle[slots]
        for begin in range(0, len(slots), SLICE):
            end = begin + SLICE
            # Meanwhile some may have expired, and others may have their slots.
            there = self._held.columns.tree_handle[slots[begin:end]] == handles[begin:end]
            self._held.remove(slots[begin:end][there])
            yield

    def _shadows(self, source: str) -> Slots:
        columns = self._held.columns
        mine = columns.source == self._held.groups.source(source)
        return np.flatnonzero(columns.shadow & mine)

    def _leave_shadows(self, rows: Rows) -> None:
        """Copies of the obstacles that are about to move, of the same names and handles, that stay
        where they are.
        """
        columns, tree = self._held.columns, self._held.tree
        lo, hi = tree.boxes(columns.tree_handle[rows.slot])
        stays = (lo == rows.lo).all(axis=1) & (hi == rows.hi).all(axis=1)
        moves = ~stays | rows.records['shaped'] | columns.geometry['shaped'][rows.slot]
        slots = rows.slot[moves]
        handles = tree.insert_many(lo[moves], hi[moves], columns.categories[slots])
        copies = tree.slots(handles)
        columns.grow(int(copies.max(initial=-1)) + 1)
        columns.copy(slots, copies)
        columns.tree_handle[copies] = handles
        columns.shadow[copies] = True
        columns.shadows += len(copies)
        self._held.registry.copy(slots, copies)
