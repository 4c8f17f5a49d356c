# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The meshes of a scene, or their shadows, as kernels read them."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from ...tree.access import node_dtype
from ...tree.compiler import CACHE_LINE, chosen_by_types, inlined, lean_kernel
from .mesh import CONVEX, LANES, NO_WIDE, NUMBERS, Floats, Mesh
from .shadow import Seen
from .shape import MESH
from .surface import Surface, Wide

# ---- The meshes of a scene, or what a planar scene sees of them, and their arrays.

# Where the rows of a mesh are among all, first and last + 1; the root of its tree among its nodes.
HULL = np.dtype(
    [
        ('vertices', np.int64, (2,)),
        ('discs', np.int64, (2,)),
        ('faces', np.int64, (2,)),
        ('seeds', np.int64, (2,)),
        ('wide', np.int64, (2,)),  # nodes of the snapshot
        ('center', np.float64, (3,)),  # of the snapshot
        ('per_length', np.float64),
        ('root', np.int64),
        ('radius', np.float64),
        ('form', np.int64),  # CONVEX, SOLID or SHELL
    ],
    align=True,
)


# The arrays are made anew once they hold so many times the vertices in use, and so many more.
MOST_FORGOTTEN, FEW_FORGOTTEN = 2, 1000


class Hulls(NamedTuple):
    """All meshes of a scene for the kernels, one after the other."""

    spans: NDArray[np.void]
    """(n,) of HULL, one a mesh."""
    vertices: Floats
    discs: Floats
    """See `farthest`."""
    corners: NDArray[np.int32]
    normals: Floats
    nodes: NDArray[Any]
    """Of the meshes' trees, two a triangle."""
    seeds: Floats
    """A corner of each part of each mesh."""
    planes: NDArray[np.float32]
    """Of the snapshots of the meshes' trees, a wide node a row."""
    children: NDArray[np.int32]
    """The same."""
    triangles: NDArray[np.float32]
    """The same."""
    rows: NDArray[np.int32]
    """Of the triangles as given, one a triangle."""


class AnyHulls(Hulls):
    """The same if one is not convex. Of the type it depends what is compiled."""

    __slots__ = ()


def _on_cache_lines(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Zeros from a cache line on: no node of a tree then lies in more lines than it must."""
    size = math.prod(shape) * dtype.itemsize
    room = np.zeros(size + CACHE_LINE, np.uint8)
    start = -room.ctypes.data % CACHE_LINE
    return room[start : start + size].view(dtype).reshape(shape)


class _Rows:
    """Rows of many meshes, one after the other, with room for more."""

    def __init__(self, none: NDArray[Any]) -> None:
        self._array, self.used = none, 0

    def append(self, more: NDArray[Any]) -> tuple[int, int]:
        """Where the new rows begin and end."""
        begin, end = self.used, self.used + len(more)
        if end > len(self._array):
            bigger = _on_cache_lines((max(end, 2 * begin), *more.shape[1:]), self._array.dtype)
            bigger[:begin] = self._array[:begin]
            self._array = bigger
        self._array[begin:end], self.used = more, end
        return begin, end

    @property
    def rows(self) -> NDArray[Any]:
        return self._array[: self.used]


class _Joined:
    """The rows of meshes in arrays that grow: one more does not move the others."""

    def __init__(self) -> None:
        self._hulls: Hulls | None = None
        self._spans = np.zeros(0, HULL)
        self._columns = [
            *(_Rows(np.empty((0, 3))), _Rows(np.empty((0, NUMBERS, LANES)))),
            *(_Rows(np.empty((0, 3), np.int32)), _Rows(np.empty((0, 3)))),
            _Rows(np.empty(0, node_dtype(3))),
            _Rows(np.empty((0, 3))),
            *(_Rows(NO_WIDE.planes), _Rows(NO_WIDE.children), _Rows(NO_WIDE.triangles)),
            _Rows(np.empty(0, np.int32)),
        ]
        self._all_convex, self.depth = True, 0

    def add(self, number: int, mesh: Mesh | Seen) -> None:
        if number >= len(self._spans):
            spans = np.zeros(max(number + 1, 2 * len(self._spans)), HULL)
            spans[: len(self._spans)] = self._spans
            self._spans = spans
        self._hulls = None
        nodes, root = mesh.tree
        wide = mesh.wide if isinstance(mesh, Mesh) else NO_WIDE
        given: tuple[NDArray[Any], ...] = (
            mesh.vertices,
            mesh.discs,
            mesh.corners,
            mesh.normals,
            nodes,
            mesh.seeds,
            wide.planes,
            wide.children,
            wide.triangles,
            mesh.rows,
        )
        places = [column.append(rows) for column, rows in zip(self._columns, given, strict=True)]
        span = self._spans[number]
        span['root'], span['radius'], span['form'] = root, mesh.radius, mesh.form
        span['vertices'], span['discs'], span['faces'] = places[:3]
        span['seeds'], span['wide'] = places[5:7]
        span['center'], span['per_length'] = wide.center, wide.per_length
        self._all_convex = self._all_convex and mesh.form == CONVEX
        self.depth = max(self.depth, wide.depth)

    def hulls(self) -> Hulls:
        if self._hulls is None:
            form = Hulls if self._all_convex else AnyHulls
            self._hulls = form(self._spans, *(column.rows for column in self._columns))
        return self._hulls

    @property
    def size(self) -> int:
        """Vertices, those of forgotten meshes too."""
        return self._columns[0].used


NO_HULLS = _Joined().hulls()


def of_one_type(hulls: Hulls, others: Hulls) -> tuple[Hulls, Hulls]:
    """Two of them, both for meshes of any form if one is."""
    if type(hulls) is type(others):
        return hulls, others
    return AnyHulls(*hulls), AnyHulls(*others)


class MeshStore:
    """The different meshes or shadows of a scene, each once, however many obstacles have it."""

    def __init__(self) -> None:
        self._numbers: dict[bytes, int] = {}
        self.by_number: dict[int, Mesh | Seen] = {}
        self._uses: dict[int, int] = {}
        self._free: list[int] = []  # numbers
        self._used = 0  # vertices
        self._joined = _Joined()

    def __len__(self) -> int:
        return len(self.by_number)

    def __getitem__(self, number: int) -> Mesh | Seen:
        return self.by_number[number]

    def take(self, mesh: Mesh | Seen, times: int = 1) -> int:
        """Number of a mesh, used so many times more."""
        number = self._numbers.get(mesh.key)
        if number is None:
            number = self._free.pop() if self._free else len(self.by_number)
            self._joined.add(number, mesh)
            self._numbers[mesh.key], self.by_number[number], self._uses[number] = number, mesh, 0
            self._used += len(mesh.vertices)
        self._uses[number] += times
        return number

    def release(self, number: int, times: int = 1) -> None:
        """Use a mesh so many times less; one that nobody uses is forgotten."""
        self._uses[number] -= times
        if self._uses[number]:
            return
        mesh = self.by_number.pop(number)
        del self._numbers[mesh.key], self._uses[number]
        self._free.append(number)
        self._used -= len(mesh.vertices)
        if self._joined.size > MOST_FORGOTTEN * self._used + FEW_FORGOTTEN:
            self._joined = _Joined()
            for other, other_mesh in self.by_number.items():
                self._joined.add(other, other_mesh)

    @property
    def hulls(self) -> Hulls:
        """The meshes for the kernels."""
        return self._joined.hulls()

    @property
    def depth(self) -> int:
        """Levels of the deepest snapshot of a mesh's tree; 0 without any."""
        return self._joined.depth

    @property
    def nbytes(self) -> int:
        """Memory of what the kernels read."""
        return sum(array.nbytes for array in self.hulls) if len(self) else 0


# ---- A mesh as kernels read it: its form and triangles, or its vertices for GJK.


def are_any(hulls: Any) -> bool:
    """Whether meshes, given by their numba type, may be of any form."""
    return getattr(hulls, 'instance_class', None) is AnyHulls


@lean_kernel
def form_of(hulls, shape):
    """The form of a shape, that of its mesh if it has one."""
    return hulls.spans[shape.mesh].form if shape.kind == MESH else CONVEX


@lean_kernel
def surface_of(hulls, shape):
    """The triangles of a shape's mesh."""
    return numbered_surface(hulls, shape.mesh)


@lean_kernel
def numbered_surface(hulls, number):
    """The triangles of a mesh."""
    span = hulls.spans[number]
    first, stop = span.faces[0], span.faces[1]
    node, last = span.wide[0], span.wide[1]
    children = hulls.children[node:last].reshape(-1)
    planes = hulls.planes[node:last].reshape(-1)
    triangles = hulls.triangles[node:last].reshape(-1)
    units = span.center, span.per_length
    return Surface(
        hulls.vertices[span.vertices[0] : span.vertices[1]],
        hulls.corners[first:stop],
        hulls.nodes[2 * first : 2 * stop],
        span.root,
        span.radius,
        Wide(planes, children, children.view(np.uint32), triangles, *units, last - node, 0),
    )


@lean_kernel
def triangle_hull(hulls, surface, face, places):
    """A triangle of a surface as a convex mesh; its corners are copied to `places` (3, 3)."""
    for number in range(3):
        corner = surface.vertices[surface.corners[face, number]]
        for axis in range(3):
            places[number, axis] = corner[axis]
    return Hull(places, hulls.discs[:0], surface.radius)


class Hull(NamedTuple):
    """Vertices of a mesh, for GJK."""

    places: Any
    discs: Any
    """See `farthest`."""
    radius: Any
    """A length beyond which no vertex is, m."""


@chosen_by_types
def hull_of(hulls, shape):
    """Vertices of a shape's mesh, none if it has none; None where there are no meshes."""
    return _nothing_of if isinstance(hulls, types.NoneType) else _vertices_of


@chosen_by_types
def hull_of_point(hull):
    """A hull without vertices, of the same type."""
    return _nothing if isinstance(hull, types.NoneType) else _no_vertices


@inlined
def _nothing_of(hulls, shape):
    return None


@inlined
def _vertices_of(hulls, shape):
    if shape.kind != MESH:
        return Hull(hulls.vertices[:0], hulls.discs[:0], 1.0)
    span = hulls.spans[shape.mesh]
    return Hull(
        hulls.vertices[span.vertices[0] : span.vertices[1]],
        hulls.discs[span.discs[0] : span.discs[1]],
        span.radius,
    )


@inlined
def _nothing(hull):
    return None


@inlined
def _no_vertices(hull):
    return Hull(hull.places[:0], hull.discs[:0], 1.0)
