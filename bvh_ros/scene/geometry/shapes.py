# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes of obstacles as arrays.

What is legal, one canonical form, and the boxes that bound them.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree import checks
from .meshes import Mesh

Floats = NDArray[np.float64]

# A unit quaternion is known to about one ulp a component. One this close to a rotation that maps
# axes to axes is taken as that rotation: the box would differ by less than the rounding of its own
# corners.
SNAP = 2.0**-50

# Growth of the bounds of what is not an axis-aligned box, a share of the largest coordinate or
# reach: above what counts as touching, see `casting.frame`, so that the broad phase never loses
# what the true shape touches.
OUTWARD = 2.0**-45


class ShapeKind(IntEnum):
    """Kinds of obstacles."""

    BOX = 0
    SPHERE = 1
    CYLINDER = 2
    CAPSULE = 3
    MESH = 4


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
        kind = np.full(len(centres), ShapeKind.BOX, np.uint8)
        return cls(
            kind, centres, turns, np.broadcast_to(checks.floats('size', size), centres.shape)
        )

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


REASONS = (
    '',
    'its kind is none of BOX, SPHERE, CYLINDER, CAPSULE and MESH',
    'its position is not finite',
    'its orientation is not finite',
    'its size is not finite',
    'its size is negative',
    'the three sizes of a sphere must be equal (they are its diameter)',
    'the sizes of a cylinder or capsule along x and y must be equal (they are its diameter)',
    'a sphere, cylinder or capsule needs sizes above zero',
    'a capsule must be at least as long (size along z) as it is wide',
    'a mesh needs its Mesh and the size of it (see Shapes.of_meshes)',
    'its bounds exceed the largest double',
)
(
    FINE,
    UNKNOWN_KIND,
    BAD_POSITION,
    BAD_ORIENTATION,
    BAD_SIZE,
    NEGATIVE_SIZE,
    NOT_ROUND,
    NOT_CIRCULAR,
    NO_SIZE,
    TOO_SHORT,
    NO_MESH,
    TOO_LARGE,
) = range(len(REASONS))


def as_shapes(shapes: Shapes) -> Shapes:
    """The same with arrays of the right types; ValueError where they cannot be made so, or their
    lengths disagree.
    """
    if not isinstance(shapes, Shapes):
        raise ValueError(f'shapes must be of type Shapes, not {type(shapes).__name__}')
    kind = np.asarray(shapes.kind)
    if kind.ndim != 1 or isinstance(shapes.kind, np.ma.MaskedArray):
        raise ValueError(f'shapes.kind must be an array of shape (n,), not {kind.shape}')
    count = len(kind)
    position = checks.floats_to_read('shapes.position', shapes.position)
    orientation = checks.floats_to_read('shapes.orientation', shapes.orientation)
    size = checks.floats_to_read('shapes.size', shapes.size)
    wanted: dict[str, tuple[NDArray[Any], tuple[int, ...]]]
    wanted = {'kind': (kind, (count,)), 'position': (position, (count, 3))}
    wanted |= {'orientation': (orientation, (count, 4)), 'size': (size, (count, 3))}
    for name, (array, shape) in wanted.items():
        if array.shape != shape:
            raise ValueError(f'shapes.{name} has shape {array.shape}, not {shape}')
    if kind.dtype.kind not in 'iu' and count:
        raise ValueError(f'shapes.kind holds {kind.dtype}, not values of ShapeKind')
    known = (kind >= 0) & (kind < len(ShapeKind))
    kinds = np.where(known, kind, 255).astype(np.uint8)
    mesh = shapes.mesh
    if mesh is not None and (not isinstance(mesh, np.ndarray) or mesh.shape != (count,)):
        raise ValueError(f'shapes.mesh must be None or an array of shape ({count},)')
    return Shapes(kinds, position, orientation, size, mesh)


def _rows(name: str, value: ArrayLike, width: int) -> Floats:
    """One row (width,) or many (n, width)."""
    array = checks.floats(name, value)
    if array.shape in ((0,), (width,)):
        array = array.reshape(-1, width)
    if array.ndim != 2 or array.shape[1] != width:
        raise ValueError(f'{name} must have shape (n, {width}), not {array.shape}')
    return array


def faults(shapes: Shapes) -> NDArray[np.uint8]:
    """Index into `REASONS` of the first fault of each row, `FINE` where there is none."""
    kind, position, orientation, size, _ = shapes
    code = np.zeros(len(kind), np.uint8)
    box, sphere, cylinder, capsule, mesh = (kind == value for value in ShapeKind)

    def refuse(bad: Any, reason: int) -> None:
        code[bad & (code == FINE)] = reason

    # A sum of finite numbers may overflow, but then it goes the slow way and is found fine.
    with np.errstate(over='ignore', invalid='ignore'):
        total = position.sum() + orientation.sum() + size.sum()
    if not np.isfinite(total):
        refuse(~np.isfinite(position).all(axis=1), BAD_POSITION)
        refuse(~np.isfinite(orientation).all(axis=1), BAD_ORIENTATION)
        refuse(~np.isfinite(size).all(axis=1), BAD_SIZE)
    if size.size and not size.min() >= 0:
        refuse((size < 0).any(axis=1), NEGATIVE_SIZE)
    if not box.all():
        refuse(~(box | sphere | cylinder | capsule | mesh), UNKNOWN_KIND)
        refuse(sphere & ((size[:, 0] != size[:, 1]) | (size[:, 0] != size[:, 2])), NOT_ROUND)
        refuse((cylinder | capsule) & (size[:, 0] != size[:, 1]), NOT_CIRCULAR)
        refuse(~(box | mesh) & ~(size > 0).all(axis=1), NO_SIZE)
        refuse(_without_mesh(shapes, mesh), NO_MESH)
        refuse(capsule & (size[:, 2] < size[:, 0]), TOO_SHORT)
    return code


def _without_mesh(shapes: Shapes, mesh: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Rows of kind MESH that hold no `Mesh`, or not its size."""
    without = mesh.copy()
    for row in np.flatnonzero(mesh & (shapes.mesh is not None)).tolist():
        held = None if shapes.mesh is None else shapes.mesh[row]
        without[row] = not isinstance(held, Mesh) or (held.size != shapes.size[row]).any()
    return without


def canonical(shapes: Shapes) -> tuple[Shapes, NDArray[np.bool_]]:
    """Unit quaternions, and the mask of axis-aligned boxes.

    A box whose rotation maps axes to axes becomes the same box unturned, its sizes exchanged. A
    sphere loses its rotation. A mesh gets the position of the middle of its box.
    """
    kind, position, orientation, size, mesh = shapes
    if mesh is not None:
        position, rows = position.copy(), np.flatnonzero(kind == ShapeKind.MESH)
        centres = np.array([held.centre for held in mesh[rows]]).reshape(-1, 3)
        turns = rotations(unit_quaternions(orientation[rows]))
        position[rows] += np.einsum('nij,nj->ni', turns, centres)
    if not orientation[:, :3].any():  # clouds and plain markers: nothing is turned
        unturned = np.zeros((len(kind), 4))
        unturned[:, 3] = 1.0
        return Shapes(kind, position, unturned, size, mesh), kind == ShapeKind.BOX
    orientation = unit_quaternions(orientation)
    aligned = maps_axes_to_axes(orientation) & (kind == ShapeKind.BOX)
    # Entries within rounding of -1, 0 and 1: made so, their products with the sizes are exact.
    permutation = np.abs(np.rint(rotations(orientation[aligned])))
    size = size.copy()
    size[aligned] = np.einsum('nij,nj->ni', permutation, size[aligned])
    orientation[aligned | (kind == ShapeKind.SPHERE)] = (0.0, 0.0, 0.0, 1.0)
    return Shapes(kind, position, orientation, size, mesh), aligned


def unit_quaternions(orientation: Floats) -> Floats:
    """Quaternions (n, 4) brought to unit length, zero ones to the identity."""
    largest = np.abs(orientation).max(axis=1, initial=0.0, keepdims=True)
    zero = largest[:, 0] == 0
    # By a power of two first, so that squares neither overflow nor vanish.
    scaled = np.ldexp(orientation, -np.frexp(largest)[1])
    scaled[zero] = (0.0, 0.0, 0.0, 1.0)
    unit: Floats = scaled / np.sqrt((scaled * scaled).sum(axis=1, keepdims=True))
    return unit


def maps_axes_to_axes(orientation: Floats) -> NDArray[np.bool_]:
    """Whether unit quaternions are among the 24 rotations of a cube.

    1, 2 or 4 components of equal magnitude, the others zero.
    """
    magnitude = np.abs(orientation)
    present = magnitude > SNAP
    count = present.sum(axis=1)
    ideal = np.where(present, 1.0 / np.sqrt(np.maximum(count, 1.0))[:, None], 0.0)
    matches: NDArray[np.bool_] = (np.abs(magnitude - ideal) <= SNAP).all(axis=1) & (count != 3)
    return matches


def rotations(orientation: Floats) -> Floats:
    """Rotation matrices (n, 3, 3) of unit quaternions; column k is the shape's own axis k."""
    x, y, z, w = orientation.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def bounds(shapes: Shapes, aligned: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Boxes (n, 3) around canonical shapes.

    Exact (position -+ size / 2) where aligned, else a little outwards.
    """
    half = shapes.size * 0.5
    if aligned.all():
        return shapes.position - half, shapes.position + half
    turned = np.flatnonzero(~aligned)
    half[turned] = _reach(shapes, turned)
    lo, hi = shapes.position - half, shapes.position + half
    if shapes.mesh is not None:
        rows = np.flatnonzero(shapes.kind == ShapeKind.MESH)
        for row, turn in zip(rows.tolist(), rotations(shapes.orientation[rows]), strict=True):
            places = shapes.mesh[row].vertices @ turn.T
            lo[row] = shapes.position[row] + places.min(axis=0)
            hi[row] = shapes.position[row] + places.max(axis=0)
    largest = (np.abs(shapes.position[turned]) + half[turned]).max(axis=1, keepdims=True)
    pad = largest * OUTWARD + 5e-324
    lo[turned] -= pad
    hi[turned] += pad
    return lo, hi


def _reach(shapes: Shapes, rows: NDArray[np.int64]) -> Floats:
    """How far shapes reach from their centres along the world's axes."""
    half = shapes.size[rows] * 0.5
    matrices = rotations(shapes.orientation[rows])
    reach: Floats = np.einsum('nij,nj->ni', np.abs(matrices), half)
    sphere = shapes.kind[rows] == ShapeKind.SPHERE
    reach[sphere] = half[sphere]
    cylinder = shapes.kind[rows] == ShapeKind.CYLINDER
    axis = matrices[cylinder][:, :, 2]
    # A disc of radius R reaches R sin(angle between its axis and the world's).
    sine = np.sqrt(np.square(axis[:, [1, 2, 0]]) + np.square(axis[:, [2, 0, 1]]))
    reach[cylinder] = half[cylinder][:, 2:] * np.abs(axis) + half[cylinder][:, :1] * sine
    capsule = shapes.kind[rows] == ShapeKind.CAPSULE
    radius = half[capsule][:, :1]
    reach[capsule] = (half[capsule][:, 2:] - radius) * np.abs(matrices[capsule][:, :, 2]) + radius
    return reach


def along_axes(points: Floats, ndim: int) -> Floats:
    """Points (n, 3) as a tree of so many axes takes them."""
    # A slice would be copied row by row, six times as slowly.
    return points if ndim == 3 else points.take((0, 1), axis=1)
