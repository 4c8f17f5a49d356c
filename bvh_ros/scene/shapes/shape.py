# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes of obstacles: as callers give them, and their one canonical form."""

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree.access import FLOAT64, checks, of_row
from ...tree.compiler import entry_point, inlined, lean_kernel, stack_array
from .mesh import NO_REACHES, Mesh, reach_both_ways

# ---- Lengths that neither overflow nor vanish.

LARGE, SMALL = 2.0**200, 2.0**-200  # between them lengths may be multiplied four times


@inlined
def scale_of(largest):
    """The power of two that brings lengths between SMALL and LARGE; 1 where they are."""
    if SMALL < largest < LARGE or largest == 0.0:
        return 1.0
    return math.ldexp(1.0, min(max(-math.frexp(largest)[1], -1000), 1000))


@inlined
def hypot(one, other):
    """`math.hypot`, to the last digit, in less time where one of the two is zero."""
    if one == 0.0:
        return abs(other)
    return abs(one) if other == 0.0 else math.hypot(one, other)


@inlined
def ldexp(number, exponent):
    """`math.ldexp`, in less time where the exponent is zero."""
    return number if exponent == 0 else math.ldexp(number, exponent)


LEAST_SQUARE, LARGEST_SQUARE = 1e-270, 1e300  # no product that matters vanishes, or overflows


@lean_kernel
def length(vector):
    """Euclidean length, right to 2**-51 of itself; neither overflows nor vanishes where the result
    does not.
    """
    square = 0.0
    for axis in range(vector.shape[0]):
        square += vector[axis] * vector[axis]
    if LEAST_SQUARE < square < LARGEST_SQUARE:
        return math.sqrt(square)
    total = abs(vector[0])
    for axis in range(1, vector.shape[0]):
        total = hypot(total, vector[axis])
    return total


# ---- Rotations by unit quaternions in kernels.


@lean_kernel
def rotate(quaternion, vector, sign):
    """Turn a vector in place by a unit quaternion, or back by it with sign -1."""
    x, y, z, w = sign * quaternion[0], sign * quaternion[1], sign * quaternion[2], quaternion[3]
    a, b, c = vector[0], vector[1], vector[2]
    u, v, n = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    vector[0] = a + w * u + y * n - z * v
    vector[1] = b + w * v + z * u - x * n
    vector[2] = c + w * n + x * v - y * u


@lean_kernel
def fill_rotation(unit, matrix):
    """Fill in the rotation matrix (3, 3) of a unit quaternion; its column k is the shape's own
    axis k.
    """
    x, y, z, w = unit[0], unit[1], unit[2], unit[3]
    matrix[0, 0] = 1 - 2 * (y * y + z * z)
    matrix[0, 1] = 2 * (x * y - z * w)
    matrix[0, 2] = 2 * (x * z + y * w)
    matrix[1, 0] = 2 * (x * y + z * w)
    matrix[1, 1] = 1 - 2 * (x * x + z * z)
    matrix[1, 2] = 2 * (y * z - x * w)
    matrix[2, 0] = 2 * (x * z - y * w)
    matrix[2, 1] = 2 * (y * z + x * w)
    matrix[2, 2] = 1 - 2 * (x * x + y * y)


# ---- A shape in canonical form as one record, as kernels read it.

# `shaped` is anything but an axis-aligned box: it needs a narrow phase.
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

UNTURNED = np.zeros((), GEOMETRY)  # what is not `shaped` has this kind and orientation
UNTURNED['orientation'] = (0.0, 0.0, 0.0, 1.0)

Records = NDArray[np.void]  # of GEOMETRY


# ---- Shapes of obstacles as arrays, as callers give them; see `canonical` for what they become.

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


class ShapeColumns(NamedTuple):
    """The fields of `Shapes`."""

    kind: NDArray[np.uint8]
    position: Floats
    orientation: Floats
    size: Floats
    mesh: NDArray[np.object_] | None = None


class Shapes(ShapeColumns):
    """Poses and sizes of n obstacles, one a row.

    `boxes`, `spheres`, `cylinders`, `capsules` and `of_meshes` make shapes of one kind. The class
    itself takes rows of several kinds, each given by the box around it in its own frame:

    - a sphere by its diameter three times,
    - a cylinder (axis: local z) by diameter, diameter, height,
    - a capsule (axis: local z) by diameter, diameter, length from tip to tip,
    - a mesh by the size of its `Mesh`; its position is that of its triangles' frame.

    Parameters
    ----------
    kind : array_like, shape (n,)
        Values of `ShapeKind`, or one for all.
    position : array_like, shape (n, 3)
        Centres, m. Two coordinates are enough for a planar scene; other scenes refuse them.
    orientation : array_like, shape (n, 4), or (4,) for all
        Quaternions x, y, z, w.
    size : array_like, shape (n, 3), or (3,) for all
        Full edge lengths along the shape's own axes, m. For a planar scene boxes need two only.
    mesh : sequence of n, optional
        A `Mesh` in the rows of kind MESH.

    Raises
    ------
    ValueError
        If a row is no legal shape; the message names the argument and the row.

    Examples
    --------
    >>> from bvh_ros import Shapes
    >>> Shapes.boxes([[2, 0, 0], [5, 0, 0]], size=[1, 1, 1])
    Shapes(2 boxes)
    >>> Shapes([0, 1], [[2, 0, 0], [5, 0, 0]], [0, 0, 0, 1], [1, 1, 1])
    Shapes(1 box, 1 sphere)
    """

    __slots__ = ()

    def __new__(
        cls,
        kind: ArrayLike,
        position: ArrayLike,
        orientation: ArrayLike,
        size: ArrayLike,
        mesh: Sequence[Any] | NDArray[np.object_] | None = None,
    ) -> 'Shapes':
        """Check each argument, and each row."""
        centres = _places(position)
        count = len(centres)
        kinds = _kinds_of_rows(kind, count)
        turns = _one_or_rows('orientation', orientation, count, (4,))
        checks.rotations('orientation', turns)
        made = unchecked_shapes(kinds, centres, turns, _sizes(size, count), _meshes(mesh, kinds))
        _require_legal(as_shapes(made, planar=True))
        return made

    def __repr__(self) -> str:
        counts = np.bincount(np.asarray(self.kind), minlength=len(ShapeKind)).tolist()
        parts = [
            f'{count:,} {PLURALS[kind] if count != 1 else ShapeKind(kind).name.lower()}'
            for kind, count in enumerate(counts[: len(ShapeKind)])
            if count
        ]
        if others := sum(counts[len(ShapeKind) :]):
            parts.append(f'{others:,} of no kind')
        return f'Shapes({", ".join(parts) or "none"})'

    def take(self, rows: Any) -> 'Shapes':
        """Some of the rows: a slice, integers or booleans, as numpy takes them."""
        try:
            kind = self.kind[rows]
        except checks.FOREIGN as error:
            raise ValueError(f'rows must name rows of {len(self.kind)}: {error}') from None
        if kind.ndim != 1:
            raise ValueError(f'rows must have one dimension, not those of {kind.shape}')
        return unchecked_shapes(
            *(kind, self.position[rows], self.orientation[rows], self.size[rows]),
            None if self.mesh is None else self.mesh[rows],
        )

    @classmethod
    def boxes(
        cls, position: ArrayLike, size: ArrayLike, orientation: ArrayLike | None = None
    ) -> 'Shapes':
        """Boxes with centres (n, 3) and full edge lengths (n, 3), or (3,) for all, m; for a planar
        scene two coordinates and two lengths are enough.

        `orientation`: quaternions x, y, z, w, (n, 4), or (4,) for all; None: axis-aligned.
        """
        return cls(ShapeKind.BOX, position, _unturned(orientation), size)

    @classmethod
    def spheres(cls, position: ArrayLike, radius: ArrayLike) -> 'Shapes':
        """Balls with centres (n, 3) and a radius, one for all or (n,), m."""
        centres = _places(position)
        diameter = _diameters(radius, len(centres))
        size = np.repeat(diameter[:, None], 3, axis=1)
        return cls(ShapeKind.SPHERE, centres, IDENTITY, size)

    @classmethod
    def cylinders(
        cls,
        position: ArrayLike,
        radius: ArrayLike,
        height: ArrayLike,
        orientation: ArrayLike | None = None,
    ) -> 'Shapes':
        """Cylinders about their own z axis: centres (n, 3), and radius and height, each one for
        all or (n,), m.

        `orientation`: quaternions x, y, z, w, (n, 4), or (4,) for all; None: upright.
        """
        centres = _places(position)
        across, along = _diameters(radius, len(centres)), _positive('height', height, len(centres))
        size = np.column_stack((across, across, along))
        return cls(ShapeKind.CYLINDER, centres, _unturned(orientation), size)

    @classmethod
    def capsules(
        cls,
        position: ArrayLike,
        radius: ArrayLike,
        length: ArrayLike,
        orientation: ArrayLike | None = None,
    ) -> 'Shapes':
        """Cylinders with round ends about their own z axis: centres (n, 3), and radius and length
        from tip to tip, each one for all or (n,), m.

        `orientation`: quaternions x, y, z, w, (n, 4), or (4,) for all; None: upright.
        """
        centres = _places(position)
        across, along = _diameters(radius, len(centres)), _positive('length', length, len(centres))
        short = np.flatnonzero(along < across)
        if len(short):
            raise ValueError(
                'length must be at least twice the radius, as it goes from tip to tip: row '
                f'{short[0]} has length {along[short[0]]} and radius {across[short[0]] / 2}'
            )
        size = np.column_stack((across, across, along))
        return cls(ShapeKind.CAPSULE, centres, _unturned(orientation), size)

    @classmethod
    def of_meshes(
        cls,
        meshes: 'Mesh | Sequence[Mesh]',
        position: ArrayLike | None = None,
        orientation: ArrayLike | None = None,
    ) -> 'Shapes':
        """Meshes, one for all or one a row, whose frames are at `position` (n, 3), m; None: at the
        origin.

        `orientation`: quaternions x, y, z, w, (n, 4), or (4,) for all; None: unturned.
        """
        places = None if position is None else _places(position)
        if isinstance(meshes, Mesh):
            meshes = [meshes] * (1 if places is None else len(places))
        given, meshes = checks.iterator('meshes', meshes), []
        for mesh in given:
            if not isinstance(mesh, Mesh):
                raise ValueError('meshes must be a sequence of Mesh')
            meshes.append(mesh)
        if places is None:
            places = np.zeros((len(meshes), 3))
        if len(places) != len(meshes):
            raise ValueError(f'position must have a row for each of {len(meshes)} meshes')
        sizes = np.array([mesh.size for mesh in meshes]).reshape(-1, 3)
        return cls(ShapeKind.MESH, places, _unturned(orientation), sizes, meshes)


PLURALS = 'boxes', 'spheres', 'cylinders', 'capsules', 'meshes'
IDENTITY = np.array((0.0, 0.0, 0.0, 1.0))  # the quaternion of no rotation
IDENTITY.flags.writeable = False


def unchecked_shapes(
    kind: NDArray[Any],
    position: Floats,
    orientation: Floats,
    size: Floats,
    mesh: NDArray[np.object_] | None = None,
) -> Shapes:
    """Rows of a message, which may be no legal shapes: an update refuses these one by one."""
    return tuple.__new__(Shapes, (kind, position, orientation, size, mesh))


def _unturned(orientation: ArrayLike | None) -> ArrayLike:
    return IDENTITY if orientation is None else orientation


def _kinds_of_rows(value: Any, count: int) -> NDArray[np.uint8]:
    """A kind a row, of those that there are."""
    try:
        array = np.asarray(value)
        checks.refuse_masked(value, array)
    except checks.FOREIGN as error:
        raise ValueError(f'kind must be values of ShapeKind: {error}') from None
    if array.shape not in ((), (count,)):
        raise ValueError(f'kind must be one for all or have shape ({count},), not {array.shape}')
    if array.dtype.kind not in 'iu' and count:
        raise ValueError(f'kind must be values of ShapeKind, not {array.dtype}')
    wrong = np.flatnonzero((array < 0) | (array >= len(ShapeKind)))
    if count and len(wrong):
        row = wrong[0]
        raise ValueError(
            f'kind must be from 0 to {MESH}, see ShapeKind: row {row} is {array.reshape(-1)[row]}'
        )
    kinds = np.empty(count, np.uint8)
    kinds[:] = array
    return kinds


def _one_or_rows(name: str, value: ArrayLike, count: int, widths: tuple[int, ...]) -> Floats:
    """A row for all, (width,) or (1, width), or (count, width), as rows of their own."""
    array = value if isinstance(value, np.ndarray) else checks.floats(name, value)
    if count == 0 and array.shape == (0,):
        array = array.reshape(0, widths[0])
    width = array.shape[-1] if array.ndim else 0
    if width not in widths or array.shape[:-1] not in ((), (1,), (count,)):
        raise ValueError(
            f'{name} must have shape ({count}, {widths[0]}) as position has {count} rows, or '
            f'({widths[0]},) for all, not {array.shape}'
        )
    if array is value:
        array = checks.floats(name, array)
    if array.shape == (count, width):
        return array
    rows = np.empty((count, width))
    rows[:] = array
    return rows


def _sizes(value: ArrayLike, count: int) -> Floats:
    """Edge lengths, of which one number is that of a cube."""
    if isinstance(value, checks.NUMBER):
        value = np.full(3, checks.one('size', value))
    return _one_or_rows('size', value, count, (3, 2))


def _positive(name: str, value: ArrayLike, count: int) -> Floats:
    """Lengths above zero, (count,), from one for all or one a row."""
    array = checks.unless_refused(name, value, (count,))
    if array.shape not in ((), (1,), (count,)):
        raise ValueError(f'{name} must be a number or have shape ({count},), not {array.shape}')
    array = checks.floats(name, array)
    rows = np.empty(count)
    rows[:] = array
    with np.errstate(over='ignore'):
        bad = np.flatnonzero(~((rows > 0.0) & (2.0 * rows < np.inf)))
    if len(bad):
        raise ValueError(f'{name} must be above zero and finite: row {bad[0]} is {rows[bad[0]]}')
    return rows


def _diameters(radius: ArrayLike, count: int) -> Floats:
    return 2.0 * _positive('radius', radius, count)


def _meshes(value: Any, kinds: NDArray[np.uint8]) -> NDArray[np.object_] | None:
    """A mesh in the rows of kind MESH, if there are any."""
    rows = np.flatnonzero(kinds == MESH)
    if value is None and not len(rows):
        return None
    given: list[Any] = []
    if value is not None:
        try:
            count = len(value)
        except checks.FOREIGN:
            raise ValueError(f'mesh must be a sequence, not {checks.shown_short(value)}') from None
        if count != len(kinds):
            raise ValueError(f'mesh must have {len(kinds)} rows, one a shape, not {count}')
        given = list(checks.iterator('mesh', value))
    for row in rows.tolist():
        if not given or not isinstance(given[row], Mesh):
            raise ValueError(f'mesh must be a Mesh where kind is MESH: row {row} has none')
    meshes = np.empty(len(kinds), object)
    meshes[:] = given
    return meshes


def _require_legal(shapes: Shapes) -> None:
    """ValueError that names the first row that is no legal shape."""
    kind, position, orientation, size, mesh = shapes
    row, fault = first_fault_entry()(kind, position, orientation, size)
    if fault != FINE:
        turned = fault in (BAD_ORIENTATION, NOT_UNIT)
        shown = (position if fault == BAD_POSITION else orientation if turned else size)[row]
        raise ValueError(f'row {row} is no legal shape: {REASONS[fault]}: {shown.tolist()}')
    if mesh is not None:
        for row in np.flatnonzero(kind == MESH).tolist():
            if not np.array_equal(mesh[row].size, size[row]):
                raise ValueError(
                    f'size must be that of the mesh: row {row} is {size[row].tolist()}, its mesh '
                    f'{mesh[row].size.tolist()} (see Shapes.of_meshes)'
                )


def as_one_shape(shape: Shapes, planar: bool = False) -> Shapes:
    """`as_shapes` of one row; ValueError if it has more or none."""
    given = as_shapes(shape, planar)
    if len(given.kind) != 1:
        raise ValueError(
            f'shape must be one row of Shapes, not {len(given.kind)}: a body of several parts is '
            'one Mesh of all their triangles'
        )
    return given


def as_shapes(shapes: Shapes, planar: bool = False) -> Shapes:
    """The same with arrays of the right types; ValueError where they cannot be made so, or their
    lengths disagree. Shapes of two coordinates are for a planar scene, and get the third.
    """
    if not isinstance(shapes, Shapes):
        raise ValueError(
            f'shapes must be of type Shapes, not {type(shapes).__name__}'
            + (': see Shapes.of_meshes' if type(shapes) is Mesh else '')
        )
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
    if not planar and 2 in (np.shape(position)[-1:] + np.shape(size)[-1:]):
        raise ValueError('shapes of two coordinates need a planar scene: Scene(planar=True)')
    position = checks.rows('shapes.position', position, 3, count, planar)
    orientation = checks.rows('shapes.orientation', orientation, 4, count)
    size = checks.rows('shapes.size', size, 3, count, planar)
    if mesh is not None and (not isinstance(mesh, np.ndarray) or mesh.shape != (count,)):
        raise ValueError(f'shapes.mesh must be None or an array of shape ({count},)')
    return unchecked_shapes(kind, position, orientation, size, mesh)


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


def _places(value: ArrayLike) -> Floats:
    """One centre, (3,), or many, (n, 3); or of two coordinates, for a planar scene."""
    array = checks.floats('position', value)
    if array.ndim == 1:
        array = array.reshape(-1, len(array) or 3)
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise ValueError(f'position must have shape (n, 3), not {array.shape}')
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
    return unchecked_shapes(
        *(records['kind'], records['position'], records['orientation'], records['half'] * 2.0)
    )


def along_axes(points: Floats, ndim: int) -> Floats:
    """Points (n, 3) as a tree of so many axes takes them."""
    # A slice would be copied row by row, six times as slowly.
    return points if ndim == 3 else points.take((0, 1), axis=1)


# ---- What shapes are legal, their one canonical form, and the boxes that bound them.
#
# A row of a message is looked at by itself: what it becomes does not depend on the others.

# A unit quaternion is known to about one ulp a component. One this close to a rotation that maps
# axes to axes is taken as that rotation: the box would differ by less than the rounding of its own
# corners.
SNAP = 2.0**-50

# Growth of the bounds of what is not an axis-aligned box, a share of the largest coordinate or
# reach: above what counts as touching, see `cast.shapes`, so that the broad phase never loses
# what the true shape touches. From above heights count only of what leans.
OUTWARD = 2.0**-45
LEAST = 5e-324
NO_BOUNDS = np.empty((0, 2, 3))

REASONS = (
    '',
    'its kind is none of BOX, SPHERE, CYLINDER, CAPSULE and MESH',
    'its position is not finite',
    'its orientation is not finite',
    'the length of its orientation is not 1 (a quaternion is x, y, z, w)',
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
    NOT_UNIT,
    BAD_SIZE,
    NEGATIVE_SIZE,
    NOT_ROUND,
    NOT_CIRCULAR,
    NO_SIZE,
    TOO_SHORT,
    NO_MESH,
    TOO_LARGE,
) = range(len(REASONS))


class Canonical(NamedTuple):
    """Rows of shapes in canonical form, with bounds; only what is FINE means anything.

    Quaternions have unit length. A box whose rotation maps axes to axes is the same box unturned,
    its sizes exchanged. A sphere has lost its rotation. A mesh has the position of the middle of
    its box.
    """

    records: Records
    lo: Floats
    """(n, ndim) exact (position -+ size / 2) where aligned, else a little outwards."""
    hi: Floats
    faults: NDArray[np.uint8]
    """(n,) index into `REASONS` of the first fault of each row."""


SHORTEST, LONGEST = checks.SHORTEST, checks.LONGEST


@inlined
def is_finite(vector):
    finite = True
    for axis in range(vector.shape[0]):
        finite &= math.isfinite(vector[axis])
    return finite


@inlined
def is_unset(quaternion):
    """Whether a quaternion is zero."""
    return (
        quaternion[0] == 0.0
        and quaternion[1] == 0.0
        and quaternion[2] == 0.0
        and quaternion[3] == 0.0
    )


@inlined
def is_rotation(quaternion):
    """Whether a quaternion has length 1 to within 1 %, or is zero: an unset field of a message."""
    square = 0.0
    for part in range(4):
        square += quaternion[part] * quaternion[part]
    return SHORTEST <= square <= LONGEST or is_unset(quaternion)


@lean_kernel
def fault_of(kind, position, orientation, size):
    """The first fault of a row, but for those of meshes and bounds."""
    if not is_finite(position):
        return BAD_POSITION
    if not is_finite(orientation):
        return BAD_ORIENTATION
    if not is_rotation(orientation):
        return NOT_UNIT
    if not is_finite(size):
        return BAD_SIZE
    if size[0] < 0.0 or size[1] < 0.0 or size[2] < 0.0:
        return NEGATIVE_SIZE
    if kind > MESH:
        return UNKNOWN_KIND
    if kind in (BOX, MESH):
        return FINE
    if kind == SPHERE and (size[0] != size[1] or size[0] != size[2]):
        return NOT_ROUND
    if kind != SPHERE and size[0] != size[1]:
        return NOT_CIRCULAR
    if size[0] == 0.0 or size[1] == 0.0 or size[2] == 0.0:
        return NO_SIZE
    return TOO_SHORT if kind == CAPSULE and size[2] < size[0] else FINE


@lean_kernel
def first_fault(kinds, positions, orientations, sizes):
    """(row, fault) of the first row with one; FINE if there is none."""
    for i in range(positions.shape[0]):
        fault = fault_of(kinds[i], positions[i], orientations[i], sizes[i])
        if fault != FINE:
            return i, fault
    return 0, FINE


@functools.cache
def first_fault_entry() -> Callable[..., Any]:
    """The machine code of `first_fault`."""
    rows = np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 3))
    return entry_point(first_fault, np.empty(0, np.uint8), *rows)


@lean_kernel
def fill_unit(orientation, unit):
    """Fill in a quaternion brought to unit length, the identity for a rotation by nothing."""
    largest = 0.0
    for part in range(4):
        largest = max(largest, abs(orientation[part]))
    if orientation[0] == 0.0 and orientation[1] == 0.0 and orientation[2] == 0.0:
        unit[0] = unit[1] = unit[2] = 0.0
        unit[3] = 1.0
        return
    # By a power of two first, so that squares neither overflow nor vanish.
    exponent, square = math.frexp(largest)[1], 0.0
    for part in range(4):
        unit[part] = math.ldexp(orientation[part], -exponent)
        square += unit[part] * unit[part]
    length = math.sqrt(square)
    for part in range(4):
        unit[part] /= length


@lean_kernel
def maps_axes_to_axes(unit):
    """Whether a unit quaternion is among the 24 rotations of a cube.

    1, 2 or 4 components of equal magnitude, the others zero.
    """
    count = 0
    for part in range(4):
        count += abs(unit[part]) > SNAP
    ideal = 1.0 / math.sqrt(max(count, 1.0))
    for part in range(4):
        magnitude = abs(unit[part])
        if abs(magnitude - (ideal if magnitude > SNAP else 0.0)) > SNAP:
            return False
    return count != 3


@lean_kernel
def reach_along(kind, half, matrix, axis):
    """How far a shape reaches from its centre along one of the world's axes."""
    if kind == SPHERE:
        return half[axis]
    if kind == CYLINDER:
        # A disc of radius R reaches R sin(angle between its axis and the world's).
        y, z = matrix[(axis + 1) % 3, 2], matrix[(axis + 2) % 3, 2]
        return half[2] * abs(matrix[axis, 2]) + half[0] * math.sqrt(y * y + z * z)
    if kind == CAPSULE:
        return (half[2] - half[0]) * abs(matrix[axis, 2]) + half[0]
    reach = abs(matrix[axis, 0]) * half[0] + abs(matrix[axis, 1]) * half[1]
    return reach + abs(matrix[axis, 2]) * half[2]


@lean_kernel
def canonical_row(kind, position, orientation, size, ndim, record, bounds):
    """Fill in record and bounds (2, 3) of a row without faults."""
    matrix = stack_array((3, 3), np.float64)
    fill_unit(orientation, record.orientation)
    fill_rotation(record.orientation, matrix)
    aligned = kind == BOX and maps_axes_to_axes(record.orientation)
    record.kind, record.shaped, record.mesh = kind, not aligned, 0
    for axis in range(3):
        edge = size[axis]
        if aligned:  # entries within rounding of -1, 0 and 1
            edge = 0.0
            for other in range(3):
                edge += abs(np.rint(matrix[axis, other])) * size[other]
        record.position[axis], record.half[axis] = position[axis], edge * 0.5
    if aligned or kind == SPHERE:
        record.orientation[0] = record.orientation[1] = record.orientation[2] = 0.0
        record.orientation[3] = 1.0
    pad = 0.0
    for axis in range(3):
        reach = record.half[axis]
        if not aligned:
            reach = reach_along(kind, record.half, matrix, axis)
            if axis < ndim:
                pad = max(pad, abs(position[axis]) + reach)
            elif record.orientation[0] != 0.0 or record.orientation[1] != 0.0:
                pad = max(pad, record.half[axis])
        bounds[0, axis], bounds[1, axis] = position[axis] - reach, position[axis] + reach
    if not aligned:
        for axis in range(3):
            bounds[0, axis] -= pad * OUTWARD + LEAST
            bounds[1, axis] += pad * OUTWARD + LEAST


@lean_kernel
def canonical_rows(kinds, positions, orientations, sizes, form, within):
    """Fill in a `Canonical`, or instead of its bounds those of `within` (n, 2, 3) unless that has
    no rows; return whether there is a row of kind MESH. All but positions: one for all, or (n,).
    """
    own, meshes, ndim = stack_array((2, 3), np.float64), False, form.lo.shape[1]
    for i in range(positions.shape[0]):
        bounds = within[i] if within.shape[0] > 0 else own
        kind, turn = of_row(kinds, i), orientations[i if orientations.shape[0] > 1 else 0]
        size = sizes[i if sizes.shape[0] > 1 else 0]
        fault = fault_of(kind, positions[i], turn, size)
        if fault == FINE:
            canonical_row(kind, positions[i], turn, size, ndim, form.records[i], bounds)
            if not (is_finite(bounds[0]) and is_finite(bounds[1])):
                fault = TOO_LARGE
            for axis in range(ndim if within.shape[0] == 0 else 0):
                form.lo[i, axis], form.hi[i, axis] = bounds[0, axis], bounds[1, axis]
        form.faults[i] = fault
        meshes = meshes or kind == MESH
    return meshes


def _empty_form(count: int, ndim: int) -> Canonical:
    # As Canonical(...), which would take one more call of a function of Python's.
    columns = np.empty(count, GEOMETRY), *np.empty((2, count, ndim)), np.empty(count, UINT8)
    return tuple.__new__(Canonical, columns)


@functools.cache
def rows_entry(ndim: int) -> Callable[..., Any]:
    """The machine code of `canonical_rows`."""
    rows = np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 3)), _empty_form(0, ndim)
    return entry_point(canonical_rows, np.empty(0, np.uint8), *rows, NO_BOUNDS)


def canonicalise(shapes: Shapes, ndim: int = 3) -> Canonical:
    """Look at shapes alone, which must be from `as_shapes`: nothing here depends on the world."""
    form = _empty_form(len(shapes.kind), ndim)
    if rows_entry(ndim)(*shapes[:4], form, NO_BOUNDS) or shapes.mesh is not None:
        _place_meshes(shapes, form)
    return form


@lean_kernel
def mesh_row(mesh, position, record, ndim, bounds):
    """Fill in position and bounds (2, 3) of a row with a `PlacedMesh`, whose frame is at a
    position.
    """
    matrix, half, centre = stack_array((3, 3), np.float64), record.half, mesh.centre
    fill_rotation(record.orientation, matrix)
    largest = 0.0
    if record.orientation[0] != 0.0 or record.orientation[1] != 0.0:
        largest = max(half[0], half[1], half[2])
    for axis in range(3):
        x, y, z = matrix[axis, 0], matrix[axis, 1], matrix[axis, 2]
        record.position[axis] = position[axis] + (x * centre[0] + y * centre[1] + z * centre[2])
        ahead, behind = reach_both_ways(mesh.vertices, mesh.reaches, x, y, z)
        if axis < ndim:
            around = max(reach_along(MESH, half, matrix, axis), ahead, behind)
            largest = max(largest, abs(record.position[axis]) + around)
        bounds[0, axis], bounds[1, axis] = -behind, ahead
    pad = largest * OUTWARD + LEAST
    for axis in range(3):
        bounds[0, axis] = record.position[axis] + bounds[0, axis] - pad
        bounds[1, axis] = record.position[axis] + bounds[1, axis] + pad


class PlacedMesh(NamedTuple):
    """What `mesh_rows` needs of a `Mesh`."""

    vertices: Any
    reaches: Any
    centre: Any
    size: Any


@lean_kernel
def mesh_rows(mesh, rows, positions, sizes, form):
    """Fill in those rows of a `Canonical` that have a mesh, a `PlacedMesh`."""
    bounds, ndim = stack_array((2, 3), np.float64), form.lo.shape[1]
    for row in rows:
        size = sizes[row]
        if size[0] != mesh.size[0] or size[1] != mesh.size[1] or size[2] != mesh.size[2]:
            form.faults[row] = NO_MESH
            continue
        mesh_row(mesh, positions[row], form.records[row], ndim, bounds)
        fine = is_finite(bounds[0]) and is_finite(bounds[1])
        form.faults[row] = FINE if fine else TOO_LARGE
        for axis in range(ndim):
            form.lo[row, axis], form.hi[row, axis] = bounds[0, axis], bounds[1, axis]


@functools.cache
def mesh_rows_entry() -> Callable[..., Any]:
    """The machine code of `mesh_rows`."""
    none = np.empty((0, 3))
    mesh = PlacedMesh(none, NO_REACHES, np.empty(0), np.empty(0))
    return entry_point(mesh_rows, mesh, np.empty(0, np.int64), none, none, _empty_form(0, 3))


def _place_meshes(shapes: Shapes, form: Canonical) -> None:
    """What rows of kind MESH have that others have not."""
    is_mesh = (shapes.kind == MESH) & ((form.faults == FINE) | (form.faults == TOO_LARGE))
    rows = np.flatnonzero(is_mesh)
    if shapes.mesh is None:
        form.faults[rows] = NO_MESH
        return
    for mesh, some in by_mesh(shapes.mesh, rows):
        if isinstance(mesh, Mesh):
            placed = PlacedMesh(mesh.vertices, mesh.reaches, mesh.centre, mesh.size)
            mesh_rows_entry()(placed, some, shapes.position, shapes.size, form)
        else:
            form.faults[some] = NO_MESH


def by_mesh(
    meshes: NDArray[np.object_], rows: NDArray[np.int64]
) -> Iterator[tuple[Any, NDArray[np.int64]]]:
    """The different meshes of some rows of an array (n,), and which rows have each."""
    once, which = different(meshes[rows])
    if len(once) <= 1:
        yield from zip(once, [rows], strict=False)
        return
    order = np.argsort(which, kind='stable')
    ends = np.searchsorted(which[order], np.arange(1, len(once)))
    yield from zip(once, np.split(rows[order], ends), strict=True)


def different(meshes: NDArray[np.object_]) -> tuple[list[Any], NDArray[np.intp]]:
    """The meshes of an array (n,), each once, and which of them each row has."""
    given = meshes.tolist()
    if given and given.count(given[0]) == len(given):  # the rest takes twenty times as long
        return given[:1], np.zeros(len(given), np.intp)
    keys = np.fromiter(map(id, meshes), np.int64, len(meshes))
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    return meshes[first].tolist(), which
