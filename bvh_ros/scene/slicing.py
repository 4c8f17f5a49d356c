# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A very large update in slices, between which the scene can be asked.

A half applied update must not open a gap: the third point of one cloud may stand where the
seventh stands in the next. So what moves leaves a shadow where it was, and all shadows go, with
whatever the update does not name, only when the whole update is in. Until then the world holds
what either message says, never less.
"""

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..tree.dynamic_bvh import DynamicBVH
from ..tree.nodes import ALL, SLOT_MASK
from .geometry.shapes import Shapes, as_shapes
from .refusals import Refusals
from .store.columns import Columns
from .store.groups import Groups
from .store.names import Names, as_families
from .store.registry import Registry, Slots
from .store.updating import TIMES, Rows, column

# Fewer rows than this are applied at once, in 30 to 80 ms: slices and their shadows take ten times
# as long in all.
AT_ONCE = 120_000
SLICE = 1024  # rows, 2 to 5 ms


class Part(NamedTuple):
    """Some rows of an update, as for `Scene.update`."""

    names: Names
    shapes: Shapes
    stamp: ArrayLike
    expires: ArrayLike = 0
    categories: ArrayLike | None = None

    def cut(self, length: int) -> Iterator['Part']:
        """The same in parts of at most so many rows."""
        names, given = as_families(self.names), as_shapes(self.shapes)
        total = len(given.kind)
        if len(names) != total:
            raise ValueError(f'there are {len(names)} names for {total} shapes')
        columns: list[Any] = [
            column('stamp', self.stamp, total, TIMES.max, TIMES.min),
            column('expires', self.expires, total, TIMES.max),
            None,
        ]
        if self.categories is not None:
            columns[2] = column('categories', self.categories, total, ALL)
        for begin in range(0, max(total, 1), length):
            rows = slice(begin, begin + length)
            shapes = given.take(rows)
            rest: list[Any] = [None if each is None else each[rows] for each in columns]
            yield Part(names.take(rows), shapes, *rest)


@dataclass
class Replacement:
    """A replacement that is under way."""

    source: str
    group: str
    left: int
    """Rows that are still to come; room for them is kept free."""
    named: list[Slots] = field(default_factory=list)
    """What came; all else in the group is about to go."""


class SlicedUpdates:
    """Updates that pause."""

    max_obstacles: int
    _tree: DynamicBVH
    _columns: Columns
    _registry: Registry
    _groups: Groups
    _apply: Callable[..., Refusals]
    _require_memory: Callable[[int], None]
    _members: Callable[[str, str, Slots], Slots]
    _remove: Callable[[Slots], int]
    _under_way: list[Replacement]
    __len__: Callable[[], int]

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
        self._require_memory(total)
        sliced = not at_once and self._is_large(source, group, total, whole)
        length = SLICE if sliced else max(total, 1)
        if length >= total:
            (part,) = parts(length)
            return self._apply(source, group, part, whole)
        refusals = Refusals()
        running = Replacement(source, group, total)
        row = 0
        if whole:
            self._under_way.append(running)
        try:
            for part in parts(length):
                running.left -= len(part.shapes.kind)
                refusals.extend(self._apply(source, group, part, False, running.named), first=row)
                row += len(part.shapes.kind)
                yield
            yield from self._remove_in_slices(
                self._leaving(running) if whole else self._shadows(source)
            )
        finally:
            if whole:
                self._under_way.remove(running)
            self._remove(self._shadows(source))
        return refusals

    def _leaving(self, running: Replacement) -> Slots:
        """What a replacement has not named so far."""
        besides = np.concatenate([np.empty(0, np.int64), *running.named])
        return self._members(running.source, running.group, besides)

    def _room(self) -> int:
        """How many obstacles may come, once what is under way has ended."""
        room = self.max_obstacles - len(self)
        for running in self._under_way:
            leaving = self._leaving(running)
            room += int(np.count_nonzero(~self._columns.shadow[leaving])) - max(running.left, 0)
        return max(room, 0)

    def _is_large(self, source: str, group: str, total: int, whole: bool) -> bool:
        if total < AT_ONCE:
            return False
        # With less room it has to be known first what goes, to know what may come.
        mine = self._members(source, group, np.empty(0, np.int64))
        return not whole or total <= self._room() + len(mine)

    def _remove_in_slices(self, slots: Slots) -> Iterator[None]:
        handles = self._columns.tree_handle[slots]
        for begin in range(0, len(slots), SLICE):
            end = begin + SLICE
            # Meanwhile some may have expired, and others may have their slots.
            there = self._columns.tree_handle[slots[begin:end]] == handles[begin:end]
            self._remove(slots[begin:end][there])
            yield

    def _shadows(self, source: str) -> Slots:
        mine = self._columns.source == self._groups.source(source)
        return np.flatnonzero(self._columns.shadow & mine)

    def _leave_shadows(self, rows: Rows) -> None:
        """Copies of the obstacles that are about to move, of the same names and handles, that stay
        where they are.
        """
        columns, ndim = self._columns, self._tree.ndim
        lo, hi = self._tree.boxes(columns.tree_handle[rows.slot])
        stays = (lo == rows.lo[:, :ndim]).all(axis=1) & (hi == rows.hi[:, :ndim]).all(axis=1)
        moves = ~stays | rows.shaped | columns.geometry['shaped'][rows.slot]
        slots = rows.slot[moves]
        handles = self._tree.insert_many(lo[moves], hi[moves], columns.categories[slots])
        copies = handles & SLOT_MASK
        columns.grow(int(copies.max(initial=-1)) + 1)
        columns.copy(slots, copies)
        columns.tree_handle[copies] = handles
        columns.shadow[copies] = True
        columns.shadows += len(copies)
        self._registry.copy(slots, copies)
