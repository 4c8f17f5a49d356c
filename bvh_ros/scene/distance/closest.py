# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The point of an obstacle that is closest to a query's centre, and how far it is.

Far from the world's origin points are rounded more than distances. A planar scene is seen from
above: z is that of the caller.
"""

import math

import numpy as np

from ...tree.compiler import inlined, lean_kernel, stack_array
from ..geometry.hull import hull_of
from ..geometry.lengths import scale_of
from ..geometry.rim import closest_on_footprint
from ..geometry.rotation import fill_rotation
from ..geometry.shapes import BOX, CYLINDER, MESH
from .hull_gap import closest_on_hull


@lean_kernel
def length(vector):
    """Euclidean length; where squares would overflow or vanish scaled by a power of two, which
    changes no digit elsewhere.
    """
    largest, square = 0.0, 0.0
    for axis in range(vector.shape[0]):
        largest = max(largest, abs(vector[axis]))
        square += vector[axis] * vector[axis]
    if 1e-140 < largest < 1e140:
        return math.sqrt(square)
    exponent, square = math.frexp(largest)[1], 0.0
    for axis in range(vector.shape[0]):
        scaled = math.ldexp(vector[axis], -exponent)
        square += scaled * scaled
    return math.ldexp(math.sqrt(square), exponent)


@lean_kernel
def look_back(point, centre, ndim, normal):
    """Distance of a point from the centre along the first axes; fill in the unit vector to the
    centre, zero at it.
    """
    for axis in range(3):
        normal[axis] = centre[axis] - point[axis] if axis < ndim else 0.0
    distance = length(normal)
    if distance > 0.0:
        for axis in range(ndim):
            normal[axis] /= distance
    return distance


@lean_kernel
def closest_in_box(lo, hi, centre, point):
    """Fill in the coordinates along the box's axes."""
    for axis in range(lo.shape[0]):
        point[axis] = min(max(centre[axis], lo[axis]), hi[axis])


@lean_kernel
def closest_in_frame(shape, hulls, local, closest):
    """Fill in the point closest to `local` in the frame of a shape, where it lies at the origin;
    `local` itself inside.
    """
    half, away = shape.half, stack_array(3, np.float64)
    for axis in range(3):
        closest[axis] = min(max(local[axis], -half[axis]), half[axis])
    if shape.kind == BOX:
        return
    if shape.kind == MESH:
        if hulls is not None:
            closest_on_hull(hull_of(hulls, shape), local, closest)
        return
    if shape.kind == CYLINDER:
        shrink = half[0] / max(length(local[:2]), half[0])
        closest[0], closest[1] = local[0] * shrink, local[1] * shrink
        return
    straight = half[2] - half[0]  # of a capsule; of a sphere nothing
    level = min(max(local[2], -straight), straight)
    away[0], away[1], away[2] = local[0], local[1], local[2] - level
    far = length(away)
    shrink = half[0] / max(far, half[0])
    for axis in range(3):
        on_surface = away[axis] * shrink + (level if axis == 2 else 0.0)
        closest[axis] = on_surface if far > half[0] else local[axis]


@lean_kernel
def closest_in_shape(shape, hulls, centre, point):
    """Fill in the point of a turned or round shape closest to the centre; the centre itself
    inside. Return the distance.
    """
    matrix = stack_array((3, 3), np.float64)
    local, closest = stack_array(3, np.float64), stack_array(3, np.float64)
    fill_rotation(shape.orientation, matrix)
    for axis in range(3):
        local[axis] = (
            matrix[0, axis] * (centre[0] - shape.position[0])
            + matrix[1, axis] * (centre[1] - shape.position[1])
            + matrix[2, axis] * (centre[2] - shape.position[2])
        )
    closest_in_frame(shape, hulls, local, closest)
    inside = closest[0] == local[0] and closest[1] == local[1] and closest[2] == local[2]
    for axis in range(3):
        place = (matrix[axis, 0] * closest[0] + matrix[axis, 1] * closest[1]) + matrix[
            axis, 2
        ] * closest[2]
        point[axis] = centre[axis] if inside else place + shape.position[axis]
        local[axis] -= closest[axis]  # from here on the way
    return length(local)


@lean_kernel
def closest_in_footprint(footprint, hulls, centre, point):
    """Fill in x and y of the point of a footprint closest to the centre; the centre's inside."""
    local, closest = stack_array(2, np.float64), stack_array(2, np.float64)
    largest = footprint.radius + footprint.straight + footprint.half_axes[1]
    for axis in range(2):
        largest = max(largest, abs(centre[axis]), abs(footprint.centre[axis]))
    scale = scale_of(largest)
    for axis in range(2):
        local[axis] = centre[axis] * scale - footprint.centre[axis] * scale
    inside = closest_on_footprint(footprint, hulls, scale, local, closest) == 0.0
    for axis in range(2):
        place = closest[axis] / scale + footprint.centre[axis]
        point[axis] = centre[axis] if inside else place


@inlined
def fill_corners(shape, corners):
    """Fill in the corners (2, 3) of an axis-aligned box: the same doubles that the tree holds."""
    for axis in range(3):
        corners[0, axis] = shape.position[axis] - shape.half[axis]
        corners[1, axis] = shape.position[axis] + shape.half[axis]


@lean_kernel
def closest_in_obstacle(shape, hulls, centre, point, normal):
    """Fill in the obstacle's point closest to the centre, and the unit vector from there to the
    centre; return the distance.
    """
    if shape.shaped:
        distance = closest_in_shape(shape, hulls, centre, point)
        look_back(point, centre, 3, normal)
        return distance
    corners = stack_array((2, 3), np.float64)
    fill_corners(shape, corners)
    closest_in_box(corners[0], corners[1], centre, point)
    return look_back(point, centre, 3, normal)


@lean_kernel
def closest_from_above(shape, footprint, hulls, centre, point, normal):
    """`closest_in_obstacle` seen from above; z of the point stays."""
    if shape.shaped:
        closest_in_footprint(footprint, hulls, centre, point)
    else:
        corners = stack_array((2, 3), np.float64)
        fill_corners(shape, corners)
        closest_in_box(corners[0, :2], corners[1, :2], centre, point)
    return look_back(point, centre, 2, normal)
