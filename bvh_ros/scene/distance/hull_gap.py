# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far a point is from a convex mesh, as GJK says."""

import math

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from ..geometry.hull import hull_of, hull_of_point
from .gjk import AXES, CENTRE, CORE_ROWS, HALF, Core
from .simplex import FIRST, SECOND, SLACK, WAY_ROOM
from .sure_gap import set_normal, sure_bounds


@lean_kernel
def hull_gap(hull, point, apart, normal):
    """Distance of a point from a mesh, 0 inside; `apart` leads from its closest point there, and
    the unit vector `normal` across the plane that proves it: next to the mesh the way between two
    points is noise, that vector is not.
    """
    ball = stack_array((CORE_ROWS, 3), np.float64)
    mesh = stack_array((CORE_ROWS, 3), np.float64)
    way = stack_array(WAY_ROOM, np.float64)
    largest = max(hull.radius, abs(point[0]), abs(point[1]), abs(point[2]))
    exponent = math.frexp(largest)[1]
    for row in range(CORE_ROWS):
        for axis in range(3):
            ball[row, axis] = mesh[row, axis] = 1.0 if row == AXES + axis else 0.0
    for axis in range(3):
        ball[CENTRE, axis] = math.ldexp(point[axis], -exponent)
    mesh[HALF, 0] = math.ldexp(1.0, -exponent)
    point_core, mesh_core = Core(ball, False, hull_of_point(hull)), Core(mesh, False, hull)
    high = sure_bounds(point_core, mesh_core, SLACK, True, way)[1]
    for axis in range(3):
        apart[axis] = math.ldexp(way[FIRST + axis] - way[SECOND + axis], exponent)
    set_normal(way, normal)
    if high <= SLACK:
        return 0.0
    return math.ldexp(high, exponent)


@lean_kernel
def closest_on_hull(hull, point, out):
    """Fill `out` with the closest point of a mesh, `point` itself inside; return the distance."""
    apart, normal = stack_array(3, np.float64), stack_array(3, np.float64)
    distance = hull_gap(hull, point, apart, normal)
    for axis in range(3):
        out[axis] = point[axis] - apart[axis] if distance > 0.0 else point[axis]
    return distance


@lean_kernel
def closest_on_mesh(hulls, shape, scale, point, out):
    """`closest_on_hull` of a shape's mesh times scale."""
    place = stack_array(3, np.float64)
    for axis in range(3):
        place[axis] = point[axis] / scale
    closest_on_hull(hull_of(hulls, shape), place, out)
    for axis in range(3):
        out[axis] *= scale
