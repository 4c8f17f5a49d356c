# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and balls against one mesh in its own frame.

**A convex mesh** is followed from before it, so that where the ray enters is the first triangle
that it crosses, whatever the winding. Where the origin lies beyond that, the same from behind
decides whether it lies before the exit, that is inside. GJK computes the distance of a ball.

**Any other mesh** is entered by the first triangle that the ray crosses from its origin on; or at
once, if the mesh is solid and holds the origin. The ray is that of the caller in the frame of the
mesh, with a direction of any length: where the mesh is not turned, and lies at the world's origin,
nothing is rounded before the decision. A ball touches where it first touches a triangle.
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
    s, face = first_crossing(surface, ray, 4.0 * surface.radius)
    entry = begin + s * scale
    if entry > 0.0:
        return (entry if entry <= reach else np.inf), FACE + face
    for axis in range(3):
        ray[ORIGIN, axis] += 2.0 * surface.radius * ray[DIRECTION, axis]
        ray[DIRECTION, axis] = -ray[DIRECTION, axis]
    s, face = first_crossing(surface, ray, 4.0 * surface.radius)
    return (0.0 if end - s * scale >= 0.0 else np.inf), np.int64(INSIDE)


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
def enter_convex(hulls, shape, frame, pair, radius, t_max, work):
    """(t, feature) at which a ray, or a ball swept along it, enters a shape's convex mesh."""
    reach = reach_of(t_max, frame.pace)
    if radius == 0.0:
        surface = surface_of(hulls, shape)
        s, feature = enter_surface(surface, frame.scale, work[0], work[1], reach)
        return time_of(s, frame.pace, t_max), feature
    solid = hull_of(hulls, shape), frame.scale
    s, _ = approach_hull(solid, radius, reach, frame.slack, work)
    return time_of(s, frame.pace, t_max), np.int64(INSIDE if s == 0.0 else ROUND)


# ---- meshes that are not convex


@lean_kernel
def enter_triangles(surface, is_solid, shape, pair, t_max):
    """(t, feature) at which a thin ray enters any mesh, t up to t_max."""
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
    s, face = first_crossing(surface, ray, reach)
    return (min(math.ldexp(s, exponent), t_max) if s < np.inf else np.inf), FACE + face


MINUTE = 2.0**-200


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
