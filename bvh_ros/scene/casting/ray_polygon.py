# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A disc swept along a ray against the rim of a convex polygon."""

import math

import numpy as np

from ...tree.jit.compiling import lean_kernel
from ..geometry.oval import slab
from ..geometry.rim import corner_of, edge_of
from .ray_shapes import enter_sphere


@lean_kernel
def enter_rounded_rim(rim, origin, direction, radius, reach, offset):
    """Where a ray from outside enters a grown polygon. That is covered by discs about the corners,
    rectangles on the edges, as thick as the discs, and the polygon itself; the ray enters where it
    first meets one.
    """
    best = np.inf
    for i in range(rim.corners.shape[0]):
        x, y = corner_of(rim, i)
        offset[0], offset[1] = origin[0] - x, origin[1] - y
        x, y = edge_of(rim, i)
        edge = math.hypot(x, y)
        if edge == 0.0 and i > 0:
            continue
        best = min(best, enter_sphere(offset, direction, radius, reach)[0])
        if edge == 0.0:
            continue
        x, y = x / edge, y / edge
        facing = direction[0] * y - direction[1] * x  # the outward normal is (y, -x)
        if facing < 0.0:
            along, rate = offset[0] * x + offset[1] * y, direction[0] * x + direction[1] * y
            entry, leave = slab(along - 0.5 * edge, rate, 0.5 * edge)
            first, last = slab(offset[0] * y - offset[1] * x, facing, radius)
            entry = max(entry, first, 0.0)
            if entry <= min(leave, last, reach):
                best = min(best, entry)
    return best
