# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distances below 0: what of an answer changes where a point or shape reaches into an obstacle."""

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from .closest import fill_corners
from .penetration import depth_of_point, penetration


@lean_kernel
def out_of_aligned(lo, hi, low, high, normal):
    """The least distance by which a box, or point, from low to high has to move along an axis to
    leave the box from lo to hi, negative if it is outside; fill in which way. Ties go to the
    lowest axis, and there upwards.
    """
    least, out, sign = np.inf, 0, 1.0
    for axis in range(lo.shape[0]):
        up, down = hi[axis] - low[axis], high[axis] - lo[axis]
        if min(up, down) < least:
            least, out, sign = min(up, down), axis, 1.0 if up <= down else -1.0
    for axis in range(3):
        normal[axis] = sign if axis == out else 0.0
    return least


@lean_kernel
def sink_in_box(lo, hi, centre, found, row):
    """Where an axis-aligned box holds the centre, fill in how deep."""
    if found.distances[row] > 0.0:
        return
    normal = found.normals[row]
    found.distances[row] = 0.0 - out_of_aligned(lo, hi, centre, centre, normal)
    for axis in range(lo.shape[0]):
        if normal[axis] != 0.0:
            found.points[row, axis] = hi[axis] if normal[axis] > 0.0 else lo[axis]


@lean_kernel
def sink_in_obstacle(shape, bodies, centre, found, row):
    """Where an obstacle holds the centre, fill in how deep."""
    if found.distances[row] > 0.0:
        return
    ndim = 3 if bodies.footprints is None else 2
    points = stack_array((2, 3), np.float64)
    if not shape.shaped:
        fill_corners(shape, points)
        sink_in_box(points[0, :ndim], points[1, :ndim], centre, found, row)
        return
    normal = found.normals[row]
    depth = depth_of_point(centre, shape, bodies.hulls, ndim == 2, points, normal)
    found.distances[row] = 0.0 - depth
    for axis in range(ndim):
        found.points[row, axis] = points[1, axis]


@lean_kernel
def sink_shape(one, other, bodies, distance, points):
    """Minus the depth of a shape in an obstacle where their distance is 0; then fill in the points
    of their surfaces that are so far apart.
    """
    if distance > 0.0:
        return distance
    planar, normal = bodies.footprints is not None, stack_array(3, np.float64)
    if one.shaped or other.shaped:
        return 0.0 - penetration(
            one, bodies.query_hulls, other, bodies.hulls, planar, points, normal
        )
    return 0.0 - box_depth(one, other, 2 if planar else 3, points, normal)


@lean_kernel
def box_depth(one, other, ndim, points, normal):
    """`penetration` of two axis-aligned boxes; across the way out, `points` are as
    `gap.box_gap` left them.
    """
    corners = stack_array((4, 3), np.float64)
    fill_corners(one, corners[:2])
    fill_corners(other, corners[2:])
    depth = out_of_aligned(
        *(corners[2, :ndim], corners[3, :ndim]), *(corners[0, :ndim], corners[1, :ndim]), normal
    )
    for axis in range(ndim):
        if normal[axis] != 0.0:
            side = 1 if normal[axis] > 0.0 else 0
            points[0, axis], points[1, axis] = corners[1 - side, axis], corners[2 + side, axis]
    return depth
