# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and balls against one mesh in its own frame.

A thin ray enters a mesh by the first triangle that it crosses from its origin on; or at once, if
its origin is on a triangle, or in the solid. The ray is that of the caller in the frame of the
mesh, with a direction of any length: where the mesh is not turned, and lies at the world's origin,
nothing is rounded before the decision.

A ball touches a mesh where it first touches a triangle, or at once where a solid holds its centre.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import DIRECTION, INSIDE, LARGEST, ORIGIN, RAY_ROWS, set_ray
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..distance.gjk import SLACK, dot
from ..distance.narrow_phase import hull_gap
from ..shapes.footprint import FACE, ROUND
from ..shapes.hull import form_of, surface_of, triangle_hull
from ..shapes.mesh import CONVEX, SHELL, farthest_vertex
from ..shapes.shape import ldexp, rotate
from ..shapes.surface import (
    closest_between,
    coordinates_in,
    first_crossing,
    holds_point,
    visit_ball,
)
from .arguments import clear_triangle
from .shapes import ROUNDING, approach_by, reach_of, slope_of, time_of

# ---- thin rays


@lean_kernel
def into_frame(radius, shape, given, ray):
    """Fill in origin and direction of a ray in the frame of a mesh, the direction times a power of
    two if it is very short or long; return (the exponent of that, whether it is zero).
    """
    largest, exponent = 0.0, 0
    for axis in range(3):
        ray[ORIGIN, axis] = given[ORIGIN, axis] - shape.position[axis]
        largest = max(largest, abs(given[DIRECTION, axis]))
    if not SHORT < largest < LONG:
        exponent = -math.frexp(largest)[1]
    for axis in range(3):
        ray[DIRECTION, axis] = ldexp(given[DIRECTION, axis], exponent)
    rotate(shape.orientation, ray[ORIGIN], -1.0)
    rotate(shape.orientation, ray[DIRECTION], -1.0)
    for axis in range(3):  # what is below all digits of the mesh would leave the exact sums
        if abs(ray[ORIGIN, axis]) < MINUTE * radius:
            ray[ORIGIN, axis] = 0.0
        if abs(ray[DIRECTION, axis]) < MINUTE:
            ray[DIRECTION, axis] = 0.0
    return exponent, largest == 0.0


@lean_kernel
def enter_triangles(surface, is_solid, shape, pair, t_max):
    """(t, feature) at which a thin ray enters a mesh, t up to t_max."""
    ray = stack_array((RAY_ROWS, 3), np.float64)
    exponent, is_still = into_frame(surface.radius, shape, pair.ray, ray)
    if is_solid and holds_point(surface, ray[ORIGIN]):
        return 0.0, np.int64(INSIDE)
    reach = ldexp(t_max, -exponent)
    if is_still:
        ray[DIRECTION, 0], reach = 1.0, 0.0
    begin = come_near(surface.radius, ray)
    if not begin <= reach:
        return np.inf, ROUND
    s, face = first_crossing(surface, ray, reach - begin)
    if s == np.inf:
        return np.inf, ROUND
    if begin + s == 0.0:  # exactly
        return 0.0, np.int64(INSIDE)
    return time_in(begin + s, exponent, t_max), FACE + face


@inlined
def time_in(s, exponent, t_max):
    """The t of a hit, s times a power of two, as `shapes.time_of`."""
    return min(ldexp(s, exponent), t_max, LARGEST)


MINUTE, SHORT, LONG = 2.0**-200, 2.0**-20, 2.0**20
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


@inlined
def touch_mesh(hulls, shape, given, hit, point, normal, triangle):
    """Fill in the point, normal and triangle of a thin ray's hit, as `contact.contact`.

    It is inlined: to hand over the arrays of all meshes takes as long as the rest.
    """
    t, feature = hit
    if feature < FACE:
        clear_triangle(triangle)
        for axis in range(3):
            point[axis], normal[axis] = given[ORIGIN, axis] + t * given[DIRECTION, axis], 0.0
    else:
        span = hulls.spans[shape.mesh]
        number, vertices = span.faces[0] + feature - FACE, hulls.vertices[span.vertices[0] :]
        face = vertices, hulls.corners[number], hulls.rows[number]
        for axis in range(3):
            normal[axis] = hulls.normals[number, axis]
        touch_face(face, span.radius, span.form, shape, given, t, point, normal, triangle)


@lean_kernel
def touch_face(face, radius, form, shape, given, t, point, normal, triangle):
    """`touch_mesh` of a ray that hits a triangle, face = (vertices, its corners, its row), whose
    normal in the frame of the mesh is given.
    """
    (vertices, corner, row), local = face, stack_array((RAY_ROWS, 3), np.float64)
    exponent, _ = into_frame(radius, shape, given, local)
    along, s = 0.0, ldexp(t, -exponent)
    for axis in range(3):
        point[axis] = given[ORIGIN, axis] + t * given[DIRECTION, axis]
        along += normal[axis] * local[DIRECTION, axis]
        local[ORIGIN, axis] += s * local[DIRECTION, axis]
    if along > 0.0 and form != CONVEX:  # those of a convex mesh point outwards already
        for axis in range(3):
            normal[axis] = -normal[axis]
    rotate(shape.orientation, normal, 1.0)
    if triangle is not None:
        u, v = coordinates_in(vertices, corner, local[ORIGIN])
        triangle[0], triangle[1], triangle[2] = row, u, v


# ---- balls


@lean_kernel
def measure_hull(solid, point, normal):
    """`approach`'s measure of a convex mesh times a scale, by GJK: how far the plane through its
    vertex farthest towards the point keeps it off, and its closest point.
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


@lean_kernel
def measure_triangle(solid, point, normal):
    """`measure_hull` of a triangle. The plane across the line to its closest point nearly always
    proves the distance.
    """
    hull, scale = solid
    place, closest, places = stack_array(3, np.float64), stack_array(3, np.float64), hull.places
    size = hull.radius
    for axis in range(3):
        place[axis] = point[axis] / scale
        size = max(size, abs(place[axis]))
    distance = math.sqrt(closest_between(places[0], places[1], places[2], place, closest))
    if distance > 0.0:
        low = np.inf
        for axis in range(3):
            normal[axis] = (place[axis] - closest[axis]) / distance
        for number in range(3):
            along = 0.0
            for axis in range(3):
                along += normal[axis] * (place[axis] - places[number, axis])
            low = min(low, along)
        if distance - low <= SLACK * size:
            return low * scale, distance * scale
    return measure_hull(solid, point, normal)


approach_triangle = approach_by(measure_triangle)


@lean_kernel
def stays_off(solid, radius, until, is_hit, slack, work):
    """Whether a ball surely does not touch a triangle before it has gone a distance, but for what
    rounds that: there a plane keeps them apart, to which the ball came no nearer before. If the
    ball touches nothing there, it must be off by the slack. `work` as for `approach`.
    """
    origin, direction, point, normal = work[0], work[1], work[2], work[3]
    if until == np.inf:
        return False
    for axis in range(3):
        point[axis] = origin[axis] + until * direction[axis]
    low, _ = measure_triangle(solid, point, normal)
    slope = slope_of(normal, direction)
    more = ROUNDING * until * slope if is_hit else slack
    return low > radius + more and slope <= 0.0


class Touch(NamedTuple):
    """Where a ball touches the first triangle, or a disc the first shadow, so far."""

    s: Any
    """How far it goes until then, inf if it touches none."""
    query: Any
    """What the visitor needs: `TouchQuery`, or `footprint.DiscQuery`."""


class TouchQuery(NamedTuple):
    """What `_visit_touched` needs."""

    hulls: Any
    frame: Any
    radius: Any
    reach: Any
    work: Any
    places: Any
    """Scratch, (3, 3)."""


@inlined
def _visit_touched(surface, ray, face, zero, touch):
    query = touch.query
    frame, radius, until = query.frame, query.radius, min(touch.s, query.reach)
    solid = triangle_hull(query.hulls, surface, face, query.places), frame.scale
    if not stays_off(solid, radius, until, touch.s <= until, frame.slack, query.work):
        s, _ = approach_triangle(solid, radius, until, frame.slack, query.work)
        touch = Touch(min(touch.s, s), query)
    return touch, min(touch.s, query.reach) / frame.scale


GROWN = 2.0**-46  # of the lengths in play: more than what rounds a place


@inlined
def in_lengths_of(surface, frame, radius, work, ray):
    """Fill in the path of a ball, rows 0 and 1 of `work`, in the lengths of a mesh; return a
    radius that rounding makes no smaller than the ball's.
    """
    size = 0.0
    for axis in range(3):
        ray[ORIGIN, axis] = work[0, axis] / frame.scale
        ray[DIRECTION, axis] = work[1, axis]
        size = max(size, abs(ray[ORIGIN, axis]))
    set_ray(ray, ray[ORIGIN], ray[DIRECTION])
    return (radius + frame.slack) / frame.scale * (1.0 + GROWN) + GROWN * (size + surface.radius)


@lean_kernel
def approach_triangles(hulls, surface, is_solid, frame, radius, reach, work):
    """How far a ball goes until it touches any mesh, inf if it does not."""
    ray = stack_array((RAY_ROWS, 3), np.float64)
    grown = in_lengths_of(surface, frame, radius, work, ray)
    if is_solid and holds_point(surface, ray[ORIGIN]):
        return 0.0
    query = TouchQuery(hulls, frame, radius, reach, work, stack_array((3, 3), np.float64))
    touch = Touch(np.inf, query)
    return visit_ball(surface, ray, grown, reach / frame.scale, touch, _visit_touched).s


@lean_kernel
def enter_mesh(hulls, shape, frame, pair, radius, t_max, work):
    """(t, feature) at which a ray, or a ball swept along it, enters a shape's mesh."""
    surface, is_solid = surface_of(hulls, shape), form_of(hulls, shape) != SHELL
    if radius == 0.0:
        return enter_triangles(surface, is_solid, shape, pair, t_max)
    reach = reach_of(t_max, frame.pace)
    s = approach_triangles(hulls, surface, is_solid, frame, radius, reach, work)
    return time_of(s, frame.pace, t_max), np.int64(INSIDE if s == 0.0 else ROUND)
