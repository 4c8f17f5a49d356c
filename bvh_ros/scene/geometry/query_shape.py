# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shape that an overlap query asks about."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree import checks
from ..store.columns import GEOMETRY, UNTURNED
from ..store.mesh_store import Hulls, MeshStore
from . import shapes
from .polygon import outlined
from .shapes import Floats, Shapes


class QueryShape(NamedTuple):
    """A shape to be grown by `tolerance` all round; `lo`, `hi` bound the shape itself."""

    centre: Floats
    """(3,)"""
    tolerance: float
    aligned: bool
    """It is a box whose axes are the world's: `lo` and `hi` are its corners exactly."""
    lo: Floats
    hi: Floats
    height: float
    """Where the points of a planar scene are put."""
    turned: NDArray[np.void] | None = None
    """(1,) of `columns.GEOMETRY`; of an aligned box only where it was at hand."""
    hulls: Hulls | None = None
    """Of a mesh."""

    @property
    def solid(self) -> NDArray[np.void]:
        """(1,) of `columns.GEOMETRY`: what the narrow phase reads. Boxes among boxes need none."""
        if self.turned is not None:
            return self.turned
        solid = UNTURNED.reshape(1).copy()
        solid['position'], solid['half'] = self.centre, self.hi * 0.5 - self.lo * 0.5
        return solid

    def reach(self) -> tuple[Floats, Floats]:
        """Bounds of the grown shape, rounded outwards, within the range of doubles."""
        if self.tolerance == 0.0:
            return self.lo, self.hi
        largest = np.finfo(np.float64).max
        with np.errstate(over='ignore'):
            lo = np.nextafter(self.lo - self.tolerance, -np.inf)
            hi = np.nextafter(self.hi + self.tolerance, np.inf)
        return np.maximum(lo, -largest), np.minimum(hi, largest)


def geometry_arrays(form: Shapes, shaped: NDArray[np.bool_]) -> NDArray[np.void]:
    """Records (n,) of canonical shapes."""
    records = np.zeros(len(form.kind), GEOMETRY)
    records['position'], records['orientation'] = form.position, form.orientation
    records['half'] = form.size * 0.5
    records['kind'], records['shaped'] = form.kind, shaped
    return records


def box_query(
    start: ArrayLike, goal: ArrayLike, orientation: ArrayLike, tolerance: float, planar: bool
) -> QueryShape:
    """Check the arguments of `Scene.overlap`."""
    first, second = checks.point('start', start, 3), checks.point('goal', goal, 3)
    turn = checks.point('orientation', orientation, 4)[None]
    aligned = not any(turn[0, :3].tolist())
    if not aligned:
        turn = shapes.unit_quaternions(turn)
        if planar and (turn[0, 0] != 0.0 or turn[0, 1] != 0.0):
            raise ValueError('in a planar scene the orientation of a box must be about z only')
        aligned = bool(shapes.maps_axes_to_axes(turn)[0])
    reach = _tolerance(tolerance)
    height = float(first[2])
    if planar:
        first[2] = second[2] = 0.0
    # Three numbers: Python's own arithmetic is faster than numpy's.
    diagonal = [b - a for a, b in zip(first.tolist(), second.tolist(), strict=True)]
    if not all(map(math.isfinite, diagonal)):
        raise ValueError('the query box is larger than the largest double')
    centre = first * 0.5 + second * 0.5
    if aligned or not any(diagonal):
        corners = np.minimum(first, second), np.maximum(first, second)
        return QueryShape(centre, reach, True, *corners, height)
    edges = np.abs(shapes.rotations(turn)[0].T @ diagonal)
    form = Shapes.boxes(centre, edges, turn)
    lo, hi = shapes.bounds(form, np.zeros(1, np.bool_))
    solid = geometry_arrays(form, np.ones(1, np.bool_))
    return QueryShape(centre, reach, False, lo[0], hi[0], height, solid)


def shape_query(shape: Shapes, tolerance: float, planar: bool) -> QueryShape:
    """Check the arguments of `Scene.overlap_shape`."""
    given = shapes.as_shapes(shape)
    if len(given.kind) != 1:
        raise ValueError(f'shape must be one row of Shapes, not {len(given.kind)}')
    reason = shapes.REASONS[shapes.faults(given)[0]]
    form, aligned = shapes.canonical(given) if not reason else (given, np.zeros(1, np.bool_))
    if not reason:
        with np.errstate(over='ignore'):
            lo, hi = shapes.bounds(form, aligned)
        if not (np.isfinite(lo).all() and np.isfinite(hi).all()):
            reason = shapes.REASONS[shapes.TOO_LARGE]
    if reason:
        raise ValueError(f'shape cannot be used: {reason}')
    height = float(form.position[0, 2])
    if planar:
        form = outlined(form)
    solid = geometry_arrays(form, ~aligned)
    store = MeshStore()
    if form.mesh is not None and form.mesh[0] is not None:
        solid['mesh'] = store.take(form.mesh[0])
    hulls = store.hulls if len(store) else None
    reach = _tolerance(tolerance)
    box = bool(aligned[0]), lo[0], hi[0]
    return QueryShape(form.position[0], reach, *box, height, solid, hulls)


def _tolerance(value: float) -> float:
    tolerance = checks.limit('tolerance', value)
    if np.isinf(tolerance):
        raise ValueError('tolerance must be finite')
    return tolerance
