# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shapes that overlap and distance queries ask about, other than boxes between corners."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree.access import ALL, checks, of_row
from ...tree.compiler import inlined
from ..geometry.canonical import (
    FINE,
    NO_BOUNDS,
    NO_MESH,
    REASONS,
    TOO_LARGE,
    Canonical,
    canonical_row,
    canonicalise,
    different,
    fault_of,
    is_finite,
    rows_entry,
)
from ..geometry.polygon import outlined
from ..geometry.records import GEOMETRY, Records
from ..geometry.shapes import BOX, MESH, UINT8, Floats, Shapes, as_shapes
from ..store.mesh_store import Hulls, MeshStore
from .query_shape import QueryShape

_NO_ROWS = np.empty((0, 3))
NO_RECORDS = np.empty(0, GEOMETRY)
NO_GIVEN = np.empty(0, UINT8), _NO_ROWS, np.empty((0, 4)), _NO_ROWS
# One for all rows, of aligned boxes.
BOXES, UNTURNED = np.zeros(1, UINT8), np.zeros((1, 4))
# Why a kernel answers nothing: a shape is not legal, or needs a narrow phase where none is given.
FAULTY, NARROW = -2, -3


class QueryRows(NamedTuple):
    """n shapes, each to be grown by its tolerance, for kernels."""

    records: Records
    """(n,), or none: then the kernel makes them of what is `given`."""
    bounds: Floats
    """(n, 2, 3) around the shapes themselves; the corners of aligned boxes exactly."""
    tolerances: Floats
    """One for all, or (n,)."""
    masks: NDArray[np.uint32]
    """One for all, or (n,)."""
    given: tuple[Any, ...] = NO_GIVEN
    """Kinds, positions, orientations and sizes: all but positions one for all, or (n,)."""

    def one(self, row: int) -> QueryShape:
        """The query of a row."""
        record = self.records[row : row + 1]
        tolerance = self.tolerances.item(row if len(self.tolerances) > 1 else 0)
        aligned, height = not record['shaped'][0], record['position'].item(2)
        return QueryShape(record, self.bounds[row], aligned, tolerance, height)

    def mask(self, row: int) -> np.uint32:
        """The mask of a row."""
        seen: np.uint32 = self.masks[row if len(self.masks) > 1 else 0]
        return seen


def number_of(rows: tuple[Any, ...]) -> int:
    """How many there are of plain `QueryRows`."""
    return len(rows[0]) or len(rows[4][1])


def begin_shaped(rows: tuple[Any, ...]) -> bool:
    """Whether of plain `QueryRows` one, or the first that is given, seems to be more than an
    axis-aligned box.
    """
    records, _, _, _, (kinds, _, turns, _) = rows
    if kinds is BOXES and turns is UNTURNED:
        return False
    if len(records) or not (len(kinds) and len(turns)):
        return bool(records['shaped'].any())
    if kinds.item(0) != BOX:
        return True
    return turns.item(0) != 0.0 or turns.item(1) != 0.0 or turns.item(2) != 0.0


@inlined
def make_row(rows, row, own, box):
    """(record (1,), bounds (2, 3), fault) of a row; `own` and `box` are room for them where they
    are still to be made.
    """
    records, bounds, _, _, (kinds, positions, orientations, sizes) = rows
    if records.shape[0] > 0:
        return records[row : row + 1], bounds[row], FINE
    kind, position = of_row(kinds, row), positions[row]
    turn = orientations[row if orientations.shape[0] > 1 else 0]
    size = sizes[row if sizes.shape[0] > 1 else 0]
    fault = NO_MESH if kind == MESH else fault_of(kind, position, turn, size)
    if fault == FINE:
        canonical_row(kind, position, turn, size, 3, own[0], box)
        if not (is_finite(box[0]) and is_finite(box[1])):
            fault = TOO_LARGE
    return own, box, fault


def given_rows(given: tuple[Any, ...], tolerance: Any, mask: ArrayLike) -> tuple[Any, ...]:
    """A plain `QueryRows` of shapes without meshes, as of `QueryRows.given`, whose records a
    kernel makes, and whose faults it finds.
    """
    count, tolerances, masks = len(given[1]), checks.NOTHING, checks.EVERYTHING
    if type(tolerance) is not float or tolerance != 0.0:
        tolerances = checks.lengths_or_one('tolerance', tolerance, count)
    if mask is not ALL:
        masks = checks.masks_or_one(mask, count)
    return NO_RECORDS, NO_BOUNDS, tolerances, masks, given


def with_records(rows: QueryRows) -> QueryRows:
    """Legal rows with records, as Python reads them."""
    if len(rows.records):
        return rows
    form = canonicalise(_row_by_row(Shapes(*rows.given), number_of(rows)))
    bounds = np.stack((form.lo, form.hi), axis=1)
    return rows._replace(records=form.records, bounds=bounds, given=NO_GIVEN)


def query_rows(
    given: Shapes, tolerance: ArrayLike, mask: ArrayLike, planar: bool, *names: str
) -> tuple[QueryRows, Hulls | None]:
    """Check arguments, `given` from `as_shapes`, or without meshes with one kind, orientation or
    size for all; the rows, and the arrays of their meshes if they have any. `names`: what the
    positions, sizes and orientations are called where they are not finite; '' if by their row.
    """
    count = len(given.position)
    bounds = np.empty((count, 2, 3))
    # As Canonical(...), which would take one more call of a function of Python's.
    columns = np.empty(count, GEOMETRY), _NO_ROWS, _NO_ROWS, np.empty(count, UINT8)
    form: Canonical = tuple.__new__(Canonical, columns)
    if given.mesh is not None or rows_entry(3)(*given[:4], form, bounds):
        given = _row_by_row(given, count)
        form = canonicalise(given)
        bounds[:, 0], bounds[:, 1] = form.lo, form.hi
    if np.count_nonzero(form.faults):  # but for FINE, which is 0
        for name, rows in zip(
            names, (given.position, given.size, given.orientation), strict=False
        ):
            if name:
                checks.finite(name, rows)
        bad = int(np.argmax(form.faults != FINE))
        reason = REASONS[form.faults[bad]]
        raise ValueError(f'the shape of row {bad} cannot be used: {reason}')
    tolerances = checks.lengths_or_one('tolerance', tolerance, count)
    parts = form.records, bounds, tolerances, checks.masks_or_one(mask, count)
    return tuple.__new__(QueryRows, (*parts, NO_GIVEN)), _hulls(given, form, planar)


def _row_by_row(given: Shapes, count: int) -> Shapes:
    """With all columns of so many rows."""
    every: Any = (np.broadcast_to(rows, (count, *rows.shape[1:])) for rows in given[:4])
    kind, position, orientation, size = map(np.ascontiguousarray, every)
    return Shapes(kind, position, orientation, size, given.mesh)


def shape_query(shape: Shapes, tolerance: float, planar: bool) -> tuple[QueryShape, Hulls | None]:
    """`query_rows` of one row, as a query of its own."""
    given = as_shapes(shape)
    if len(given.kind) != 1:
        raise ValueError(f'shape must be one row of Shapes, not {len(given.kind)}')
    rows, hulls = query_rows(given, checks.limit('tolerance', tolerance), ALL, planar)
    return rows.one(0), hulls


def _hulls(given: Shapes, form: Canonical, planar: bool) -> Hulls | None:
    """The arrays of the rows' meshes, whose numbers the records get."""
    if given.mesh is None:  # else a row of kind MESH has a fault
        return None
    rows = np.flatnonzero(form.records['kind'] == MESH)
    if not len(rows):
        return None
    store, meshes = MeshStore(), outlined(given.mesh, form) if planar else given.mesh
    if meshes is not None:
        once, which = different(meshes[rows])
        form.records['mesh'][rows] = np.array([store.take(mesh) for mesh in once])[which]
    return store.hulls
