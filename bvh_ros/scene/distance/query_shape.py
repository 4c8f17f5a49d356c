# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shape that an overlap query asks about."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...tree.access import checks
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..geometry.canonical import canonical_row, fill_unit, is_finite, maps_axes_to_axes
from ..geometry.records import GEOMETRY, UNTURNED, Records
from ..geometry.rotation import fill_rotation
from ..geometry.shapes import BOX, Floats

NO_TURN = (0.0, 0.0, 0.0, 0.0)
LARGEST = 1.7976931348623157e308

# The box between two corners is so, or is not, because, see `fill_box`.
ALIGNED, TURNED, NOT_FINITE, TOO_LONG, TILTED = range(5)
REFUSED = {
    TOO_LONG: 'the query box is larger than the largest double',
    TILTED: 'in a planar scene the orientation of a box must be about z only',
}


class QueryShape(NamedTuple):
    """A shape to be grown by `tolerance` all round, for kernels."""

    record: Records
    """(1,)"""
    bounds: Floats
    """(2, 3) around the shape itself; the corners of an aligned box exactly."""
    aligned: bool
    """It is a box whose axes are the world's."""
    tolerance: float
    height: float
    """Where the points of a planar scene are put."""


@lean_kernel
def fill_box(start, goal, orientation, planar, records, bounds):
    """Fill in record (1,) and bounds of the box between two corners whose axes are turned; return
    whether it is ALIGNED or TURNED, or why there is none.
    """
    record = records[0]
    if not (is_finite(start) and is_finite(goal) and is_finite(orientation)):
        return NOT_FINITE
    unit, matrix = stack_array(4, np.float64), stack_array((3, 3), np.float64)
    diagonal, centre = stack_array(3, np.float64), stack_array(3, np.float64)
    fill_unit(orientation, unit)
    if planar and (unit[0] != 0.0 or unit[1] != 0.0):
        return TILTED
    point = True
    for axis in range(3):
        flat = planar and axis == 2
        first, second = (0.0, 0.0) if flat else (start[axis], goal[axis])
        diagonal[axis], centre[axis] = second - first, first * 0.5 + second * 0.5
        bounds[0, axis], bounds[1, axis] = min(first, second), max(first, second)
        if not math.isfinite(diagonal[axis]):
            return TOO_LONG
        point = point and diagonal[axis] == 0.0
    if point or maps_axes_to_axes(unit):
        fill_aligned(bounds, centre, record)
        return ALIGNED
    fill_rotation(unit, matrix)
    edges = stack_array(3, np.float64)
    for axis in range(3):
        edges[axis] = abs(
            matrix[0, axis] * diagonal[0]
            + matrix[1, axis] * diagonal[1]
            + matrix[2, axis] * diagonal[2]
        )
    ndim = 2 if planar else 3
    canonical_row(np.uint8(BOX), centre, orientation, edges, ndim, record, bounds)
    return TURNED


@inlined
def fill_aligned(bounds, centre, record):
    record.kind, record.shaped, record.mesh = BOX, False, 0
    for axis in range(3):
        record.position[axis] = centre[axis]
        record.half[axis] = bounds[1, axis] * 0.5 - bounds[0, axis] * 0.5
        record.orientation[axis] = 0.0
    record.orientation[3] = 1.0


@lean_kernel
def grow(query, grown):
    """Fill in bounds of the grown shape, rounded outwards, within the range of doubles."""
    for axis in range(3):
        lo, hi = query.bounds[0, axis], query.bounds[1, axis]
        if query.tolerance > 0.0:
            lo = max(np.nextafter(lo - query.tolerance, -np.inf), -LARGEST)
            hi = min(np.nextafter(hi + query.tolerance, np.inf), LARGEST)
        grown[0, axis], grown[1, axis] = lo, hi


def box_query(
    start: ArrayLike, goal: ArrayLike, orientation: ArrayLike, tolerance: float, planar: bool
) -> QueryShape:
    """Check the arguments of `Scene.overlap`."""
    first, second = _coordinates('start', start, 3), _coordinates('goal', goal, 3)
    turn = UNTURNED['orientation']
    if orientation is not NO_TURN:
        turn = _coordinates('orientation', orientation, 4)
    record, bounds = np.empty(1, GEOMETRY), np.empty((2, 3))
    state = fill_box(first, second, turn, planar, record, bounds)
    if state > TURNED:
        for name, value in (('start', first), ('goal', second), ('orientation', turn)):
            checks.point(name, value, len(value))
        raise ValueError(REFUSED[state])
    reach = _tolerance(tolerance)
    return QueryShape(record, bounds, state == ALIGNED, reach, first.item(2))


def _coordinates(name: str, value: ArrayLike, count: int) -> Floats:
    """So many numbers; whether they are finite, the kernel sees."""
    if type(value) is np.ndarray and value.shape == (count,):
        return checks.floats(name, value)
    return checks.point(name, value, count)


def _tolerance(value: float) -> float:
    tolerance = checks.limit('tolerance', value)
    if math.isinf(tolerance):
        raise ValueError('tolerance must be finite')
    return tolerance
