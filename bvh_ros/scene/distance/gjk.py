# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far two convex solids are apart: GJK, and separating axes for two boxes."""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from ..shapes.mesh import farthest_vertex

# ---- Simplices of support points (see `gjk`): which of their points is closest to the origin.
#
# Rows of a simplex: a corner, which is a difference of a point of one core and one of the other,
# and the point of the one in it.

SLACK = 2.0**-48  # of lengths about 1: all that rounds support points, quaternions included
FIRST, SECOND, DIRECTION_ROOM = 3, 6, 9  # of what `gap_bounds` fills in


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
    size = 0
    for corner in range(count):
        if weights[corner] > 0.0:
            for axis in range(6):
                simplex[size, axis] = simplex[corner, axis]
            size += 1
    if size == 3:
        drop_onto_plane(simplex, point)
    return size, distance


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


# ---- How far two convex solids are apart, by the method of Gilbert, Johnson and Keerthi (1988).
#
# The distance of two solids is that of the origin from the set of all differences a - b of their
# points. GJK walks towards it on simplices (points, edges, triangles, tetrahedra) whose corners
# are support points: those of the set that are farthest along a direction. Each step gives two
# bounds: the point v of the simplex closest to the origin is a difference of two points of the
# solids, so they are no farther apart than |v|; and the whole set lies beyond the plane through
# the newest corner with normal v, so they are no nearer than v . corner / |v|. Both bounds hold
# to SLACK, wherever the walk ends; where they differ, `certified` goes on.
#
# A core is a solid without its rounding: a box, of which a sphere keeps the centre and a capsule
# the axis, a cylinder, or a mesh.

MOST_STEPS = 100
HANDED_ON = 16  # beside a cylinder: what is open then is for `widest_gap`
CONVERGED = 2.0**-48  # relative gap between the bounds' squares
HALF, AXES, CENTRE = 0, 1, 4
CORE_ROWS = 5


class Core(NamedTuple):
    """What is left of a solid without its rounding."""

    rows: Any
    """(CORE_ROWS, 3): half sizes (of a mesh the factor of its vertices, thrice); then the axes of
    its frame, one a row; then its centre.
    """
    is_round: Any
    """Whether it is a cylinder."""
    hull: Any
    """A mesh's `hull.Hull`, without vertices for other cores; None where there are no meshes."""


@lean_kernel
def support(rows, is_round, hull, direction, sign, out):
    """Add to `out` sign times the point of a `Core` that is farthest along -sign * direction.

    numba drops the branch of meshes where `hull` is an argument, and None.
    """
    half = rows[HALF]
    if hull is not None and hull.places.shape[0] > 0:
        support_hull(rows, hull, direction, sign, out)
        return
    across = 0.0
    if is_round:
        across = math.hypot(dot(rows[AXES], direction), dot(rows[AXES + 1], direction))
    for axis in range(3):
        along = -sign * dot(rows[AXES + axis], direction)
        place = math.copysign(half[axis], along)
        if is_round and axis < 2:
            place = half[axis] * along / across if across > 0.0 else 0.0
        for row in range(3):
            out[row] += sign * place * rows[AXES + axis, row]
    for row in range(3):
        out[row] += sign * rows[CENTRE, row]


@lean_kernel
def support_hull(rows, hull, direction, sign, out):
    """`support` of a mesh: the farthest of its vertices."""
    x, y, z = (
        dot(rows[AXES], direction),
        dot(rows[AXES + 1], direction),
        dot(rows[AXES + 2], direction),
    )
    best = farthest_vertex(hull, -sign * x, -sign * y, -sign * z)
    for row in range(3):
        place = 0.0
        for axis in range(3):
            place += hull.places[best, axis] * rows[AXES + axis, row]
        out[row] += sign * (place * rows[HALF, 0] + rows[CENTRE, row])


@lean_kernel
def corner_of(one, other, direction, corner):
    """Fill in a row of a simplex: the corner farthest against `direction`, and this core's
    point in it.
    """
    corner[:] = 0.0
    support(one.rows, one.is_round, one.hull, direction, 1.0, corner[3:])
    for axis in range(3):
        corner[axis] = corner[3 + axis]
    support(other.rows, other.is_round, other.hull, direction, -1.0, corner)


@lean_kernel
def gap_bounds(one, other, limit, point):
    """(low, high) around the distance of two cores; high is 0 and low at most 0 if they overlap.

    Apart from rounding they are equal, unless one of them says already on which side of `limit`
    the distance is (NaN: it is asked for itself), or GJK could not tell. `point` becomes the
    vector from the other core to this one found last; then the points of this core and of the
    other between which `high` is (if they overlap, one of both, twice).

    Rows of the simplex: the corner, and the point of this core in it.
    """
    simplex = stack_array((4, 6), np.float64)
    weights, trial = stack_array(4, np.float64), stack_array(4, np.float64)
    for axis in range(3):
        point[axis] = one.rows[CENTRE, axis] - other.rows[CENTRE, axis]
    if dot(point, point) == 0.0:  # any direction will do: the centre of a mesh need not lie in it
        point[0] = 1.0
    steps = MOST_STEPS
    if limit < np.inf and (one.is_round or other.is_round):
        steps = HANDED_ON
    low, high, count = -np.inf, np.inf, 0
    for _ in range(steps):
        corner = simplex[count]
        corner_of(one, other, point, corner)
        square, along = dot(point, point), dot(point, corner)
        if square == 0.0:
            return min(low, 0.0), 0.0
        low = max(low, along / math.sqrt(square))
        if low > limit or (count > 0 and square - along <= CONVERGED * square):
            break
        repeated = False
        for i in range(count):
            same = simplex[i, 0] == corner[0] and simplex[i, 1] == corner[1]
            repeated = repeated or (same and simplex[i, 2] == corner[2])
        if repeated:
            break
        count += 1
        inside = count == 4 and low <= 0.0 and holds_origin(simplex, weights)
        if inside and missed(simplex, weights) <= SLACK:
            weigh(simplex, count, weights, point)
            return low, 0.0
        count, length = keep_closest(simplex, count, weights, trial, point, high)
        high = min(high, length)
        if high <= limit:
            break
    return min(low, high), high


# ---- Whether a plane keeps two oriented boxes apart: the separating axes of Gottschalk, Lin and
# Manocha, "OBBTree", 1996.
#
# Two boxes are apart if and only if their shadows on one of 15 lines are: the three axes of
# each, and the cross products of an axis of one with an axis of the other. Boxes are cores, see
# `gjk`.

LINES = 15

# The gap along a cross product is known to slack / its length: down to this length, well enough.
NEARLY_PARALLEL = 2.0**-6
PARALLEL = 2.0**-48  # and here the axes of the boxes do all it could


@lean_kernel
def separation(one, other, slack):
    """(gap, sure): a gap between two boxes' shadows on one of the 15 lines, 0 if each gap is
    within `slack`; not `sure` if edges are so nearly parallel that their cross product says
    little. The boxes are at least `gap` apart.
    """
    turn = stack_array((3, 3), np.float64)  # the other's axes seen from one, in columns
    offset = stack_array(3, np.float64)
    for i in range(3):
        offset[i] = 0.0
        for row in range(3):
            offset[i] += one[AXES + i, row] * (other[CENTRE, row] - one[CENTRE, row])
        for j in range(3):
            turn[i, j] = 0.0
            for row in range(3):
                turn[i, j] += one[AXES + i, row] * other[AXES + j, row]
    gap = along_axes(one[HALF], other[HALF], turn, offset) - slack
    if gap > 0.0:
        return gap, True
    return along_crosses(one[HALF], other[HALF], turn, offset, slack)


@lean_kernel
def along_axes(half, other_half, turn, offset):
    """The widest gap along the axes of either box."""
    widest = -np.inf
    for i in range(3):
        apart, other_apart, along = abs(offset[i]) - half[i], -other_half[i], 0.0
        for j in range(3):
            apart -= abs(turn[i, j]) * other_half[j]
            other_apart -= abs(turn[j, i]) * half[j]
            along += turn[j, i] * offset[j]
        widest = max(widest, apart, other_apart + abs(along))
    return widest


@lean_kernel
def along_crosses(half, other_half, turn, offset, slack):
    """`separation` along the cross products.

    That of one's axis i and the other's axis j has, seen from one, the components 0, -turn[z, j]
    and turn[y, j] on i and the two axes y, z that follow it.
    """
    sure = True
    for i in range(3):
        y, z = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            reach = half[y] * abs(turn[z, j]) + half[z] * abs(turn[y, j])
            reach += other_half[k] * abs(turn[i, m]) + other_half[m] * abs(turn[i, k])
            apart = abs(offset[z] * turn[y, j] - offset[y] * turn[z, j]) - reach - slack
            across = math.sqrt(turn[y, j] * turn[y, j] + turn[z, j] * turn[z, j])
            if apart > 0.0 and across > PARALLEL:
                return apart / across, True
            sure = sure and not PARALLEL < across < NEARLY_PARALLEL
    return 0.0, sure


@lean_kernel
def fill_line(one, other, line, direction):
    """Fill in a unit vector along one of the 15 lines; false if there is none."""
    i, j = (line - 6) // 3, line % 3
    if line >= 6:
        return fill_cross(one[AXES + i], other[AXES + j], direction)
    for row in range(3):
        direction[row] = one[AXES + j, row] if line < 3 else other[AXES + j, row]
    return dot(direction, direction) > 0.0


@lean_kernel
def fill_cross(one, other, direction):
    """Fill in the unit vector across two; false if they are parallel. Nearly parallel ones leave
    it few digits: those across `one` are put right, as a long edge needs them, and those across
    `other` follow.
    """
    for turn in range(2):
        if turn == 0:
            for axis in range(3):
                y, z = (axis + 1) % 3, (axis + 2) % 3
                direction[axis] = one[y] * other[z] - one[z] * other[y]
        else:
            along = dot(one, direction)
            for axis in range(3):
                direction[axis] -= along * one[axis]
        size = math.sqrt(dot(direction, direction))
        if size == 0.0:
            return False
        for axis in range(3):
            direction[axis] /= size
    return True
