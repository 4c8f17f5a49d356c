# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far two shapes are apart, and which of their points are closest."""

import math

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from .closest import fill_corners, length
from .gjk import CORE_ROWS
from .narrow_phase import fill_cores, ordered
from .simplex import FIRST, SECOND, SLACK, WAY_ROOM, dot
from .sure_gap import sure_bounds


@lean_kernel
def gap(one, hulls, other, other_hulls, planar, points):
    """Distance of two shapes, 0 if they touch; fill in the closest points, or twice a common
    one. It is the same from either side.
    """
    if ordered(one, other):
        return ordered_gap(one, hulls, other, other_hulls, planar, points)
    distance = ordered_gap(other, other_hulls, one, hulls, planar, points)
    for axis in range(3):
        points[0, axis], points[1, axis] = points[1, axis], points[0, axis]
    return distance


@lean_kernel
def ordered_gap(one, hulls, other, other_hulls, planar, points):
    first = stack_array((CORE_ROWS, 3), np.float64)
    second = stack_array((CORE_ROWS, 3), np.float64)
    way = stack_array(WAY_ROOM, np.float64)
    cores, (radius, other_radius), exponent = fill_cores(
        *(one, hulls, other, other_hulls), planar, (first, second)
    )
    limit = radius + other_radius + SLACK
    low, high, _ = sure_bounds(cores[0], cores[1], limit, True, way)
    apart = high if high - low <= SLACK else low
    touching = apart <= limit
    for axis in range(3):
        way[axis] = way[FIRST + axis] - way[SECOND + axis]
    share, other_share = surfaces(radius, other_radius, math.sqrt(dot(way, way)), touching)
    for axis in range(3):
        points[0, axis] = way[FIRST + axis] - share * way[axis]
        points[1, axis] = way[FIRST + axis] - other_share * way[axis]
        for row in range(2):
            points[row, axis] = math.ldexp(points[row, axis], exponent) + one.position[axis]
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


@lean_kernel
def box_gap(one, other, ndim, points):
    """`gap` of two axis-aligned boxes: between their faces, and in the middle where they face
    each other.
    """
    corners = stack_array((4, 3), np.float64)
    gaps = stack_array(3, np.float64)
    fill_corners(one, corners[:2])
    fill_corners(other, corners[2:])
    for axis in range(3):
        # Of what they have in common, if low <= high.
        low = max(corners[0, axis], corners[2, axis])
        high = min(corners[1, axis], corners[3, axis])
        gaps[axis] = max(low - high, 0.0) if axis < ndim else 0.0
        for row in range(2):
            if low <= high:
                points[row, axis] = low * 0.5 + high * 0.5
            elif corners[2 * row, axis] >= low:
                points[row, axis] = corners[2 * row, axis]
            else:
                points[row, axis] = corners[2 * row + 1, axis]
    return length(gaps)
