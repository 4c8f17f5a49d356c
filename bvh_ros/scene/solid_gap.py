# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distance between an oriented box and a cylinder, in closed form up to a bisection.

python-fcl finds this distance by an iteration that stops 1e-4 short at times; between boxes it is
exact to the last digits.

If the two are apart, the closest point of the box lies on one of its edges, or inside a face whose
normal leads to the cylinder's extreme point. If they touch, then an edge of the box touches the
cylinder, or the cylinder's centre lies in the box, or the cylinder crosses a face inside its rim:
then any point of it in that face's plane will do.
"""

import math

import numpy as np

from ..tree.compiling import lean_kernel
from .ray_shapes import cylinder_distance

BISECTIONS = 60


@lean_kernel
def box_cylinder_gap(half, turn, centre, radius, half_height):
    """Distance of a box from a cylinder, in the cylinder's frame; 0 if they touch.

    The columns of `turn` are the box's axes.
    """
    if box_holds(half, turn, centre, 0.0, 0.0, 0.0):
        return 0.0
    best = np.inf
    for axis in range(3):
        for side in (-1.0, 1.0):
            best = min(best, face_gap(half, turn, centre, axis, side, radius, half_height))
    if best == 0.0:
        return 0.0
    for axis in range(3):
        for b in (-1.0, 1.0):
            for c in (-1.0, 1.0):
                best = min(best, edge_gap(half, turn, centre, axis, b, c, radius, half_height))
    return best


@lean_kernel
def box_holds(half, turn, centre, x, y, z):
    for axis in range(3):
        along = (
            turn[0, axis] * (x - centre[0])
            + turn[1, axis] * (y - centre[1])
            + turn[2, axis] * (z - centre[2])
        )
        if abs(along) > half[axis]:
            return False
    return True


@lean_kernel
def face_gap(half, turn, centre, axis, side, radius, half_height):
    """Distance from a face to the cylinder's extreme points over it.

    0 if the cylinder crosses the face's inside; else inf.
    """
    nx, ny, nz = side * turn[0, axis], side * turn[1, axis], side * turn[2, axis]
    level = nx * centre[0] + ny * centre[1] + nz * centre[2] + half[axis]
    across = math.hypot(nx, ny)
    # Farthest against the normal: a point of a rim, or of a cap's middle where the cap lies flat.
    x, y = (-radius * nx / across, -radius * ny / across) if across > 0.0 else (0.0, 0.0)
    reach, best = across * radius + abs(nz) * half_height, np.inf
    if abs(level) <= reach:  # the line between the two extreme points meets the plane
        z = math.copysign(half_height, -nz)
        share = -level / reach
        if over_face(half, turn, centre, axis, share * x, share * y, share * z):
            return 0.0
    for z in (-half_height, half_height):
        depth = nx * x + ny * y + nz * z - level
        if depth >= 0.0 and over_face(half, turn, centre, axis, x, y, z):
            best = min(best, depth)
    return best


@lean_kernel
def edge_gap(half, turn, centre, axis, second, third, radius, half_height):
    """Distance of the edge along `axis` at the signs `second`, `third` of the other two axes.

    Along a line the squared distance from a convex body is convex: bisect its slope.
    """
    j, k = (axis + 1) % 3, (axis + 2) % 3
    low, high, best = -half[axis], half[axis], np.inf
    for _ in range(BISECTIONS):
        s = 0.5 * (low + high)
        x = (
            centre[0]
            + s * turn[0, axis]
            + second * half[j] * turn[0, j]
            + third * half[k] * turn[0, k]
        )
        y = (
            centre[1]
            + s * turn[1, axis]
            + second * half[j] * turn[1, j]
            + third * half[k] * turn[1, k]
        )
        z = (
            centre[2]
            + s * turn[2, axis]
            + second * half[j] * turn[2, j]
            + third * half[k] * turn[2, k]
        )
        best = min(best, cylinder_distance(x, y, z, radius, half_height))
        across, slope = math.hypot(x, y), 0.0
        if across > radius:
            slope += (1.0 - radius / across) * (x * turn[0, axis] + y * turn[1, axis])
        if abs(z) > half_height:
            slope += (z - math.copysign(half_height, z)) * turn[2, axis]
        if slope > 0.0:
            high = s
        else:
            low = s
    return best


@lean_kernel
def over_face(half, turn, centre, axis, x, y, z):
    """Whether a point lies over (or under) the face of this axis."""
    for other in range(3):
        if other != axis:
            along = (
                turn[0, other] * (x - centre[0])
                + turn[1, other] * (y - centre[1])
                + turn[2, other] * (z - centre[2])
            )
            if abs(along) > half[other]:
                return False
    return True
