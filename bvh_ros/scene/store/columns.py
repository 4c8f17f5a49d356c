# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the scene knows of each obstacle, as arrays indexed by the slot of its box in the tree."""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import copy_bytes, touch
from ...tree.compiler import entry_point, lean_kernel
from ..geometry.footprint import FOOTPRINT, footprints
from ..geometry.records import GEOMETRY, UNTURNED
from ..geometry.shapes import MESH, shapes_of
from .mesh_store import NO_HULLS, Hulls, MeshStore
from .registry import Slots

if TYPE_CHECKING:
    from .updating import Rows

FREE = -1
NEVER = np.iinfo(np.int64).max


class Kept(NamedTuple):
    """The columns that every update writes, for `write_rows`."""

    geometry: Any
    stamp: Any
    expires: Any
    source: Any
    group: Any


class Bodies(NamedTuple):
    """What the narrow phase reads."""

    shapes: Any
    """Records by slot."""
    footprints: Any
    """The same seen from above; None where the scene is not planar."""
    hulls: Hulls | None
    """Meshes of the scene; None where neither it nor the query has any."""
    query_hulls: Hulls | None


@lean_kernel
def write_rows(kept, slots, records, stamp, expires, owner):
    """Write rows of an update to their slots; owner = (source, group). Returns how many obstacles
    were in another group before, or in none; when the first of them expires, ns; how many more
    need a narrow phase, and whether one of them does, or did.
    """
    source, group = owner
    joined, shaped, concerned, soonest = 0, 0, False, np.int64(NEVER)
    for i in range(slots.shape[0]):
        slot = slots[i]
        joined += kept.group[slot] != group
        before, now = kept.geometry[slot].shaped, records[i].shaped
        shaped += now - before
        concerned = concerned or before or now
        kept.geometry[slot] = records[i]
        kept.stamp[slot], kept.expires[slot] = stamp[i], expires[i]
        kept.source[slot], kept.group[slot] = source, group
        if expires[i] > 0:
            soonest = min(soonest, expires[i])
    return joined, soonest, shaped, concerned


@functools.cache
def _write_rows() -> Callable[..., Any]:
    """The machine code of `write_rows`."""
    records, numbers = np.empty(0, GEOMETRY), np.empty(0, np.int64)
    kept = Kept(records, *[numbers] * 4)
    return entry_point(write_rows, kept, numbers, records, numbers, numbers, (0, 0))


class Columns:
    """Growable arrays, one row a slot; a slot is in use where `tree_handle` is not FREE."""

    # What kernels get, at hand for each of them: to gather it takes a tenth of a call of a row.
    hulls: Hulls | None
    """The meshes; None without any: what is None is not compiled."""
    shapes: tuple[Any, Any]
    """(records, hulls), and (footprints, hulls), one of which is None: see `cast.arguments`."""
    bodies: Bodies

    def __init__(self, planar: bool, meshes: bool = False) -> None:
        self.tree_handle = np.empty(0, np.int64)
        self.node_handle = np.empty(0, np.int64)
        self.geometry = np.empty(0, GEOMETRY)
        self.footprint = np.empty(0, FOOTPRINT) if planar else None
        self.categories = np.empty(0, np.uint32)
        self.stamp = np.empty(0, np.int64)
        self.expires = np.empty(0, np.int64)
        self.source = np.empty(0, np.int64)
        self.group = np.empty(0, np.int64)
        self.shadow = np.empty(0, np.bool_)  # where an obstacle was, see slicing.py
        self.shadows = 0  # how many there are
        self.shaped = 0  # how many rows need a narrow phase
        self.meshes = MeshStore()
        self._expects_meshes = meshes
        # Pairs of true shapes that overlap queries compared, and those that GJK left open.
        self.pairs_compared = self.pairs_in_more_digits = 0
        self._gather()

    def _gather(self) -> None:
        """Have at hand what kernels get, after an array or a mesh was replaced."""
        solid, flat = self.geometry, self.footprint
        hulls = self.hulls = (
            self.meshes.hulls if self._expects_meshes or self.meshes.held else None
        )
        self.shapes = ((solid, hulls), None) if flat is None else (None, (flat, hulls))
        self.bodies = Bodies(solid, flat, hulls, None if hulls is None else NO_HULLS)

    def clear(self) -> None:
        """Forget everybody."""
        counts = self.pairs_compared, self.pairs_in_more_digits
        self.__init__(self.footprint is not None, self._expects_meshes)  # type: ignore[misc]
        self.pairs_compared, self.pairs_in_more_digits = counts

    def room_for(self, count: int) -> dict[str, NDArray[Any]]:
        """Larger arrays for `grow`, empty if there is no need. Fresh memory takes longer to get
        than to fill, so another thread may ask for it.
        """
        room = self._larger(count)
        for name, array in room.items():
            if name != 'footprint' or self.shaped:  # else it is in no memory yet
                touch(array)
        return room

    def grow(self, count: int, room: dict[str, NDArray[Any]] | None = None) -> None:
        """Make room for the slots below `count`."""
        old = len(self.tree_handle)
        if count <= old:
            return
        for name, bigger in (room or self._larger(count)).items():
            if name != 'footprint' or self.shaped:
                copy_bytes(getattr(self, name), bigger)
            setattr(self, name, bigger)
        self._gather()

    def _larger(self, count: int) -> dict[str, NDArray[Any]]:
        """Arrays for the slots below `count`, at least twice as long; none if these will do."""
        old = len(self.tree_handle)
        if count <= old:
            return {}
        arrays = {n: array for n, array in vars(self).items() if isinstance(array, np.ndarray)}
        larger = {name: np.zeros(max(count, 2 * old), arrays[name].dtype) for name in arrays}
        larger['tree_handle'].fill(FREE)
        larger['geometry'][:] = UNTURNED
        return larger

    def different(self, slots: Slots) -> Slots:
        """Rows of the first place of each obstacle, ascending: one may stand at two, see
        slicing.py.
        """
        if not self.shadows:
            return np.arange(len(slots))
        return np.sort(np.unique(self.node_handle[slots], return_index=True)[1])

    def shadows_of(self, slots: Slots) -> Slots:
        """Where else the obstacles of some slots stand, see slicing.py."""
        shadows = np.flatnonzero(self.shadow)
        return shadows[np.isin(self.node_handle[shadows], self.node_handle[slots])]

    def copy(self, slots: Slots, copies: Slots) -> None:
        """Write to some slots what others hold."""
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array[copies] = array[slots]
        self.shaped += int(np.count_nonzero(self.geometry['shaped'][copies]))
        for slot in self._with_meshes(copies):
            self.meshes.take(self.meshes[int(self.geometry['mesh'][slot])])

    def write(self, slots: Slots, rows: 'Rows', owner: tuple[int, int]) -> tuple[int, int]:
        """Write rows of an update; `owner` is (source, group). Returns how many obstacles were in
        another group before, or in none, and when the first of them expires, ns.
        """
        numbers = self._take_meshes(rows) if rows.mesh is not None else []
        if len(self.meshes):
            self._release_meshes(slots)  # afterwards: what only moves is never forgotten
            self._gather()
        # As Kept(...), which would take one more call of a function of Python's.
        columns = self.geometry, self.stamp, self.expires, self.source, self.group
        kept, told = tuple.__new__(Kept, columns), (rows.records, rows.stamp, rows.expires)
        joined, soonest, shaped, concerned = _write_rows()(kept, slots, *told, owner)
        self.shaped += shaped
        if self.footprint is not None and concerned:
            self.footprint[slots] = footprints(shapes_of(rows.records), rows.records['shaped'])
            for row, number in numbers:
                self.footprint['polygon'][slots[row]] = number + 1
        return joined, soonest

    def _take_meshes(self, rows: 'Rows') -> list[tuple[int, int]]:
        """Row and number of each mesh; the records get the numbers, too."""
        numbers, mesh = [], np.asarray(rows.mesh)
        for row in np.flatnonzero(rows.records['kind'] == MESH).tolist():
            number = self.meshes.take(mesh[row])
            rows.records['mesh'][row] = number
            numbers.append((row, number))
        return numbers

    def _with_meshes(self, slots: Slots) -> list[int]:
        if not len(self.meshes):
            return []
        with_meshes: list[int] = slots[self.geometry['kind'][slots] == MESH].tolist()
        return with_meshes

    def _release_meshes(self, slots: Slots) -> None:
        for slot in self._with_meshes(slots):
            self.meshes.release(int(self.geometry['mesh'][slot]))

    def used(self) -> Slots:
        """Slots in use, in order of the node handles, that is of first appearance."""
        slots = np.flatnonzero(self.tree_handle != FREE)
        return slots[np.argsort(self.node_handle[slots], kind='stable')]

    def forget(self, slots: Slots) -> None:
        """Mark slots as free. What scans whole columns must not find them."""
        self.tree_handle[slots] = FREE
        self.node_handle[slots] = 0
        if len(self.meshes):
            self._release_meshes(slots)
            self._gather()
        if self.footprint is not None:
            self.footprint['shaped'][slots[self.geometry['shaped'][slots]]] = False
        self.shaped -= int(np.count_nonzero(self.geometry['shaped'][slots]))
        self.geometry[slots] = UNTURNED
        self.expires[slots] = 0
        self.categories[slots] = 0
        self.group[slots] = 0
        self.source[slots] = 0
        self.shadows -= int(np.count_nonzero(self.shadow[slots]))
        self.shadow[slots] = False

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return sum(a.nbytes for a in vars(self).values() if isinstance(a, np.ndarray))
