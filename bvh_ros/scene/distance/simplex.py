# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simplices of support points (see `gjk`): which of their points is closest to the origin.

Rows of a simplex: a corner, which is a difference of a point of one core and one of the other, and
the point of the one in it.
"""

import math

import numpy as np

from ...tree.compiler import lean_kernel

SLACK = 2.0**-48  # of lengths about 1: all that rounds support points, quaternions included
FIRST, SECOND, WAY_ROOM = 3, 6, 9  # of what `gjk.gap_bounds` fills in


@lean_kernel
def dot(one, other):
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@lean_kernel
def on_edge(simplex, i, j, trial):
    """Weights of the corners i and j at the edge's point closest to the origin."""
    along, length = 0.0, 0.0
    for axis in range(3):
        step = simplex[j, axis] - simplex[i, axis]
        along -= simplex[i, axis] * step
        length += step * step
    share = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    trial[:] = 0.0
    trial[j] = share
    trial[i] = 1.0 - share  # last: a point is an edge from itself to itself


@lean_kernel
def on_triangle(simplex, i, j, k, trial):
    """The same on a triangle; false if the closest point is not over its inside."""
    i, j, k = widest_first(simplex, i, j, k)
    a, b, c = 0.0, 0.0, 0.0
    for axis in range(3):
        normal = normal_part(simplex, i, j, k, axis)
        a += normal * over_edge(simplex, j, k, axis)
        b += normal * over_edge(simplex, k, i, axis)
        c += normal * over_edge(simplex, i, j, axis)
    total = a + b + c
    if a < 0.0 or b < 0.0 or c < 0.0 or total == 0.0:
        return False
    trial[:] = 0.0
    trial[i], trial[j], trial[k] = a / total, b / total, c / total
    return True


@lean_kernel
def over_edge(simplex, i, j, axis):
    """Component of the cross product of two corners, as that of one with the edge to the other:
    of corners close together that keeps its digits.
    """
    y, z = (axis + 1) % 3, (axis + 2) % 3
    return simplex[i, y] * (simplex[j, z] - simplex[i, z]) - simplex[i, z] * (
        simplex[j, y] - simplex[i, y]
    )


@lean_kernel
def widest_first(simplex, i, j, k):
    """Three corners in the same sense, first that from which the two shorter edges go: their cross
    product has the most digits.
    """
    a, b, c = 0.0, 0.0, 0.0
    for axis in range(3):
        one, two, three = simplex[i, axis], simplex[j, axis], simplex[k, axis]
        a, b, c = a + (two - three) ** 2, b + (three - one) ** 2, c + (one - two) ** 2
    if a >= b and a >= c:
        return i, j, k
    return (j, k, i) if b >= c else (k, i, j)


@lean_kernel
def normal_part(simplex, i, j, k, axis):
    """Component of the normal of three corners."""
    y, z = (axis + 1) % 3, (axis + 2) % 3
    return (simplex[j, y] - simplex[i, y]) * (simplex[k, z] - simplex[i, z]) - (
        simplex[j, z] - simplex[i, z]
    ) * (simplex[k, y] - simplex[i, y])


@lean_kernel
def holds_origin(simplex, weights):
    """Whether a tetrahedron does: seen from each corner, the origin is on the inner side.

    Fill in the weights of the corners that make the origin.
    """
    for i in range(4):
        j, k, m = widest_first(simplex, (i + 1) % 4, (i + 2) % 4, (i + 3) % 4)
        inner, here = 0.0, 0.0
        for axis in range(3):
            normal = normal_part(simplex, j, k, m, axis)
            inner += normal * (simplex[i, axis] - simplex[j, axis])
            here -= normal * simplex[j, axis]
        if inner == 0.0 or (here < 0.0) != (inner < 0.0):
            return False
        weights[i] = here / inner
    return True


@lean_kernel
def weigh(simplex, count, weights, point):
    """Fill in the points of the cores, from the corners' weights."""
    for axis in range(3):
        place, apart = 0.0, 0.0
        for corner in range(count):
            place += weights[corner] * simplex[corner, 3 + axis]
            apart += weights[corner] * simplex[corner, axis]
        point[FIRST + axis], point[SECOND + axis] = place, place - apart


@lean_kernel
def missed(simplex, weights):
    """By how much the corners with their weights, brought to a sum of 1, miss the origin."""
    total, square = weights[0] + weights[1] + weights[2] + weights[3], 0.0
    for corner in range(4):
        weights[corner] /= total
    for axis in range(3):
        place = 0.0
        for corner in range(4):
            place += weights[corner] * simplex[corner, axis]
        square += place * place
    return math.sqrt(square)


@lean_kernel
def drop_onto_plane(simplex, point):
    """The closest point of a triangle along its normal, where the triangle is wider than far.

    The weighted sum of its corners has a rounding error of their size: next to the origin that is
    noise, while the direction of the normal is good to the last digits.
    """
    i, j, k = widest_first(simplex, 0, 1, 2)
    normal_square, height, longest = 0.0, 0.0, 0.0
    for axis in range(3):
        normal = normal_part(simplex, i, j, k, axis)
        normal_square += normal * normal
        height += normal * simplex[i, axis]
        longest = max(longest, abs(simplex[j, axis] - simplex[k, axis]))
    if height != 0.0 and normal_square > dot(point, point) * longest * longest:
        for axis in range(3):
            point[axis] = normal_part(simplex, i, j, k, axis) * (height / normal_square)


@lean_kernel
def keep_closest(simplex, count, weights, trial, point, high):
    """Of a simplex keep the corners of the part that is closest to the origin, and its point.

    That part has the newest corner, the last. Return how many corners are left, and the
    distance; where that is below `high`, `weigh` its point.
    """
    best, newest = np.inf, count - 1
    for j in range(max(newest, 1)):
        on_edge(simplex, newest, j, trial)
        best = take_if_closer(simplex, count, weights, trial, point, best)
        for k in range(j):
            if on_triangle(simplex, newest, j, k, trial):
                best = take_if_closer(simplex, count, weights, trial, point, best)
    distance = math.sqrt(best)
    if distance < high:
        weigh(simplex, count, weights, point)
    kept = 0
    for corner in range(count):
        if weights[corner] > 0.0:
            for axis in range(6):
                simplex[kept, axis] = simplex[corner, axis]
            kept += 1
    if kept == 3:
        drop_onto_plane(simplex, point)
    return kept, distance


@lean_kernel
def take_if_closer(simplex, count, weights, trial, point, best):
    """Let `trial` be the weights and fill `point` if that is closer than `best`."""
    square = 0.0
    for axis in range(3):
        place = 0.0
        for corner in range(count):
            place += trial[corner] * simplex[corner, axis]
        square += place * place
    if square >= best:
        return best
    for corner in range(4):
        weights[corner] = trial[corner]
    for axis in range(3):
        point[axis] = 0.0
        for corner in range(count):
            point[axis] += trial[corner] * simplex[corner, axis]
    return square
