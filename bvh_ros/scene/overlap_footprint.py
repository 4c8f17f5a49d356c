# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distances of footprints from a query's footprint, for planar scenes.

A query is a rectangle or a point.
"""

import numpy as np

from ..tree.compiling import kernel
from .ray_footprint import closest_on_footprint, closest_on_oval, closest_on_zonogon

BISECTIONS = 60


@kernel
def closest_points(prints, centre, points):
    """Fill `points` with each footprint's point closest to `centre`; inside the centre itself."""
    local, closest = np.empty(2), np.empty(2)
    for i in range(prints.shape[0]):
        for axis in range(2):
            local[axis] = centre[axis] - prints[i].centre[axis]
        inside = closest_on_footprint(prints[i], local, closest) == 0.0
        for axis in range(2):
            points[i, axis] = centre[axis] if inside else closest[axis] + prints[i].centre[axis]


@kernel
def gaps(prints, query):
    """Distance of each footprint from the query's zonogon; 0 where they touch."""
    result = np.empty(prints.shape[0])
    offset, point, closest = np.empty(2), np.empty(2), np.empty(2)
    for i in range(prints.shape[0]):
        for axis in range(2):
            offset[axis] = query.centre[axis] - prints[i].centre[axis]
        if prints[i].oval:
            result[i] = oval_gap(prints[i], query, offset, point, closest)
        else:
            distance = zonogon_gap(prints[i], query, offset, point, closest)
            result[i] = max(distance - prints[i].radius, 0.0)
    return result


@kernel
def separated(one, other, offset):
    """Whether one of `one`'s strips, which lie along its edges, keeps the two apart."""
    for k in range(3):
        normal = one.normals[k]
        support = 0.0
        for i in range(6):
            corner = other.corners[i]
            support = max(support, normal[0] * corner[0] + normal[1] * corner[1])
        if abs(normal[0] * offset[0] + normal[1] * offset[1]) > one.widths[k] + support:
            return True
    return False


@kernel
def zonogon_gap(one, other, offset, point, closest):
    """Least distance from a corner of one to the other; 0 if no edge of either separates them."""
    if not separated(one, other, offset) and not separated(other, one, offset):
        return 0.0
    best = np.inf
    for i in range(6):
        for axis in range(2):
            point[axis] = other.corners[i, axis] + offset[axis]
        best = min(best, closest_on_zonogon(one, point, closest))
        for axis in range(2):
            point[axis] = one.corners[i, axis] - offset[axis]
        best = min(best, closest_on_zonogon(other, point, closest))
    return best


@kernel
def oval_gap(oval, other, offset, point, closest):
    """The squared distance from the oval is convex along each edge: bisect its slope."""
    for axis in range(2):
        point[axis] = -offset[axis]
    if closest_on_zonogon(other, point, closest) == 0.0:
        return 0.0
    best = np.inf
    for i in range(6):
        corner, following = other.corners[i], other.corners[(i + 1) % 6]
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            slope = 0.0
            for axis in range(2):
                point[axis] = (1 - middle) * corner[axis] + middle * following[axis] + offset[axis]
            best = min(best, closest_on_oval(oval, point, closest))
            if best == 0.0:
                return 0.0
            for axis in range(2):
                slope += (point[axis] - closest[axis]) * (following[axis] - corner[axis])
            if slope > 0.0:
                high = middle
            else:
                low = middle
    return best
