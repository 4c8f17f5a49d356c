# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`expanding_polytope` in the plane, for what is seen from above: edges instead of faces."""

import math

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from .expanding_polytope import reach_in
from .simplex import SLACK

MOST_EDGES = 256


@lean_kernel
def polygon_depth(one, other, normal):
    """`expanding_polytope.polytope_depth` of cores with z = 0, parted within the plane."""
    edges = stack_array((MOST_EDGES, 2, 2), np.float64)  # from, to
    lines = stack_array((MOST_EDGES, 3), np.float64)  # as planes
    corner = stack_array(3, np.float64)
    normal[2] = 0.0
    for axis in range(2):
        for side in range(2):
            normal[axis], normal[1 - axis] = 1.0 - 2.0 * side, 0.0
            high = reach_in(one, other, normal, corner)
            for row in range(2):
                edges[side, 0, row] = edges[1 - side, 1, row] = corner[row]
        if edges[0, 0, axis] != edges[1, 0, axis]:
            break
    low, count = high, 2
    if edges[0, 0, 0] == edges[1, 0, 0] and edges[0, 0, 1] == edges[1, 0, 1]:
        return low, high
    set_line(edges[0], lines[0])
    set_line(edges[1], lines[1])
    way, high = stack_array(3, np.float64), np.inf
    while count < MOST_EDGES:
        closest = 0
        for edge in range(count):
            if lines[edge, 2] < lines[closest, 2]:
                closest = edge
        low = lines[closest, 2]
        way[0], way[1], way[2] = lines[closest, 0], lines[closest, 1], 0.0
        reach = reach_in(one, other, way, corner)
        if reach < high:
            high, normal[0], normal[1] = reach, way[0], way[1]
        if high - low <= SLACK:
            break
        for row in range(2):
            edges[count, 0, row], edges[count, 1, row] = corner[row], edges[closest, 1, row]
            edges[closest, 1, row] = corner[row]
        set_line(edges[closest], lines[closest])
        set_line(edges[count], lines[count])
        count += 1
    return min(low, high), high


@lean_kernel
def set_line(edge, line):
    """Fill in the outward unit normal of an edge, counter-clockwise, and its distance from the
    origin, inf if it has no length.
    """
    x, y = edge[1, 1] - edge[0, 1], edge[0, 0] - edge[1, 0]
    size = math.hypot(x, y)
    line[0], line[1], line[2] = 0.0, 0.0, np.inf
    if size > 0.0:
        line[0], line[1] = x / size, y / size
        line[2] = line[0] * edge[0, 0] + line[1] * edge[0, 1]
