# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Named obstacles with shape, pose, lifetime and category, on top of one tree."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.dynamic_bvh import DynamicBVH
from ..tree.nodes import SLOT_MASK
from . import narrow_phase, updating
from .columns import Columns, as_index
from .groups import Groups
from .queries import SceneQueries
from .registry import UNKNOWN, Names, Registry, Slots, as_names, name_at, take
from .results import Obstacle
from .shapes import Shapes, ShapeKind, as_shapes
from .updating import Refusal, Rows

LAST_NODE_HANDLE = 2**31 - 1
NEVER = np.iinfo(np.int64).max


class Scene(SceneQueries):
    """Obstacles that come and go, and the questions about them.

    Stamps and clocks are integers in nanoseconds that the caller passes in; the scene reads no clock. Positions are in metres, all
    in one frame.

    Parameters
    ----------
    planar : bool
        The world seen from above: a 2D tree of footprints. z is ignored in obstacles and queries; points get the start's z.
    margin : float
        Fat boxes in the tree, m: small moves cost nothing. Answers do not depend on it.
    max_obstacles : int
        New obstacles beyond this number are refused.

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
        self, *, planar: bool = False, margin: float = 0.0, max_obstacles: int = 1_000_000
    ) -> None:
        if max_obstacles < 1:
            raise ValueError(f'max_obstacles must be at least 1, not {max_obstacles}')
        self.planar = planar
        self.max_obstacles = max_obstacles
        self.newest = 0
        """Stamp of the newest update included, ns; 0 if there is none."""
        self._tree = DynamicBVH(ndim=2 if planar else 3, margin=margin)
        self._columns = Columns()
        self._registry = Registry()
        self._groups = Groups()
        self._next_node_handle = 1
        self._next_expiry = NEVER
        self._any_shaped = False

    # ---- changes

    def update(
        self,
        source: str,
        names: Names,
        shapes: Shapes,
        *,
        stamp: int,
        expires: ArrayLike = 0,
        categories: ArrayLike = 1,
    ) -> list[Refusal]:
        """Add or modify obstacles.

        Parameters
        ----------
        source : str
            The owner; nobody else can touch these obstacles.
        names : sequence of n str, or Numbered
            Of several good rows with one name the last holds.
        shapes : Shapes
            n rows.
        stamp : int
            Time of the data, ns.
        expires : int or (n,) array
            When they vanish on the caller's clock, ns, see `expire`; 0 is never.
        categories : int or (n,) array
            32-bit masks; a query sees an obstacle if its own mask has a bit in common.

        Returns
        -------
        list of Refusal
            The rows that are not taken over, in order, and why. Their obstacles stay as they were.

        Raises
        ------
        ValueError
            If arrays do not fit together; nothing is changed then.
        OverflowError
            If the node handles of this run are used up; nothing is changed then.
        """
        return self._apply(source, '', names, shapes, stamp, expires, categories, False)

    def replace(
        self,
        source: str,
        group: str,
        names: Names,
        shapes: Shapes,
        *,
        stamp: int,
        expires: ArrayLike = 0,
        categories: ArrayLike = 1,
    ) -> list[Refusal]:
        """`update`, and remove the obstacles of this group that are not named. The group '' is all that the source owns.

        A refused row counts as named: its obstacle stays.
        """
        return self._apply(source, group, names, shapes, stamp, expires, categories, True)

    def _apply(
        self,
        source: str,
        group: str,
        names: Names,
        shapes: Shapes,
        stamp: int,
        expires: ArrayLike,
        categories: ArrayLike,
        whole: bool,
    ) -> list[Refusal]:
        names, shapes = as_names(names), as_shapes(shapes)
        count = len(names.numbers if hasattr(names, 'numbers') else names)
        if count != len(shapes.kind):
            raise ValueError(f'there are {count} names for {len(shapes.kind)} shapes')
        slots = self._registry.find(names)
        owner = self._groups.source(source)
        rows, reasons = updating.examine(
            names, shapes, slots, self._columns.source, owner, expires, categories
        )
        stale = (
            self._unnamed(source, group, slots[slots != UNKNOWN])
            if whole
            else np.empty(0, np.int64)
        )
        new = rows.slot == UNKNOWN
        room = self.max_obstacles - len(self) + len(stale)
        for row in rows.row[new][room:].tolist():
            reasons[row] = f'the scene is full (max_obstacles is {self.max_obstacles})'
        added = rows.take(np.flatnonzero(new)[:room]) if new.any() else None
        if added and self._next_node_handle + len(added.row) - 1 > LAST_NODE_HANDLE:
            raise OverflowError(
                f'the {LAST_NODE_HANDLE} node handles of this run are used up; restart the node'
            )
        self._remove(stale)
        known = rows.take(~new)
        if len(known.row):
            self._move(known, source, group, stamp)
        if added:
            self._insert(added, take(names, added.row), source, group, stamp)
        if whole or len(rows.row):
            self.newest = max(self.newest, stamp)
        self._any_shaped = bool(self._columns.geometry['shaped'].any())
        sentences = {
            row: reason
            if isinstance(reason, str)
            else f"its name belongs to the source '{self._groups.source_name(reason)}'"
            for row, reason in sorted(reasons.items())
        }
        return [Refusal(row, name_at(names, row), reason) for row, reason in sentences.items()]

    def _unnamed(self, source: str, group: str, named: Slots) -> Slots:
        """Members of a group other than the named slots."""
        columns = self._columns
        if group:
            if self._groups.members(source, group) == 0:
                return np.empty(0, np.int64)
            member = columns.group == self._groups.group(source, group).serial
        else:
            member = columns.source == self._groups.source(source)
        member[named] = False
        return np.flatnonzero(member)

    def _move(self, rows: Rows, source: str, group: str, stamp: int) -> None:
        """Give obstacles that exist their new shape and pose."""
        columns = self._columns
        handles = columns.tree_handle[rows.slot]
        self._tree.move_many(handles, rows.lo[:, : self._tree.ndim], rows.hi[:, : self._tree.ndim])
        if (columns.categories[rows.slot] != rows.categories).any():
            self._tree.set_masks(handles, rows.categories)
        before = columns.group[rows.slot]
        self._write(rows, rows.slot, source, group, stamp)
        self._groups.leave(before)

    def _insert(self, rows: Rows, names: Names, source: str, group: str, stamp: int) -> None:
        """Add obstacles; node handles ascend with the tree's, so that both order ties alike."""
        ndim = self._tree.ndim
        handles = self._tree.insert_many(rows.lo[:, :ndim], rows.hi[:, :ndim], rows.categories)
        slots = handles & SLOT_MASK
        self._columns.grow(int(slots.max(initial=-1)) + 1)
        self._columns.tree_handle[slots] = handles
        self._columns.node_handle[slots] = np.arange(len(slots)) + self._next_node_handle
        self._next_node_handle += len(slots)
        self._registry.add(names, slots)
        self._write(rows, slots, source, group, stamp)

    def _write(self, rows: Rows, slots: Slots, source: str, group: str, stamp: int) -> None:
        columns, place = self._columns, as_index(slots)
        geometry = columns.geometry
        geometry['position'][place] = rows.shapes.position
        geometry['orientation'][place] = rows.shapes.orientation
        geometry['half'][place] = rows.shapes.size * 0.5
        geometry['kind'][place] = rows.shapes.kind
        geometry['shaped'][place] = rows.shaped
        columns.categories[place] = rows.categories
        columns.stamp[place] = stamp
        columns.expires[place] = rows.expires
        mortal = rows.expires[rows.expires > 0]
        if len(mortal):
            self._next_expiry = min(self._next_expiry, int(mortal.min()))
        joined = self._groups.group(source, group)
        joined.members += len(slots)
        columns.group[place] = joined.serial
        columns.source[place] = self._groups.source(source)

    def _remove(self, slots: Slots) -> int:
        if len(slots):
            self._tree.remove_many(self._columns.tree_handle[slots])
            self._registry.discard(slots)
            self._groups.leave(self._columns.group[slots])
            self._columns.forget(slots)
            self._any_shaped = bool(self._columns.geometry['shaped'].any())
        return len(slots)

    def remove(self, source: str, names: Names) -> int:
        """Remove obstacles of this source by name; return how many there were. Names it does not own are left alone."""
        slots = np.unique(self._registry.find(as_names(names)))
        slots = slots[slots != UNKNOWN]
        return self._remove(slots[self._columns.source[slots] == self._groups.source(source)])

    def remove_group(self, source: str, group: str) -> int:
        """Remove the obstacles of a group ('': all that the source owns); return how many there were."""
        return self._remove(self._unnamed(source, group, np.empty(0, np.int64)))

    def remove_namespace(self, source: str, namespace: str | None = None) -> int:
        """Remove the source's obstacles whose names begin with `namespace` + '/', or all; return how many there were."""
        if namespace is None:
            return self.remove_group(source, '')
        slots = np.concatenate(list(self._registry.starting_with(f'{namespace}/')))
        return self._remove(slots[self._columns.source[slots] == self._groups.source(source)])

    def clear(self) -> int:
        """Remove all obstacles; return how many there were."""
        self.newest = 0
        return self._remove(self._columns.used())

    def expire(self, now: int) -> int:
        """Remove the obstacles with 0 < expires <= now (ns); return how many there were. Costs nothing while none can be due."""
        if now < self._next_expiry:
            return 0
        expires = self._columns.expires
        removed = self._remove(np.flatnonzero((expires > 0) & (expires <= now)))
        mortal = expires[expires > 0]
        self._next_expiry = int(mortal.min()) if len(mortal) else NEVER
        return removed

    def rebuild(self) -> None:
        """Build the tree anew."""
        self._tree.rebuild()

    # ---- introspection

    def __len__(self) -> int:
        return len(self._tree)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._registry.slot(name) != UNKNOWN

    def get(self, name: str) -> Obstacle:
        """What is known of one obstacle. KeyError if there is none of this name."""
        slot = self._registry.slot(name)
        if slot == UNKNOWN:
            raise KeyError(name)
        columns = self._columns
        geometry = columns.geometry[slot]
        group = self._groups.of(int(columns.group[slot]))
        return Obstacle(
            name,
            int(columns.node_handle[slot]),
            ShapeKind(int(geometry['kind'])),
            geometry['position'].copy(),
            geometry['orientation'].copy(),
            geometry['half'] * 2.0,
            int(columns.stamp[slot]),
            int(columns.expires[slot]),
            group.source,
            group.name,
        )

    def names(self) -> list[tuple[int, str]]:
        """(node handle, name) of all obstacles, by handle."""
        slots = self._columns.used()
        return [
            (handle, self._registry.name(slot))
            for handle, slot in zip(
                self._columns.node_handle[slots].tolist(), slots.tolist(), strict=True
            )
        ]

    def name_of(self, handle: int) -> str:
        """Name of the obstacle with this node handle. KeyError if there is none (any more)."""
        slots = np.flatnonzero(self._columns.node_handle == handle) if handle > 0 else []
        if not len(slots):
            raise KeyError(f'no obstacle has the node handle {handle}')
        return self._registry.name(int(slots[0]))

    def stats(self) -> dict[str, Any]:
        """Sizes, the tree's shape, and which parts this scene uses."""
        tree = self._tree.stats()
        return {
            'boxes': len(self),
            'planar': self.planar,
            'margin': tree['margin'],
            'height': tree['height'],
            'cost': tree['cost'],
            'sources': self._groups.by_source(),
            'shaped': int(np.count_nonzero(self._columns.geometry['shaped'])),
            'mortal': int(np.count_nonzero(self._columns.expires)),
            'node_handles_left': LAST_NODE_HANDLE - self._next_node_handle + 1,
            'narrow_phase': narrow_phase.loaded(),
            'tree': tree,
        }

    def validate(self) -> None:
        """Raise RuntimeError, saying what is broken, unless tree, names and columns agree."""
        self._tree.validate()
        slots = self._columns.used()
        handles: NDArray[np.int64] = self._columns.tree_handle[slots]
        if not np.array_equal(handles, self._tree.ids()):
            raise RuntimeError('the tree and the columns hold different obstacles')
        if len(self._registry) != len(slots):
            raise RuntimeError(f'{len(self._registry)} names for {len(slots)} obstacles')
        for slot in slots.tolist():
            if self._registry.slot(self._registry.name(slot)) != slot:
                raise RuntimeError(
                    f'the name {self._registry.name(slot)!r} leads to another obstacle'
                )
        if sum(self._groups.by_source().values()) != len(slots):
            raise RuntimeError('the groups count other than the obstacles there are')
