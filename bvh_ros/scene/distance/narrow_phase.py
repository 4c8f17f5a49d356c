# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two shapes: whether they touch, how far they are apart, and their closest points."""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import ALL, NONE, Near, no_plane32, pruning_limit, set_plane32
from ...tree.compiler import chosen_by_types, inlined, lean_kernel, stack_array
from ..shapes.footprint import closest_on_footprint
from ..shapes.hull import are_any, form_of, hull_of, hull_of_point, surface_of, triangle_hull
from ..shapes.mesh import CONVEX, SHELL, SOLID
from ..shapes.shape import BOX, CAPSULE, CYLINDER, MESH, SPHERE, fill_rotation, rotate, scale_of
from ..shapes.surface import WAITING, closest_between, closest_on_surface, holds_point, visit_near
from ..shapes.triangles32 import Extent
from .certified import certified_bounds, set_normal
from .gjk import (
    AXES,
    CENTRE,
    CORE_ROWS,
    DIRECTION_ROOM,
    FIRST,
    HALF,
    SECOND,
    SLACK,
    Core,
    dot,
    separation,
    support,
)

# ---- How far a point is from a mesh.


@lean_kernel
def hull_gap(hull, point, apart, normal):
    """Distance of a point from a convex mesh, 0 inside, by GJK; `apart` leads from its closest
    point there, and the unit vector `normal` across the plane that proves it: next to the mesh the
    direction between two points is noise, that vector is not.
    """
    ball = stack_array((CORE_ROWS, 3), np.float64)
    mesh = stack_array((CORE_ROWS, 3), np.float64)
    direction = stack_array(DIRECTION_ROOM, np.float64)
    largest = max(hull.radius, abs(point[0]), abs(point[1]), abs(point[2]))
    exponent = math.frexp(largest)[1]
    for row in range(CORE_ROWS):
        for axis in range(3):
            ball[row, axis] = mesh[row, axis] = 1.0 if row == AXES + axis else 0.0
    for axis in range(3):
        ball[CENTRE, axis] = math.ldexp(point[axis], -exponent)
    mesh[HALF, 0] = math.ldexp(1.0, -exponent)
    point_core, mesh_core = Core(ball, False, hull_of_point(hull)), Core(mesh, False, hull)
    high = certified_bounds(point_core, mesh_core, SLACK, True, direction)[1]
    for axis in range(3):
        apart[axis] = math.ldexp(direction[FIRST + axis] - direction[SECOND + axis], exponent)
    set_normal(direction, normal)
    if high <= SLACK:
        return 0.0
    return math.ldexp(high, exponent)


@lean_kernel
def closest_in_mesh(hulls, shape, point, out):
    """Fill `out` with the closest point of a shape's mesh, `point` itself inside; return the
    distance.
    """
    surface = surface_of(hulls, shape)
    if form_of(hulls, shape) != SHELL and holds_point(surface, point):
        for axis in range(3):
            out[axis] = point[axis]
        return 0.0
    return closest_on_surface(surface, point, out)


@lean_kernel
def closest_on_mesh(hulls, shape, scale, point, out):
    """`closest_in_mesh` of a mesh times scale."""
    place = stack_array(3, np.float64)
    for axis in range(3):
        place[axis] = point[axis] / scale
    closest_in_mesh(hulls, shape, place, out)
    for axis in range(3):
        out[axis] *= scale


# ---- The point of an obstacle that is closest to a query's centre, and how far it is.
#
# Far from the world's origin points are rounded more than distances. A planar scene is seen from
# above: z is that of the caller.


@lean_kernel
def length(vector):
    """Euclidean length; where squares would overflow or vanish scaled by a power of two, which
    changes no digit elsewhere.
    """
    largest, square = 0.0, 0.0
    for axis in range(vector.shape[0]):
        largest = max(largest, abs(vector[axis]))
        square += vector[axis] * vector[axis]
    if 1e-140 < largest < 1e140:
        return math.sqrt(square)
    exponent, square = math.frexp(largest)[1], 0.0
    for axis in range(vector.shape[0]):
        scaled = math.ldexp(vector[axis], -exponent)
        square += scaled * scaled
    return math.ldexp(math.sqrt(square), exponent)


@lean_kernel
def look_back(point, centre, ndim, normal):
    """Distance of a point from the centre along the first axes; fill in the unit vector to the
    centre, zero at it.
    """
    for axis in range(3):
        normal[axis] = centre[axis] - point[axis] if axis < ndim else 0.0
    distance = length(normal)
    if distance > 0.0:
        for axis in range(ndim):
            normal[axis] /= distance
    return distance


@lean_kernel
def closest_in_box(lo, hi, centre, point):
    """Fill in the coordinates along the box's axes."""
    for axis in range(lo.shape[0]):
        point[axis] = min(max(centre[axis], lo[axis]), hi[axis])


@lean_kernel
def closest_in_frame(shape, hulls, local, closest):
    """Fill in the point closest to `local` in the frame of a shape, where it lies at the origin;
    `local` itself inside.
    """
    half, away = shape.half, stack_array(3, np.float64)
    for axis in range(3):
        closest[axis] = min(max(local[axis], -half[axis]), half[axis])
    if shape.kind == BOX:
        return
    if shape.kind == MESH:
        if hulls is not None:
            closest_in_mesh(hulls, shape, local, closest)
        return
    if shape.kind == CYLINDER:
        shrink = half[0] / max(length(local[:2]), half[0])
        closest[0], closest[1] = local[0] * shrink, local[1] * shrink
        return
    straight = half[2] - half[0]  # of a capsule; of a sphere nothing
    level = min(max(local[2], -straight), straight)
    away[0], away[1], away[2] = local[0], local[1], local[2] - level
    far = length(away)
    shrink = half[0] / max(far, half[0])
    for axis in range(3):
        on_surface = away[axis] * shrink + (level if axis == 2 else 0.0)
        closest[axis] = on_surface if far > half[0] else local[axis]


@lean_kernel
def closest_in_shape(shape, hulls, centre, point):
    """Fill in the point of a turned or round shape closest to the centre; the centre itself
    inside. Return the distance.
    """
    matrix = stack_array((3, 3), np.float64)
    local, closest = stack_array(3, np.float64), stack_array(3, np.float64)
    fill_rotation(shape.orientation, matrix)
    for axis in range(3):
        local[axis] = (
            matrix[0, axis] * (centre[0] - shape.position[0])
            + matrix[1, axis] * (centre[1] - shape.position[1])
            + matrix[2, axis] * (centre[2] - shape.position[2])
        )
    closest_in_frame(shape, hulls, local, closest)
    inside = closest[0] == local[0] and closest[1] == local[1] and closest[2] == local[2]
    for axis in range(3):
        place = (matrix[axis, 0] * closest[0] + matrix[axis, 1] * closest[1]) + matrix[
            axis, 2
        ] * closest[2]
        point[axis] = centre[axis] if inside else place + shape.position[axis]
        local[axis] -= closest[axis]  # from here on the direction
    return length(local)


@lean_kernel
def closest_in_footprint(footprint, hulls, centre, point):
    """Fill in x and y of the point of a footprint closest to the centre; the centre's inside."""
    local, closest = stack_array(2, np.float64), stack_array(2, np.float64)
    largest = footprint.radius + footprint.straight + footprint.half_axes[1]
    for axis in range(2):
        largest = max(largest, abs(centre[axis]), abs(footprint.centre[axis]))
    scale = scale_of(largest)
    for axis in range(2):
        local[axis] = centre[axis] * scale - footprint.centre[axis] * scale
    inside = closest_on_footprint(footprint, hulls, scale, local, closest) == 0.0
    for axis in range(2):
        place = closest[axis] / scale + footprint.centre[axis]
        point[axis] = centre[axis] if inside else place


@inlined
def fill_corners(shape, corners):
    """Fill in the corners (2, 3) of an axis-aligned box: the same doubles that the tree holds."""
    for axis in range(3):
        corners[0, axis] = shape.position[axis] - shape.half[axis]
        corners[1, axis] = shape.position[axis] + shape.half[axis]


@lean_kernel
def closest_in_obstacle(shape, hulls, centre, point, normal):
    """Fill in the obstacle's point closest to the centre, and the unit vector from there to the
    centre; return the distance.
    """
    if shape.shaped:
        distance = closest_in_shape(shape, hulls, centre, point)
        look_back(point, centre, 3, normal)
        return distance
    corners = stack_array((2, 3), np.float64)
    fill_corners(shape, corners)
    closest_in_box(corners[0], corners[1], centre, point)
    return look_back(point, centre, 3, normal)


@lean_kernel
def closest_from_above(shape, footprint, hulls, centre, point, normal):
    """`closest_in_obstacle` seen from above; z of the point stays."""
    if shape.shaped:
        closest_in_footprint(footprint, hulls, centre, point)
    else:
        corners = stack_array((2, 3), np.float64)
        fill_corners(shape, corners)
        closest_in_box(corners[0, :2], corners[1, :2], centre, point)
    return look_back(point, centre, 2, normal)


# ---- Whether true shapes touch: the narrow phase, for any pair of kinds.
#
# Every shape is a `core` grown by a radius: of a sphere the core is its centre, of a capsule its
# axis. Growing by a tolerance is the same again, so corners come out round (the Minkowski sum
# with a ball). Two boxes are first tested for a separating plane; `certified` decides
# the rest. Seen from above they work on the shadows of the cores, whose axes and
# centres have z = 0.
#
# **The solid** is that of the stored doubles: position, half sizes, and the quaternion
# brought to unit length. Cores are seen from the position of one of the two, so that a pair far
# from the world's origin is as well known as one next to it. A pair has one order,
# whichever shape is the query: `ordered` gives it.
#
# **Touching counts, and so does a gap too small to certify**: shapes are apart only where a
# plane keeps them apart by more than SLACK of the largest length in play (how far their
# centres are apart, a half size, the tolerance), and to touch only where a point of one is as
# near to a point of the other. Axis-aligned boxes are decided exactly elsewhere, see `overlaps`.


@lean_kernel
def half_size(shape, axis, planar):
    """Half of a size of a shape. Seen from above its height counts only if it leans, as in
    `footprint.footprints`.
    """
    upright = shape.orientation[0] == 0.0 and shape.orientation[1] == 0.0
    return 0.0 if planar and upright and axis == 2 else shape.half[axis]


@lean_kernel
def largest_length(shape, origin, planar):
    """The largest coordinate or half size of a shape, seen from `origin`."""
    largest = 0.0
    for axis in range(3):
        largest = max(largest, half_size(shape, axis, planar))
        if axis < 2 or not planar:
            largest = max(largest, abs(shape.position[axis] - origin[axis]))
    return largest


@lean_kernel
def ordered(one, other):
    """Whether two shapes are in the order in which a pair is looked at."""
    if one.kind != other.kind:
        return one.kind < other.kind
    for axis in range(3):
        if one.position[axis] != other.position[axis]:
            return one.position[axis] < other.position[axis]
        if one.half[axis] != other.half[axis]:
            return one.half[axis] < other.half[axis]
    for axis in range(4):
        if one.orientation[axis] != other.orientation[axis]:
            return one.orientation[axis] < other.orientation[axis]
    return one.mesh <= other.mesh


@lean_kernel
def fill_core(shape, origin, exponent, planar, core):
    """Fill in the core of a shape, seen from `origin` and times 2**-exponent; return (whether it
    is round, radius by which it is grown).
    """
    for axis in range(3):
        half = 1.0 if shape.kind == MESH else half_size(shape, axis, planar)
        core[HALF, axis] = math.ldexp(half, -exponent)
        core[CENTRE, axis] = math.ldexp(shape.position[axis] - origin[axis], -exponent)
        for row in range(3):
            core[AXES + axis, row] = 1.0 if axis == row else 0.0
        if not (planar and shape.kind == MESH):  # a polygon, which is turned already
            rotate(shape.orientation, core[AXES + axis], 1.0)
    if planar:
        for row in range(AXES, CORE_ROWS):
            core[row, 2] = 0.0
    radius = 0.0
    if shape.kind == SPHERE or shape.kind == CAPSULE:
        radius = core[HALF, 0]
        for axis in range(3):
            core[HALF, axis] = max(core[HALF, axis] - radius, 0.0)
    return shape.kind == CYLINDER, radius


@lean_kernel
def fill_cores(one, hull, other, other_hull, planar, rows):
    """The cores of two shapes, seen from the place of the first and times 2**-exponent, by which
    the largest length in play is about 1: (cores, radii, exponent). `rows` is where they are put.
    """
    origin = one.position
    largest = max(largest_length(one, origin, planar), largest_length(other, origin, planar))
    exponent = math.frexp(largest)[1]
    round_one, radius = fill_core(one, origin, exponent, planar, rows[0])
    round_other, other_radius = fill_core(other, origin, exponent, planar, rows[1])
    cores = Core(rows[0], round_one, hull), Core(rows[1], round_other, other_hull)
    return cores, (radius, other_radius), exponent


@lean_kernel
def near_convex(one, hulls, other, other_hulls, tolerance, planar):
    """`near` of two convex shapes."""
    hull, other_hull = hull_of(hulls, one), hull_of(other_hulls, other)
    return near_hulls(one, hull, other, other_hull, tolerance, planar)


@lean_kernel
def near_hulls(one, hull, other, other_hull, tolerance, planar):
    """The same, with the vertices of their meshes."""
    if ordered(one, other):
        return ordered_near(one, hull, other, other_hull, tolerance, planar)
    return ordered_near(other, other_hull, one, hull, tolerance, planar)


@lean_kernel
def ordered_near(one, hull, other, other_hull, tolerance, planar):
    first = stack_array((CORE_ROWS, 3), np.float64)
    second = stack_array((CORE_ROWS, 3), np.float64)
    # As `fill_cores`, but what many boxes need not comes after them: 5 % of a turned overlap.
    origin = one.position
    largest = max(largest_length(one, origin, planar), largest_length(other, origin, planar))
    exponent = math.frexp(max(largest, tolerance))[1]
    round_one, radius = fill_core(one, origin, exponent, planar, first)
    round_other, other_radius = fill_core(other, origin, exponent, planar, second)
    reach = radius + other_radius + math.ldexp(tolerance, -exponent)
    boxes = not (round_one or one.kind == MESH or round_other or other.kind == MESH)
    if boxes and not planar:
        gap, sure = separation(first, second, SLACK)
        if gap > reach:
            return False, False
        if gap == 0.0 and sure:
            return True, False
    direction = stack_array(DIRECTION_ROOM, np.float64)
    limit = reach + SLACK
    cores = Core(first, round_one, hull), Core(second, round_other, other_hull)
    low, _, more_digits = certified_bounds(cores[0], cores[1], limit, False, direction)
    return low <= limit, more_digits


# ---- How far two shapes are apart, and which of their points are closest.


@lean_kernel
def gap_convex(one, hulls, other, other_hulls, planar, points):
    """`gap` of two convex shapes."""
    hull, other_hull = hull_of(hulls, one), hull_of(other_hulls, other)
    return gap_hulls(one, hull, other, other_hull, planar, points)


@lean_kernel
def gap_hulls(one, hull, other, other_hull, planar, points):
    """The same, with the vertices of their meshes."""
    if ordered(one, other):
        return ordered_gap(one, hull, other, other_hull, planar, points)
    distance = ordered_gap(other, other_hull, one, hull, planar, points)
    for axis in range(3):
        points[0, axis], points[1, axis] = points[1, axis], points[0, axis]
    return distance


@lean_kernel
def ordered_gap(one, hull, other, other_hull, planar, points):
    first = stack_array((CORE_ROWS, 3), np.float64)
    second = stack_array((CORE_ROWS, 3), np.float64)
    direction = stack_array(DIRECTION_ROOM, np.float64)
    cores, (radius, other_radius), exponent = fill_cores(
        *(one, hull, other, other_hull), planar, (first, second)
    )
    limit = radius + other_radius + SLACK
    low, high, _ = certified_bounds(cores[0], cores[1], limit, True, direction)
    apart = high if high - low <= SLACK else low
    touching = apart <= limit
    for axis in range(3):
        direction[axis] = direction[FIRST + axis] - direction[SECOND + axis]
    share, other_share = surfaces(
        radius, other_radius, math.sqrt(dot(direction, direction)), touching
    )
    for axis in range(3):
        points[0, axis] = direction[FIRST + axis] - share * direction[axis]
        points[1, axis] = direction[FIRST + axis] - other_share * direction[axis]
        for row in range(2):
            points[row, axis] = math.ldexp(points[row, axis], exponent) + one.position[axis]
    return 0.0 if touching else math.ldexp(apart - radius - other_radius, exponent)


@lean_kernel
def surfaces(radius, other_radius, length, touching):
    """Where the surfaces are on the direction from a point of one core to a point of the other, in
    shares of it; twice a point in both where they touch.
    """
    if touching:
        share = radius / max(radius + other_radius, length) if radius > 0.0 else 0.0
        return share, share
    return radius / length, 1.0 - other_radius / length


@lean_kernel
def box_gap(one, other, ndim, points):
    """`gap` of two axis-aligned boxes: between their faces, and in the middle where they face
    each other.
    """
    corners = stack_array((4, 3), np.float64)
    gaps = stack_array(3, np.float64)
    fill_corners(one, corners[:2])
    fill_corners(other, corners[2:])
    for axis in range(3):
        # Of what they have in common, if low <= high.
        low = max(corners[0, axis], corners[2, axis])
        high = min(corners[1, axis], corners[3, axis])
        gaps[axis] = max(low - high, 0.0) if axis < ndim else 0.0
        for row in range(2):
            if low <= high:
                points[row, axis] = low * 0.5 + high * 0.5
            elif corners[2 * row, axis] >= low:
                points[row, axis] = corners[2 * row, axis]
            else:
                points[row, axis] = corners[2 * row + 1, axis]
    return length(gaps)


# ---- Meshes that are not convex: triangle by triangle.
#
# Such a mesh touches what one of its triangles touches, and is as near as the nearest of them.
# Each is a convex mesh of three corners, so each comparison has its certificate. The tree of the
# mesh leaves out the triangles whose boxes are too far from the box of the other shape, both in
# the frame of the mesh. Of two such meshes each triangle of one is compared with those of the
# other.
#
# A solid that no surface comes near may still be inside another one. Then all of it is, part by
# part, so one corner of each part tells. Seen from above there is no such inside: the shadows of
# its faces cover all of a solid's shadow.

FRAMES = 2.0**-46  # of the lengths in play: more than what rounds a place from frame to frame


class Pair(NamedTuple):
    """Two shapes, the first of which has a mesh that is not convex."""

    one: Any
    hulls: Any
    other: Any
    other_hulls: Any
    planar: Any
    tolerance: Any
    points: Any
    """(2, 3): where the closest points are put."""
    face: Any
    """The triangle of the other mesh that is looked at; NONE for all of the other shape."""


@lean_kernel
def to_frame(shape, planar, place):
    """Bring a place into the frame of a shape; a mesh of a planar scene is turned already."""
    for axis in range(3):
        place[axis] -= shape.position[axis]
    if not (planar and shape.kind == MESH):
        rotate(shape.orientation, place, -1.0)


@lean_kernel
def from_frame(shape, planar, place):
    """Bring a place back."""
    if not (planar and shape.kind == MESH):
        rotate(shape.orientation, place, 1.0)
    for axis in range(3):
        place[axis] += shape.position[axis]


@lean_kernel
def fill_own_box(shape, hulls, face, box):
    """Fill in the box (2, 3) around a shape, or a triangle of its mesh, in its own frame."""
    for axis in range(3):
        box[0, axis], box[1, axis] = -shape.half[axis], shape.half[axis]
    if shape.kind == MESH:
        surface = surface_of(hulls, shape)
        if surface.corners.shape[0] == 0:  # a polygon, that of a convex mesh seen from above
            for row in range(surface.vertices.shape[0]):
                for axis in range(3):
                    place = surface.vertices[row, axis]
                    box[0, axis] = place if row == 0 else min(box[0, axis], place)
                    box[1, axis] = place if row == 0 else max(box[1, axis], place)
            return
        node = surface.root if face == NONE else 2 * face
        for axis in range(3):
            box[0, axis], box[1, axis] = surface.nodes[node].lo[axis], surface.nodes[node].hi[axis]


@lean_kernel
def fill_box_in_frame(pair, box):
    """Fill in the box (2, 3) around the other shape, or its triangle, in the first one's frame;
    return its `Extent`.
    """
    own, corner = stack_array((2, 3), np.float64), stack_array(3, np.float64)
    fill_own_box(pair.other, pair.other_hulls, pair.face, own)
    size = 0.0
    for axis in range(3):
        box[0, axis], box[1, axis] = np.inf, -np.inf
    for number in range(8):
        for axis in range(3):
            corner[axis] = own[number >> axis & 1, axis]
            size = max(size, abs(corner[axis]), abs(pair.other.position[axis]))
            size = max(size, abs(pair.one.position[axis]))
        from_frame(pair.other, pair.planar, corner)
        to_frame(pair.one, pair.planar, corner)
        for axis in range(3):
            box[0, axis] = min(box[0, axis], corner[axis])
            box[1, axis] = max(box[1, axis], corner[axis])
    for axis in range(3):
        box[0, axis] -= FRAMES * size
        box[1, axis] += FRAMES * size
    if pair.planar:  # seen from above, heights do not count
        box[0, 2], box[1, 2] = -np.inf, np.inf
    return extent_of(pair, own, FRAMES * size)


@lean_kernel
def extent_of(pair, own, doubt):
    """The `Extent` of the other shape, or its triangle, in the snapshot of the first one's mesh.
    `own` is the box around it in its own frame.
    """
    rows, half = stack_array((CORE_ROWS, 3), np.float64), stack_array(3, np.float64)
    unit = surface_of(pair.hulls, pair.one).wide.per_length
    is_round, radius = fill_core(pair.other, pair.one.position, 0, False, rows)
    for axis in range(3):
        half[axis] = 0.5 * (own[1, axis] - own[0, axis])
    # The middle of the box around a mesh need not be in the mesh.
    inner = -length(half) if pair.other.kind == MESH else min(half[0], half[1], half[2])
    for axis in range(3):
        half[axis] -= radius
        rotate(pair.one.orientation, rows[AXES + axis], -1.0)
    if is_round:  # its axis, grown by the radius of the cylinder
        radius, half[0], half[1] = half[0], 0.0, 0.0
    return Extent(
        times32(rows[AXES], half[0] * unit),
        times32(rows[AXES + 1], half[1] * unit),
        times32(rows[AXES + 2], half[2] * unit),
        np.float32((radius + 4.0 * doubt) * unit),
        np.float32((inner - 4.0 * doubt) * unit),
    )


@inlined
def times32(vector, factor):
    """A vector times a factor, in float32."""
    one, two, three = vector[0] * factor, vector[1] * factor, vector[2] * factor
    return np.float32(one), np.float32(two), np.float32(three)


class Plane(NamedTuple):
    """A plane that the other shape lies behind, as of `keeps_off`, in the frame of the mesh."""

    normal: Any
    """(3,) towards the other shape."""
    place: Any
    """(1,) where along the normal the other shape begins; -inf if unknown."""
    doubt: Any
    """By how much rounding may move it."""


@lean_kernel
def set_plane(pair, other_hull, towards, plane):
    """Set a `Plane` across a direction of the world, of any length."""
    rows, point = stack_array((CORE_ROWS, 3), np.float64), stack_array(3, np.float64)
    size = length(towards)
    plane.place[0] = -np.inf
    for axis in range(3):
        plane.normal[axis] = point[axis] = 0.0
    if not 0.0 < size < np.inf:
        return
    for axis in range(3):
        plane.normal[axis] = towards[axis] / size
    is_round, radius = fill_core(pair.other, pair.one.position, 0, False, rows)
    support(rows, is_round, other_hull, plane.normal, 1.0, point)
    plane.place[0] = dot(plane.normal, point) - radius
    rotate(pair.one.orientation, plane.normal, -1.0)


@inlined
def keeps_off(plane, places, limit):
    """Whether a plane keeps a triangle farther off than a limit."""
    highest = -np.inf
    for number in range(3):
        highest = max(highest, dot(plane.normal, places[number]))
    return plane.place[0] - highest - plane.doubt > limit


@inlined
def reach_plane(surface, plane, limit, above):
    """Leave out the boxes of triangles that `keeps_off` a limit."""
    set_plane32(surface.wide, plane.normal, plane.place[0] - plane.doubt - limit, above)


@lean_kernel
def lies_apart(pair, other_hull, places, plane, limit):
    """Whether the plane across the line from a triangle to the centre of the other shape keeps the
    two farther apart than a limit; `plane` is scratch.
    """
    centre, closest = stack_array(3, np.float64), stack_array(3, np.float64)
    for axis in range(3):
        centre[axis] = pair.other.position[axis]
    to_frame(pair.one, False, centre)
    closest_between(places[0], places[1], places[2], centre, closest)
    for axis in range(3):
        centre[axis] -= closest[axis]
    rotate(pair.one.orientation, centre, 1.0)
    set_plane(pair, other_hull, centre, plane)
    return keeps_off(plane, places, limit)


@inlined
def compare_triangle(pair, face, places, other_places, plane, above, touches, best):
    """Compare a triangle of the first mesh with the other convex shape, or its triangle:
    `touches`, None or True, says whether only contact counts. Returns what best[0] is to become.
    """
    surface = surface_of(pair.hulls, pair.one)
    hull = triangle_hull(pair.hulls, surface, face, places)
    if pair.face == NONE:
        other_hull = hull_of(pair.other_hulls, pair.other)
    else:
        other_surface = surface_of(pair.other_hulls, pair.other)
        other_hull = triangle_hull(pair.other_hulls, other_surface, pair.face, other_places)
    if touches is None:
        # Around the corner that is nearest, triangles differ by no more than rounding. Where that
        # may decide whether they touch, all are compared.
        limit, ties = best[0], 2.0 * plane.doubt
        if keeps_off(plane, places, limit - ties if limit > 2.0 * ties else limit):
            return np.inf
    else:
        limit = pair.tolerance
        if keeps_off(plane, places, limit):
            return np.inf
        if not pair.planar and lies_apart(pair, other_hull, places, plane, limit):
            reach_plane(surface, plane, limit, above)
            return np.inf
        is_near, _ = near_hulls(
            pair.one, hull, pair.other, other_hull, pair.tolerance, pair.planar
        )
        return 0.0 if is_near else np.inf
    points = stack_array((2, 3), np.float64)
    distance = gap_hulls(pair.one, hull, pair.other, other_hull, pair.planar, points)
    if distance < best[0]:
        for row in range(2):
            for axis in range(3):
                pair.points[row, axis] = points[row, axis]
        for axis in range(3):
            points[1, axis] -= points[0, axis]
        if not pair.planar:
            set_plane(pair, other_hull, points[1], plane)
            reach_plane(surface, plane, distance, above)
    return distance


class Compared(NamedTuple):
    """What `visit_nearest` hands on."""

    pair: Any
    touches: Any
    places: Any
    other_places: Any
    plane: Any
    """`Plane` across the line to the nearest triangle so far, or to the last one that `lies_apart`
    looked at."""
    above: Any
    """See `reach_plane`."""


@inlined
def _look_at_triangle(compared, query, leaf, square, best, count, limit):
    (pair, touches, places, other_places, plane, above), face = compared, np.int64(leaf >> 1)
    distance = compare_triangle(pair, face, places, other_places, plane, above, touches, best)
    if distance < best[0]:
        best[0] = distance
        limit = -1.0 if distance == 0.0 else pruning_limit(distance)
    return np.int64(1), limit


@inlined
def room_for(touches):
    """How many triangles wait: where only contact counts, the first one that touches ends it."""
    return WAITING if touches is None else 1


@lean_kernel
def visit_triangles(pair, touches, best):
    """Lower best[0] to the distance of the nearest triangle of the first mesh, or to 0 if one is
    within the tolerance.
    """
    places, box = stack_array((3, 3), np.float64), stack_array((2, 3), np.float64)
    other_places = stack_array((3, 3), np.float64)
    surface, extent = surface_of(pair.hulls, pair.one), fill_box_in_frame(pair, box)
    limit = best[0] if touches is None else pair.tolerance
    query = Near(box[0], box[1], 1, limit, ALL)
    doubt = surface.radius + pair.tolerance
    for row in range(2):
        for axis in range(3):
            doubt = max(doubt, abs(box[row, axis]))
    doubt *= FRAMES
    plane = Plane(stack_array(3, np.float64), stack_array(1, np.float64), doubt)
    above = stack_array(4, np.float32)
    no_plane32(above)
    plane.place[0] = -np.inf
    for axis in range(3):
        plane.normal[axis] = 0.0
    compared = Compared(pair, touches, places, other_places, plane, above)
    limit, room = pruning_limit(limit), room_for(touches)
    visit_near(compared, surface, query, best, limit, above, extent, room, _look_at_triangle)


@inlined
def _look_at_other(compared, query, leaf, square, best, count, limit):
    pair, touches, _, _, _, _ = compared
    one, hulls, other, other_hulls, planar, tolerance, points, _ = pair
    face = np.int64(leaf >> 1)
    single = Pair(other, other_hulls, one, hulls, planar, tolerance, points, face)
    before = best[0]
    visit_triangles(single, touches, best)
    if best[0] < before:
        limit = -1.0 if best[0] == 0.0 else pruning_limit(best[0])
        if touches is None:
            for axis in range(3):
                swap = points[0, axis]
                points[0, axis], points[1, axis] = points[1, axis], swap
    return np.int64(1), limit


@lean_kernel
def visit_both(pair, touches, best):
    """`visit_triangles` where the other mesh is not convex, either."""
    places, box = stack_array((3, 3), np.float64), stack_array((2, 3), np.float64)
    surface, extent = surface_of(pair.hulls, pair.one), fill_box_in_frame(pair, box)
    limit = best[0] if touches is None else pair.tolerance
    query = Near(box[0], box[1], 1, limit, ALL)
    above = stack_array(4, np.float32)
    no_plane32(above)
    compared = Compared(pair, touches, places, places, None, above)
    limit, room = pruning_limit(limit), room_for(touches)
    visit_near(compared, surface, query, best, limit, above, extent, room, _look_at_other)


@lean_kernel
def holds_part(one, hulls, other, other_hulls, place):
    """Whether a solid holds a corner of a part of the other shape, or its centre; fill in where
    that is.
    """
    if form_of(hulls, one) != SOLID:
        return False
    surface, local = surface_of(hulls, one), stack_array(3, np.float64)
    first, stop = 0, 1
    if other.kind == MESH:
        span = other_hulls.spans[other.mesh]
        first, stop = span.seeds[0], span.seeds[1]
    for row in range(first, stop):
        for axis in range(3):
            place[axis] = other_hulls.seeds[row, axis] if other.kind == MESH else 0.0
        from_frame(other, False, place)
        for axis in range(3):
            local[axis] = place[axis]
        to_frame(one, False, local)
        if holds_point(surface, local):
            return True
    return False


@lean_kernel
def compare(one, hulls, other, other_hulls, tolerance, planar, touches, points):
    """Distance of two shapes, of which one or both have meshes that are not convex; with `touches`
    0 or inf, as they are within the tolerance or not.
    """
    best, place = stack_array(1, np.float64), stack_array(3, np.float64)
    best[0], none = np.inf, np.int64(NONE)
    mine, theirs = form_of(hulls, one), form_of(other_hulls, other)
    if theirs == CONVEX:
        pair = Pair(one, hulls, other, other_hulls, planar, tolerance, points, none)
        visit_triangles(pair, touches, best)
    elif mine == CONVEX:
        pair = Pair(other, other_hulls, one, hulls, planar, tolerance, points, none)
        visit_triangles(pair, touches, best)
        if touches is None:
            for axis in range(3):
                swap = points[0, axis]
                points[0, axis], points[1, axis] = points[1, axis], swap
    else:
        pair = Pair(one, hulls, other, other_hulls, planar, tolerance, points, none)
        visit_both(pair, touches, best)
    if best[0] > 0.0 and not planar:
        contained = holds_part(one, hulls, other, other_hulls, place)
        if contained or holds_part(other, other_hulls, one, hulls, place):
            best[0] = 0.0
            if touches is None:
                for axis in range(3):
                    points[0, axis] = points[1, axis] = place[axis]
    return best[0]


@lean_kernel
def near_any(one, hulls, other, other_hulls, tolerance, planar):
    """`near` of shapes that may have meshes of any form."""
    if form_of(hulls, one) == CONVEX and form_of(other_hulls, other) == CONVEX:
        return near_convex(one, hulls, other, other_hulls, tolerance, planar)
    points = stack_array((2, 3), np.float64)
    found = compare(one, hulls, other, other_hulls, tolerance, planar, True, points)
    return found == 0.0, False


@lean_kernel
def gap_any(one, hulls, other, other_hulls, planar, points):
    """`gap` of shapes that may have meshes of any form."""
    if form_of(hulls, one) == CONVEX and form_of(other_hulls, other) == CONVEX:
        return gap_convex(one, hulls, other, other_hulls, planar, points)
    return compare(one, hulls, other, other_hulls, 0.0, planar, None, points)


# ---- Any two shapes.


@chosen_by_types
def near(one, hulls, other, other_hulls, tolerance, planar):
    """Whether two shapes (records of `columns.GEOMETRY`) are within `tolerance` of each other; and
    whether that took more digits.
    """
    return near_any if are_any(hulls) else near_convex


@chosen_by_types
def gap(one, hulls, other, other_hulls, planar, points):
    """Distance of two shapes, 0 if they touch; fill in the closest points, or twice a common
    one. It is the same from either side.
    """
    return gap_any if are_any(hulls) else gap_convex


@lean_kernel
def near_pairs(records, hulls, pairs, planar, found):
    """Fill in which pairs (m, 2) of shapes touch; return how many took more digits."""
    count = 0
    for i in range(pairs.shape[0]):
        one, other = records[pairs[i, 0]], records[pairs[i, 1]]
        found[i], more = near(one, hulls, other, hulls, 0.0, planar)
        count += more
    return count
