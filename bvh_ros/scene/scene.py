# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Named obstacles with shape, pose, lifetime and category, on top of one tree."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree import checks
from ..tree.dynamic_bvh import DynamicBVH
from ..tree.nodes import SLOT_MASK
from .distance_queries import DistanceQueries
from .geometry.shapes import Shapes, along_axes, as_shapes
from .inspection import SceneInspection
from .refusals import Refusals
from .removals import Removals
from .results import LAST_NODE_HANDLE
from .slicing import Part, Replacement, SlicedUpdates
from .store import updating
from .store.columns import Columns, as_index
from .store.groups import NOBODY, Groups
from .store.names import Families, Names, as_families
from .store.registry import UNKNOWN, Registry, Slots
from .store.updating import Rows

NEVER = np.iinfo(np.int64).max
BYTES_A_ROW, BYTES_A_SLOT = 1000, 500  # more than it takes to apply a row, to keep an obstacle
# From n names to their masks, of shape (n,).
Categorise = Callable[[Families], NDArray[np.uint32]]


class Scene(DistanceQueries, SceneInspection, SlicedUpdates, Removals):
    """Obstacles that come and go, and the questions about them.

    Stamps and clocks are integers in nanoseconds that the caller passes in; the scene reads no
    clock. Positions are in metres, all in one frame.

    Parameters
    ----------
    planar : bool
        The world seen from above: a 2D tree of footprints. z is ignored in obstacles and queries;
        points get the start's z.
    margin : float
        Fat boxes in the tree, m: small moves cost nothing. Answers do not depend on it.
    max_obstacles : int
        New obstacles beyond this number are refused.
    categorise : callable, optional
        Gives names their 32-bit masks. Asked once for each new obstacle whose update does not
        bring its categories along; without it they are 1.
    meshes : bool
        Expect meshes: else the first one makes the kernels of the queries compile anew.

    Examples
    --------
    >>> scene = Scene()
    >>> crates = Shapes.boxes([[2, 0, 0], [5, 0, 0]], [1, 1, 1])
    >>> scene.update('camera', ['near', 'far'], crates, stamp=0)
    []
    >>> hit = scene.raycast([0, 0, 0], [10, 0, 0])
    >>> hit.name, hit.t, hit.point.tolist(), hit.normal.tolist()
    ('near', 0.15, [1.5, 0.0, 0.0], [-1.0, 0.0, 0.0])
    >>> [hit.name for hit in scene.overlap([4, -1, -1], [9, 1, 1])]
    ['far']
    """

    def __init__(
        self,
        *,
        planar: bool = False,
        margin: float = 0.0,
        max_obstacles: int = 1_000_000,
        categorise: Categorise | None = None,
        meshes: bool = False,
    ) -> None:
        self.planar = bool(planar)
        self.max_obstacles = checks.whole('max_obstacles', max_obstacles, 1)
        self.newest = 0
        """Stamp of the newest update included, ns; 0 if there is none."""
        self.expired = 0
        """How many obstacles `expire` has removed so far."""
        self._categorise = categorise
        self._tree = DynamicBVH(ndim=2 if planar else 3, margin=margin)
        self._columns = Columns(planar, meshes)
        self._registry = Registry()
        self._groups = Groups()
        self._next_node_handle = 1
        self._next_expiry = NEVER
        self._any_shaped = False
        self._under_way: list[Replacement] = []

    # ---- changes

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
        return self._apply(source, '', Part(names, shapes, stamp, expires, categories), False)

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
        return self._apply(source, group, Part(names, shapes, stamp, expires, categories), True)

    def _apply(
        self, source: str, group: str, part: Part, whole: bool, named: list[Slots] | None = None
    ) -> Refusals:
        """Apply rows. With `named` they are a slice of an update: what they name is added to it,
        and what moves leaves a shadow.
        """
        shapes = as_shapes(part.shapes)
        self._require_memory(len(shapes.kind))
        called = as_families(part.names)
        updating.text('source', source), updating.text('group', group)
        formed = updating.canonicalise(shapes, self.planar)
        if len(called) != formed.total:
            raise ValueError(f'there are {len(called)} names for {formed.total} shapes')
        slots = self._registry.find(called)
        owner = self._groups.source(source)
        rows = updating.validate_rows(
            *(called, formed, slots, self._columns.source, owner, part[2:]),
            self._groups.source_name,
        )
        present = slots[slots != UNKNOWN]
        stale = self._members(source, group, present) if whole else present[:0]
        new = rows.slot == UNKNOWN
        room = self._room() + len(stale)
        full = rows.row[new][room:]
        formed.reasons.add(full, f'the scene is full (max_obstacles is {self.max_obstacles})')
        added, known = rows.take(np.flatnonzero(new)[:room]), rows.take(~new)
        if self._next_node_handle + len(added.row) - 1 > LAST_NODE_HANDLE:
            raise OverflowError(
                f'the {LAST_NODE_HANDLE} node handles of this run are used up; restart the node'
            )
        self._remove(stale)
        self._any_shaped = self._any_shaped or bool(formed.shaped.any())
        if named is not None:
            self._leave_shadows(known)
        self._move(known, source, group)
        inserted = self._insert(added, called.take(added.row), source, group)
        if named is not None:
            named += [present, inserted]
        self.newest = int(np.max(part.stamp if whole else rows.stamp, initial=self.newest))
        if self._any_shaped:
            # All columns are looked at only where the last shape may have gone; not for every
            # slice.
            self._any_shaped = named is not None or self._columns.any_shaped
        return formed.reasons.refusals(called.text)

    def _require_memory(self, rows: int) -> None:
        """Raise MemoryError now, and not when half of the rows are applied."""
        full = len(self._tree) + rows > len(self._columns.tree_handle)
        grown = 2 * len(self._columns.tree_handle) if full else 0
        np.empty(rows * BYTES_A_ROW + grown * BYTES_A_SLOT, np.uint8)  # asked for, not used

    def _members(self, source: str, group: str, besides: Slots) -> Slots:
        """Members of a group ('': all of the source), besides some."""
        columns = self._columns
        number = self._groups.number(source, group) if group else self._groups.source(source)
        if number == NOBODY:
            return np.empty(0, np.int64)
        member = (columns.group if group else columns.source) == number
        member[besides] = False
        return np.flatnonzero(member)

    def _move(self, rows: Rows, source: str, group: str) -> None:
        """Give obstacles that exist their new shape and pose."""
        if not len(rows.row):
            return
        columns = self._columns
        handles = columns.tree_handle[rows.slot]
        ndim = self._tree.ndim
        self._tree.move_many(handles, along_axes(rows.lo, ndim), along_axes(rows.hi, ndim))
        masks = rows.categories
        if masks is not None and (columns.categories[rows.slot] != masks).any():
            self._tree.set_masks(handles, masks)
            columns.categories[rows.slot] = masks
        before = columns.group[rows.slot]
        self._write(rows, rows.slot, source, group)
        self._groups.leave(before)

    def _insert(self, rows: Rows, names: Families, source: str, group: str) -> Slots:
        """Add obstacles; node handles ascend with the tree's, so that both order ties alike."""
        if not len(rows.row):
            return rows.slot
        ndim, masks = self._tree.ndim, rows.categories
        if masks is None and self._categorise is not None:
            masks = self._categorise(names)
        lo, hi = along_axes(rows.lo, ndim), along_axes(rows.hi, ndim)
        handles = self._tree.insert_many(lo, hi, masks)
        slots = handles & SLOT_MASK
        self._columns.grow(int(slots.max(initial=-1)) + 1)
        self._columns.tree_handle[slots] = handles
        self._columns.categories[slots] = 1 if masks is None else masks
        self._columns.node_handle[slots] = np.arange(len(slots)) + self._next_node_handle
        self._next_node_handle += len(slots)
        self._registry.add(names, slots)
        self._write(rows, slots, source, group)
        return slots

    def _write(self, rows: Rows, slots: Slots, source: str, group: str) -> None:
        columns, place = self._columns, as_index(slots)
        geometry = columns.geometry
        geometry['position'][place] = rows.shapes.position
        geometry['half'][place] = rows.shapes.size * 0.5
        if self._any_shaped and (rows.shaped.any() or geometry['shaped'][place].any()):
            columns.write_shaped(slots, rows.shapes, rows.shaped)
        columns.stamp[place] = rows.stamp
        columns.expires[place] = rows.expires
        mortal = rows.expires[rows.expires > 0]
        if len(mortal):
            self._next_expiry = min(self._next_expiry, int(mortal.min()))
        numbers = self._groups.join(source, group, len(slots))
        columns.source[place], columns.group[place] = numbers

    def _remove(self, slots: Slots) -> int:
        if len(slots) == len(self._tree) > 0:
            return self._remove_all()
        if len(slots):
            self._tree.remove_many(self._columns.tree_handle[slots])
            self._registry.discard(slots)
            self._groups.leave(self._columns.group[slots[~self._columns.shadow[slots]]])
            self._columns.forget(slots)
            self._any_shaped = self._any_shaped and self._columns.any_shaped
        return len(slots)

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
        return self._remove(self._members(source, group, np.empty(0, np.int64)))

    def remove_namespace(self, source: str, namespace: str | None = None) -> int:
        """Remove the source's obstacles named `namespace`/x, where x has no slash; None: all.

        Return how many there were.
        """
        if namespace is None:
            return self.remove_group(source, '')
        updating.text('namespace', namespace)
        return self.discard(self.find(source, [], {namespace}))

    def shift_expiries(self, by: int) -> None:
        """The caller's clock jumped by so many ns: what an obstacle has left to live stays."""
        by = updating.whole_time('by', by)
        expires = self._columns.expires
        mortal = expires > 0
        # Never 0, which is for ever, nor later than can be told.
        times = np.minimum(expires[mortal], min(NEVER - by, NEVER)) + by
        expires[mortal] = np.maximum(times, 1)
        self._note_next_expiry()

    def _note_next_expiry(self) -> None:
        mortal = self._columns.expires[self._columns.expires > 0]
        self._next_expiry = int(mortal.min()) if len(mortal) else NEVER

    def rebuild(self) -> None:
        """Build the tree anew."""
        self._tree.rebuild()
