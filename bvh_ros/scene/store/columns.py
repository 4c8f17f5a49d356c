# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the scene knows of each obstacle, as arrays indexed by the slot of its box in the tree."""

import numpy as np
from numpy.typing import NDArray

from ..geometry.footprint import FOOTPRINT, footprints
from ..geometry.shapes import ShapeKind, Shapes
from .mesh_store import Hulls, MeshStore
from .registry import Slots

FREE = -1

# One record for the kernels. `shaped` is anything but an axis-aligned box: it needs a narrow
# phase.
GEOMETRY = np.dtype(
    [
        ('position', np.float64, (3,)),
        ('orientation', np.float64, (4,)),
        ('half', np.float64, (3,)),
        ('kind', np.uint8),
        ('shaped', np.bool_),
        ('mesh', np.int32),  # in what alignment leaves free
    ],
    align=True,
)

# What is not `shaped` has this kind and orientation: updates of plain boxes need not write them.
UNTURNED = np.zeros((), GEOMETRY)
UNTURNED['orientation'] = (0.0, 0.0, 0.0, 1.0)


class Columns:
    """Growable arrays, one row a slot; a slot is in use where `tree_handle` is not FREE."""

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
        self.meshes = MeshStore()
        self._expects_meshes = meshes
        # Pairs of true shapes that overlap queries compared, and those that GJK left open.
        self.pairs_compared = self.pairs_in_more_digits = 0

    def clear(self) -> None:
        """Forget everybody."""
        counts = self.pairs_compared, self.pairs_in_more_digits
        self.__init__(self.footprint is not None, self._expects_meshes)  # type: ignore[misc]
        self.pairs_compared, self.pairs_in_more_digits = counts

    def grow(self, count: int) -> None:
        """Make room for the slots below `count`, at least doubling."""
        old = len(self.tree_handle)
        if count <= old:
            return
        capacity, any_shaped = max(count, 2 * old), self.any_shaped
        for name, array in vars(self).items():
            if isinstance(array, np.ndarray):
                bigger = np.zeros(capacity, array.dtype)
                if name != 'footprint' or any_shaped:  # else it is in no memory yet
                    bigger[:old] = array
                setattr(self, name, bigger)
        self.tree_handle[old:] = FREE
        self.geometry[old:] = UNTURNED

    def different(self, slots: Slots) -> Slots:
        """Rows of the first place of each obstacle, ascending: one may stand at two, see
        slicing.py.
        """
        if not self.shadows:
            return np.arange(len(slots))
        return np.sort(np.unique(self.node_handle[slots], return_index=True)[1])

    def copy(self, slots: Slots, copies: Slots) -> None:
        """Write to some slots what others hold."""
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array[copies] = array[slots]
        for slot in self._with_meshes(copies):
            self.meshes.take(self.meshes[int(self.geometry['mesh'][slot])])

    def geometry_arrays(self) -> tuple[NDArray[np.void], Hulls | None] | None:
        """Geometry and `hulls`; None where the scene is planar and has footprints."""
        return (self.geometry, self.hulls()) if self.footprint is None else None

    def footprint_arrays(self) -> tuple[NDArray[np.void], Hulls | None] | None:
        """Footprints and `hulls`; None where the scene is not planar."""
        return (self.footprint, self.hulls()) if self.footprint is not None else None

    def hulls(self) -> Hulls | None:
        """The meshes for the kernels; None without any: what is None is not compiled."""
        return self.meshes.hulls if len(self.meshes) or self._expects_meshes else None

    def write_shaped(self, slots: Slots, shapes: Shapes, shaped: NDArray[np.bool_]) -> None:
        """What only shapes that need a narrow phase have."""
        numbers = []
        if shapes.mesh is not None:
            for row in np.flatnonzero(shapes.kind == ShapeKind.MESH).tolist():
                numbers.append((slots[row], self.meshes.take(shapes.mesh[row])))
        self._release_meshes(slots)  # afterwards: what only moves is never forgotten
        place, geometry = as_index(slots), self.geometry
        geometry['orientation'][place] = shapes.orientation
        geometry['kind'][place] = shapes.kind
        geometry['shaped'][place] = shaped
        for slot, number in numbers:
            geometry['mesh'][slot] = number
        if self.footprint is not None:
            self.footprint[place] = footprints(shapes, shaped)
            for slot, number in numbers:
                self.footprint['polygon'][slot] = number + 1

    def _with_meshes(self, slots: Slots) -> list[int]:
        if not len(self.meshes):
            return []
        with_meshes: list[int] = slots[self.geometry['kind'][slots] == ShapeKind.MESH].tolist()
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
        self._release_meshes(slots)
        if self.footprint is not None:
            self.footprint['shaped'][slots[self.geometry['shaped'][slots]]] = False
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

    @property
    def any_shaped(self) -> bool:
        """Whether anything in the scene needs a narrow phase."""
        return bool(self.geometry['shaped'].any())


def as_index(slots: Slots) -> NDArray[np.int64] | slice:
    """The same places as a slice where they are consecutive.

    Whole columns move several times faster.
    """
    if len(slots) > 1 and slots[-1] - slots[0] == len(slots) - 1 and (np.diff(slots) == 1).all():
        return slice(int(slots[0]), int(slots[-1]) + 1)
    return slots
