# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The meshes of a scene, or the polygons that a planar scene sees of them, and their arrays."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..tree.nodes import node_dtype
from .farthest import LANES, NUMBERS
from .meshes import Floats, Mesh
from .polygon import Polygon

# Where the rows of a mesh are among all, first and last + 1; the root of its tree among its nodes.
HULL = np.dtype(
    [
        ('vertices', np.int64, (2,)),
        ('discs', np.int64, (2,)),
        ('faces', np.int64, (2,)),
        ('root', np.int64),
        ('radius', np.float64),
    ],
    align=True,
)


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


def _joined(meshes: dict[int, Mesh | Polygon]) -> Hulls:
    spans = np.zeros(max(meshes, default=-1) + 1, HULL)
    rows: list[tuple[NDArray[Any], ...]] = [
        (
            *(np.empty((0, 3)), np.empty((0, NUMBERS, LANES)), np.empty((0, 3), np.int32)),
            *(np.empty((0, 3)), np.empty(0, node_dtype(3))),
        )
    ]
    ends = dict.fromkeys(('vertices', 'discs', 'faces'), 0)
    for number, mesh in sorted(meshes.items()):
        nodes, root = mesh.tree
        rows.append((mesh.vertices, mesh.discs, mesh.corners, mesh.normals, nodes))
        spans['root'][number], spans['radius'][number] = root, mesh.radius
        for name, array in zip(ends, rows[-1], strict=False):
            spans[name][number] = ends[name], ends[name] + len(array)
            ends[name] += len(array)
    return Hulls(spans, *map(np.concatenate, zip(*rows, strict=True)))


NO_HULLS = _joined({})


class MeshStore:
    """The different meshes or polygons of a scene, each once, however many obstacles have it."""

    def __init__(self) -> None:
        self._numbers: dict[bytes, int] = {}
        self._meshes: dict[int, Mesh | Polygon] = {}
        self._uses: dict[int, int] = {}
        self._hulls: Hulls | None = None

    def __len__(self) -> int:
        return len(self._meshes)

    def __getitem__(self, number: int) -> Mesh | Polygon:
        return self._meshes[number]

    def take(self, mesh: Mesh | Polygon) -> int:
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
            self._hulls = _joined(self._meshes)
        return self._hulls

    @property
    def nbytes(self) -> int:
        """Memory of what the kernels read."""
        return sum(array.nbytes for array in self.hulls) if len(self) else 0
