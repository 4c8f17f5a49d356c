# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first thing that each ray meets, by brute force and without rounding.

A filter in float64 with sound bounds sorts out what surely is not first; the rest is settled in
whole numbers.
"""

from collections.abc import Callable
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ...scene.geometry.shapes import Shapes
from ..scenes import Boxes, Floats, Rays
from .exact import Whole, WholeShapes, bits_below_the_point, enter_slabs, whole

Rows = NDArray[np.int64]
NOTHING = -1
MANY = 256


class Truth(NamedTuple):
    """What real arithmetic says of n rays."""

    rows: Rows
    """(n,) of the object met first, the lowest among equals; NOTHING where none is."""
    ts: list[Fraction | None]
    """Exact distance to it."""
    entry: Callable[[int, int], Fraction | None]
    """Exact distance at which a ray enters an object: entry(row, ray)."""
    lengths: Floats
    """(n,) of the directions, m: distances are in units of them."""


@njit(nogil=True)
def _slab_bounds(lo, hi, origin, direction):
    """Bounds of entry and exit: (entry low, entry high, exit low, exit high).

    Difference and quotient round once each: within 2**-50 of the value relatively, and 1e-300.
    """
    bounds = (0.0, 0.0, np.inf, np.inf)
    for axis in range(3):
        if direction[axis] == 0.0:
            if origin[axis] < lo[axis] or origin[axis] > hi[axis]:
                return np.inf, np.inf, -np.inf, -np.inf
            continue
        first = (lo[axis] - origin[axis]) / direction[axis]
        last = (hi[axis] - origin[axis]) / direction[axis]
        near, far = min(first, last), max(first, last)
        near_error, far_error = abs(near) * 2.0**-50 + 1e-300, abs(far) * 2.0**-50 + 1e-300
        bounds = (
            max(bounds[0], near - near_error),
            max(bounds[1], near + near_error),
            min(bounds[2], far - far_error),
            min(bounds[3], far + far_error),
        )
    return bounds


@njit(nogil=True)
def _candidates(lo, hi, origin, direction, entries, found):
    """Boxes that may be the first on a ray; returns how many, counting those that do not fit."""
    nearest = np.inf  # a box is surely met up to here
    for row in range(lo.shape[0]):
        low, high, leave_low, leave_high = _slab_bounds(lo[row], hi[row], origin, direction)
        entries[row] = low if low <= leave_high else np.inf
        if high <= leave_low:
            nearest = min(nearest, high)
    count = 0
    for row in range(lo.shape[0]):
        if entries[row] < np.inf and entries[row] <= nearest:
            if count < found.shape[0]:
                found[count] = row
            count += 1
    return count


def _ray_bits(rays: Rays) -> int:
    values = (*rays.origins.ravel().tolist(), *rays.directions.ravel().tolist())
    return bits_below_the_point(values)


def boxes_truth(boxes: Boxes, rays: Rays) -> Truth:
    """Truth of axis-aligned boxes; coordinates between 1e-150 and 1e150, so that no bound of the
    filter overflows.
    """
    values = (*boxes.lo.ravel().tolist(), *boxes.hi.ravel().tolist())
    bits = max(_ray_bits(rays), bits_below_the_point(values))
    starts = [whole(row, bits) for row in rays.origins.tolist()]
    ways = [whole(row, bits) for row in rays.directions.tolist()]

    def entry(row: int, ray: int) -> Fraction | None:
        low, high = whole(boxes.lo[row].tolist(), bits), whole(boxes.hi[row].tolist(), bits)
        near = [plane - o for plane, o in zip(low, starts[ray], strict=True)]
        far = [plane - o for plane, o in zip(high, starts[ray], strict=True)]
        return enter_slabs(near, far, ways[ray])

    entries = np.empty(len(boxes.lo))

    def candidates(ray: int) -> Rows:
        found = np.empty(MANY, np.int64)
        while True:
            line = rays.origins[ray], rays.directions[ray]
            count = _candidates(boxes.lo, boxes.hi, *line, entries, found)
            if count <= len(found):
                return found[:count]
            found = np.empty(count, np.int64)

    return _settle(rays, candidates, entry)


def shapes_truth(shapes: Shapes, rays: Rays) -> Truth:
    """Truth of turned boxes, spheres and cylinders: the true shapes of the quaternions as given.

    The filter is the ball around each shape.
    """
    solids = WholeShapes(shapes, _ray_bits(rays))
    starts: list[Whole] = [whole(row, solids.bits) for row in rays.origins.tolist()]
    ways: list[Whole] = [whole(row, solids.bits) for row in rays.directions.tolist()]
    reach = np.linalg.norm(shapes.size, axis=1) * 0.5 * 1.001 + 1e-9

    def entry(row: int, ray: int) -> Fraction | None:
        return solids.entry(row, starts[ray], ways[ray])

    def candidates(ray: int) -> Rows:
        offset = shapes.position - rays.origins[ray]
        way = rays.directions[ray] / np.linalg.norm(rays.directions[ray])
        along = np.maximum(offset @ way, 0.0)
        apart = np.linalg.norm(offset - along[:, None] * way, axis=1)
        return np.flatnonzero(apart <= reach)

    return _settle(rays, candidates, entry)


def _settle(
    rays: Rays, candidates: Callable[[int], Rows], entry: Callable[[int, int], Fraction | None]
) -> Truth:
    count = len(rays.origins)
    rows, ts = np.full(count, NOTHING, np.int64), []
    for ray in range(count):
        met = [(t, row) for row in candidates(ray).tolist() if (t := entry(row, ray)) is not None]
        ts.append(min(met)[0] if met else None)
        if met:
            rows[ray] = min(met)[1]
    return Truth(rows, ts, entry, np.linalg.norm(rays.directions, axis=1))


def brute_force(boxes: Boxes, rays: Rays) -> tuple[Rows, Floats]:
    """The usual slab test in float64 and numpy, ray by ray: (rows, t)."""
    rows, ts = np.full(len(rays.origins), NOTHING, np.int64), np.full(len(rays.origins), np.inf)
    with np.errstate(all='ignore'):
        for ray, (origin, direction) in enumerate(zip(*rays, strict=True)):
            inverse = 1.0 / direction
            first, last = (boxes.lo - origin) * inverse, (boxes.hi - origin) * inverse
            near, far = np.where(inverse > 0, first, last), np.where(inverse > 0, last, first)
            entry = np.fmax.reduce(near, axis=1, initial=0.0)  # 0 * inf is NaN: bounds nothing
            leave = np.fmin.reduce(far, axis=1, initial=np.inf)
            met = np.flatnonzero(entry <= leave)
            if len(met):
                rows[ray] = met[entry[met].argmin()]
                ts[ray] = entry[rows[ray]]
    return rows, ts
