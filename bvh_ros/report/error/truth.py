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
from numpy.typing import NDArray

from ...scene.geometry.shapes import Shapes
from ..scenes import Boxes, Floats, Rays
from .exact import Whole, WholeShapes, bits_below_the_point, enter_slabs, whole

Rows = NDArray[np.int64]
NOTHING = -1


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

    def candidates(ray: int) -> Rows:
        """Boxes that may be the first: difference and quotient round once each, so an entry or
        exit is right within 2**-50 of its value, and 1e-300.
        """
        with np.errstate(all='ignore'):
            planes = (np.stack(boxes) - rays.origins[ray]) / rays.directions[ray]
            planes[:, np.isnan(planes).any(axis=0)] = [[-np.inf], [np.inf]]  # along a plane
            more = np.copysign(2.0**-50, planes)
            lower, upper = planes * (1.0 - more) - 1e-300, planes * (1.0 + more) + 1e-300
        entry, surely_in = (
            np.maximum(side.min(axis=0).max(axis=1), 0.0) for side in (lower, upper)
        )
        surely_out, leave = (side.max(axis=0).min(axis=1) for side in (lower, upper))
        nearest = surely_in[surely_in <= surely_out].min(initial=np.inf)
        return np.flatnonzero((entry <= leave) & (entry <= nearest) & (entry < np.inf))

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
