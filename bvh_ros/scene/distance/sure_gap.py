# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far two cores (see `gjk`) are apart, **with a proof**.

What GJK found is taken only with a certificate: a plane that leaves a gap (a lower bound), or a
point of each core (an upper bound), and for a distance both within SLACK of each other. What it
leaves open, because edges or faces lie along each other or the cores just touch, goes the sure
way: the same walk over simplices whose closest points are found with twice the digits, see
`sure_simplex`. On the differences of finitely many vertices it ends, and then both bounds agree.
Beside a round core `plane_search` finds the plane first, and the walk starts along its normal.
Where there is no plane, the corners that ruled out every normal hold the origin between them
(Farkas): the walk is over those, too, so that it ends at a point of both cores.
"""

import math

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from .gjk import corner_of, gap_bounds
from .plane_search import MOST_TRIALS, widest_gap
from .simplex import FIRST, SECOND, SLACK, dot
from .sure_simplex import closest

SURE_STEPS = 300  # a hundred are many
IDLE_STEPS = 10  # without a better bound: beside a round rim that is all that doubles tell
POOL = MOST_TRIALS + SURE_STEPS


@lean_kernel
def sure_bounds(one, other, limit, measured, way):
    """(low, high) around the distance of two cores, and whether that took more digits; `way` as
    in `gjk.gap_bounds`.

    Either the distance is proven to be above or not above `limit`, or the bounds agree; if it is
    to be `measured`, they agree wherever low is above the limit.
    """
    asked = np.nan if measured else limit
    low, high = gap_bounds(one, other, asked, way)
    if certain(low, high, limit, measured):
        return low, high, False
    enough = np.inf if measured else limit
    pool, pooled = stack_array((POOL, 6), np.float64), 0
    if one.is_round or other.is_round:
        start = stack_array(3, np.float64)
        for axis in range(3):
            start[axis] = way[axis]
        least = max(limit, 0.0)
        gap, pooled = widest_gap(one, other, start, least, enough, pool)
        if gap > least:
            low = max(low, gap)
            for axis in range(3):
                way[axis] = start[axis]
        if low > enough:
            return low, high, True
    below, above = walk((one, other), limit, enough, low, high, way, pool, pooled)
    return below, min(high, above), True


@lean_kernel
def certain(low, high, limit, measured):
    """Whether two bounds decide: see `sure_bounds`."""
    return high <= limit or high - low <= SLACK or (low > limit and not measured)


@lean_kernel
def walk(cores, limit, enough, low, best, way, pool, pooled):
    """`gjk.gap_bounds` with more digits, starting along `way`, until one of the bounds is above
    `enough` or not above `limit`, or they agree. `low` is known already; points closer than `best`
    are written to `way`.

    No corner is forgotten: the next is the best of those in `pool`, the newest among them. So it
    ends no farther off than the closest point of all that were ever seen.
    """
    simplex, normal = stack_array((4, 6), np.float64), stack_array(3, np.float64)
    weights, point = stack_array((4, 2), np.float64), stack_array((3, 2), np.float64)
    set_normal(way, normal)
    high, count, idle = np.inf, 0, 0
    for _ in range(SURE_STEPS):
        corner = pool[pooled]
        corner_of(*cores, normal, corner)
        along = dot(normal, corner)
        pooled += 1
        take_lowest(pool, pooled, normal, simplex[count])
        idle = 0 if along > low else idle + 1
        low = max(low, along)
        if low > enough or high - low <= SLACK or known(simplex, count) or idle > IDLE_STEPS:
            break
        count += 1
        distance = math.sqrt(closest(simplex, count, weights, point))
        count = keep_corners(simplex, count, weights, point, way, distance < min(high, best))
        if distance < high:
            high, idle = distance, 0
        if high <= limit or high == 0.0:
            break
        set_normal(way, normal)
    return min(low, high), high


@lean_kernel
def take_lowest(pool, pooled, normal, corner):
    """Fill in the corner of the pool that is farthest against a normal."""
    best, lowest = pooled - 1, dot(normal, pool[pooled - 1])
    for i in range(pooled - 1):
        height = dot(normal, pool[i])
        if height < lowest:
            best, lowest = i, height
    for axis in range(6):
        corner[axis] = pool[best, axis]


@lean_kernel
def set_normal(way, normal):
    """Fill in the unit vector along `way`; any if it is zero."""
    largest = max(abs(way[0]), abs(way[1]), abs(way[2]))
    exponent = math.frexp(largest)[1]
    for axis in range(3):
        normal[axis] = math.ldexp(way[axis], -exponent)
    if largest == 0.0:
        normal[0] = 1.0
    length = math.sqrt(dot(normal, normal))
    for axis in range(3):
        normal[axis] /= length


@lean_kernel
def known(simplex, count):
    """Whether the newest corner is one of the others."""
    for i in range(count):
        same = simplex[i, 0] == simplex[count, 0] and simplex[i, 1] == simplex[count, 1]
        if same and simplex[i, 2] == simplex[count, 2]:
            return True
    return False


@lean_kernel
def keep_corners(simplex, count, weights, point, way, closer):
    """Write down the closest point, and if it is `closer` the cores' points in it; keep the
    corners that make it, and return how many.
    """
    for axis in range(3):
        way[axis] = point[axis, 0]
        if closer:
            way[FIRST + axis] = 0.0
            for i in range(count):
                way[FIRST + axis] += weights[i, 0] * simplex[i, 3 + axis]
            way[SECOND + axis] = way[FIRST + axis] - point[axis, 0]
    kept = 0
    for i in range(count):
        if weights[i, 0] > 0.0:
            for axis in range(6):
                simplex[kept, axis] = simplex[i, axis]
            kept += 1
    return kept
