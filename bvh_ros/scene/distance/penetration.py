# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How deep two shapes overlap."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from ...tree.access import two_sum
from ...tree.compiler import chosen_by_types, inlined, lean_kernel, stack_array
from ..shapes.hull import are_any, form_of, hull_of, hull_of_point, surface_of
from ..shapes.mesh import CONVEX, SOLID
from ..shapes.shape import MESH, SPHERE, rotate
from ..shapes.surface import closest_on_surface, closest_triangle, holds_point
from .certified import certified_bounds, cross2, dot2, set_normal
from .gjk import (
    AXES,
    CENTRE,
    CORE_ROWS,
    DIRECTION_ROOM,
    HALF,
    LINES,
    SECOND,
    SLACK,
    Core,
    corner_of,
    dot,
    fill_line,
)
from .narrow_phase import (
    fill_core,
    fill_cores,
    fill_corners,
    from_frame,
    largest_length,
    look_back,
    ordered,
    to_frame,
)

# ---- The least distance by which two overlapping cores can be parted: expanding polytopes (van
# den Bergen, "Proximity Queries and Penetration Depth Computation on 3D Game Objects", 2001).
#
# Let D be the set of all differences b - a of points of the other core and of this one. It holds
# the origin where they overlap, and to move this core by m parts them if m is not inside D: the
# least such m leads to the closest point of D's surface. A polytope with corners in D grows by
# the corner of D that is farthest along the normal of its closest face. The face is nearer than
# D's surface, the plane through the new corner farther: two bounds, and it ends when they agree.
#
# Where faces are slivers, normals and sides take twice the digits; so the polytope stays convex.
# Its faces always close: each edge belongs to two, once in either direction.

MOST_CORNERS = 256  # of polyhedra few are needed, about round rims all where many sides are tied
MOST_FACES = 2 * MOST_CORNERS
SIDE_SURE = 2.0**-44  # of lengths about 1: nearer to a plane, doubles do not decide the side


class Polytope(NamedTuple):
    """Corners, and the triangles between them."""

    corners: Any
    """(MOST_CORNERS, 3)"""
    faces: Any
    """(MOST_FACES, 3) rows of `corners`, counter-clockwise from outside."""
    planes: Any
    """(MOST_FACES, 4) outward unit normals, and distances from the origin; 0 and inf where a
    triangle has no area."""


@lean_kernel
def reach_in(one, other, direction, corner):
    """Fill in the corner of D that is farthest along `direction`; return how far that is."""
    both = stack_array(6, np.float64)
    corner_of(one, other, direction, both)
    for axis in range(3):
        corner[axis] = -both[axis]
    return dot(direction, corner)


@lean_kernel
def polytope_depth(one, other, normal):
    """(low, high) around the least distance that parts two cores (see `gjk`); `normal` becomes the
    unit vector along which this core has to move by `high`.

    They agree to SLACK, but where more sides are tied, to rounding, than a polytope has corners;
    `high` parts them all the same. Of cores that are just apart both are not above 0.
    """
    corners = stack_array((MOST_CORNERS, 3), np.float64)
    faces = stack_array((MOST_FACES, 3), np.int64)
    planes = stack_array((MOST_FACES, 4), np.float64)
    polytope = Polytope(corners, faces, planes)
    if not first_triangle(one, other, corners, normal):
        high = reach_in(one, other, normal, corners[0])
        return high, high
    for side in range(2):
        faces[side, 0], faces[side, 1], faces[side, 2] = 0, 1 + side, 2 - side
        set_plane(polytope, side)
    low, high, count = -np.inf, np.inf, 2
    if one.is_round or other.is_round:
        high = try_lines(one, other, normal)
    for number in range(3, MOST_CORNERS):
        closest = 0
        for face in range(count):
            if planes[face, 3] < planes[closest, 3]:
                closest = face
        low, direction = planes[closest, 3], planes[closest, :3]
        reach = reach_in(one, other, direction, corners[number])
        if reach < high:
            high = reach
            for axis in range(3):
                normal[axis] = direction[axis]
        if high - low <= SLACK:
            break
        count = expand(polytope, count, number)
        if count == 0:
            break
    return min(low, high), high


@lean_kernel
def try_lines(one, other, normal):
    """The least way apart along the 15 lines, and straight through the side of a cylinder; fill in
    where to. Beside round rims these are the ways that many others are nearly as short as.
    """
    direction, corner, least = stack_array(3, np.float64), stack_array(3, np.float64), np.inf
    for line in range(LINES + 2):
        if line < LINES:
            some = fill_line(one.rows, other.rows, line, direction)
        else:
            axis = one.rows[AXES + 2] if line == LINES else other.rows[AXES + 2]
            some = fill_aside(one.rows, other.rows, axis, direction)
        for _ in range(2 if some else 0):
            reach = reach_in(one, other, direction, corner)
            if reach < least:
                least = reach
                for row in range(3):
                    normal[row] = direction[row]
            for row in range(3):
                direction[row] = -direction[row]
    return least


@lean_kernel
def fill_aside(one, other, axis, direction):
    """Fill in the unit vector between the centres of two cores, across an axis; false if there is
    none.
    """
    for row in range(3):
        direction[row] = one[CENTRE, row] - other[CENTRE, row]
    along = dot(direction, axis)
    for row in range(3):
        direction[row] -= along * axis[row]
    size = math.sqrt(dot(direction, direction))
    for row in range(3):
        direction[row] = direction[row] / size if size > 0.0 else 0.0
    return size > 0.0


@lean_kernel
def first_triangle(one, other, corners, normal):
    """Fill in three corners; false if D is a line, across which `normal` is then."""
    trial, direction = stack_array((2, 3), np.float64), stack_array(3, np.float64)
    edge, widest = stack_array(3, np.float64), -1.0
    for axis in range(3):
        for side in range(2):
            for row in range(3):
                direction[row] = (1.0 - 2.0 * side) * (row == axis)
            reach_in(one, other, direction, trial[side])
        for row in range(3):
            direction[row] = trial[1, row] - trial[0, row]
        if dot(direction, direction) > widest:
            widest = dot(direction, direction)
            for row in range(3):
                corners[0, row], corners[1, row] = trial[0, row], trial[1, row]
                edge[row] = direction[row]
    widest = 0.0
    for turn in range(6):
        axis, sign = turn % 3, 1.0 - 2.0 * (turn // 3)
        y, z = (axis + 1) % 3, (axis + 2) % 3
        direction[axis], direction[y], direction[z] = 0.0, sign * edge[z], -sign * edge[y]
        size = math.sqrt(dot(direction, direction))
        if size == 0.0 and widest > 0.0:
            continue
        for row in range(3):
            direction[row] = direction[row] / size if size > 0.0 else 1.0 * (row == axis)
        reach_in(one, other, direction, trial[0])
        if widest == 0.0:
            for row in range(3):
                normal[row] = direction[row]
        area = size_across(edge, corners[0], trial[0])
        if area > widest:
            widest = area
            for row in range(3):
                corners[2, row] = trial[0, row]
    return widest > 0.0


@lean_kernel
def size_across(edge, start, place):
    """How far a place is from the line along an edge, times the edge's length."""
    largest, away = 0.0, stack_array(3, np.float64)
    for axis in range(3):
        away[axis] = place[axis] - start[axis]
    for axis in range(3):
        y, z = (axis + 1) % 3, (axis + 2) % 3
        largest = max(largest, abs(edge[y] * away[z] - edge[z] * away[y]))
    return largest


@lean_kernel
def fill_normal(corners, face, normal):
    """Fill in twice a triangle's area along its normal, with twice the digits: (3, 2)."""
    room = stack_array((2, 3, 2), np.float64)
    for axis in range(3):
        start = corners[face[0], axis]
        for side in range(2):
            room[side, axis, 0], room[side, axis, 1] = two_sum(
                corners[face[1 + side], axis], -start
            )
    cross2(room[0], room[1], normal)


@lean_kernel
def set_plane(polytope, number):
    """Fill in the plane of a face."""
    face, plane = polytope.faces[number], polytope.planes[number]
    normal = stack_array((3, 2), np.float64)
    fill_normal(polytope.corners, face, normal)
    largest = max(abs(normal[0, 0]), abs(normal[1, 0]), abs(normal[2, 0]))
    exponent = math.frexp(largest)[1]
    for axis in range(3):
        plane[axis] = math.ldexp(normal[axis, 0], -exponent)
    size = math.sqrt(dot(plane, plane))
    plane[3] = np.inf
    if size > 0.0:
        for axis in range(3):
            plane[axis] /= size
        plane[3] = dot(plane, polytope.corners[face[0]])


@lean_kernel
def is_above(polytope, number, corner):
    """Whether a corner is on the outer side of a face."""
    plane = polytope.planes[number]
    height = dot(plane, corner) - plane[3]
    if not abs(height) <= SIDE_SURE:
        return height > 0.0
    room, face = stack_array((2, 3, 2), np.float64), polytope.faces[number]
    fill_normal(polytope.corners, face, room[0])
    for axis in range(3):
        start = polytope.corners[face[0], axis]
        room[1, axis, 0], room[1, axis, 1] = two_sum(corner[axis], -start)
    return dot2(room[0], room[1])[0] > 0.0


@lean_kernel
def expand(polytope, count, number):
    """Add a corner: faces between the rim of the visible faces and the corner replace them. Return
    the number of faces, 0 if there is no room.
    """
    faces, planes = polytope.faces, polytope.planes
    visible, left = stack_array((MOST_FACES, 3), np.int64), 0
    many = 0
    for face in range(count):
        sees = is_above(polytope, face, polytope.corners[number])
        target = visible[many] if sees else faces[left]
        for axis in range(3):
            target[axis] = faces[face, axis]
        if sees:
            many += 1
            continue
        for axis in range(4):
            planes[left, axis] = planes[face, axis]
        left += 1
    for face in range(many):
        for side in range(3):
            i, j = visible[face, side], visible[face, (side + 1) % 3]
            if has_edge(visible, many, j, i):
                continue
            if left == MOST_FACES:
                return 0
            faces[left, 0], faces[left, 1], faces[left, 2] = i, j, number
            set_plane(polytope, left)
            left += 1
    return left


@lean_kernel
def has_edge(faces, count, i, j):
    """Whether one of some faces has the edge from i to j."""
    for face in range(count):
        for side in range(3):
            if faces[face, side] == i and faces[face, (side + 1) % 3] == j:
                return True
    return False


# ---- `polytope_depth` in the plane, for what is seen from above: edges instead of faces.

MOST_EDGES = 256


@lean_kernel
def polygon_depth(one, other, normal):
    """`polytope_depth` of cores with z = 0, parted within the plane."""
    edges = stack_array((MOST_EDGES, 2, 2), np.float64)  # from, to
    lines = stack_array((MOST_EDGES, 3), np.float64)  # as planes
    corner = stack_array(3, np.float64)
    normal[2] = 0.0
    for axis in range(2):
        for side in range(2):
            normal[axis], normal[1 - axis] = 1.0 - 2.0 * side, 0.0
            high = reach_in(one, other, normal, corner)
            for row in range(2):
                edges[side, 0, row] = edges[1 - side, 1, row] = corner[row]
        if edges[0, 0, axis] != edges[1, 0, axis]:
            break
    low, count = high, 2
    if edges[0, 0, 0] == edges[1, 0, 0] and edges[0, 0, 1] == edges[1, 0, 1]:
        return low, high
    set_line(edges[0], lines[0])
    set_line(edges[1], lines[1])
    direction, high = stack_array(3, np.float64), np.inf
    while count < MOST_EDGES:
        closest = 0
        for edge in range(count):
            if lines[edge, 2] < lines[closest, 2]:
                closest = edge
        low = lines[closest, 2]
        direction[0], direction[1], direction[2] = lines[closest, 0], lines[closest, 1], 0.0
        reach = reach_in(one, other, direction, corner)
        if reach < high:
            high, normal[0], normal[1] = reach, direction[0], direction[1]
        if high - low <= SLACK:
            break
        for row in range(2):
            edges[count, 0, row], edges[count, 1, row] = corner[row], edges[closest, 1, row]
            edges[closest, 1, row] = corner[row]
        set_line(edges[closest], lines[closest])
        set_line(edges[count], lines[count])
        count += 1
    return min(low, high), high


@lean_kernel
def set_line(edge, line):
    """Fill in the outward unit normal of an edge, counter-clockwise, and its distance from the
    origin, inf if it has no length.
    """
    x, y = edge[1, 1] - edge[0, 1], edge[0, 0] - edge[1, 0]
    size = math.hypot(x, y)
    line[0], line[1], line[2] = 0.0, 0.0, np.inf
    if size > 0.0:
        line[0], line[1] = x / size, y / size
        line[2] = line[0] * edge[0, 0] + line[1] * edge[0, 1]


# ---- How deep shapes that touch reach into each other: the least distance by which one of them
# has to move until they only just touch, and in which direction.
#
# Shapes are solids, meshes and footprints too. Their cores (see `gjk`) are apart, and their
# radii overlap; or the cores overlap, and one has to be moved: boxes, points and segments along
# one of 15 lines (see `separation`), a point in a cylinder through its side or an end, all
# others as `polytope_depth` says. Between the cores, one moved that far and a bit, GJK then
# finds the points: so they are of the shapes, and as far apart as the depth.

BEYOND = 2.0**-8  # of lengths about 1: how far cores are parted to see where they touch


@lean_kernel
def penetration(one, hulls, other, other_hulls, planar, points, normal):
    """Depth of two shapes that touch, m, not below 0; fill in the points of their surfaces that
    are so far apart, and the unit vector along which the first has to move. It is the same from
    either side.
    """
    if ordered(one, other):
        return ordered_penetration(one, hulls, other, other_hulls, planar, points, normal)
    depth = ordered_penetration(other, other_hulls, one, hulls, planar, points, normal)
    for axis in range(3):
        points[0, axis], points[1, axis] = points[1, axis], points[0, axis]
        normal[axis] = -normal[axis]
    return depth


@lean_kernel
def ordered_penetration(one, hulls, other, other_hulls, planar, points, normal):
    first = stack_array((CORE_ROWS, 3), np.float64)
    second = stack_array((CORE_ROWS, 3), np.float64)
    hull, other_hull = hull_of(hulls, one), hull_of(other_hulls, other)
    cores, radii, exponent = fill_cores(*(one, hull, other, other_hull), planar, (first, second))
    depth = core_depth(cores, radii, planar, points, normal)
    return scaled_back(depth, exponent, one.position, points)


@lean_kernel
def depth_of_point(place, shape, hulls, planar, points, normal):
    """`penetration` of a point in a shape."""
    first = stack_array((CORE_ROWS, 3), np.float64)
    second = stack_array((CORE_ROWS, 3), np.float64)
    origin, largest = shape.position, largest_length(shape, shape.position, planar)
    for axis in range(2 if planar else 3):
        largest = max(largest, abs(place[axis] - origin[axis]))
    exponent = math.frexp(largest)[1]
    is_round, radius = fill_core(shape, origin, exponent, planar, second)
    for row in range(CORE_ROWS):
        for axis in range(3):
            first[row, axis] = 1.0 if row == AXES + axis and not (planar and axis == 2) else 0.0
    for axis in range(2 if planar else 3):
        first[CENTRE, axis] = math.ldexp(place[axis] - origin[axis], -exponent)
    hull = hull_of(hulls, shape)
    cores = Core(first, False, hull_of_point(hull)), Core(second, is_round, hull)
    depth = core_depth(cores, (0.0, radius), planar, points, normal)
    return scaled_back(depth, exponent, origin, points)


@lean_kernel
def scaled_back(depth, exponent, origin, points):
    """Bring points to metres in the world; return the depth in metres."""
    for row in range(2):
        for axis in range(3):
            points[row, axis] = math.ldexp(points[row, axis], exponent) + origin[axis]
    return math.ldexp(max(depth, 0.0), exponent)


@lean_kernel
def core_depth(cores, radii, planar, points, normal):
    """`penetration` of two cores with their radii."""
    direction = stack_array(DIRECTION_ROOM, np.float64)
    low, high, _ = certified_bounds(cores[0], cores[1], SLACK, True, direction)
    set_normal(direction, normal)
    depth = -high if high - low <= SLACK else -low
    if high <= SLACK:
        depth = max(least_way(cores[0], cores[1], planar, normal), 0.0)
    if is_point(cores[0]):
        for axis in range(3):
            direction[SECOND + axis] = cores[0].rows[CENTRE, axis] + depth * normal[axis]
    elif high <= SLACK:
        part(cores, depth + BEYOND, normal, direction)
    depth += radii[0] + radii[1]
    for axis in range(3):
        points[1, axis] = direction[SECOND + axis] + radii[1] * normal[axis]
        points[0, axis] = points[1, axis] - depth * normal[axis]
    return depth


@lean_kernel
def part(cores, distance, normal, direction):
    """`gap_bounds` fills in `direction` once the first core has moved so far along a normal."""
    rows = stack_array((CORE_ROWS, 3), np.float64)
    for row in range(CORE_ROWS):
        for axis in range(3):
            rows[row, axis] = cores[0].rows[row, axis]
    for axis in range(3):
        rows[CENTRE, axis] += distance * normal[axis]
    moved = Core(rows, cores[0].is_round, cores[0].hull)
    certified_bounds(moved, cores[1], SLACK, True, direction)


@lean_kernel
def least_way(one, other, planar, normal):
    """The least distance by which a core has to move to leave another; fill in the
    direction.
    """
    if planar:
        return polygon_depth(one, other, normal)[1]
    mesh = is_mesh(one.hull) or is_mesh(other.hull)
    if not (mesh or one.is_round or other.is_round):
        return out_of_box(one.rows, other.rows, normal)
    if is_point(one) and other.is_round:
        return out_of_cylinder(other.rows, one.rows[CENTRE], 1.0, normal)
    if is_point(other) and one.is_round:
        return out_of_cylinder(one.rows, other.rows[CENTRE], -1.0, normal)
    return polytope_depth(one, other, normal)[1]


@lean_kernel
def is_mesh(hull):
    if hull is not None:
        return hull.places.shape[0] > 0
    return False


@lean_kernel
def is_point(core):
    half = core.rows[HALF]
    return half[0] == 0.0 and half[1] == 0.0 and half[2] == 0.0


@lean_kernel
def out_of_cylinder(rows, place, sign, normal):
    """`least_way` of a point in a cylinder (sign 1), or of that around it (-1)."""
    local = stack_array(3, np.float64)
    for axis in range(3):
        local[axis] = 0.0
        for row in range(3):
            local[axis] += rows[AXES + axis, row] * (place[row] - rows[CENTRE, row])
    across = math.hypot(local[0], local[1])
    side, end = rows[HALF, 0] - across, rows[HALF, 2] - abs(local[2])
    for row in range(3):
        if end < side:
            normal[row] = math.copysign(sign, sign * local[2]) * rows[AXES + 2, row]
        elif across > 0.0:
            normal[row] = sign * (
                local[0] / across * rows[AXES, row] + local[1] / across * rows[AXES + 1, row]
            )
        else:
            normal[row] = sign * rows[AXES, row]
    return min(side, end)


@lean_kernel
def out_of_box(one, other, normal):
    """`least_way` of two boxes, either of which may be flat: along the axes of both, and across an
    edge of each.
    """
    direction, least = stack_array(3, np.float64), np.inf
    for line in range(LINES):
        if not fill_line(one, other, line, direction):
            continue
        reach, offset = 0.0, 0.0
        for axis in range(3):
            reach += one[HALF, axis] * abs(dot(one[AXES + axis], direction))
            reach += other[HALF, axis] * abs(dot(other[AXES + axis], direction))
            offset += direction[axis] * (one[CENTRE, axis] - other[CENTRE, axis])
        if reach - abs(offset) < least:
            least = reach - abs(offset)
            for row in range(3):
                normal[row] = -direction[row] if offset < 0.0 else direction[row]
    return least


# ---- Distances below 0: what of an answer changes where a point or shape reaches into an
# obstacle.


@lean_kernel
def out_of_aligned(lo, hi, low, high, normal):
    """The least distance by which a box, or point, from low to high has to move along an axis to
    leave the box from lo to hi, negative if it is outside; fill in the direction. Ties go to the
    lowest axis, and there upwards.
    """
    least, out, sign = np.inf, 0, 1.0
    for axis in range(lo.shape[0]):
        up, down = hi[axis] - low[axis], high[axis] - lo[axis]
        if min(up, down) < least:
            least, out, sign = min(up, down), axis, 1.0 if up <= down else -1.0
    for axis in range(3):
        normal[axis] = sign if axis == out else 0.0
    return least


@lean_kernel
def signed_distance_in_box(lo, hi, centre, found, row):
    """Where an axis-aligned box holds the centre, fill in how deep."""
    if found.distances[row] > 0.0:
        return
    normal = found.normals[row]
    found.distances[row] = 0.0 - out_of_aligned(lo, hi, centre, centre, normal)
    for axis in range(lo.shape[0]):
        if normal[axis] != 0.0:
            found.points[row, axis] = hi[axis] if normal[axis] > 0.0 else lo[axis]


@lean_kernel
def signed_distance_in_obstacle(bodies, slot, centre, found, row):
    """Where the obstacle of a slot holds the centre, fill in how deep."""
    if found.distances[row] > 0.0:
        return
    shape, ndim = bodies.shapes[slot], 3 if bodies.footprints is None else 2
    points = stack_array((2, 3), np.float64)
    if not shape.shaped:
        fill_corners(shape, points)
        signed_distance_in_box(points[0, :ndim], points[1, :ndim], centre, found, row)
        return
    normal = found.normals[row]
    depth = depth_in_obstacle(centre, shape, bodies.hulls, ndim == 2, points, normal)
    found.distances[row] = 0.0 - depth
    for axis in range(ndim):
        found.points[row, axis] = points[1, axis]


@lean_kernel
def depth_with_meshes(centre, shape, hulls, planar, points, normal):
    """`depth_of_point` where there are meshes: in a mesh it is the distance from the surface. Of
    one that is not convex, seen from above, it is inf, as `NO_DEPTH` says.
    """
    form = form_of(hulls, shape)
    if shape.kind != MESH or (planar and form == CONVEX):
        return depth_of_point(centre, shape, hulls, planar, points, normal)
    if planar:
        return -NO_DEPTH
    local, closest = stack_array(3, np.float64), points[1]
    for axis in range(3):
        local[axis] = points[0, axis] = centre[axis]
    to_frame(shape, False, local)
    depth, face = closest_triangle(surface_of(hulls, shape), local, closest)
    look_back(local, closest, 3, normal)  # before the world's frame rounds the two places
    if form == CONVEX:  # out across a face: next to that its normal has more digits
        for axis in range(3):
            normal[axis] = hulls.normals[hulls.spans[shape.mesh].faces[0] + face, axis]
    from_frame(shape, False, closest)
    rotate(shape.orientation, normal, 1.0)
    return depth


@chosen_by_types
def depth_in_obstacle(centre, shape, hulls, planar, points, normal):
    """How deep a point is in an obstacle that holds it."""
    return depth_of_point if isinstance(hulls, types.NoneType) else depth_with_meshes


# Instead of minus a depth, where a mesh that is not convex touches anything but a ball; seen from
# above, anything. The way out of its shadow, the union of those of its triangles, is not known:
# the nearest edge of a triangle may lie within another one.
NO_DEPTH = -np.inf


@lean_kernel
def ball_in_any(hulls, one, other, bodies, distance, points):
    """`signed_by_surface` where there are meshes of any form."""
    sign, ball, mesh, side = 1.0, one, other, 0
    place, towards = stack_array(3, np.float64), stack_array(3, np.float64)
    if form_of(hulls, other) == CONVEX:
        hulls, ball, mesh, side = bodies.query_hulls, other, one, 1
    form = form_of(hulls, mesh)
    if form == CONVEX:
        return np.inf
    if bodies.footprints is not None or ball.kind != SPHERE or form != SOLID:
        return distance if distance > 0.0 else NO_DEPTH
    for axis in range(3):
        place[axis] = ball.position[axis]
    to_frame(mesh, False, place)
    surface, closest = surface_of(hulls, mesh), points[1 - side]
    if holds_point(surface, place):
        sign = -1.0
    away = closest_on_surface(surface, place, closest)
    look_back(place, closest, 3, towards)  # before the world's frame rounds the two places
    from_frame(mesh, False, closest)
    rotate(mesh.orientation, towards, 1.0)
    radius = ball.half[0]
    for axis in range(3):
        points[side, axis] = ball.position[axis] + sign * radius * towards[axis]
    return sign * away - radius


@chosen_by_types
def signed_by_surface(hulls, one, other, bodies, distance, points):
    """Signed distance of a ball from the surface of a solid that is not convex, with the points
    that are so far apart. Of other pairs with such a mesh `distance` if it is above 0, else
    NO_DEPTH; inf if both are convex.
    """
    return ball_in_any if are_any(hulls) else no_surface


@inlined
def no_surface(hulls, one, other, bodies, distance, points):
    return np.inf


@lean_kernel
def signed_distance_of_shapes(one, other, bodies, distance, points):
    """Minus the depth of a shape in an obstacle where their distance is 0; then fill in the points
    of their surfaces that are so far apart.
    """
    signed = signed_by_surface(bodies.hulls, one, other, bodies, distance, points)
    if signed < np.inf:
        return signed
    if distance > 0.0:
        return distance
    planar, normal = bodies.footprints is not None, stack_array(3, np.float64)
    if one.shaped or other.shaped:
        return 0.0 - penetration(
            one, bodies.query_hulls, other, bodies.hulls, planar, points, normal
        )
    return 0.0 - box_depth(one, other, 2 if planar else 3, points, normal)


@lean_kernel
def box_depth(one, other, ndim, points, normal):
    """`penetration` of two axis-aligned boxes; across the way out, `points` are as
    `box_gap` left them.
    """
    corners = stack_array((4, 3), np.float64)
    fill_corners(one, corners[:2])
    fill_corners(other, corners[2:])
    depth = out_of_aligned(
        *(corners[2, :ndim], corners[3, :ndim]), *(corners[0, :ndim], corners[1, :ndim]), normal
    )
    for axis in range(ndim):
        if normal[axis] != 0.0:
            side = 1 if normal[axis] > 0.0 else 0
            points[0, axis], points[1, axis] = corners[1 - side, axis], corners[2 + side, axis]
    return depth
