# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The point of a simplex that is closest to the origin, with twice the digits of a double.

Next to the origin the closest point is a difference of nearly equal numbers: of the last digit of
the corners, 2**-53, a way of 2**-40 has its direction to four digits only, and where two long
edges or wide faces lie along each other, that is not enough to tell a gap from none. Here the
direction is right to 2**-53 wherever the corners themselves tell it. Every part of the simplex is
looked at, so that no wrong turn leads astray.

Rows of a simplex: the corner, and the point of the first solid in it.
"""

import math

import numpy as np

from ...tree.access import two_sum
from ...tree.compiler import lean_kernel, stack_array
from .double_double import cross2, dot2, over, plus, times

# Of lengths about 1: what the weights of a tetrahedron may miss the origin by. Of a flat one they
# have few digits; what they miss it by is known all the same, and this is well below `gjk.SLACK`.
NOTHING = 2.0**-50


@lean_kernel
def between(simplex, i, j, out):
    """Fill in the way from corner i to corner j."""
    for axis in range(3):
        out[axis, 0], out[axis, 1] = two_sum(simplex[j, axis], -simplex[i, axis])


@lean_kernel
def at_corner(simplex, i, out):
    for axis in range(3):
        out[axis, 0], out[axis, 1] = simplex[i, axis], 0.0


@lean_kernel
def at_weights(simplex, count, trial, point):
    """Fill in the sum of the corners with their weights."""
    for axis in range(3):
        place = np.float64(0.0), np.float64(0.0)
        for i in range(count):
            part = times((trial[i, 0], trial[i, 1]), (simplex[i, axis], 0.0))
            place = plus(place, part)
        point[axis, 0], point[axis, 1] = place


@lean_kernel
def over_edge(simplex, i, j, trial):
    """Weights of the point of an edge closest to the origin; false if that is one of its ends."""
    step, corner = stack_array((3, 2), np.float64), stack_array((3, 2), np.float64)
    between(simplex, i, j, step)
    at_corner(simplex, i, corner)
    square, along = dot2(step, step), dot2(corner, step)
    beyond = plus(square, along)  # by all digits: an end may be that near
    if not (along[0] < 0.0 < beyond[0]):
        return False
    share = over((-along[0], -along[1]), square)
    trial[:] = 0.0
    trial[j, 0], trial[j, 1] = share
    trial[i, 0], trial[i, 1] = plus((1.0, 0.0), (-share[0], -share[1]))
    return True


@lean_kernel
def over_triangle(simplex, i, j, k, trial, point):
    """Weights of the point of a triangle closest to the origin, and the point along its normal;
    false if that is not over its inside.
    """
    room = stack_array((6, 3, 2), np.float64)
    one, other, normal, corner, way, across = room[0], room[1], room[2], room[3], room[4], room[5]
    between(simplex, i, j, one)
    between(simplex, i, k, other)
    cross2(one, other, normal)
    square = dot2(normal, normal)
    if square[0] == 0.0:
        return False
    at_corner(simplex, i, corner)
    height = over(dot2(normal, corner), square)
    for axis in range(3):
        place = times((normal[axis, 0], normal[axis, 1]), height)
        point[axis, 0], point[axis, 1] = place
        way[axis, 0], way[axis, 1] = plus(place, (-simplex[i, axis], 0.0))
    cross2(way, other, across)
    second = over(dot2(normal, across), square)
    cross2(one, way, across)
    third = over(dot2(normal, across), square)
    rest = plus(second, third)
    first = plus((1.0, 0.0), (-rest[0], -rest[1]))
    trial[:] = 0.0
    trial[i, 0], trial[i, 1] = first
    trial[j, 0], trial[j, 1] = second
    trial[k, 0], trial[k, 1] = third
    return min(first[0], second[0], third[0]) >= 0.0


@lean_kernel
def around_origin(simplex, trial, point):
    """Weights of the corners of a tetrahedron that make the origin; false if it does not hold it,
    or is so flat that nobody can tell.
    """
    room = stack_array((4, 3, 2), np.float64)
    one, other, normal, corner = room[0], room[1], room[2], room[3]
    for i in range(4):
        j, k, m = (i + 1) % 4, (i + 2) % 4, (i + 3) % 4
        between(simplex, j, k, one)
        between(simplex, j, m, other)
        cross2(one, other, normal)
        at_corner(simplex, j, corner)
        between(simplex, j, i, other)
        here, inner = dot2(normal, corner), dot2(normal, other)
        if inner[0] == 0.0:
            return False
        trial[i, 0], trial[i, 1] = over((-here[0], -here[1]), inner)
        if not trial[i, 0] >= 0.0:
            return False
    at_weights(simplex, 4, trial, point)
    missed = max(abs(point[0, 0]), abs(point[1, 0]), abs(point[2, 0]))
    total = trial[0, 0] + trial[1, 0] + trial[2, 0] + trial[3, 0]
    return missed <= NOTHING and abs(total - 1.0) <= NOTHING


@lean_kernel
def closest(simplex, count, weights, point):
    """Fill in the closest point of a simplex and the weights of the corners that make it; return
    its squared distance.

    Of all candidates it is the one for which the plane across its way leaves the widest gap
    before all corners. Their distances would not tell: a way that is turned by an angle gets
    shorter by the square of it only, while the far corners move by the angle itself.
    """
    trial = stack_array((4, 2), np.float64)
    place, widest = stack_array((3, 2), np.float64), -np.inf
    if count == 4 and around_origin(simplex, trial, place):
        place[:] = 0.0
        accept(simplex, count, trial, place, widest, weights, point)
        return 0.0
    for i in range(count):
        trial[:] = 0.0
        trial[i, 0] = 1.0
        at_corner(simplex, i, place)
        widest = accept(simplex, count, trial, place, widest, weights, point)
        for j in range(i):
            if over_edge(simplex, i, j, trial):
                at_weights(simplex, count, trial, place)
                widest = accept(simplex, count, trial, place, widest, weights, point)
            for k in range(j):
                if over_triangle(simplex, i, j, k, trial, place):
                    widest = accept(simplex, count, trial, place, widest, weights, point)
    return dot2(point, point)[0]


@lean_kernel
def gap_before(simplex, count, place):
    """The gap that the plane across a way leaves before all corners; inf if there is no way."""
    length, widest = math.sqrt(dot2(place, place)[0]), np.inf
    if length > 0.0:
        for i in range(count):
            along = 0.0
            for axis in range(3):
                along += place[axis, 0] * simplex[i, axis]
            widest = min(widest, along / length)
    return widest


@lean_kernel
def accept(simplex, count, trial, place, widest, weights, point):
    """Take over a point whose plane leaves a wider gap."""
    gap = gap_before(simplex, count, place)
    if gap <= widest:
        return widest
    for i in range(4):
        weights[i, 0], weights[i, 1] = trial[i, 0], trial[i, 1]
    for axis in range(3):
        point[axis, 0], point[axis, 1] = place[axis, 0], place[axis, 1]
    return gap
