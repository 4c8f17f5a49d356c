# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The box that an overlap query asks about."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..tree import checks
from .shapes import Floats, Shapes, bounds, maps_axes_to_axes, rotations, unit_quaternions

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


class BoxQuery(NamedTuple):
    """A box to be grown by `tolerance` with rounded corners; `lo`, `hi` bound the box itself."""

    centre: Floats
    orientation: Floats
    half: Floats
    tolerance: float
    aligned: bool
    """Its axes are the world's: `lo` and `hi` are its corners exactly."""
    lo: Floats
    hi: Floats
    height: float
    """z of the start; where the points of a planar scene are put."""

    @property
    def is_point(self) -> bool:
        """Whether the corners coincide: a point, or with the tolerance a ball."""
        return not self.half.any()

    def reach(self) -> tuple[Floats, Floats]:
        """Bounds of the grown box, rounded outwards, within the range of doubles."""
        largest = np.finfo(np.float64).max
        if self.tolerance == 0.0:
            return self.lo, self.hi
        with np.errstate(over='ignore'):
            lo = np.nextafter(self.lo - self.tolerance, -np.inf)
            hi = np.nextafter(self.hi + self.tolerance, np.inf)
        return np.maximum(lo, -largest), np.minimum(hi, largest)


def box_query(
    start: ArrayLike, goal: ArrayLike, orientation: ArrayLike, tolerance: float, planar: bool
) -> BoxQuery:
    """Check the arguments of `Scene.overlap`."""
    first, second = checks.point('start', start, 3), checks.point('goal', goal, 3)
    turn = unit_quaternions(checks.point('orientation', orientation, 4)[None])[0]
    reach = checks.limit('tolerance', tolerance)
    height = float(first[2])
    if planar:
        if turn[0] != 0.0 or turn[1] != 0.0:
            raise ValueError('in a planar scene the orientation of a box must be about z only')
        first[2] = second[2] = 0.0
    with np.errstate(over='ignore'):
        diagonal = second - first
    if not np.isfinite(diagonal).all() or np.isinf(reach):
        raise ValueError('the query box is larger than the largest double')
    centre = first * 0.5 + second * 0.5
    if maps_axes_to_axes(turn[None])[0] or not diagonal.any():
        lo, hi = np.minimum(first, second), np.maximum(first, second)
        return BoxQuery(centre, IDENTITY, np.abs(diagonal) * 0.5, reach, True, lo, hi, height)
    half = np.abs(rotations(turn[None])[0].T @ diagonal) * 0.5
    lo, hi = bounds(Shapes.boxes(centre, half * 2.0, turn[None]), np.zeros(1, np.bool_))
    return BoxQuery(centre, turn, half, reach, False, lo[0], hi[0], height)
