# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and balls against one mesh in its own frame.

A thin ray enters a mesh by the first triangle that it crosses from its origin on; or at once, if
the mesh is solid and holds the origin. The ray is that of the caller in the frame of the mesh,
with a direction of any length: where the mesh is not turned, and lies at the world's origin,
nothing is rounded before the decision.

A ball touches a convex mesh where GJK says so, any other one where it first touches a triangle.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    DEEPEST,
    DIRECTION,
    INSIDE,
    NONE,
    ORIGIN,
    RAY_ROWS,
    Stack,
    intersect_node,
    next_leaf,
    prepare_ray,
    push_root,
    set_ray,
    traversal_distance,
)
from ...tree.compiler import chosen_by_types, inlined, lean_kernel, stack_array
from ..distance.gjk import dot
from ..distance.narrow_phase import hull_gap
from ..shapes.footprint import FACE, ROUND
from ..shapes.hull import are_any, form_of, hull_of, surface_of, triangle_hull
from ..shapes.mesh import CONVEX, SOLID, farthest_vertex
from ..shapes.shape import rotate
from ..shapes.surface import first_crossing, holds_point
from .shapes import approach_by, reach_of, time_of

# ---- thin rays


@lean_kernel
def enter_triangles(surface, is_solid, shape, pair, t_max):
    """(t, feature) at which a thin ray enters a mesh, t up to t_max."""
    given, ray = pair.ray, stack_array((RAY_ROWS, 3), np.float64)
    largest = 0.0
    for axis in range(3):
        ray[ORIGIN, axis] = given[ORIGIN, axis] - shape.position[axis]
        largest = max(largest, abs(given[DIRECTION, axis]))
    exponent = -math.frexp(largest)[1]
    for axis in range(3):
        ray[DIRECTION, axis] = math.ldexp(given[DIRECTION, axis], exponent)
    rotate(shape.orientation, ray[ORIGIN], -1.0)
    rotate(shape.orientation, ray[DIRECTION], -1.0)
    for axis in range(3):  # what is below all digits of the mesh would leave the exact sums
        if abs(ray[ORIGIN, axis]) < MINUTE * surface.radius:
            ray[ORIGIN, axis] = 0.0
        if abs(ray[DIRECTION, axis]) < MINUTE:
            ray[DIRECTION, axis] = 0.0
    if is_solid and holds_point(surface, ray[ORIGIN]):
        return 0.0, np.int64(INSIDE)
    reach = math.ldexp(t_max, -exponent)
    if largest == 0.0:
        ray[DIRECTION, 0], reach = 1.0, 0.0
    begin = come_near(surface.radius, ray)
    if not begin <= reach:
        return np.inf, ROUND
    s, face = first_crossing(surface, ray, reach - begin)
    return (min(math.ldexp(begin + s, exponent), t_max) if s < np.inf else np.inf), FACE + face


MINUTE = 2.0**-200
FARTHEST, GIANT = 2.0**60, 2.0**200  # of a mesh's radius; m


@lean_kernel
def come_near(radius, ray):
    """Move a ray's origin to before the mesh if it is so far away that products of lengths may
    leave the range of doubles; return how far, in units of its direction.
    """
    largest, along, square = 0.0, 0.0, 0.0
    for axis in range(3):
        largest = max(largest, abs(ray[ORIGIN, axis]))
        along -= 0.25 * ray[ORIGIN, axis] * ray[DIRECTION, axis]
        square += ray[DIRECTION, axis] * ray[DIRECTION, axis]
    if largest <= (FARTHEST if radius < GIANT else 2.0) * radius:
        return 0.0
    begin = 4.0 * (along / square) - 2.0 * radius / math.sqrt(square)
    if not begin > 0.0:
        return 0.0
    for axis in range(3):
        ray[ORIGIN, axis] += begin * ray[DIRECTION, axis]
    return begin


# ---- balls


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
def enter_convex(hulls, shape, frame, pair, radius, t_max, work):
    """(t, feature) at which a ray, or a ball swept along it, enters a shape's convex mesh."""
    if radius == 0.0:
        return enter_triangles(surface_of(hulls, shape), True, shape, pair, t_max)
    reach = reach_of(t_max, frame.pace)
    solid = hull_of(hulls, shape), frame.scale
    s, _ = approach_hull(solid, radius, reach, frame.slack, work)
    return time_of(s, frame.pace, t_max), np.int64(INSIDE if s == 0.0 else ROUND)


# ---- meshes that are not convex


class BallNodes(NamedTuple):
    """What `enter_ball` reads."""

    ray: Any
    wide: Any
    radius: Any
    """By how much nodes are grown."""
    box: Any
    """Scratch, (2, 3)."""


@inlined
def enter_ball(nodes, node, path, limit):
    """Where the centre of a ball may enter a node grown by its radius."""
    for axis in range(3):
        path.box[0, axis] = nodes[node].lo[axis] - path.radius
        path.box[1, axis] = nodes[node].hi[axis] + path.radius
    return intersect_node(path.box[0], path.box[1], path.ray, limit, path.wide)


@lean_kernel
def approach_triangles(hulls, surface, is_solid, frame, radius, reach, work):
    """How far a ball goes until it touches any mesh, inf if it does not."""
    ray, box = stack_array((RAY_ROWS, 3), np.float64), stack_array((2, 3), np.float64)
    room, places = stack_array((5, 3), np.float64), stack_array((3, 3), np.float64)
    nodes, root, size = surface.nodes, surface.root, 0.0
    for axis in range(3):
        ray[ORIGIN, axis] = work[0, axis] / frame.scale
        ray[DIRECTION, axis] = work[1, axis]
        size = max(size, abs(ray[ORIGIN, axis]))
    if is_solid and holds_point(surface, ray[ORIGIN]):
        return 0.0
    set_ray(ray, ray[ORIGIN], ray[DIRECTION])
    grown = (radius + frame.slack) / frame.scale * (1.0 + GROWN) + GROWN * (size + surface.radius)
    for axis in range(3):
        box[0, axis] = nodes[root].lo[axis] - grown
        box[1, axis] = nodes[root].hi[axis] + grown
    scale, wide = prepare_ray(ray, box[0], box[1])
    path, best = BallNodes(ray, wide, grown, box), np.inf
    limit = traversal_distance(reach / frame.scale, scale)
    stack = Stack(stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64))
    top = push_root(nodes, root, path, limit, stack, enter_ball)
    while top > 0:
        leaf, top = next_leaf(nodes, path, limit, stack, top, enter_ball)
        if leaf == NONE:
            break
        hull = triangle_hull(hulls, surface, np.int64(leaf >> 1), places)
        for row in range(2):
            for axis in range(3):
                room[row, axis] = work[row, axis]
        until = min(best, reach)
        s, _ = approach_hull((hull, frame.scale), radius, until, frame.slack, room)
        if s < best:
            best = s
            limit = traversal_distance(s / frame.scale, scale)
    return best


GROWN = 2.0**-46  # of the lengths in play: more than what rounds a place


@lean_kernel
def enter_any(hulls, shape, frame, pair, radius, t_max, work):
    """`enter_convex` of any mesh."""
    form = form_of(hulls, shape)
    if form == CONVEX:
        return enter_convex(hulls, shape, frame, pair, radius, t_max, work)
    surface = surface_of(hulls, shape)
    if radius == 0.0:
        return enter_triangles(surface, form == SOLID, shape, pair, t_max)
    reach = reach_of(t_max, frame.pace)
    s = approach_triangles(hulls, surface, form == SOLID, frame, radius, reach, work)
    return time_of(s, frame.pace, t_max), np.int64(INSIDE if s == 0.0 else ROUND)


@chosen_by_types
def enter_mesh(hulls, shape, frame, pair, radius, t_max, work):
    """(t, feature) at which a ray, or a ball swept along it, enters a shape's mesh."""
    return _of_any if are_any(hulls) else _of_convex


def _of_any(hulls, shape, frame, pair, radius, t_max, work):
    return enter_any(hulls, shape, frame, pair, radius, t_max, work)


def _of_convex(hulls, shape, frame, pair, radius, t_max, work):
    return enter_convex(hulls, shape, frame, pair, radius, t_max, work)
