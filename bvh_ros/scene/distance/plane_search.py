# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The widest gap that a plane leaves between two solids: what decides where GJK cannot.

Beside a round rim GJK halves arcs until the corners of its simplices are so close together that
rounding turns their planes. This search knows no corners. Let corner(n) be the difference of the
solids' support points, as in `gjk`: a plane with the unit normal n leaves n . corner(n) between
them, so one of any length leaves more than g if n . corner(n) - g |n| > 0, and for no other n is
that more than n . (corner - g n / |n|) of this corner. So each normal that was tried rules out a
half-plane of others, itself among them; the next is tried in the middle of what remains. That is
the method of centres of gravity (Levin 1965, Newman 1965) in two dimensions: each trial leaves at
most 63 % of the area. It ends with a plane between the two, or when no plane can gain anything.

Normals are m + x s + y t, where s and t are across m. Any vector m between two points of the
solids makes an acute angle with each normal that leaves a gap.
"""

import math

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from .gjk import CENTRE, corner_of
from .simplex import dot

WIDEST = 32.0  # x and y at first: up to 88 degrees to the side
MOST_TRIALS = 120
ROOM = MOST_TRIALS + 4  # corners of a square, and one more with every cut
GAINED = 2.0**-52  # of lengths below 1


@lean_kernel
def fill_frame(one, other, way, frame):
    """Fill in s, t and m; s and t after Duff et al., "Building an Orthonormal Basis, Revisited",
    2017.

    m lies in the middle between `way`, which leads aside where that ends far from the gap, and
    the way between the centres, which does so where the cores are thin.
    """
    for axis in range(3):
        frame[0, axis] = one.rows[CENTRE, axis] - other.rows[CENTRE, axis]
    length, size = math.sqrt(dot(way, way)), math.sqrt(dot(frame[0], frame[0]))
    for axis in range(3):
        frame[2, axis] = way[axis] / length + (frame[0, axis] / size if size > 0.0 else 0.0)
    length = math.sqrt(dot(frame[2], frame[2]))
    x, y, z = frame[2, 0] / length, frame[2, 1] / length, frame[2, 2] / length
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    frame[0, 0], frame[0, 1], frame[0, 2] = 1.0 + sign * x * x * a, sign * x * y * a, -sign * x
    frame[1, 0], frame[1, 1], frame[1, 2] = x * y * a, sign + y * y * a, -y
    frame[2, 0], frame[2, 1], frame[2, 2] = x, y, z


@lean_kernel
def middle(polygon, count):
    """Centre of gravity of a convex polygon, from the triangles at its first corner."""
    area, x, y = 0.0, 0.0, 0.0
    for i in range(2, count):
        a, b = polygon[i - 1, 0] - polygon[0, 0], polygon[i - 1, 1] - polygon[0, 1]
        c, d = polygon[i, 0] - polygon[0, 0], polygon[i, 1] - polygon[0, 1]
        part = a * d - b * c
        area, x, y = area + part, x + part * (a + c), y + part * (b + d)
    if area <= 0.0:  # it is flat
        half = polygon[count // 2]
        return 0.5 * polygon[0, 0] + 0.5 * half[0], 0.5 * polygon[0, 1] + 0.5 * half[1]
    return polygon[0, 0] + x / (3.0 * area), polygon[0, 1] + y / (3.0 * area)


@lean_kernel
def clip(polygon, count, a, b, c, clipped):
    """Fill `clipped` with the part of a polygon where a + b x + c y > 0; return its corners."""
    kept = 0
    for i in range(count):
        x, y, u, v = polygon[i - 1, 0], polygon[i - 1, 1], polygon[i, 0], polygon[i, 1]
        if i == 0:
            x, y = polygon[count - 1, 0], polygon[count - 1, 1]
        before, here = a + b * x + c * y, a + b * u + c * v
        if (before > 0.0) != (here > 0.0):
            share = before / (before - here)
            clipped[kept, 0], clipped[kept, 1] = x + share * (u - x), y + share * (v - y)
            kept += 1
        if here > 0.0:
            clipped[kept, 0], clipped[kept, 1] = u, v
            kept += 1
    return kept


@lean_kernel
def widest_gap(one, other, way, least, enough, pool):
    """The widest gap between two cores (see `gjk`), or the first found above `enough`; `least`
    (not negative) if there is none above that. Then how many corners it wrote to `pool`, rows as
    those of a simplex in `gjk`: where no plane keeps the cores apart, these are why.

    `way` leads from a point of the other core to one of this; it becomes the vector across the
    gap.
    """
    frame = stack_array((3, 3), np.float64)
    normal, corner = stack_array(3, np.float64), stack_array(3, np.float64)
    pooled = 0
    polygon = stack_array((ROOM, 2), np.float64)
    clipped = stack_array((ROOM, 2), np.float64)
    fill_frame(one, other, way, frame)
    for i in range(4):
        polygon[i, 0] = WIDEST if i == 0 or i == 3 else -WIDEST
        polygon[i, 1] = WIDEST if i < 2 else -WIDEST
    count = 4
    for _ in range(MOST_TRIALS):
        x, y = middle(polygon, count)
        length = math.sqrt(1.0 + x * x + y * y)
        for axis in range(3):
            normal[axis] = (frame[2, axis] + x * frame[0, axis] + y * frame[1, axis]) / length
        corner_of(one, other, normal, pool[pooled])
        for axis in range(3):
            corner[axis] = pool[pooled, axis]
        pooled += 1
        gap = dot(normal, corner)
        if gap > least:
            least = gap
            for axis in range(3):
                way[axis] = gap * normal[axis]
        if least > enough:
            break
        for axis in range(3):
            corner[axis] -= least * normal[axis]
        a, b, c = dot(frame[2], corner) - GAINED, dot(frame[0], corner), dot(frame[1], corner)
        count = clip(polygon, count, a, b, c, clipped)
        polygon, clipped = clipped, polygon
        if count == 0:
            break
    return least, pooled
