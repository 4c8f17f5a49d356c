# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A point, a thin ray, or a disc swept along it, against the rim of a convex polygon."""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.jit.compiling import inlined, lean_kernel
from ..geometry.oval import slab
from .mesh_rays import FACE
from .ray_shapes import enter_sphere


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
def cross_polygon(rim, origin, way, slack):
    """(entry, leave, feature) of a line into a polygon, with the edge that is entered; (inf, -inf)
    if it misses it by more than `slack`.

    It crosses an edge whose corners are on different sides of it. A corner is the same in both its
    edges, so no line slips between them; and where it crosses is a point of the edge, however
    small the angle.
    """
    count = rim.corners.shape[0]
    x, y = corner_of(rim, count - 1)
    along = (x - origin[0]) * way[0] + (y - origin[1]) * way[1]
    aside = (y - origin[1]) * way[0] - (x - origin[0]) * way[1]
    entry, leave, feature = np.inf, -np.inf, np.int64(FACE)
    closest, passed, corner = np.inf, 0.0, 0
    for i in range(count):
        before, before_aside = along, aside
        x, y = corner_of(rim, i)
        along = (x - origin[0]) * way[0] + (y - origin[1]) * way[1]
        aside = (y - origin[1]) * way[0] - (x - origin[0]) * way[1]
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
def enter_rounded_rim(rim, origin, way, radius, reach, offset):
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
        best = min(best, enter_sphere(offset, way, radius, reach)[0])
        if edge == 0.0:
            continue
        x, y = x / edge, y / edge
        facing = way[0] * y - way[1] * x  # the outward normal is (y, -x)
        if facing < 0.0:
            along, rate = offset[0] * x + offset[1] * y, way[0] * x + way[1] * y
            entry, leave = slab(along - 0.5 * edge, rate, 0.5 * edge)
            first, last = slab(offset[0] * y - offset[1] * x, facing, radius)
            entry = max(entry, first, 0.0)
            if entry <= min(leave, last, reach):
                best = min(best, entry)
    return best
