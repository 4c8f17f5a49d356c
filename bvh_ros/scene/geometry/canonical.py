# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What shapes are legal, their one canonical form, and the boxes that bound them.

A row of a message is looked at by itself: what it becomes does not depend on the others.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import of_row
from ...tree.compiler import entry_point, inlined, lean_kernel, stack_array
from .meshes import Mesh
from .records import GEOMETRY, Records
from .rotation import fill_rotation
from .shapes import BOX, CAPSULE, CYLINDER, MESH, SPHERE, UINT8, Floats, Shapes, rotations, turned

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

MOST_PLACES = 1 << 18  # of vertices that are turned at once

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


@inlined
def is_finite(vector):
    finite = True
    for axis in range(vector.shape[0]):
        finite &= math.isfinite(vector[axis])
    return finite


@lean_kernel
def fault_of(kind, position, orientation, size):
    """The first fault of a row, but for those of meshes and bounds."""
    if not is_finite(position):
        return BAD_POSITION
    if not is_finite(orientation):
        return BAD_ORIENTATION
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


def _place_meshes(shapes: Shapes, form: Canonical) -> None:
    """What rows of kind MESH have that others have not."""
    is_mesh = (shapes.kind == MESH) & ((form.faults == FINE) | (form.faults == TOO_LARGE))
    held: Any = np.full(len(shapes.kind), None) if shapes.mesh is None else shapes.mesh
    rows = np.flatnonzero(is_mesh)
    once, which = different(held[rows])
    sizes = [mesh.size if isinstance(mesh, Mesh) else np.full(3, np.nan) for mesh in once]
    known = (np.array(sizes).reshape(-1, 3)[which] == shapes.size[rows]).all(axis=1)
    form.faults[rows[~known]] = NO_MESH
    rows = rows[known]
    if not len(rows):
        return
    records = form.records[rows]
    turns, ndim = rotations(records['orientation']), form.lo.shape[1]
    meshes, which = different(held[rows])
    centres = np.array([mesh.centre for mesh in meshes]).reshape(-1, 3)[which]
    with np.errstate(over='ignore', invalid='ignore'):
        low, high = _reaches(meshes, which, turns)
        records['position'] += turned(turns, centres)
        position, half = records['position'], records['half']
        spread = np.abs(position) + turned(np.abs(turns), half)
        leans = records['orientation'][:, :2].any(axis=1)
        largest = np.maximum(
            spread[:, :ndim].max(axis=1, initial=0.0),
            np.where(leans, half.max(axis=1, initial=0.0), 0.0),
        )
        pad = largest[:, None] * OUTWARD + LEAST
        lo, hi = position + low - pad, position + high + pad
    finite = np.isfinite(lo).all(axis=1) & np.isfinite(hi).all(axis=1)
    form.faults[rows] = np.where(finite, FINE, TOO_LARGE)
    form.lo[rows], form.hi[rows] = lo[:, :ndim], hi[:, :ndim]
    form.records[rows] = records


def different(meshes: NDArray[np.object_]) -> tuple[list[Any], NDArray[np.intp]]:
    """The meshes of an array (n,), each once, and which of them each row has."""
    keys = np.fromiter(map(id, meshes), np.int64, len(meshes))
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    return meshes[first].tolist(), which


def _reaches(meshes: list[Mesh], which: NDArray[np.intp], turns: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest corners (n, 3) of turned meshes, seen from their centres."""
    low, high = np.empty((2, len(which), 3))
    order = np.argsort(which, kind='stable')
    for mesh, group in zip(
        meshes,
        np.split(order, np.searchsorted(which[order], np.arange(1, len(meshes)))),
        strict=True,
    ):
        step = max(MOST_PLACES // len(mesh.vertices), 1)
        for begin in range(0, len(group), step):
            some = group[begin : begin + step]
            places = mesh.vertices @ turns[some].swapaxes(1, 2)
            low[some], high[some] = places.min(axis=1), places.max(axis=1)
    return low, high
