# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and balls against one convex mesh in its own frame.

A thin ray is followed through the tree of its triangles, see `mesh_rays`. How far a ball is away,
GJK says.
"""

import numpy as np

from ...tree.jit.compiling import lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.rays.slab import INSIDE
from ..distance.hull_gap import hull_gap
from ..distance.simplex import dot
from ..geometry.farthest import farthest_vertex
from ..geometry.hull import hull_of
from ..geometry.rim import ROUND
from .approach import approach_by
from .mesh_rays import Surface, enter_surface


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
    if radius == 0.0:
        span = hulls.spans[shape.mesh]
        first, stop = span.faces[0], span.faces[1]
        surface = Surface(
            hulls.vertices[span.vertices[0] : span.vertices[1]],
            hulls.corners[first:stop],
            hulls.nodes[2 * first : 2 * stop],
            span.root,
            span.radius,
        )
        return enter_surface(surface, frame.scale, work[0], work[1], reach)
    solid = hull_of(hulls, shape), frame.scale
    s, _ = approach_hull(solid, radius, reach, frame.slack, work)
    return s, np.int64(INSIDE if s == 0.0 else ROUND)
