# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays, balls and points against one convex mesh in its own frame.

A thin ray is followed through the tree of its triangles, see `mesh_rays`. How far a ball is away,
GJK says.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.jit.compiling import lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.rays.slab import INSIDE
from ..casting.approach import approach_by
from ..casting.mesh_rays import Surface, enter_surface
from ..casting.ray_shapes import ROUND
from ..distance.gjk import AXES, CENTRE, CORE_ROWS, FIRST, HALF, SECOND, SLACK, WAY_ROOM, dot
from ..distance.sure_gap import set_ray, sure_bounds
from .farthest import farthest_vertex

MESH = 4  # ShapeKind, as a kernel can read it


class Hull(NamedTuple):
    """Vertices of a mesh, for GJK."""

    places: Any
    discs: Any
    """See `farthest`."""
    radius: Any
    """A length beyond which no vertex is, m."""


@lean_kernel
def hull_of(hulls, shape):
    """Vertices of a shape's mesh; none if it has none."""
    if shape.kind != MESH:
        return Hull(hulls.vertices[:0], hulls.discs[:0], 1.0)
    span = hulls.spans[shape.mesh]
    return Hull(
        hulls.vertices[span.vertices[0] : span.vertices[1]],
        hulls.discs[span.discs[0] : span.discs[1]],
        span.radius,
    )


@lean_kernel
def hull_gap(hull, point, apart, normal):
    """Distance of a point from a mesh, 0 inside; `apart` leads from its closest point there, and
    the unit vector `normal` across the plane that proves it: next to the mesh the way between two
    points is noise, that vector is not.
    """
    ball = stack_array(15, np.float64).reshape(CORE_ROWS, 3)
    mesh = stack_array(15, np.float64).reshape(CORE_ROWS, 3)
    way = stack_array(WAY_ROOM, np.float64)
    largest = max(hull.radius, abs(point[0]), abs(point[1]), abs(point[2]))
    exponent = math.frexp(largest)[1]
    for row in range(CORE_ROWS):
        for axis in range(3):
            ball[row, axis] = mesh[row, axis] = 1.0 if row == AXES + axis else 0.0
    for axis in range(3):
        ball[CENTRE, axis] = math.ldexp(point[axis], -exponent)
    mesh[HALF, 0] = math.ldexp(1.0, -exponent)
    nothing = Hull(hull.places[:0], hull.discs[:0], 1.0)
    high = sure_bounds(ball, False, nothing, mesh, False, hull, SLACK, True, way)[1]
    for axis in range(3):
        apart[axis] = math.ldexp(way[FIRST + axis] - way[SECOND + axis], exponent)
    set_ray(way, normal)
    if high <= SLACK:
        return 0.0
    return math.ldexp(high, exponent)


@lean_kernel
def measure_hull(solid, point, normal):
    """`approach`'s measure of a mesh times a scale: how far the plane through its vertex farthest
    towards the point keeps it off, and its closest point.
    """
    hull, scale = solid
    place, apart = stack_array(3, np.float64), stack_array(3, np.float64)
    for axis in range(3):
        place[axis] = point[axis] / scale
    distance = hull_gap(hull, place, apart, normal)
    if distance == 0.0:
        return 0.0, 0.0
    vertex = hull.places[farthest_vertex(hull, normal[0], normal[1], normal[2])]
    return (dot(normal, place) - dot(normal, vertex)) * scale, distance * scale


approach_hull = approach_by(measure_hull)


@lean_kernel
def enter_mesh(hulls, shape, frame, radius, reach, work):
    """(s, feature) at which a ray, or a ball swept along it, enters a shape's mesh."""
    origin, way = work[0], work[1]
    if radius > 0.0:
        solid = hull_of(hulls, shape), frame.scale
        s, _ = approach_hull(solid, radius, reach, frame.slack, work)
        return s, np.int64(INSIDE if s == 0.0 else ROUND)
    span = hulls.spans[shape.mesh]
    first, stop = span.faces[0], span.faces[1]
    surface = Surface(
        hulls.vertices[span.vertices[0] : span.vertices[1]],
        hulls.corners[first:stop],
        hulls.nodes[2 * first : 2 * stop],
        span.root,
        span.radius,
    )
    return enter_surface(surface, frame.scale, origin, way, reach)


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
