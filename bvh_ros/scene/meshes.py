# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convex meshes: solids within closed surfaces of triangles, and the store of those in a scene."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# How far a vertex may lie outside another triangle's plane, and how thin a mesh may be, in shares
# of its largest extent: points that went through float32 are convex to 1e-7.
LOOSE = 2.0**-20


class Mesh:
    """A convex solid, given by the triangles of its surface.

    Parameters
    ----------
    triangles : array_like, shape (m, 3, 3)
        Corners, m; the winding does not matter. Every edge must belong to exactly two triangles,
        and the surface must bulge nowhere inwards.

    Raises
    ------
    ValueError
        If the triangles are not finite, or not the closed surface of one convex solid.
    """

    def __init__(self, triangles: ArrayLike) -> None:
        corners = np.asarray(triangles, np.float64)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3) or not len(corners):
            raise ValueError(f'triangles must have shape (m, 3, 3), not {corners.shape}')
        finite = np.isfinite(corners).all(axis=(1, 2))
        if not finite.all():
            raise ValueError(f'triangle {int(np.argmin(finite))} is not finite')
        points = corners.reshape(-1, 3)
        lo, hi = points.min(axis=0), points.max(axis=0)
        self.centre: Floats = lo * 0.5 + hi * 0.5
        """(3,) of the box around the mesh, in the frame of the triangles."""
        self.size: Floats = hi - lo
        """(3,) edges of that box."""
        if not 1e-100 < self.size.max() < 1e100:
            raise ValueError('the mesh is too small or too large')
        places, corner = np.unique(points - self.centre, axis=0, return_inverse=True)
        self.vertices: Floats = np.ascontiguousarray(places)
        """(k, 3) seen from the centre."""
        self.planes: Floats = _planes(places, corner.reshape(-1, 3), float(self.size.max()))
        """(f, 4) outward unit normal n and offset d: inside n . p <= d, seen from the centre."""
        self.key = self.vertices.tobytes() + self.planes.tobytes()


def _planes(places: Floats, corner: NDArray[np.int64], extent: float) -> Floats:
    """Planes of a closed convex surface; ValueError if it is not one."""
    one, two, three = places[corner[:, 0]], places[corner[:, 1]], places[corner[:, 2]]
    normals = np.cross(two - one, three - one)
    area = np.linalg.norm(normals, axis=1)
    if not (area > LOOSE * LOOSE * extent * extent).all():
        raise ValueError(f'triangle {int(np.argmin(area))} has no area')
    normals /= area[:, None]
    middle = places.mean(axis=0)
    normals[np.einsum('ni,ni->n', normals, one - middle) < 0] *= -1.0
    offsets = np.einsum('ni,nki->nk', normals, places[corner]).max(axis=1)
    if (offsets - normals @ middle).min() <= LOOSE * extent:
        raise ValueError('the mesh is flat, or not convex')
    first, second = _neighbours(corner)
    if len(places) - len(first) + len(corner) != 2:  # Euler: one surface without holes
        raise ValueError('the mesh is not the surface of one convex solid')
    # Closed, connected and bulging nowhere inwards at an edge: convex (Tietze and Nakajima).
    beyond = np.einsum('ni,nki->nk', normals[first], places[corner[second]])
    inwards = beyond.max(axis=1) - offsets[first]
    if inwards.max() > LOOSE * extent:
        raise ValueError(f'the mesh is not convex at triangle {int(first[np.argmax(inwards)])}')
    return np.unique(np.column_stack((normals, offsets)), axis=0)


def _neighbours(corner: NDArray[np.int64]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The two triangles at every edge; ValueError if an edge has another number of them."""
    edges = np.sort(corner[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    number = number.reshape(-1)
    if (count != 2).any():
        open_edge = int(np.flatnonzero(count[number] != 2)[0])
        raise ValueError(
            f'the mesh is not closed: an edge of triangle {open_edge // 3} belongs to '
            f'{int(count[number[open_edge]])} triangles, not two'
        )
    pairs = np.argsort(number, kind='stable').reshape(-1, 2) // 3
    return pairs[:, 0], pairs[:, 1]


class Hulls(NamedTuple):
    """All meshes of a scene for the kernels: those of mesh k are the rows from spans[k, 0] up to
    spans[k, 1] of the vertices, and from spans[k, 2] up to spans[k, 3] of the planes.
    """

    spans: NDArray[np.int64]
    vertices: Floats
    planes: Floats


NO_HULLS = Hulls(np.empty((0, 4), np.int64), np.empty((0, 3)), np.empty((0, 4)))


class MeshStore:
    """The different meshes of a scene, each once, however many obstacles have it."""

    def __init__(self) -> None:
        self._numbers: dict[bytes, int] = {}
        self._meshes: dict[int, Mesh] = {}
        self._uses: dict[int, int] = {}
        self._hulls: Hulls | None = None

    def __len__(self) -> int:
        return len(self._meshes)

    def __getitem__(self, number: int) -> Mesh:
        return self._meshes[number]

    def take(self, mesh: Mesh) -> int:
        """Number of a mesh, used once more."""
        number = self._numbers.get(mesh.key)
        if number is None:
            number = next(k for k in range(len(self._meshes) + 1) if k not in self._meshes)
            self._numbers[mesh.key], self._meshes[number], self._uses[number] = number, mesh, 0
            self._hulls = None
        self._uses[number] += 1
        return number

    def release(self, number: int) -> None:
        """Use a mesh once less; one that nobody uses is forgotten."""
        self._uses[number] -= 1
        if not self._uses[number]:
            del self._numbers[self._meshes.pop(number).key], self._uses[number]
            self._hulls = None

    @property
    def hulls(self) -> Hulls:
        """The meshes for the kernels."""
        if self._hulls is None:
            spans = np.zeros((max(self._meshes, default=-1) + 1, 4), np.int64)
            numbers = sorted(self._meshes)
            vertices = [self._meshes[k].vertices for k in numbers]
            planes = [self._meshes[k].planes for k in numbers]
            for column, parts in ((0, vertices), (2, planes)):
                ends = np.cumsum([len(part) for part in parts])
                spans[numbers, column + 1] = ends
                spans[numbers, column] = ends - [len(part) for part in parts]
            self._hulls = Hulls(
                spans, np.concatenate([np.empty((0, 3)), *vertices]),
                np.concatenate([np.empty((0, 4)), *planes]),
            )  # fmt: skip
        return self._hulls
