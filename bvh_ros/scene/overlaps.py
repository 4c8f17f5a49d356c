# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles touch a query box: broad phase, exact decision between axis-aligned boxes, narrow phase for the others."""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree import checks
from ..tree.dynamic_bvh import DynamicBVH
from ..tree.nodes import SLOT_MASK
from . import narrow_phase, shapes
from .columns import Columns
from .registry import Slots
from .shapes import Floats, ShapeKind, Shapes


class BoxQuery(NamedTuple):
    """A box, grown by `tolerance` with rounded corners; `lo` and `hi` bound the box itself, exactly if it is aligned."""

    centre: Floats
    orientation: Floats
    half: Floats
    tolerance: float
    aligned: bool
    lo: Floats
    hi: Floats

    @property
    def is_point(self) -> bool:
        return not self.half.any()


def box_query(
    start: ArrayLike, goal: ArrayLike, orientation: ArrayLike, tolerance: float, planar: bool
) -> BoxQuery:
    """Check the arguments of `Scene.overlap`."""
    first, second = checks.point('start', start, 3), checks.point('goal', goal, 3)
    turn = checks.point('orientation', orientation, 4)
    reach = checks.limit('tolerance', tolerance)
    with np.errstate(over='ignore'):
        diagonal = second - first
    if not np.isfinite(diagonal).all() or np.isinf(reach):
        raise ValueError('the query box is larger than the largest double')
    turn = shapes.unit_quaternions(turn[None])[0]
    centre = first * 0.5 + second * 0.5
    if shapes.maps_axes_to_axes(turn[None])[0] or not diagonal.any():
        identity = np.array([0.0, 0.0, 0.0, 1.0])
        return BoxQuery(
            centre,
            identity,
            np.abs(diagonal) * 0.5,
            reach,
            True,
            np.minimum(first, second),
            np.maximum(first, second),
        )
    half = np.abs(shapes.rotations(turn[None])[0].T @ diagonal) * 0.5
    box = Shapes.boxes(centre, half * 2.0, turn[None])
    lo, hi = shapes.bounds(box, np.zeros(1, np.bool_))
    return BoxQuery(centre, turn, half, reach, False, lo[0], hi[0])


class Touching(NamedTuple):
    """Obstacles that touch a query, and how each lies to its centre; one row an obstacle, in no order."""

    slots: Slots
    distances: Floats
    points: Floats
    normals: Floats


def find(tree: DynamicBVH, columns: Columns, query: BoxQuery, mask: int) -> Touching:
    """The obstacles whose distance from the query's box is at most its tolerance."""
    ndim, largest = tree.ndim, np.finfo(np.float64).max
    lo, hi = query.lo, query.hi
    if query.tolerance > 0.0:
        with np.errstate(over='ignore'):
            lo = np.clip(np.nextafter(lo - query.tolerance, -np.inf), -largest, largest)
            hi = np.clip(np.nextafter(hi + query.tolerance, np.inf), -largest, largest)
    slots = tree.overlap(lo[:ndim], hi[:ndim], mask) & SLOT_MASK
    records = columns.geometry[slots]
    touches = np.ones(len(slots), np.bool_)
    plain = ~records['shaped'] if query.aligned else np.zeros(len(slots), np.bool_)
    if query.tolerance > 0.0:
        box_lo, box_hi = corners(records[plain])
        touches[plain] = boxes_within(box_lo, box_hi, query, ndim)
    if not plain.all():
        touches[~plain] = shapes_within(records[~plain], query)
    slots, records = slots[touches], records[touches]
    points = closest_points(records, query.centre)
    offsets = query.centre - points
    distances = lengths(offsets)
    with np.errstate(invalid='ignore'):
        normals = np.where(distances[:, None] > 0.0, offsets / distances[:, None], 0.0)
    return Touching(slots, distances, points, normals)


def corners(records: NDArray[np.void]) -> tuple[Floats, Floats]:
    """Lowest and highest corners of axis-aligned boxes, the same doubles that the tree holds."""
    return records['position'] - records['half'], records['position'] + records['half']


def lengths(vectors: Floats) -> Floats:
    """Euclidean lengths of rows; scaled by a power of two, so that squares neither overflow nor vanish."""
    exponent = np.frexp(np.abs(vectors).max(axis=1, initial=0.0))[1]
    scaled = np.ldexp(vectors, -exponent[:, None])
    result: Floats = np.ldexp(np.sqrt((scaled * scaled).sum(axis=1)), exponent)
    return result


def boxes_within(lo: Floats, hi: Floats, query: BoxQuery, ndim: int) -> NDArray[np.bool_]:
    """Whether axis-aligned boxes are within the tolerance of an aligned query, as real arithmetic decides."""
    gaps = np.maximum(np.maximum(lo - query.hi, query.lo - hi), 0.0)[:, :ndim]
    distances = lengths(gaps)
    near: NDArray[np.bool_] = distances <= query.tolerance
    # A gap is rounded once, the length a few times: only next to the tolerance may that decide.
    close = np.abs(distances - query.tolerance) <= 2.0**-49 * query.tolerance
    limit = Fraction(query.tolerance) ** 2
    for row in np.flatnonzero(close):
        square = Fraction(0)
        for axis in range(ndim):
            gap = max(
                Fraction(lo[row, axis]) - Fraction(query.hi[axis]),
                Fraction(query.lo[axis]) - Fraction(hi[row, axis]),
            )
            square += max(gap, Fraction(0)) ** 2
        near[row] = square <= limit
    return near


def shapes_within(records: NDArray[np.void], query: BoxQuery) -> NDArray[np.bool_]:
    """Whether shapes are within the tolerance of the query."""
    if query.is_point:
        near: NDArray[np.bool_] = (
            lengths(query.centre - closest_points(records, query.centre)) <= query.tolerance
        )
        return near
    near = np.zeros(len(records), np.bool_)
    sphere = records['kind'] == ShapeKind.SPHERE
    balls = records[sphere]
    near[sphere] = (
        distances_to_query(balls['position'], query) <= balls['half'][:, 0] + query.tolerance
    )
    others = np.flatnonzero(~sphere)
    if len(others):
        box = narrow_phase.solid(ShapeKind.BOX, query.centre, query.orientation, query.half)
        for row in others:
            record = records[row]
            solid = narrow_phase.solid(
                int(record['kind']), record['position'], record['orientation'], record['half']
            )
            near[row] = narrow_phase.within(solid, box, query.tolerance)
    return near


def distances_to_query(points: Floats, query: BoxQuery) -> Floats:
    """Distances of points from the query's box (without its tolerance)."""
    local = (points - query.centre) @ shapes.rotations(query.orientation[None])[0]
    return lengths(np.maximum(np.abs(local) - query.half, 0.0))


def closest_points(records: NDArray[np.void], centre: Floats) -> Floats:
    """The point of each shape closest to `centre`, in closed form; the centre itself where it lies inside."""
    lo, hi = corners(records)
    points = np.clip(centre, lo, hi)
    turned = np.flatnonzero(records['shaped'])
    if not len(turned):
        return points
    records = records[turned]
    matrices = shapes.rotations(records['orientation'])
    local = np.einsum('nij,ni->nj', matrices, centre - records['position'])
    half = records['half']
    closest = np.clip(local, -half, half)
    for kind, axes in ((ShapeKind.SPHERE, 3), (ShapeKind.CYLINDER, 2)):
        rows = np.flatnonzero(records['kind'] == kind)
        far = lengths(local[rows, :axes])
        shrink = half[rows, 0] / np.maximum(far, half[rows, 0])
        closest[rows, :axes] = local[rows, :axes] * shrink[:, None]
    inside = (closest == local).all(axis=1)
    points[turned] = np.einsum('nij,nj->ni', matrices, closest) + records['position']
    points[turned[inside]] = centre
    return points
