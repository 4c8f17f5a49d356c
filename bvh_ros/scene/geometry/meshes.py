# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convex meshes: solids within closed surfaces of triangles."""

import hashlib
import math
from functools import cached_property
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree.access import DynamicBVH, checks
from .farthest import arranged, discs
from .outline import convex_polygon
from .surface import surface_of

Floats = NDArray[np.float64]

# By how much the boxes in a mesh's tree are larger than its triangles, in shares of the mesh.
PAD = 2.0**-44


class Mesh:
    """A convex solid, given by the triangles of its surface.

    Parameters
    ----------
    triangles : array_like, shape (m, 3, 3)
        Corners, m; the winding does not matter. They are taken as rounded to float32: what is as
        near as that is one corner, and by as little, 2.4e-7 of its size, the surface may lie
        within the hull of its corners. Triangles without area may close the surface. Every edge
        must belong to exactly two triangles.

    Raises
    ------
    ValueError
        If the triangles are not finite, or not the closed surface of one convex solid.
    """

    def __init__(self, triangles: ArrayLike) -> None:
        corners = checks.floats('triangles', triangles)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3) or not len(corners):
            raise ValueError(f'triangles must have shape (m, 3, 3), not {corners.shape}')
        finite = np.isfinite(corners).all(axis=(1, 2))
        if not finite.all():
            raise ValueError(f'triangle {int(np.argmin(finite))} is not finite')
        surface = surface_of(corners)
        lo, hi = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
        inside = bool((lo <= 0.0).all() and (hi >= 0.0).all())
        self.centre: Floats = np.zeros(3) if inside else lo * 0.5 + hi * 0.5
        """(3,) of the box around the mesh, in the frame of the triangles; their origin if the box
        holds that: then nothing is rounded."""
        self.size: Floats = hi - lo
        """(3,) edges of that box."""
        order = arranged(surface.vertices)
        row = np.argsort(order)
        self.vertices: Floats = surface.vertices[order] - self.centre
        """(k, 3) seen from the centre, neighbours next to each other."""
        self.corners: NDArray[np.int32] = row[surface.corners].astype(np.int32)
        """(m, 3) rows of `vertices`, one row a triangle."""
        self.normals: Floats = surface.normals
        """(m, 3) outward unit normals of the triangles."""
        self.edges: NDArray[np.int32] = row[surface.edges].astype(np.int32)
        """(e, 2) rows of `vertices`."""
        self.key = digest(self.vertices, self.corners)
        """The same for equal meshes."""
        farthest = float(np.linalg.norm(self.vertices, axis=1).max())
        self.radius = math.ldexp(1.0, math.frexp(farthest)[1])
        """A power of two beyond the farthest vertex: steps of it round nothing away."""

    @cached_property
    def tree(self) -> tuple[NDArray[Any], int]:
        """Nodes and root of a tree of the boxes around the triangles; slot k is triangle k."""
        places = self.vertices[self.corners]
        pad = PAD * float(self.size.max())
        tree = DynamicBVH.from_boxes(places.min(axis=1) - pad, places.max(axis=1) + pad)
        nodes, _, _, root = tree.arrays()
        return nodes, int(root)

    @cached_property
    def outline(self) -> Floats:
        """(k, 2) corners, counter-clockwise, of what is seen from above of the unturned mesh."""
        return convex_polygon(self.vertices[:, :2])

    @cached_property
    def discs(self) -> Floats:
        """What `farthest_vertex` needs."""
        return discs(self.vertices)


def digest(*arrays: NDArray[Any]) -> bytes:
    """A short key of what the arrays hold."""
    sha = hashlib.blake2b(digest_size=32)
    for array in arrays:
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.digest()


_in_use: WeakValueDictionary[bytes, Mesh] = WeakValueDictionary()


def mesh_of(triangles: Floats) -> Mesh:
    """`Mesh(triangles)`, or the one that was made of them while anything holds it: publishers
    repeat themselves, and to examine a surface takes far longer than to recognise it.
    """
    key = digest(triangles)
    mesh = _in_use.get(key)
    if mesh is None:
        mesh = _in_use[key] = Mesh(triangles)
    return mesh
