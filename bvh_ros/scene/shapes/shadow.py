# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shadows: what a planar scene sees of meshes, from above.

A convex mesh casts a convex polygon. Any other one casts the union of the shadows of its
triangles. The faces of a solid cast all of its shadow; so nothing has to be said of its inside.
"""

import math
from typing import Any, ClassVar, TypeAlias
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from ...tree.access import node_dtype
from .mesh import (
    CONVEX,
    LANES,
    NEGLIGIBLE,
    NO_WIDE,
    NUMBERS,
    SHELL,
    Mesh,
    WideNodes,
    convex_polygon,
    digest,
    flattened,
    tree_over,
)
from .shape import FINE, MESH, Canonical, Floats, rotations, turned

NO_DISCS, NO_NORMALS = np.empty((0, NUMBERS, LANES)), np.empty((0, 3))


class Polygon:
    """What is seen of a convex mesh in one pose: all that a planar scene needs of it.

    It stands in for the mesh in a `MeshStore`, as one without triangles.
    """

    discs: ClassVar[Floats] = NO_DISCS
    corners: ClassVar[NDArray[np.int32]] = np.empty((0, 3), np.int32)
    rows: ClassVar[NDArray[np.int32]] = np.empty(0, np.int32)
    normals: ClassVar[Floats] = NO_NORMALS
    tree: ClassVar[tuple[NDArray[Any], int]] = (np.empty(0, node_dtype(3)), 0)
    wide: ClassVar[WideNodes] = NO_WIDE
    radius: ClassVar[float] = 0.0
    form: ClassVar[int] = CONVEX

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
        self.seeds: Floats = self.vertices[:1]
        self.key = digest(self.vertices)
        """The same for equal polygons."""


class Shadow:
    """What is seen of a mesh that is not convex, in one pose: the shadows of its triangles.

    It stands in for the mesh in a `MeshStore`, as a surface that lies flat.
    """

    discs: ClassVar[Floats] = NO_DISCS
    normals: ClassVar[Floats] = NO_NORMALS
    wide: ClassVar[WideNodes] = NO_WIDE
    form: ClassVar[int] = SHELL

    def __init__(self, mesh: Mesh, orientation: Floats) -> None:
        self.mesh = mesh
        """Kept, so that `mesh_of` knows it while it is in use."""
        turn, upright = rotations(orientation[None]), not orientation[:2].any()
        # Neighbours share a corner, which is turned once: so there is no gap between them.
        places, corners = (
            mesh.shadow if upright else flattened(turned(turn, mesh.vertices), mesh.corners)
        )
        if upright:
            places = turned(turn, places)
        self.vertices: Floats = places
        """(k, 3) different corners, turned, from the centre; z is 0."""
        self.vertices[np.abs(places) < NEGLIGIBLE * float(mesh.size.max())] = 0.0
        self.corners: NDArray[np.int32] = corners
        """(m, 3) see `flattened`."""
        self.rows = np.arange(len(corners), dtype=np.int32)
        self.seeds: Floats = self.vertices[:1]
        nodes, _, _, root = tree_over(places, corners, float(mesh.size.max())).arrays()
        self.tree = nodes, int(root)
        farthest = float(np.linalg.norm(self.vertices, axis=1).max())
        self.radius = math.ldexp(1.0, math.frexp(farthest)[1])
        """As of a `Mesh`."""
        self.key = digest(self.vertices, self.corners)
        """The same for equal shadows."""


Seen: TypeAlias = Polygon | Shadow

_in_use: WeakValueDictionary[tuple[bytes, bytes], Seen] = WeakValueDictionary()


def seen_from_above(
    meshes: NDArray[np.object_] | None, form: Canonical
) -> NDArray[np.object_] | None:
    """What is seen of the meshes of canonical rows; that of a mesh which only moves is there
    already.
    """
    if meshes is None:
        return None
    seen = np.empty(len(meshes), object)
    is_mesh = (form.records['kind'] == MESH) & (form.faults == FINE)
    for row in np.flatnonzero(is_mesh).tolist():
        mesh, orientation = meshes[row], form.records['orientation'][row]
        key = mesh.key, orientation.tobytes()
        known = _in_use.get(key)
        if known is None:
            known = Polygon(mesh, orientation) if mesh.convex else Shadow(mesh, orientation)
            _in_use[key] = known
        seen[row] = known
    return seen
