# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The obstacles of a scene: for each a box in the tree, a name and a row of columns, at one
slot.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...tree.access import SLOT_MASK, DynamicBVH, checks
from ..geometry.shapes import Floats
from ..results import LAST_NODE_HANDLE, SceneHit
from .beside import beside
from .change import Change
from .columns import NEVER, Columns
from .groups import NOBODY, Groups
from .names import Families
from .registry import UNKNOWN, Registry, Slots
from .updating import Rows

EXACT = 1 << 53  # ns, 104 days: each of them is a double
KNOWN = 1 << 51  # ns, 26 days: of each of them a double of seconds tells which one it is
FEW = 32  # times for which numpy takes longer than Python
MANY = 10_000  # boxes: where fresh memory takes longer than a turn


def in_seconds(nanoseconds: int) -> float:
    """A length of time, rounded once where it is below EXACT."""
    if -EXACT < nanoseconds < EXACT:
        return nanoseconds / 1e9
    return float(np.longdouble(nanoseconds) / 10**9)


def all_in_seconds(nanoseconds: NDArray[np.longdouble]) -> Floats:
    """The same of many."""
    near = nanoseconds.astype(np.float64) / 1e9
    far = (nanoseconds / 10**9).astype(np.float64)
    return np.where(np.abs(nanoseconds) < EXACT, near, far)


class Obstacles:
    """What the parts of a scene share."""

    def __init__(self, planar: bool, margin: float, meshes: bool, most: int) -> None:
        self.planar = planar
        self.most = checks.whole('max_obstacles', most, 1)
        self.tree = DynamicBVH(ndim=2 if planar else 3, margin=margin)
        self.columns = Columns(planar, meshes)
        self.change = Change()
        self.registry = Registry()
        self.groups = Groups()
        self.newest = 0
        """Stamp of the newest update included, ns; 0 if there is none."""
        self.moves = False
        """Whether any obstacle was told a velocity since nobody had one."""
        self.epoch = 0
        """Time 0 of the tree, ns."""
        self.max_prediction = np.inf
        """Nobody moves on for longer than so many seconds after the last update, see places."""
        self.uncertainty = 0.0
        """Those that move grow by so much all round, m/s, since their last update."""
        self.movers: Any = None
        """`places.Movers`, once somebody asks."""
        self.next_node_handle = 1
        self.next_expiry = NEVER
        """Nothing expires earlier, ns."""

    def __len__(self) -> int:
        return len(self.registry)

    def hit(self, slot: int, t: float, point: Floats, normal: Floats) -> SceneHit:
        """What a query tells of an obstacle."""
        columns = self.columns
        handle, stamp = columns.node_handle.item(slot), columns.stamp.item(slot)
        told = self.registry.name(slot), handle, t, point, normal, stamp
        return tuple.__new__(SceneHit, told)  # half the time of SceneHit(...)

    def hits(self, found: Any, rows: list[int]) -> list[SceneHit]:
        """What a query tells of rows of a `touching.Found`."""
        return [
            self.hit(
                found.slots.item(row),
                found.distances.item(row),
                found.points[row].copy(),
                found.normals[row].copy(),
            )
            for row in rows
        ]

    def each_once(self, hits: list[SceneHit]) -> list[SceneHit]:
        """Of hits of one obstacle at two places, see slicing.py, the first."""
        if not self.columns.shadows:
            return hits
        first: dict[int, SceneHit] = {}
        for hit in hits:
            first.setdefault(hit.handle, hit)
        return list(first.values())

    def slot(self, name: object) -> int:
        """Slot of a name. KeyError if there is none."""
        slot = self.registry.slot(name) if isinstance(name, str) else UNKNOWN
        if slot == UNKNOWN:
            raise KeyError(name)
        return slot

    def members(self, source: str, group: str, besides: Slots | None = None) -> Slots:
        """Members of a group ('': all of the source), besides some."""
        columns = self.columns
        number = self.groups.number(source, group) if group else self.groups.source(source)
        if number == NOBODY:
            return np.empty(0, np.int64)
        member = (columns.group if group else columns.source) == number
        if besides is not None:
            member[besides] = False
        return np.flatnonzero(member)

    def require_handles(self, count: int) -> None:
        """OverflowError if there are no numbers for so many more."""
        if self.next_node_handle + count - 1 > LAST_NODE_HANDLE:
            raise OverflowError(
                f'the {LAST_NODE_HANDLE} node handles of this run are used up; restart the node'
            )

    def make_room(self, more: int) -> Iterator[None]:
        """Make room for so many more boxes, with pauses if they are many."""
        if more < MANY:
            return
        count = min(len(self.tree) + more, 2 * self.most)
        self.tree.reserve((yield from beside(self.tree.room_for, count)))
        yield
        columns = yield from beside(self.columns.room_for, count)
        with self.change:
            self.columns.grow(count, columns)
        yield
        names = yield from beside(self.registry.room_for, count)
        with self.change:
            self.registry.grow(count, names)
        yield

    def move(self, rows: Rows, source: str, group: str) -> None:
        """Give obstacles that exist their new shape and pose."""
        slots, columns = rows.slot, self.columns
        if not len(slots):
            return
        self.tree.move_sound(slots, rows.lo, rows.hi)
        masks = rows.categories
        if masks is not None and (columns.categories[slots] != masks).any():
            self.tree.set_masks(columns.tree_handle[slots], masks)
            columns.categories[slots] = masks
        before = columns.group[slots]
        joined = self._write(rows, slots, source, group)
        if joined:
            self.groups.join(source, group, joined)
            self.groups.leave(before[before != columns.group[slots]])

    def set_velocities(self, slots: Slots, rows: Rows, speeds: Floats | None) -> None:
        """Velocities of rows of an update that stand at these slots now, from their stamps on;
        where none are told, all of them are at rest.
        """
        if not len(slots) or (speeds is None and not self.moves):
            return
        if speeds is None:
            now = np.zeros((len(slots), self.tree.ndim))
        else:
            now = speeds[rows.row]
            if not self.moves:
                self.epoch = rows.stamp.item(0)
                self.moves = bool(now.any())
                if self.moves:
                    self.tree.count_nanoseconds(self.max_prediction)
        if self.moves:
            self._follow_time(rows.stamp)
            since = self.seconds(rows.stamp)
            self.tree.set_velocities(self.columns.tree_handle[slots], now, since)

    def _follow_time(self, stamps: NDArray[np.int64]) -> None:
        """Bring the tree's time 0 along where stamps have left it so far behind that they would
        lose nanoseconds: a run of months, or one that began before its clock was set.
        """
        latest = stamps.item(0) if len(stamps) == 1 else int(stamps.max())
        if latest - self.epoch < KNOWN:
            return
        self.epoch, handles = latest, self.tree.ids()
        told = self.seconds(self.columns.stamp[handles & SLOT_MASK])
        self.tree.set_velocities(handles, self.tree.velocities(handles)[0], told)

    def second(self, stamp: int) -> float:
        """One of `seconds`."""
        return in_seconds(stamp - self.epoch)

    def seconds(self, stamps: NDArray[np.int64]) -> Floats:
        """Times in ns as the tree has them: seconds since the first velocity was told, or 26 days
        ago at most, so that it knows which whole nanosecond is meant.
        """
        if len(stamps) <= FEW:
            return np.array([in_seconds(stamp - self.epoch) for stamp in stamps.tolist()])
        return all_in_seconds(stamps.astype(np.longdouble) - np.longdouble(self.epoch))

    def leave_shadows(self, rows: Rows) -> Slots:
        """Copies of the obstacles that are about to move, of the same names and handles, that stay
        where they are, see slicing.py; return their handles in the tree.
        """
        columns = self.columns
        if not len(rows.slot):
            return rows.slot
        lo, hi = self.tree.boxes(columns.tree_handle[rows.slot])
        stays = (lo == rows.lo).all(axis=1) & (hi == rows.hi).all(axis=1)
        moves = ~stays | rows.records['shaped'] | columns.geometry['shaped'][rows.slot]
        slots = rows.slot[moves]
        handles = self.tree.insert_many(lo[moves], hi[moves], columns.categories[slots])
        if self.moves:
            before = self.tree.velocities(columns.tree_handle[slots])
            self.tree.set_velocities(handles, *before)
        copies = self.tree.slots(handles)
        columns.grow(int(copies.max(initial=-1)) + 1)
        columns.copy(slots, copies)
        columns.tree_handle[copies] = handles
        columns.shadow[copies] = True
        columns.shadows += len(copies)
        self.registry.copy(slots, copies)
        return handles

    def still_there(self, handles: NDArray[np.int64]) -> Slots:
        """Slots of those of some handles of the tree that are still there."""
        known = self.columns.tree_handle
        handles = handles[handles & SLOT_MASK < len(known)]
        slots = handles & SLOT_MASK
        return slots[known[slots] == handles]

    def insert(self, rows: Rows, names: Families, source: str, group: str) -> Slots:
        """Add obstacles; node handles ascend with the tree's, so that both order ties alike."""
        masks, columns = rows.categories, self.columns
        handles = self.tree.insert_many(rows.lo, rows.hi, masks)
        slots: Slots = handles & SLOT_MASK
        columns.grow(int(slots.max()) + 1)
        columns.tree_handle[slots] = handles
        columns.categories[slots] = 1 if masks is None else masks
        first = self.next_node_handle
        self.next_node_handle += len(slots)
        columns.node_handle[slots] = np.arange(first, self.next_node_handle)
        self.registry.add(names, slots)
        self.groups.join(source, group, self._write(rows, slots, source, group))
        return slots

    def _write(self, rows: Rows, slots: Slots, source: str, group: str) -> int:
        """Write rows of columns; return how many obstacles came from other groups, or none."""
        joined, soonest = self.columns.write(slots, rows, self.groups.open(source, group))
        if soonest < self.next_expiry:
            self.next_expiry = int(soonest)
        return joined

    def remove(self, slots: Slots) -> int:
        """Forget obstacles as one change; return how many there were."""
        if not len(slots):
            return 0
        with self.change:
            return self.drop(slots)

    def drop(self, slots: Slots) -> int:
        """Forget obstacles, within a change, and where else they stand, see slicing.py; return how
        many there were.
        """
        gone = slots[~self.columns.shadow[slots]]
        if self.columns.shadows and len(gone):
            slots = np.union1d(slots, self.columns.shadows_of(gone))
        if len(slots) == len(self.tree) > 0:
            self._forget_all()
        elif len(slots):
            self.tree.remove_many(self.columns.tree_handle[slots])
            self.registry.discard(slots)
            self.groups.leave(self.columns.group[gone])
            self.columns.forget(slots)
        return len(gone)

    def clear(self) -> int:
        """Forget everybody, whatever became of a change before; return how many there were."""
        count = len(self)
        self.change.unfinished = True
        self._forget_all()
        self.newest = 0
        self.change.unfinished = False
        return count

    def _forget_all(self) -> None:
        self.moves = False  # so who moves next begins the tree's time anew
        self.tree.clear()
        self.registry.clear()
        self.groups.clear()
        self.columns.clear()

    def note_next_expiry(self) -> None:
        """Look when the next obstacle expires."""
        mortal = self.columns.expires[self.columns.expires > 0]
        self.next_expiry = int(mortal.min()) if len(mortal) else NEVER
