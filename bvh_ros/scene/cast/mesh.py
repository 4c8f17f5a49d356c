# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and balls against one convex mesh in its own frame.

GJK computes the distance of a ball. A thin ray goes through the tree of the mesh's triangles. It
is followed from before the mesh, so that where it enters is the first triangle that it
crosses, whatever the winding. Where the origin lies beyond that, the same from behind decides
whether it lies before the exit, that is inside.

**Nothing slips through an edge** (Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection",
2013): the ray is moved to the origin and sheared onto an axis. A corner comes out the same in all
its triangles, and on which side of an edge the ray passes is the sign of a - b, two rounded
products. Rounding keeps their order: the sign is right or zero, and of the two triangles at an
edge one has -(a - b). A triangle counts with its edges, so a ray that crosses the surface between
rounded corners crosses a triangle. Those corners are within a few ulp of the mesh's size of the
true ones; the boxes in the tree are larger by more (`meshes.PAD`).
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    ALL,
    DEEPEST,
    DIRECTION,
    INSIDE,
    NONE,
    ORIGIN,
    RAY_ROWS,
    Stack,
    enter_box,
    next_leaf,
    prepare_ray,
    push_root,
    set_ray,
    traversal_distance,
)
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..distance.gjk import dot
from ..distance.narrow_phase import hull_gap
from ..shapes.footprint import FACE, ROUND
from ..shapes.hull import hull_of
from ..shapes.mesh import farthest_vertex
from .shapes import approach_by

# ---- thin rays


class Surface(NamedTuple):
    """Triangles of a mesh and the tree over them; see `mesh_store`."""

    vertices: Any
    corners: Any
    nodes: Any
    root: Any
    radius: Any


class Line(NamedTuple):
    """What `enter_box` reads."""

    ray: Any
    mask: Any
    wide: Any


class Shear(NamedTuple):
    """How a direction is sheared onto one of its axes."""

    x: Any
    y: Any
    z: Any
    """Number of that axis; x and y are those of the others."""
    by_x: Any
    by_y: Any


@lean_kernel
def enter_surface(surface, scale, origin, direction, reach):
    """(s, feature) as the functions of `shapes`: the triangle by which a mesh is entered.
    The ray is given in lengths times `scale`.
    """
    ray = stack_array((RAY_ROWS, 3), np.float64)
    along = 0.0
    for axis in range(3):
        along -= origin[axis] * direction[axis]
        ray[DIRECTION, axis] = direction[axis]
    if (
        direction[0] == 0.0 and direction[1] == 0.0 and direction[2] == 0.0
    ):  # a point: along any line through it
        ray[DIRECTION, 0] = 1.0
        along, reach = -origin[0], 0.0
    begin, end = along - surface.radius * scale, along + surface.radius * scale
    if not (begin <= reach and end >= 0.0):
        return np.inf, ROUND
    for axis in range(3):
        ray[ORIGIN, axis] = (origin[axis] + begin * ray[DIRECTION, axis]) / scale
    s, face = first_crossing(surface, ray)
    entry = begin + s * scale
    if entry > 0.0:
        return (entry if entry <= reach else np.inf), FACE + face
    for axis in range(3):
        ray[ORIGIN, axis] += 2.0 * surface.radius * ray[DIRECTION, axis]
        ray[DIRECTION, axis] = -ray[DIRECTION, axis]
    s, face = first_crossing(surface, ray)
    return (0.0 if end - s * scale >= 0.0 else np.inf), np.int64(INSIDE)


@lean_kernel
def first_crossing(surface, ray):
    """(s, number) of the first triangle that a line crosses; (inf, NONE) if it crosses none."""
    nodes, root = surface.nodes, surface.root
    set_ray(ray, ray[ORIGIN], ray[DIRECTION])
    best, crossed, frame = np.inf, np.int64(NONE), shear(ray[DIRECTION])
    scale, wide = prepare_ray(ray, nodes[root].lo, nodes[root].hi)
    line, limit = Line(ray, ALL, wide), traversal_distance(4.0 * surface.radius, scale)
    stack = Stack(stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64))
    top = push_root(nodes, root, line, limit, stack, enter_box)
    while top > 0:
        leaf, top = next_leaf(nodes, line, limit, stack, top, enter_box)
        if leaf == NONE:
            break
        face = np.int64(leaf >> 1)
        depth = cross_triangle(surface.vertices, surface.corners[face], ray[ORIGIN], frame)
        s = depth / ray[DIRECTION, frame.z]
        if s < best:
            best, crossed = s, face
            limit = traversal_distance(s, scale)
    return best, crossed


@inlined
def shear(direction):
    """How to shear a direction onto an axis."""
    z = 0
    for axis in range(1, 3):
        if abs(direction[axis]) > abs(direction[z]):
            z = axis
    x, y = (z + 1) % 3, (z + 2) % 3
    return Shear(x, y, z, direction[x] / direction[z], direction[y] / direction[z])


@inlined
def sheared(vertex, origin, frame):
    """A corner as seen from the ray, which runs along the third axis."""
    depth = vertex[frame.z] - origin[frame.z]
    x = vertex[frame.x] - origin[frame.x] - frame.by_x * depth
    y = vertex[frame.y] - origin[frame.y] - frame.by_y * depth
    return x, y, depth


@inlined
def cross_triangle(vertices, corner, origin, frame):
    """How deep along the third axis a line crosses a triangle; NaN if it does not, or runs in its
    plane.
    """
    ax, ay, az = sheared(vertices[corner[0]], origin, frame)
    bx, by, bz = sheared(vertices[corner[1]], origin, frame)
    cx, cy, cz = sheared(vertices[corner[2]], origin, frame)
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    if min(u, v, w) < 0.0 < max(u, v, w):
        return np.nan
    return az + ((bz - az) * v + (cz - az) * w) / (u + v + w)


# ---- rays and balls


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
