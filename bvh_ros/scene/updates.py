# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of messages into a scene."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry.shapes import UINT8, Shapes, as_shapes
from .parts import Part, require_a_name_each
from .refusals import Refusals
from .region import Region, within
from .speeds import Follow, reach_of, speeds_of
from .store import updating
from .store.names import Families, Names, as_families
from .store.obstacles import Obstacles
from .store.registry import UNKNOWN, Slots
from .store.updating import FIRST_TIME, Owner, Rows, Validated

NONE = np.empty(0, np.int64)
BYTES_A_ROW, BYTES_A_SLOT = 1000, 500  # more than it takes to apply a row, to keep an obstacle
FEW_ROWS = 64  # of which it is only asked what new ones take
# From n names to their masks, of shape (n,).
Categorise = Callable[[Families], NDArray[np.uint32]]


@dataclass(eq=False)
class Sliced:
    """An update in slices that is under way. Who is meant is known by handles of the tree."""

    source: str
    group: str
    begun: int
    """The next node handle when it began."""
    left: int
    """Rows that are still to come; a replacement keeps room for them."""
    replaced: Slots | None
    """Who was there when a replacement began: they go unless named. Who comes meanwhile stays."""
    stays: int = 0
    """At most so many of these were named so far."""
    surveyed: bool = False
    """All that is named is known, `replaced` are the others, and `left` are new names."""
    new: list[int] = field(default_factory=list)
    """How many new names each part brings then, the first part last."""
    newest: int = 0
    """Latest stamp of its rows so far, ns: what the scene holds is as new when all are in."""
    told: list[tuple[Slots, bool]] = field(default_factory=list)
    """Who was named, in order, and whether they leave the region, and so go."""
    shadows: list[Slots] = field(default_factory=list)


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
        self.under_way: WeakSet[Sliced] = WeakSet()  # who forgets one has ended it

    def of(self, held: Obstacles) -> 'Updates':
        """The same for other obstacles."""
        return Updates(held, self._categorise, self._region)

    def update(
        self,
        source: str,
        names: Names,
        shapes: Shapes,
        *,
        stamp: ArrayLike,
        expires: ArrayLike = 0,
        categories: ArrayLike | None = None,
        velocities: ArrayLike | Follow | None = None,
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
        velocities : (n, 3) array or Tracks, optional
            m/s, from the stamp on: what queries with `at` count on. Only places move, nothing
            turns. A row whose velocity is not finite is refused. `tracking.Tracks` tells them from
            the updates before. None: the rows' obstacles are at rest.

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
        return self.apply(source, '', Part(names, shapes, stamp, expires, categories, velocities))

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
        velocities: ArrayLike | Follow | None = None,
    ) -> Refusals:
        """`update`, and remove the obstacles of this group that are not named. The group '' is all
        that the source owns.

        A refused row counts as named: its obstacle stays.
        """
        part = Part(names, shapes, stamp, expires, categories, velocities)
        return self.apply(source, group, part, whole=True)

    def apply(
        self,
        source: str,
        group: str,
        part: Part,
        *,
        whole: bool = False,
        sliced: Sliced | None = None,
    ) -> Refusals:
        """Apply rows; all that the message has if `whole`, a part of what is `sliced`."""
        held = self._held
        updating.text('source', source), updating.text('group', group)
        names, slots, valid = self._validated(source, part)
        speeds = reach = None
        if part.velocities is not None:
            speeds, valid = speeds_of(held, part.velocities, valid)
            reach = reach_of(held, part.velocities, speeds)
        added, known, outside = within(self._region, valid, reach)
        present = slots[slots != UNKNOWN] if whole or sliced else slots
        stale = held.members(source, group, present) if whole else NONE
        if len(outside) and not sliced:
            stale = np.append(stale, outside)
        if len(added.row):
            self.require_memory(len(added.row))
            room = self._room(len(added.row), sliced) + len(stale)
            added = self._fitting(added, room, valid, names)
        whole = whole or (sliced is not None and sliced.replaced is not None)
        newest = max(sliced.newest if sliced else held.newest, _latest(part, valid, whole))
        with held.change:
            if len(stale):
                held.drop(stale)
            if sliced:
                self._note_told(sliced, present, outside)
                sliced.shadows.append(held.leave_shadows(known))
            held.move(known, source, group)
            held.set_velocities(known.slot, known, speeds)
            if len(added.row):
                new = held.insert(added, names.take(added.row), source, group)
                held.set_velocities(new, added, speeds)
            (sliced or held).newest = newest
        return valid.reasons.refusals(names.text)

    def _validated(self, source: str, part: Part) -> tuple[Families, Slots, Validated]:
        """Names of the rows, their slots, and what can be applied."""
        held = self._held
        held.change.require_none()
        self.remove_orphans()
        shapes = as_shapes(part.shapes)
        if len(shapes.kind) > FEW_ROWS:
            self.require_memory(len(shapes.kind))
        names = as_families(part.names)
        require_a_name_each(names, len(shapes.kind))
        slots = held.registry.find(names)
        groups = held.groups
        # As Owner(...), which would take one more call of a function of Python's.
        told = groups.source(source), held.columns.source, groups.source_name
        owner = tuple.__new__(Owner, told)
        valid = updating.validate_rows(names, shapes, slots, owner, part[2:5], held.planar)
        return names, slots, valid

    def _fitting(self, added: Rows, room: int, valid: Validated, names: Families) -> Rows:
        """New obstacles that there is room for; where the message brings no masks, with those that
        the scene gives. The others are refused.
        """
        if room < len(added.row):
            full = f'the scene is full (max_obstacles is {self._held.most})'
            valid.reasons.add(added.row[room:], full)
            added = added.take(slice(room))
        if added.categories is None and self._categorise is not None:
            added = added._replace(categories=self._categorise(names.take(added.row)))
        self._held.require_handles(len(added.row))
        return added

    def rest(self) -> None:
        """Let all obstacles stand where they were told to be: their stamps say nothing any more,
        as the clock was set.
        """
        held = self._held
        held.change.require_none()
        handles = held.tree.ids() if held.moves else NONE
        if len(handles):
            still = np.zeros((len(handles), held.tree.ndim))
            held.tree.set_velocities(handles, still, held.tree.velocities(handles)[1])
            held.moves = False  # so who moves next begins the tree's time anew

    def require_memory(self, rows: int) -> None:
        """Raise MemoryError now, and not when half of the rows are applied."""
        columns = self._held.columns
        capacity, used = len(columns.tree_handle), len(self._held.registry) + columns.shadows
        grown = 2 * capacity if used + rows > capacity else 0
        np.empty(rows * BYTES_A_ROW + grown * BYTES_A_SLOT, UINT8)  # asked for, not used

    def leaving(self, running: Sliced) -> Slots:
        """What goes when the update ends, as far as it is known."""
        goes = np.zeros(len(self._held.columns.tree_handle), np.bool_)
        if running.replaced is not None:
            goes[self._held.still_there(running.replaced)] = True
        for handles, leave in running.told:
            goes[self._held.still_there(handles)] = leave
        return np.flatnonzero(goes)

    def _room(self, wanted: int, own: Sliced | None) -> int:
        """How many obstacles may come, once what is under way has ended; that `wanted` may is
        known without looking at all that is there.
        """
        room = self._held.most - len(self._held)
        if room >= wanted and not self.under_way:
            return wanted
        replacing = [one for one in self.under_way if one.replaced is not None]
        room -= sum(max(one.left, 0) for one in replacing if not (one is own and one.surveyed))
        if room + sum(map(self._surely_leaving, replacing)) >= wanted:
            return wanted
        return max(room + sum(len(self.leaving(one)) for one in replacing), 0)

    def room_beside(self, running: Sliced) -> int:
        """How many obstacles may come besides what others bring, if nobody goes."""
        others = [one for one in self.under_way if one.replaced is not None and one is not running]
        room = self._held.most - len(self._held)
        return max(room + sum(len(self.leaving(one)) - max(one.left, 0) for one in others), 0)

    def _note_told(self, sliced: Sliced, present: Slots, outside: Slots) -> None:
        if sliced.surveyed and self._region is None:
            return
        handles = self._held.columns.tree_handle
        sliced.told += [(handles[present], False), (handles[outside], True)]
        sliced.stays += len(present)

    def _surely_leaving(self, running: Sliced) -> int:
        """At least so many go."""
        if running.group:  # members of other groups may have joined it
            return 0
        held = self._held
        come = held.next_node_handle - running.begun  # of whatever source
        return max(held.groups.members(running.source, '') - come - running.stays, 0)

    def remove_orphans(self) -> None:
        """Remove the shadows of updates in slices that were interrupted at their very end."""
        if self._held.columns.shadows and not self.under_way:
            self._held.remove(np.flatnonzero(self._held.columns.shadow))


def _latest(part: Part, valid: Validated, whole: bool) -> int:
    """The latest stamp of the rows that are applied, ns; of the message if that is `whole`."""
    stamp: Any = part.stamp
    if not whole and not len(valid.known.row) + len(valid.added.row):
        return FIRST_TIME
    if type(stamp) is int:
        return stamp
    if whole:
        stamps = np.asarray(stamp)  # of any integers
        return int(stamps.max()) if stamps.size else FIRST_TIME
    return max(int(some.stamp.max()) for some in valid[:2] if len(some.stamp))
