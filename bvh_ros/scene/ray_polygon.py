# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A point, a thin ray, or a disc swept along it, against the rim of a convex polygon.

Corners stand counter-clockwise, in the first two columns; some may coincide.
"""

import math

import numpy as np

from ..tree.compiling import lean_kernel
from ..tree.slab import INSIDE
from .mesh_rays import FACE
from .ray_shapes import ROUND, enter_sphere


@lean_kernel
def edge_of(corners, i):
    """From a corner to the next: (x, y); outside is to the right."""
    following = corners[(i + 1) % corners.shape[0]]
    return following[0] - corners[i][0], following[1] - corners[i][1]


@lean_kernel
def enter_polygon(corners, origin, way, reach):
    """(s, feature) as the functions of `ray_shapes`: clipped by the lines of the edges, the edge
    that is entered last.
    """
    entry, leave, feature = 0.0, reach, np.int64(INSIDE)
    for i in range(corners.shape[0]):
        x, y = edge_of(corners, i)
        height = (corners[i][0] - origin[0]) * y - (corners[i][1] - origin[1]) * x
        slope = way[0] * y - way[1] * x
        if slope == 0.0:
            if height < 0.0:
                return np.inf, np.int64(ROUND)
        elif slope > 0.0:
            leave = min(leave, height / slope)
        elif height / slope > entry:
            entry, feature = height / slope, np.int64(FACE + i)
    return (entry if entry <= leave else np.inf), feature


@lean_kernel
def holds(corners, point):
    """Whether a polygon that is not flat does."""
    for i in range(corners.shape[0]):
        x, y = edge_of(corners, i)
        if (point[0] - corners[i][0]) * y > (point[1] - corners[i][1]) * x:
            return False
    return True


@lean_kernel
def closest_on_rim(corners, point, out):
    """Fill `out` with the closest point of the rim; return the distance."""
    best = np.inf
    for i in range(corners.shape[0]):
        x, y = edge_of(corners, i)
        square = x * x + y * y
        along = 0.0
        if square > 0.0:
            along = ((point[0] - corners[i][0]) * x + (point[1] - corners[i][1]) * y) / square
        along = min(max(along, 0.0), 1.0)
        near_x, near_y = corners[i][0] + along * x, corners[i][1] + along * y
        distance = math.hypot(point[0] - near_x, point[1] - near_y)
        if distance < best:
            best, out[0], out[1] = distance, near_x, near_y
    return best


@lean_kernel
def closest_on_polygon(corners, point, out):
    """As `closest_on_rim`; `point` itself and 0 inside."""
    if holds(corners, point):
        out[0], out[1] = point[0], point[1]
        return 0.0
    return closest_on_rim(corners, point, out)


@lean_kernel
def enter_rounded_rim(corners, origin, way, radius, reach, offset):
    """Where a ray from outside enters a grown polygon. That is bounded by arcs about the corners
    and by the edges moved outwards; the ray enters where it first meets one.
    """
    best = np.inf
    for i in range(corners.shape[0]):
        offset[0], offset[1] = origin[0] - corners[i][0], origin[1] - corners[i][1]
        best = min(best, enter_sphere(offset, way, radius, reach)[0])
        x, y = edge_of(corners, i)
        edge = math.hypot(x, y)
        if edge == 0.0:
            continue
        x, y = x / edge, y / edge
        facing = way[0] * y - way[1] * x  # the outward normal is (y, -x)
        height = offset[0] * y - offset[1] * x - radius
        if facing < 0.0 <= height:
            s = height / -facing
            place = (offset[0] + s * way[0]) * x + (offset[1] + s * way[1]) * y
            if 0.0 <= place <= edge and s <= reach:
                best = min(best, s)
    return best
