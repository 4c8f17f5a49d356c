# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The least distance by which two overlapping cores can be parted: expanding polytopes (van den
Bergen, "Proximity Queries and Penetration Depth Computation on 3D Game Objects", 2001).

Let D be the set of all differences b - a of points of the other core and of this one. It holds the
origin where they overlap, and to move this core by m parts them if m is not inside D: the least
such m leads to the closest point of D's surface. A polytope with corners in D grows by the corner
of D that is farthest along the normal of its closest face. The face is nearer than D's surface,
the plane through the new corner farther: two bounds, and it ends when they agree.

Where faces are slivers, normals and sides take twice the digits; so the polytope stays convex. Its
faces always close: each edge belongs to two, once in either direction.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import two_sum
from ...tree.compiler import lean_kernel, stack_array
from .double_double import cross2, dot2
from .gjk import AXES, CENTRE, corner_of
from .separation import LINES, fill_line
from .simplex import SLACK, dot

MOST_CORNERS = 256  # of polyhedra few are needed, about round rims all where many sides are tied
MOST_FACES = 2 * MOST_CORNERS
SIDE_SURE = 2.0**-44  # of lengths about 1: nearer to a plane, doubles do not tell the side


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
def reach_in(one, other, way, corner):
    """Fill in the corner of D that is farthest along `way`; return how far that is."""
    both = stack_array(6, np.float64)
    corner_of(one, other, way, both)
    for axis in range(3):
        corner[axis] = -both[axis]
    return dot(way, corner)


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
        low, way = planes[closest, 3], planes[closest, :3]
        reach = reach_in(one, other, way, corners[number])
        if reach < high:
            high = reach
            for axis in range(3):
                normal[axis] = way[axis]
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
    way, corner, least = stack_array(3, np.float64), stack_array(3, np.float64), np.inf
    for line in range(LINES + 2):
        if line < LINES:
            some = fill_line(one.rows, other.rows, line, way)
        else:
            axis = one.rows[AXES + 2] if line == LINES else other.rows[AXES + 2]
            some = fill_aside(one.rows, other.rows, axis, way)
        for _ in range(2 if some else 0):
            reach = reach_in(one, other, way, corner)
            if reach < least:
                least = reach
                for row in range(3):
                    normal[row] = way[row]
            for row in range(3):
                way[row] = -way[row]
    return least


@lean_kernel
def fill_aside(one, other, axis, way):
    """Fill in the unit vector between the centres of two cores, across an axis; false if there is
    none.
    """
    for row in range(3):
        way[row] = one[CENTRE, row] - other[CENTRE, row]
    along = dot(way, axis)
    for row in range(3):
        way[row] -= along * axis[row]
    size = math.sqrt(dot(way, way))
    for row in range(3):
        way[row] = way[row] / size if size > 0.0 else 0.0
    return size > 0.0


@lean_kernel
def first_triangle(one, other, corners, normal):
    """Fill in three corners; false if D is a line, across which `normal` is then."""
    trial, way = stack_array((2, 3), np.float64), stack_array(3, np.float64)
    edge, widest = stack_array(3, np.float64), -1.0
    for axis in range(3):
        for side in range(2):
            for row in range(3):
                way[row] = (1.0 - 2.0 * side) * (row == axis)
            reach_in(one, other, way, trial[side])
        for row in range(3):
            way[row] = trial[1, row] - trial[0, row]
        if dot(way, way) > widest:
            widest = dot(way, way)
            for row in range(3):
                corners[0, row], corners[1, row] = trial[0, row], trial[1, row]
                edge[row] = way[row]
    widest = 0.0
    for turn in range(6):
        axis, sign = turn % 3, 1.0 - 2.0 * (turn // 3)
        y, z = (axis + 1) % 3, (axis + 2) % 3
        way[axis], way[y], way[z] = 0.0, sign * edge[z], -sign * edge[y]
        size = math.sqrt(dot(way, way))
        if size == 0.0 and widest > 0.0:
            continue
        for row in range(3):
            way[row] = way[row] / size if size > 0.0 else 1.0 * (row == axis)
        reach_in(one, other, way, trial[0])
        if widest == 0.0:
            for row in range(3):
                normal[row] = way[row]
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
    """Take in a corner: the faces that see it give way to those between their rim and it. Return
    how many faces there are then, 0 if there is no room.
    """
    faces, planes = polytope.faces, polytope.planes
    seen, kept = stack_array((MOST_FACES, 3), np.int64), 0
    many = 0
    for face in range(count):
        sees = is_above(polytope, face, polytope.corners[number])
        target = seen[many] if sees else faces[kept]
        for axis in range(3):
            target[axis] = faces[face, axis]
        if sees:
            many += 1
            continue
        for axis in range(4):
            planes[kept, axis] = planes[face, axis]
        kept += 1
    for face in range(many):
        for side in range(3):
            i, j = seen[face, side], seen[face, (side + 1) % 3]
            if has_edge(seen, many, j, i):
                continue
            if kept == MOST_FACES:
                return 0
            faces[kept, 0], faces[kept, 1], faces[kept, 2] = i, j, number
            set_plane(polytope, kept)
            kept += 1
    return kept


@lean_kernel
def has_edge(faces, count, i, j):
    """Whether one of some faces has the edge from i to j."""
    for face in range(count):
        for side in range(3):
            if faces[face, side] == i and faces[face, (side + 1) % 3] == j:
                return True
    return False
