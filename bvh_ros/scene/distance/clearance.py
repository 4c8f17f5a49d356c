# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far an obstacle is from the nearest other one, by their true shapes.

No two shapes are nearer than their boxes. So some neighbour's distance bounds the search: only
boxes within it are looked at, nearest first, until the next box is farther than the best shape.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import lean_kernel
from ...tree.jit.intrinsics import stack_array
from ..geometry.hull import hull_of
from ..geometry.shapes import Floats
from ..store.columns import Columns
from ..store.registry import Slots
from .gjk import CORE_ROWS, FIRST, SECOND, SLACK, WAY_ROOM, dot
from .narrow_phase import fill_core, largest_length, ordered
from .overlaps import corners, lengths
from .sure_gap import sure_bounds

ROUNDED = 1.0 + 2.0**-40  # no computed distance is off by as much
MORE = 4


class Neighbour(NamedTuple):
    """The nearest other obstacle."""

    distance: float
    slot: int
    points: Floats
    """Shape (2, 3): the obstacle's point, and the other's."""


@lean_kernel
def gap(one, other, hulls, planar, points):
    """Distance of two shapes, 0 if they touch; fill in the closest points, or twice a common
    one. It is the same from either side.
    """
    if ordered(one, other):
        return ordered_gap(one, other, hulls, planar, points)
    distance = ordered_gap(other, one, hulls, planar, points)
    for axis in range(3):
        points[0, axis], points[1, axis] = points[1, axis], points[0, axis]
    return distance


@lean_kernel
def ordered_gap(one, other, hulls, planar, points):
    first = stack_array(15, np.float64).reshape(CORE_ROWS, 3)
    second = stack_array(15, np.float64).reshape(CORE_ROWS, 3)
    way = stack_array(WAY_ROOM, np.float64)
    origin = one.position
    largest = max(largest_length(one, origin, planar), largest_length(other, origin, planar))
    exponent = math.frexp(largest)[1]
    round_one, radius = fill_core(one, origin, exponent, planar, first)
    round_other, other_radius = fill_core(other, origin, exponent, planar, second)
    if hulls is None:
        hull = other_hull = None
    else:
        hull, other_hull = hull_of(hulls, one), hull_of(hulls, other)
    limit = radius + other_radius + SLACK
    low, high, _ = sure_bounds(
        first, round_one, hull, second, round_other, other_hull, limit, True, way
    )
    apart = high if high - low <= SLACK else low
    touching = apart <= limit
    for axis in range(3):
        way[axis] = way[FIRST + axis] - way[SECOND + axis]
    share, other_share = surfaces(radius, other_radius, math.sqrt(dot(way, way)), touching)
    for axis in range(3):
        points[0, axis] = way[FIRST + axis] - share * way[axis]
        points[1, axis] = way[FIRST + axis] - other_share * way[axis]
        for row in range(2):
            points[row, axis] = math.ldexp(points[row, axis], exponent) + origin[axis]
    return 0.0 if touching else math.ldexp(apart - radius - other_radius, exponent)


@lean_kernel
def surfaces(radius, other_radius, length, touching):
    """Where the surfaces are on the way from a point of one core to a point of the other, in
    shares of it; twice a point in both where they touch.
    """
    if touching:
        share = radius / max(radius + other_radius, length) if radius > 0.0 else 0.0
        return share, share
    return radius / length, 1.0 - other_radius / length


def nearest_other(tree: DynamicBVH, columns: Columns, slot: int) -> Neighbour | None:
    """The obstacle nearest to that of a slot, ties by handle; None if it is alone."""
    lo, hi = (side[0] for side in tree.boxes([int(columns.tree_handle[slot])]))
    some = _some_other(tree, columns, slot, lo * 0.5 + hi * 0.5)
    if some is None:
        return None
    best = _measured(columns, slot, some, tree.ndim)
    reach = np.nextafter(best.distance * ROUNDED, np.inf)
    with np.errstate(over='ignore'):
        largest = np.finfo(np.float64).max
        near = tree.overlap(np.maximum(lo - reach, -largest), np.minimum(hi + reach, largest))
    slots = tree.slots(near)
    slots = slots[columns.node_handle[slots] != columns.node_handle[slot]]
    low, high = tree.boxes(columns.tree_handle[slots])
    gaps = lengths(np.maximum(np.maximum(low - hi, lo - high), 0.0))
    for i in np.lexsort((columns.node_handle[slots], gaps)).tolist():
        if gaps[i] > best.distance * ROUNDED:
            break
        found = _measured(columns, slot, int(slots[i]), tree.ndim)
        if _rank(columns, found) < _rank(columns, best):
            best = found
    return best


def _rank(columns: Columns, found: Neighbour) -> tuple[float, int]:
    return found.distance, int(columns.node_handle[found.slot])


def _some_other(tree: DynamicBVH, columns: Columns, slot: int, point: Floats) -> int | None:
    """A slot near a point that holds another obstacle."""
    asked, handle = 2, columns.node_handle[slot]
    while True:
        slots: Slots = tree.slots(tree.nearest(point, asked)[0])
        others = slots[columns.node_handle[slots] != handle]
        if len(others):
            return int(others[0])
        if len(slots) < asked:
            return None
        asked *= MORE


def _measured(columns: Columns, slot: int, other: int, ndim: int) -> Neighbour:
    """How far two obstacles are apart."""
    records, planar = columns.geometry[[slot, other]], ndim == 2
    points = np.empty((2, 3))
    if records['shaped'].any():
        distance = gap(records[0], records[1], columns.hulls(), planar, points)
    else:
        distance = _box_gap(records, ndim, points)
    if planar:
        points[:, 2] = records['position'][0, 2]
    return Neighbour(float(distance), other, points)


def _box_gap(records: NDArray[np.void], ndim: int, points: Floats) -> float:
    """`gap` of two axis-aligned boxes: between their faces, and in the middle where they face
    each other.
    """
    lo, hi = corners(records)
    low, high = lo.max(axis=0), hi.min(axis=0)  # of what they have in common, if low <= high
    middle = low * 0.5 + high * 0.5
    points[:] = np.where(low <= high, middle, np.where(lo >= low, lo, hi))
    return float(lengths(np.maximum(low - high, 0.0)[None, :ndim])[0])
