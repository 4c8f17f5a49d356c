# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far two convex solids are apart, by the method of Gilbert, Johnson and Keerthi (1988).

The distance of two solids is that of the origin from the set of all differences a - b of their
points. GJK walks towards it on simplices (points, edges, triangles, tetrahedra) whose corners are
support points: those of the set that are farthest along a direction. Each step gives two bounds:
the point v of the simplex closest to the origin is a difference of two points of the solids, so
they are no farther apart than |v|; and the whole set lies beyond the plane through the newest
corner with normal v, so they are no nearer than v . corner / |v|. Both bounds hold to SLACK,
wherever the walk ends; where they differ, `sure_gap` goes on.

A core is a solid without its rounding: a box, of which a sphere keeps the centre and a capsule the
axis, a cylinder, or a mesh.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from ..geometry.farthest import farthest_vertex
from .simplex import SLACK, dot, holds_origin, keep_closest, missed, weigh

MOST_STEPS = 100
HANDED_ON = 16  # beside a cylinder: what is open then is for `plane_search`
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
def support(rows, is_round, hull, way, sign, out):
    """Add to `out` sign times the point of a `Core` that is farthest along -sign * way. (numba
    drops the branch of meshes where `hull` is an argument, and None.)
    """
    half = rows[HALF]
    if hull is not None and hull.places.shape[0] > 0:
        support_hull(rows, hull, way, sign, out)
        return
    across = 0.0
    if is_round:
        across = math.hypot(dot(rows[AXES], way), dot(rows[AXES + 1], way))
    for axis in range(3):
        along = -sign * dot(rows[AXES + axis], way)
        place = math.copysign(half[axis], along)
        if is_round and axis < 2:
            place = half[axis] * along / across if across > 0.0 else 0.0
        for row in range(3):
            out[row] += sign * place * rows[AXES + axis, row]
    for row in range(3):
        out[row] += sign * rows[CENTRE, row]


@lean_kernel
def support_hull(rows, hull, way, sign, out):
    """`support` of a mesh: the farthest of its vertices."""
    x, y, z = dot(rows[AXES], way), dot(rows[AXES + 1], way), dot(rows[AXES + 2], way)
    best = farthest_vertex(hull, -sign * x, -sign * y, -sign * z)
    for row in range(3):
        place = 0.0
        for axis in range(3):
            place += hull.places[best, axis] * rows[AXES + axis, row]
        out[row] += sign * (place * rows[HALF, 0] + rows[CENTRE, row])


@lean_kernel
def corner_of(one, other, way, corner):
    """Fill in a row of a simplex: the corner farthest against `way`, this core's point in it."""
    corner[:] = 0.0
    support(one.rows, one.is_round, one.hull, way, 1.0, corner[3:])
    for axis in range(3):
        corner[axis] = corner[3 + axis]
    support(other.rows, other.is_round, other.hull, way, -1.0, corner)


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
    if dot(point, point) == 0.0:  # any way will do: the centre of a mesh need not lie in it
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
        held = False
        for i in range(count):
            same = simplex[i, 0] == corner[0] and simplex[i, 1] == corner[1]
            held = held or (same and simplex[i, 2] == corner[2])
        if held:
            break
        count += 1
        held = count == 4 and low <= 0.0 and holds_origin(simplex, weights)
        if held and missed(simplex, weights) <= SLACK:
            weigh(simplex, count, weights, point)
            return low, 0.0
        count, length = keep_closest(simplex, count, weights, trial, point, high)
        high = min(high, length)
        if high <= limit:
            break
    return min(low, high), high
