# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes of obstacles as arrays, as callers give them; see `canonical` for what they become."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree.access import FLOAT64, checks
from .meshes import Mesh

Floats = NDArray[np.float64]
UINT8 = np.dtype(np.uint8)


class ShapeKind(IntEnum):
    """Kinds of obstacles."""

    BOX = 0
    SPHERE = 1
    CYLINDER = 2
    CAPSULE = 3
    MESH = 4


BOX, SPHERE, CYLINDER, CAPSULE, MESH = range(5)  # the same, as a kernel can read it


class Shapes(NamedTuple):
    """Poses and sizes of n obstacles, one a row.

    Every shape is given by the box around it in its own frame: a sphere by its diameter three
    times, a cylinder (axis: local z) by diameter, diameter, height, a capsule (axis: local z) by
    diameter, diameter, length over all. A mesh has the size of its `Mesh`, and the position is
    that of its triangles' frame.
    """

    kind: NDArray[np.uint8]
    """(n,) values of `ShapeKind`."""
    position: Floats
    """(n, 3) centres, m."""
    orientation: Floats
    """(n, 4) quaternions x, y, z, w. Zero is the identity; others need not be of unit length."""
    size: Floats
    """(n, 3) full edge lengths along the shape's own axes, m."""
    mesh: NDArray[np.object_] | None = None
    """(n,) a `Mesh` in the rows of kind MESH; None if there are no such rows."""

    def take(self, rows: Any) -> 'Shapes':
        """Some of the rows."""
        return Shapes(
            *(self.kind[rows], self.position[rows], self.orientation[rows], self.size[rows]),
            None if self.mesh is None else self.mesh[rows],
        )

    @classmethod
    def boxes(
        cls, position: ArrayLike, size: ArrayLike, orientation: ArrayLike | None = None
    ) -> 'Shapes':
        """Boxes; without `orientation` (n, 4) axis-aligned.

        A `size` of shape (3,) holds for all.
        """
        centres = _rows('position', position, 3)
        turns = np.zeros((len(centres), 4))
        if orientation is not None:
            turns = _rows('orientation', orientation, 4)
        if len(turns) != len(centres):
            raise ValueError(f'there are {len(turns)} orientations for {len(centres)} positions')
        kind, sizes = np.full(len(centres), ShapeKind.BOX, np.uint8), checks.floats('size', size)
        if sizes.shape != centres.shape:
            sizes = np.broadcast_to(sizes, centres.shape).copy()  # or every question would
        return cls(kind, centres, turns, sizes)

    @classmethod
    def of_meshes(
        cls, meshes: Sequence[Mesh], position: ArrayLike, orientation: ArrayLike | None = None
    ) -> 'Shapes':
        """Convex meshes; without `orientation` (n, 4) unturned."""
        meshes = list(meshes)
        if not all(isinstance(mesh, Mesh) for mesh in meshes):
            raise ValueError('meshes must be a sequence of Mesh')
        sizes = np.array([mesh.size for mesh in meshes]).reshape(-1, 3)
        if len(_rows('position', position, 3)) != len(meshes):
            raise ValueError(f'there must be one position for each of {len(meshes)} meshes')
        rows = cls.boxes(position, sizes, orientation)
        held = np.empty(len(meshes), object)
        held[:] = meshes
        return rows._replace(kind=np.full(len(meshes), ShapeKind.MESH, np.uint8), mesh=held)


def as_shapes(shapes: Shapes) -> Shapes:
    """The same with arrays of the right types; ValueError where they cannot be made so, or their
    lengths disagree.
    """
    if not isinstance(shapes, Shapes):
        raise ValueError(f'shapes must be of type Shapes, not {type(shapes).__name__}')
    columns: tuple[Any, ...] = shapes
    kind, position, orientation, size, mesh = columns
    if (
        type(kind) is type(position) is type(orientation) is type(size) is np.ndarray
        and kind.dtype is UINT8
        and position.dtype is orientation.dtype is size.dtype is FLOAT64
        and kind.ndim == 1
        and position.shape == size.shape == (len(kind), 3)
        and orientation.shape == (len(kind), 4)
        and kind.flags.carray
        and position.flags.carray
        and orientation.flags.carray
        and size.flags.carray
        and mesh is None
    ):
        return shapes  # much the most common: the rest takes twice as long
    kind = _kinds(kind)
    count = len(kind)
    position = checks.rows('shapes.position', position, 3, count)
    orientation = checks.rows('shapes.orientation', orientation, 4, count)
    size = checks.rows('shapes.size', size, 3, count)
    if mesh is not None and (not isinstance(mesh, np.ndarray) or mesh.shape != (count,)):
        raise ValueError(f'shapes.mesh must be None or an array of shape ({count},)')
    # As Shapes(...), which would take one more call of a function of Python's.
    return tuple.__new__(Shapes, (kind, position, orientation, size, mesh))


def _kinds(value: Any) -> NDArray[np.uint8]:
    """Kinds as bytes, what is none as a byte that is none."""
    if type(value) is np.ndarray and value.dtype is UINT8 and value.ndim == 1:
        return value if value.flags.carray else value.copy()
    kind = np.asarray(value)
    if kind.ndim != 1 or isinstance(value, np.ma.MaskedArray):
        raise ValueError(f'shapes.kind must be an array of shape (n,), not {kind.shape}')
    if kind.dtype.kind not in 'iu' and len(kind):
        raise ValueError(f'shapes.kind holds {kind.dtype}, not values of ShapeKind')
    known = (kind >= 0) & (kind < len(ShapeKind))
    return np.where(known, kind, 255).astype(np.uint8)


def _rows(name: str, value: ArrayLike, width: int) -> Floats:
    """One row (width,) or many (n, width)."""
    array = checks.floats(name, value)
    if array.shape in ((0,), (width,)):
        array = array.reshape(-1, width)
    if array.ndim != 2 or array.shape[1] != width:
        raise ValueError(f'{name} must have shape (n, {width}), not {array.shape}')
    return array


def unit_quaternions(orientation: Floats) -> Floats:
    """Quaternions (n, 4) brought to unit length, zero ones to the identity."""
    largest = np.abs(orientation).max(axis=1, initial=0.0, keepdims=True)
    zero = largest[:, 0] == 0
    # By a power of two first, so that squares neither overflow nor vanish.
    scaled = np.ldexp(orientation, -np.frexp(largest)[1])
    scaled[zero] = (0.0, 0.0, 0.0, 1.0)
    unit: Floats = scaled / np.sqrt((scaled * scaled).sum(axis=1, keepdims=True))
    return unit


def rotations(orientation: Floats) -> Floats:
    """Rotation matrices (n, 3, 3) of unit quaternions; column k is the shape's own axis k."""
    x, y, z, w = orientation.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def turned(matrices: Floats, vectors: Floats) -> Floats:
    """Vectors (n, 3) turned by matrices (n, 3, 3). Of one row `einsum` takes the terms in another
    order than of several.
    """
    x, y, z = vectors.T[:, :, None]
    sums: Floats = matrices[:, :, 0] * x + matrices[:, :, 1] * y + matrices[:, :, 2] * z
    return sums


def shapes_of(records: NDArray[np.void]) -> Shapes:
    """Shapes of canonical records, see `records`; without their meshes."""
    return Shapes(
        *(records['kind'], records['position'], records['orientation'], records['half'] * 2.0)
    )


def along_axes(points: Floats, ndim: int) -> Floats:
    """Points (n, 3) as a tree of so many axes takes them."""
    # A slice would be copied row by row, six times as slowly.
    return points if ndim == 3 else points.take((0, 1), axis=1)
