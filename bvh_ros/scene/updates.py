# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of messages into a scene."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.nodes import ALL
from .geometry.shapes import Shapes, as_shapes
from .refusals import Refusals
from .store import updating
from .store.names import Families, Names, as_families
from .store.obstacles import Obstacles
from .store.registry import UNKNOWN, Slots
from .store.updating import TIMES, Owner, Rows, Validated, column

Region = tuple[NDArray[np.float64], NDArray[np.float64]]  # lo, hi
BYTES_A_ROW, BYTES_A_SLOT = 1000, 500  # more than it takes to apply a row, to keep an obstacle
# From n names to their masks, of shape (n,).
Categorise = Callable[[Families], NDArray[np.uint32]]


def as_region(given: tuple[ArrayLike, ArrayLike] | None, ndim: int) -> Region | None:
    """Corners of a box that may be infinite; ValueError if it is none."""
    if given is None:
        return None
    try:
        lo, hi = (np.array(corner, np.float64) for corner in given)
    except (TypeError, ValueError):
        raise ValueError('region must be two corners') from None
    if lo.shape != (ndim,) or hi.shape != (ndim,) or not (lo <= hi).all():
        raise ValueError(f'region must be two corners of {ndim} numbers, the lower one first')
    return lo, hi


class Part(NamedTuple):
    """Some rows of an update, as for `Scene.update`."""

    names: Names
    shapes: Shapes
    stamp: ArrayLike
    expires: ArrayLike = 0
    categories: ArrayLike | None = None

    def cut(self, length: int) -> Iterator['Part']:
        """The same in parts of at most so many rows."""
        if isinstance(self.shapes, Shapes) and np.size(self.shapes.kind) <= length:
            yield self
            return
        names, given = as_families(self.names), as_shapes(self.shapes)
        total = len(given.kind)
        require_a_name_each(names, total)
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


def require_a_name_each(names: Families, count: int) -> None:
    """ValueError if there are more or fewer names than shapes."""
    if len(names) != count:
        raise ValueError(f'there are {len(names)} names for {count} shapes')


@dataclass
class Replacement:
    """A replacement that is under way."""

    source: str
    group: str
    left: int
    """Rows that are still to come; room for them is kept free."""
    named: list[Slots] = field(default_factory=list)
    """What came; all else in the group is about to go."""


class Updates:
    """Adds and modifies obstacles. Knows which replacements are under way: what they still bring
    has its room.
    """

    def __init__(
        self, held: Obstacles, categorise: Categorise | None, region: Region | None
    ) -> None:
        self._held = held
        self._categorise = categorise
        self._region = region
        self.under_way: list[Replacement] = []

    def update(
        self,
        source: str,
        names: Names,
        shapes: Shapes,
        *,
        stamp: ArrayLike,
        expires: ArrayLike = 0,
        categories: ArrayLike | None = None,
    ) -> Refusals:
        """Add or modify obstacles.

        Parameters
        ----------
        source : str
            The owner; nobody else can touch these obstacles.
        names : sequence of n str, Numbered or Families
            Of several good rows with one name the last holds.
        shapes : Shapes
            n rows.
        stamp : int or (n,) array
            Time of the data, ns.
        expires : int or (n,) array
            When they vanish on the caller's clock, ns, see `expire`; 0 is never.
        categories : int or (n,) array, optional
            32-bit masks; a query sees an obstacle if its own mask has a bit in common. None: known
            obstacles keep theirs, new ones get what the scene's `categorise` says.

        Returns
        -------
        sequence of Refusal
            The rows that are not taken over, in order, and why. Their obstacles stay as they were.

        Raises
        ------
        ValueError
            If arrays do not fit together; nothing is changed then.
        OverflowError
            If the node handles of this run are used up; nothing is changed then.
        """
        return self.apply(source, '', Part(names, shapes, stamp, expires, categories))

    def replace(
        self,
        source: str,
        group: str,
        names: Names,
        shapes: Shapes,
        *,
        stamp: ArrayLike,
        expires: ArrayLike = 0,
        categories: ArrayLike | None = None,
    ) -> Refusals:
        """`update`, and remove the obstacles of this group that are not named. The group '' is all
        that the source owns.

        A refused row counts as named: its obstacle stays.
        """
        part = Part(names, shapes, stamp, expires, categories)
        return self.apply(source, group, part, whole=True)

    def apply(
        self,
        source: str,
        group: str,
        part: Part,
        *,
        whole: bool = False,
        named: list[Slots] | None = None,
        before_moves: Callable[[Rows], None] | None = None,
    ) -> Refusals:
        """Apply rows; all that the message has if `whole`. What they name is added to `named`."""
        held = self._held
        shapes = as_shapes(part.shapes)
        self.require_memory(len(shapes.kind))
        names = as_families(part.names)
        updating.text('source', source), updating.text('group', group)
        require_a_name_each(names, len(shapes.kind))
        slots = held.registry.find(names)
        owner = Owner(held.groups.source(source), held.columns.source, held.groups.source_name)
        valid = updating.validate_rows(names, shapes, slots, owner, part[2:], held.planar)
        added, known, reasons = valid
        if self._region is not None:
            added = added.take(self._here(added, self._region))
        here = None if self._region is None else self._here(known, self._region)
        present = slots[slots != UNKNOWN] if whole or named is not None else slots
        stale = held.members(source, group, present) if whole else slots[:0]
        if len(added.row):
            room = self.room() + len(stale)
            full = f'the scene is full (max_obstacles is {held.most})'
            reasons.add(added.row[room:], full)
            added = self._with_masks(added.take(slice(room)), names)
            held.require_handles(len(added.row))
        if len(stale):
            held.remove(stale)
        if before_moves is not None:
            before_moves(known)
        if here is not None and not here.all():
            held.remove(known.slot[~here])
            known = known.take(here)
        held.move(known, source, group)
        inserted = added.slot
        if len(added.row):
            inserted = held.insert(added, names.take(added.row), source, group)
        if named is not None:
            named += [present, inserted]
        if whole or len(known.row) + len(valid.added.row):
            held.newest = max(held.newest, _latest(part.stamp, valid, whole))
        return reasons.refusals(names.text)

    @staticmethod
    def _here(rows: Rows, region: Region) -> NDArray[np.bool_]:
        """Whether the bounds of each obstacle touch a region."""
        lo, hi = region
        return np.asarray(((rows.lo <= hi) & (rows.hi >= lo)).all(axis=1))

    def _with_masks(self, added: Rows, names: Families) -> Rows:
        """New obstacles; where the message brings no masks, with those that the scene gives."""
        if added.categories is None and self._categorise is not None:
            return added._replace(categories=self._categorise(names.take(added.row)))
        return added

    def require_memory(self, rows: int) -> None:
        """Raise MemoryError now, and not when half of the rows are applied."""
        columns = self._held.columns
        capacity, used = len(columns.tree_handle), len(self._held) + columns.shadows
        grown = 2 * capacity if used + rows > capacity else 0
        np.empty(rows * BYTES_A_ROW + grown * BYTES_A_SLOT, np.uint8)  # asked for, not used

    def leaving(self, running: Replacement) -> Slots:
        """What a replacement has not named so far."""
        besides = np.concatenate([np.empty(0, np.int64), *running.named])
        return self._held.members(running.source, running.group, besides)

    def room(self) -> int:
        """How many obstacles may come, once what is under way has ended."""
        room = self._held.most - len(self._held)
        for running in self.under_way:
            leaving = self.leaving(running)
            there = np.count_nonzero(~self._held.columns.shadow[leaving])
            room += int(there) - max(running.left, 0)
        return max(room, 0)


def _latest(given: ArrayLike, valid: Validated, whole: bool) -> int:
    """The latest stamp of the rows that are applied, ns; of the message if that is `whole`."""
    stamp: Any = given
    if type(stamp) is int:
        return stamp
    if whole:
        return int(np.max(stamp, initial=TIMES.min))
    return max(int(np.max(some.stamp, initial=TIMES.min)) for some in valid[:2])
