# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far two convex cores are apart, with a proof."""

import math

import numpy as np

from ...tree.access import two_product, two_sum
from ...tree.compiler import lean_kernel, stack_array
from .gjk import CENTRE, FIRST, SECOND, SLACK, corner_of, dot, gap_bounds

# ---- Numbers of twice the digits: the unrounded sum of two doubles, the second below the last
# digit of the first (Dekker, "A Floating-Point Technique for Extending the Available Precision",
# 1971).
#
# A number is a pair (high, low); a vector is an array (3, 2). Lengths are about 1.


@lean_kernel
def plus(a, b):
    total, error = two_sum(a[0], b[0])
    below, least = two_sum(a[1], b[1])
    total, error = two_sum(total, error + below)
    return two_sum(total, error + least)


@lean_kernel
def times(a, b):
    product, error = two_product(a[0], b[0])
    return two_sum(product, error + (a[0] * b[1] + a[1] * b[0]))


@lean_kernel
def over(a, b):
    share = a[0] / b[0]
    product = times(b, (share, 0.0))
    rest = plus(a, (-product[0], -product[1]))
    return two_sum(share, rest[0] / b[0])


@lean_kernel
def dot2(one, other):
    total = np.float64(0.0), np.float64(0.0)
    for axis in range(3):
        part = times((one[axis, 0], one[axis, 1]), (other[axis, 0], other[axis, 1]))
        total = plus(total, part)
    return total


@lean_kernel
def cross2(one, other, out):
    """Fill in the cross product."""
    for axis in range(3):
        y, z = (axis + 1) % 3, (axis + 2) % 3
        first = times((one[y, 0], one[y, 1]), (other[z, 0], other[z, 1]))
        second = times((one[z, 0], one[z, 1]), (other[y, 0], other[y, 1]))
        out[axis, 0], out[axis, 1] = plus(first, (-second[0], -second[1]))


# ---- The point of a simplex that is closest to the origin, with twice the digits of a double.
#
# Next to the origin the closest point is a difference of nearly equal numbers: of the last digit
# of the corners, 2**-53, a vector of 2**-40 has its direction to four digits only, and where two
# long edges or wide faces lie along each other, that is not enough to tell a gap from none. Here
# the direction is right to 2**-53 wherever the corners themselves tell it. Every part of the
# simplex is looked at, so that no wrong turn leads astray.
#
# Rows of a simplex: the corner, and the point of the first solid in it.

# Of lengths about 1: what the weights of a tetrahedron may miss the origin by. Of a flat one they
# have few digits; what they miss it by is known all the same, and this is well below `gjk.SLACK`.
ROUNDING_OF_WEIGHTS = 2.0**-50


@lean_kernel
def between(simplex, i, j, out):
    """Fill in the direction from corner i to corner j."""
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
    one, other, normal, corner, direction, across = (
        room[0],
        room[1],
        room[2],
        room[3],
        room[4],
        room[5],
    )
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
        direction[axis, 0], direction[axis, 1] = plus(place, (-simplex[i, axis], 0.0))
    cross2(direction, other, across)
    second = over(dot2(normal, across), square)
    cross2(one, direction, across)
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
    or is too flat to decide.
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
    return missed <= ROUNDING_OF_WEIGHTS and abs(total - 1.0) <= ROUNDING_OF_WEIGHTS


@lean_kernel
def closest_in_simplex(simplex, count, weights, point):
    """Fill in the closest point of a simplex and the weights of the corners that make it; return
    its squared distance.

    Of all candidates it is the one for which the plane across its direction leaves the widest gap
    before all corners. Their distances would not tell: a direction that is turned by an angle gets
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
    """The gap that the plane across a direction leaves before all corners; inf without one."""
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


# ---- The widest gap that a plane leaves between two solids: what decides where GJK cannot.
#
# Beside a round rim GJK halves arcs until the corners of its simplices are so close together
# that rounding turns their planes. This search knows no corners. Let corner(n) be the difference
# of the solids' support points, as in `gjk`: a plane with the unit normal n leaves n . corner(n)
# between them, so one of any length leaves more than g if n . corner(n) - g |n| > 0, and for no
# other n is that more than n . (corner - g n / |n|) of this corner. So each normal that was
# tried rules out a half-plane of others, itself among them; the next is tried in the middle of
# what remains. That is the method of centres of gravity (Levin 1965, Newman 1965) in two
# dimensions: each trial leaves at most 63 % of the area. It ends with a plane between the two,
# or when no plane can gain anything.
#
# Normals are m + x s + y t, where s and t are across m. Any vector m between two points of the
# solids makes an acute angle with each normal that leaves a gap.

WIDEST = 32.0  # x and y at first: up to 88 degrees to the side
MOST_TRIALS = 120
ROOM = MOST_TRIALS + 4  # corners of a square, and one more with every cut
GAINED = 2.0**-52  # of lengths below 1


@lean_kernel
def fill_frame(one, other, direction, frame):
    """Fill in s, t and m; s and t after Duff et al., "Building an Orthonormal Basis, Revisited",
    2017.

    m lies in the middle between two directions: `direction`, which leads aside where it ends far
    from the gap, and that between the centres, which does so where the cores are thin.
    """
    for axis in range(3):
        frame[0, axis] = one.rows[CENTRE, axis] - other.rows[CENTRE, axis]
    length, size = math.sqrt(dot(direction, direction)), math.sqrt(dot(frame[0], frame[0]))
    for axis in range(3):
        frame[2, axis] = direction[axis] / length + (frame[0, axis] / size if size > 0.0 else 0.0)
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
    corners = 0
    for i in range(count):
        x, y, u, v = polygon[i - 1, 0], polygon[i - 1, 1], polygon[i, 0], polygon[i, 1]
        if i == 0:
            x, y = polygon[count - 1, 0], polygon[count - 1, 1]
        before, here = a + b * x + c * y, a + b * u + c * v
        if (before > 0.0) != (here > 0.0):
            share = before / (before - here)
            clipped[corners, 0], clipped[corners, 1] = x + share * (u - x), y + share * (v - y)
            corners += 1
        if here > 0.0:
            clipped[corners, 0], clipped[corners, 1] = u, v
            corners += 1
    return corners


@lean_kernel
def widest_gap(one, other, direction, least, enough, pool):
    """The widest gap between two cores (see `gjk`), or the first found above `enough`; `least`
    (not negative) if there is none above that. Then how many corners it wrote to `pool`, rows as
    those of a simplex in `gjk`: where no plane keeps the cores apart, these are why.

    `direction` leads from a point of the other core to one of this. It becomes the vector across
    the gap.
    """
    frame = stack_array((3, 3), np.float64)
    normal, corner = stack_array(3, np.float64), stack_array(3, np.float64)
    pooled = 0
    polygon = stack_array((ROOM, 2), np.float64)
    clipped = stack_array((ROOM, 2), np.float64)
    fill_frame(one, other, direction, frame)
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
                direction[axis] = gap * normal[axis]
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


# ---- How far two cores (see `gjk`) are apart, **with a proof**.
#
# What GJK found is taken only with a certificate: a plane that leaves a gap (a lower bound), or
# a point of each core (an upper bound), and for a distance both within SLACK of each other. What
# it leaves open, because edges or faces lie along each other or the cores just touch, goes the
# sure way: the same walk over simplices whose closest points are found with twice the digits,
# see `closest_in_simplex`. On the differences of finitely many vertices it ends, and then both
# bounds agree. Beside a round core `widest_gap` finds the plane first, and the walk starts along
# its normal. Where there is no plane, the corners that ruled out every normal hold the origin
# between them (Farkas): the walk is over those, too, so that it ends at a point of both cores.

SURE_STEPS = 300  # a hundred are many
IDLE_STEPS = 10  # without a better bound: beside a round rim that is all that doubles tell
POOL = MOST_TRIALS + SURE_STEPS


@lean_kernel
def certified_bounds(one, other, limit, measured, direction):
    """(low, high) around the distance of two cores, and whether that took more digits;
    `direction` as in `gap_bounds`.

    Either the distance is proven to be above or not above `limit`, or the bounds agree; if it is
    to be `measured`, they agree wherever low is above the limit.
    """
    least = np.nan if measured else limit
    low, high = gap_bounds(one, other, least, direction)
    if decides(low, high, limit, measured):
        return low, high, False
    enough = np.inf if measured else limit
    pool, pooled = stack_array((POOL, 6), np.float64), 0
    if one.is_round or other.is_round:
        start = stack_array(3, np.float64)
        for axis in range(3):
            start[axis] = direction[axis]
        least = max(limit, 0.0)
        gap, pooled = widest_gap(one, other, start, least, enough, pool)
        if gap > least:
            low = max(low, gap)
            for axis in range(3):
                direction[axis] = start[axis]
        if low > enough:
            return low, high, True
    below, above = walk((one, other), limit, enough, low, high, direction, pool, pooled)
    return below, min(high, above), True


@lean_kernel
def decides(low, high, limit, measured):
    """Whether two bounds decide: see `sure_bounds`."""
    return high <= limit or high - low <= SLACK or (low > limit and not measured)


@lean_kernel
def walk(cores, limit, enough, low, best, direction, pool, pooled):
    """`gap_bounds` with more digits, starting along `direction`, until one of the bounds is above
    `enough` or not above `limit`, or they agree. `low` is known already; points closer than `best`
    are written to `direction`.

    No corner is forgotten: the next is the best of those in `pool`, the newest among them. So it
    ends no farther off than the closest point of all that were ever seen.
    """
    simplex, normal = stack_array((4, 6), np.float64), stack_array(3, np.float64)
    weights, point = stack_array((4, 2), np.float64), stack_array((3, 2), np.float64)
    set_normal(direction, normal)
    high, count, idle = np.inf, 0, 0
    for _ in range(SURE_STEPS):
        corner = pool[pooled]
        corner_of(*cores, normal, corner)
        along = dot(normal, corner)
        pooled += 1
        take_lowest(pool, pooled, normal, simplex[count])
        idle = 0 if along > low else idle + 1
        low = max(low, along)
        if low > enough or high - low <= SLACK or is_repeated(simplex, count) or idle > IDLE_STEPS:
            break
        count += 1
        distance = math.sqrt(closest_in_simplex(simplex, count, weights, point))
        count = keep_corners(simplex, count, weights, point, direction, distance < min(high, best))
        if distance < high:
            high, idle = distance, 0
        if high <= limit or high == 0.0:
            break
        set_normal(direction, normal)
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
def set_normal(direction, normal):
    """Fill in the unit vector along `direction`; any if it is zero."""
    largest = max(abs(direction[0]), abs(direction[1]), abs(direction[2]))
    exponent = math.frexp(largest)[1]
    for axis in range(3):
        normal[axis] = math.ldexp(direction[axis], -exponent)
    if largest == 0.0:
        normal[0] = 1.0
    length = math.sqrt(dot(normal, normal))
    for axis in range(3):
        normal[axis] /= length


@lean_kernel
def is_repeated(simplex, count):
    """Whether the newest corner is one of the others."""
    for i in range(count):
        same = simplex[i, 0] == simplex[count, 0] and simplex[i, 1] == simplex[count, 1]
        if same and simplex[i, 2] == simplex[count, 2]:
            return True
    return False


@lean_kernel
def keep_corners(simplex, count, weights, point, direction, closer):
    """Write down the closest point, and if it is `closer` the cores' points in it; keep the
    corners that make it, and return how many.
    """
    for axis in range(3):
        direction[axis] = point[axis, 0]
        if closer:
            direction[FIRST + axis] = 0.0
            for i in range(count):
                direction[FIRST + axis] += weights[i, 0] * simplex[i, 3 + axis]
            direction[SECOND + axis] = direction[FIRST + axis] - point[axis, 0]
    corners = 0
    for i in range(count):
        if weights[i, 0] > 0.0:
            for axis in range(6):
                simplex[corners, axis] = simplex[i, axis]
            corners += 1
    return corners
