# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How deep shapes that touch reach into each other: the least distance by which one of them has to
move until they only just touch, and which way.

Shapes are solids, meshes and footprints too. Their cores (see `gjk`) are apart, and their radii
overlap; or the cores overlap, and one has to be moved: boxes, points and segments along one of 15
lines (see `separation`), a point in a cylinder through its side or an end, all others as
`expanding_polytope` says. Between the cores, one moved that far and a bit, GJK then finds the
points: so they are of the shapes, and as far apart as the depth.
"""

import math

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from ..geometry.hull import hull_of, hull_of_point
from .expanding_polygon import polygon_depth
from .expanding_polytope import polytope_depth
from .gjk import AXES, CENTRE, CORE_ROWS, HALF, Core
from .narrow_phase import fill_core, fill_cores, largest_length, ordered
from .separation import LINES, fill_line
from .simplex import SECOND, SLACK, WAY_ROOM, dot
from .sure_gap import set_normal, sure_bounds

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
    cores, radii, exponent = fill_cores(*(one, hulls, other, other_hulls), planar, (first, second))
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
    way = stack_array(WAY_ROOM, np.float64)
    low, high, _ = sure_bounds(cores[0], cores[1], SLACK, True, way)
    set_normal(way, normal)
    depth = -high if high - low <= SLACK else -low
    if high <= SLACK:
        depth = max(least_way(cores[0], cores[1], planar, normal), 0.0)
    if is_point(cores[0]):
        for axis in range(3):
            way[SECOND + axis] = cores[0].rows[CENTRE, axis] + depth * normal[axis]
    elif high <= SLACK:
        part(cores, depth + BEYOND, normal, way)
    depth += radii[0] + radii[1]
    for axis in range(3):
        points[1, axis] = way[SECOND + axis] + radii[1] * normal[axis]
        points[0, axis] = points[1, axis] - depth * normal[axis]
    return depth


@lean_kernel
def part(cores, distance, normal, way):
    """`gjk.gap_bounds` fills in `way` once the first core has moved so far along a normal."""
    rows = stack_array((CORE_ROWS, 3), np.float64)
    for row in range(CORE_ROWS):
        for axis in range(3):
            rows[row, axis] = cores[0].rows[row, axis]
    for axis in range(3):
        rows[CENTRE, axis] += distance * normal[axis]
    moved = Core(rows, cores[0].is_round, cores[0].hull)
    sure_bounds(moved, cores[1], SLACK, True, way)


@lean_kernel
def least_way(one, other, planar, normal):
    """The least distance by which a core has to move to leave another; fill in which way."""
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
    way, least = stack_array(3, np.float64), np.inf
    for line in range(LINES):
        if not fill_line(one, other, line, way):
            continue
        reach, offset = 0.0, 0.0
        for axis in range(3):
            reach += one[HALF, axis] * abs(dot(one[AXES + axis], way))
            reach += other[HALF, axis] * abs(dot(other[AXES + axis], way))
            offset += way[axis] * (one[CENTRE, axis] - other[CENTRE, axis])
        if reach - abs(offset) < least:
            least = reach - abs(offset)
            for row in range(3):
                normal[row] = -way[row] if offset < 0.0 else way[row]
    return least
