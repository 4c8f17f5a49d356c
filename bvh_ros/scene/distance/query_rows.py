# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shapes that overlap and distance queries ask about, other than boxes between corners."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree import checks
from ...tree.nodes import ALL
from ..geometry.canonical import FINE, REASONS, Canonical, canonicalise, different
from ..geometry.polygon import outlined
from ..geometry.records import Records
from ..geometry.shapes import MESH, Floats, Shapes, as_shapes
from ..store.mesh_store import Hulls, MeshStore
from .query_shape import QueryShape


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
    given: Shapes, tolerance: ArrayLike, mask: ArrayLike, planar: bool
) -> tuple[QueryRows, Hulls | None]:
    """Check arguments, `given` from `as_shapes`; the rows, and the arrays of their meshes if they
    have any.
    """
    form, count = canonicalise(given), len(given.kind)
    if np.count_nonzero(form.faults):  # but for FINE, which is 0
        bad = int(np.argmax(form.faults != FINE))
        reason = REASONS[form.faults[bad]]
        raise ValueError(f'the shape of row {bad} cannot be used: {reason}')
    bounds = np.empty((count, 2, 3))  # filled: np.stack takes eight times as long
    bounds[:, 0], bounds[:, 1] = form.lo, form.hi
    tolerances = checks.lengths_or_one('tolerance', tolerance, count)
    hulls = _hulls(given, form, planar)
    return QueryRows(form.records, bounds, tolerances, checks.masks_or_one(mask, count)), hulls


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
