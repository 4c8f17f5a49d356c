# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convex polygons: meshes seen from above, for planar scenes."""

from typing import Any, ClassVar
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from ...tree.access import node_dtype
from .canonical import FINE, Canonical
from .farthest import LANES, NUMBERS
from .meshes import Floats, Mesh, digest
from .outline import convex_polygon
from .shapes import MESH, rotations


class Polygon:
    """What is seen of a mesh in one pose: all that a planar scene needs of it.

    It stands in for the mesh in a `MeshStore`, as one without triangles.
    """

    discs: ClassVar[Floats] = np.empty((0, NUMBERS, LANES))
    corners: ClassVar[NDArray[np.int32]] = np.empty((0, 3), np.int32)
    normals: ClassVar[Floats] = np.empty((0, 3))
    tree: ClassVar[tuple[NDArray[Any], int]] = (np.empty(0, node_dtype(3)), 0)
    radius: ClassVar[float] = 0.0

    def __init__(self, mesh: Mesh, orientation: Floats) -> None:
        self.mesh = mesh
        """Kept, so that `mesh_of` knows it while it is in use."""
        turn = rotations(orientation[None])[0]
        upright = not orientation[:2].any()
        corners = mesh.outline if upright else convex_polygon(mesh.vertices @ turn[:2].T)
        if upright:
            corners = corners @ turn[:2, :2].T
        self.vertices: Floats = np.column_stack((corners, np.zeros(len(corners))))
        """(k, 3) corners counter-clockwise, turned, from the centre; z is 0."""
        self.key = digest(self.vertices)
        """The same for equal polygons."""


_in_use: WeakValueDictionary[tuple[bytes, bytes], Polygon] = WeakValueDictionary()


def outlined(meshes: NDArray[np.object_] | None, form: Canonical) -> NDArray[np.object_] | None:
    """The polygons of the meshes of canonical rows; that of a mesh which only moves is there
    already.
    """
    if meshes is None:
        return None
    seen = np.empty(len(meshes), object)
    is_mesh = (form.records['kind'] == MESH) & (form.faults == FINE)
    for row in np.flatnonzero(is_mesh).tolist():
        mesh, orientation = meshes[row], form.records['orientation'][row]
        key = mesh.key, orientation.tobytes()
        seen[row] = _in_use.get(key) or Polygon(mesh, orientation)
        _in_use[key] = seen[row]
    return seen
