# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shapes that overlap and distance queries ask about, other than boxes between corners."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree import checks
from ...tree.nodes import ALL
from ..geometry.canonical import FINE, REASONS, Canonical, canonicalise, different, rows_entry
from ..geometry.polygon import outlined
from ..geometry.records import GEOMETRY, Records
from ..geometry.shapes import MESH, UINT8, Floats, Shapes, as_shapes
from ..store.mesh_store import Hulls, MeshStore
from .query_shape import QueryShape

_NO_ROWS = np.empty((0, 3))


class QueryRows(NamedTuple):
    """n shapes, each to be grown by its tolerance, for kernels."""

    records: Records
    """(n,)"""
    bounds: Floats
    """(n, 2, 3) around the shapes themselves; the corners of aligned boxes exactly."""
    tolerances: Floats
    """One for all, or (n,)."""
    masks: NDArray[np.uint32]
    """One for all, or (n,)."""

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
    return tuple.__new__(QueryRows, parts), _hulls(given, form, planar)


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
