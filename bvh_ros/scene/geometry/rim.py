# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Footprints as kernels see them: the rim of a polygon, and what of a footprint is closest."""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.compiler import inlined, lean_kernel, stack_array
from .oval import measure_oval, to_oval

# What of a shape's surface a ray enters: below are the axes of flat faces, see `slab.INSIDE`.
ROUND = 3
FACE = 4  # the first triangle of a mesh, or edge of a polygon


class Rim(NamedTuple):
    """That of a polygon."""

    corners: Any
    """(k, 2), counter-clockwise; some may coincide."""
    scale: Any
    """What they are to be multiplied by."""


@inlined
def corner_of(rim, i):
    return rim.corners[i, 0] * rim.scale, rim.corners[i, 1] * rim.scale


@lean_kernel
def edge_of(rim, i):
    """From a corner to the next: (x, y); outside is to the right."""
    here_x, here_y = corner_of(rim, i)
    x, y = corner_of(rim, (i + 1) % rim.corners.shape[0])
    return x - here_x, y - here_y


@lean_kernel
def cross_polygon(rim, origin, direction, slack):
    """(entry, leave, feature) of a line into a polygon, with the edge that is entered; (inf, -inf)
    if it misses it by more than `slack`.

    It crosses an edge whose corners are on different sides of it. A corner is the same in both its
    edges, so no line slips between them; and where it crosses is a point of the edge, however
    small the angle.
    """
    count = rim.corners.shape[0]
    x, y = corner_of(rim, count - 1)
    along = (x - origin[0]) * direction[0] + (y - origin[1]) * direction[1]
    aside = (y - origin[1]) * direction[0] - (x - origin[0]) * direction[1]
    entry, leave, feature = np.inf, -np.inf, np.int64(FACE)
    closest, passed, corner = np.inf, 0.0, 0
    for i in range(count):
        before, before_aside = along, aside
        x, y = corner_of(rim, i)
        along = (x - origin[0]) * direction[0] + (y - origin[1]) * direction[1]
        aside = (y - origin[1]) * direction[0] - (x - origin[0]) * direction[1]
        if abs(aside) < closest:
            closest, passed, corner = abs(aside), along, i
        if before_aside >= 0.0 >= aside and before_aside > aside:
            s = before + (along - before) * (before_aside / (before_aside - aside))
            if s < entry:
                entry, feature = s, np.int64(FACE + (i + count - 1) % count)
        elif before_aside <= 0.0 <= aside and before_aside < aside:
            s = before + (along - before) * (before_aside / (before_aside - aside))
            leave = max(leave, s)
    if entry <= leave:
        return entry, leave, feature
    if closest <= slack:
        return passed, passed, np.int64(FACE + corner)
    return np.inf, -np.inf, feature


@lean_kernel
def closest_on_rim(rim, point, out):
    """Fill `out` with the closest point of the rim; return the distance."""
    best = np.inf
    for i in range(rim.corners.shape[0]):
        corner_x, corner_y = corner_of(rim, i)
        x, y = edge_of(rim, i)
        edge, share = math.hypot(x, y), 0.0
        if edge > 0.0:
            along = (point[0] - corner_x) * (x / edge) + (point[1] - corner_y) * (y / edge)
            share = min(max(along / edge, 0.0), 1.0)
        near_x, near_y = corner_x + share * x, corner_y + share * y
        distance = math.hypot(point[0] - near_x, point[1] - near_y)
        if distance < best:
            best, out[0], out[1] = distance, near_x, near_y
    return best


@lean_kernel
def closest_on_polygon(rim, point, out):
    """As `closest_on_rim`; `point` itself and 0 inside."""
    out[0], out[1] = 1.0, 0.0
    entry, leave, _ = cross_polygon(rim, point, out, 0.0)
    if entry <= 0.0 <= leave:
        out[0], out[1] = point[0], point[1]
        return 0.0
    return closest_on_rim(rim, point, out)


@lean_kernel
def rim_of(footprint, hulls, scale):
    """The rim of a footprint that is no oval: what is seen of a mesh is kept with those."""
    if hulls is not None and footprint.polygon > 0:
        span = hulls.spans[footprint.polygon - 1].vertices
        return Rim(hulls.vertices[span[0] : span[1], :2], scale)
    return Rim(footprint.corners[:, :2], scale)


@lean_kernel
def oval_of(footprint, scale):
    """See `oval`."""
    a, b = footprint.half_axes[0] * scale, footprint.half_axes[1] * scale
    return footprint.straight * scale, a, b


@lean_kernel
def closest_on_footprint(footprint, hulls, scale, point, out):
    """Fill `out` with a footprint's closest point, `point` itself inside; return the distance."""
    if footprint.oval:
        return look_out_of_oval(footprint, scale, point, out, out)
    distance = closest_on_polygon(rim_of(footprint, hulls, scale), point, out)
    radius = footprint.radius * scale
    if distance <= radius:
        out[0], out[1] = point[0], point[1]
        return 0.0
    for axis in range(2):
        out[axis] += (point[axis] - out[axis]) * (radius / distance)
    return distance - radius


@lean_kernel
def look_out_of_oval(footprint, scale, point, normal, closest):
    """Fill in the direction outwards at the oval's rim next to a point, then the closest point,
    itself inside; return the distance.
    """
    along, across = footprint.along, stack_array((2, 2), np.float64)
    across[0, 0], across[0, 1] = to_oval(along, point)
    _, distance = measure_oval(oval_of(footprint, scale), across[0], across[1])
    u, v = across[1, 0], across[1, 1]
    x, y = u * along[0] - v * along[1], u * along[1] + v * along[0]
    normal[0], normal[1] = x, y
    closest[0], closest[1] = point[0] - distance * x, point[1] - distance * y
    return distance
