# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays, balls and points against one convex mesh in its own frame.

A thin ray is clipped by the planes of the faces, so it can slip through no edge: a convex solid is
the overlap of the half-spaces within its planes. How far a ball is away, GJK says.
"""

import numpy as np

from ..tree.compiling import lean_kernel
from ..tree.machine import stack_array
from ..tree.slab import INSIDE
from .gjk import AXES, CENTRE, CORE_ROWS, HALF, dot, gap_bounds
from .ray_shapes import NEWTON_STEPS, ROUND, ROUNDING

MESH = 4  # ShapeKind, as a kernel can read it
FACE = 4  # feature of the first face; below are those of `ray_shapes`


@lean_kernel
def vertex_span(hulls, shape):
    """Rows of the vertices of a shape's mesh: from, up to. No rows if it is none."""
    if shape.kind != MESH:
        return 0, 0
    return hulls.spans[shape.mesh, 0], hulls.spans[shape.mesh, 1]


@lean_kernel
def enter_mesh(hulls, shape, origin, way, radius, reach, scratch):
    """(s, feature) at which a ray, or a ball swept along it, enters a shape's mesh."""
    if radius == 0.0:
        planes = hulls.planes[hulls.spans[shape.mesh, 2] : hulls.spans[shape.mesh, 3]]
        return enter_hull(planes, origin, way, reach)
    first, stop = vertex_span(hulls, shape)
    vertices = hulls.vertices[first:stop]
    return enter_rounded_hull(vertices, origin, way, radius, reach, scratch)


@lean_kernel
def enter_hull(planes, origin, way, reach):
    """(s, feature) as the functions of `ray_shapes`: the face that is entered last."""
    entry, leave, feature = 0.0, reach, INSIDE
    for face in range(planes.shape[0]):
        height = planes[face, 3] - dot(planes[face], origin)
        slope = dot(planes[face], way)
        if slope == 0.0:
            if height < 0.0:
                return np.inf, ROUND
        elif slope > 0.0:
            leave = min(leave, height / slope)
        elif height / slope > entry:
            entry, feature = height / slope, FACE + face
    return (entry if entry <= leave else np.inf), feature


@lean_kernel
def hull_gap(vertices, point, apart):
    """Distance of a point from a mesh, 0 inside; `apart` leads from its closest point there."""
    ball = stack_array(15, np.float64).reshape(CORE_ROWS, 3)
    mesh = stack_array(15, np.float64).reshape(CORE_ROWS, 3)
    for row in range(CORE_ROWS):
        for axis in range(3):
            ball[row, axis] = mesh[row, axis] = 1.0 if row == AXES + axis else 0.0
    for axis in range(3):
        ball[CENTRE, axis] = point[axis]
    mesh[HALF, 0] = 1.0
    return gap_bounds(ball, False, vertices[0:0], mesh, False, vertices, np.nan, apart)[1]


@lean_kernel
def enter_rounded_hull(vertices, origin, way, radius, reach, point):
    """Newton's iteration for distance(s) = radius, see `ray_shapes.approach_rim`."""
    apart = stack_array(3, np.float64)
    for axis in range(3):
        point[axis] = origin[axis]
    distance = hull_gap(vertices, point, apart)
    if distance <= radius:
        return 0.0, INSIDE
    s = 0.0
    for _ in range(NEWTON_STEPS):
        slope = dot(apart, way) / distance
        if slope >= 0.0:
            return np.inf, ROUND
        step = (radius - distance) / slope
        s += step
        if s > reach:
            return np.inf, ROUND
        for axis in range(3):
            point[axis] = origin[axis] + s * way[axis]
        distance = hull_gap(vertices, point, apart)
        if distance <= radius or step <= ROUNDING * s:
            break
    return s, ROUND


@lean_kernel
def closest_on_hull(vertices, point, out):
    """Fill `out` with the closest point of a mesh, `point` itself inside; return the distance."""
    apart = stack_array(3, np.float64)
    distance = hull_gap(vertices, point, apart)
    for axis in range(3):
        out[axis] = point[axis] - apart[axis] if distance > 0.0 else point[axis]
    return distance
