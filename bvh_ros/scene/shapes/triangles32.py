# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sixteen triangles of a mesh at once, in float32: how near they may be, and which a line may
cross, or a ball that is swept along it touch.

The box of a triangle may be much nearer than the triangle: of a fine mesh, tens of boxes are
nearer than the closest point, and a line meets three boxes for each triangle that it crosses. What
float32 tells of a triangle is a bound; float64 decides on the few triangles that are left.

Of many triangles the same holds: a tilted piece of a surface is far thinner than its box. So each
child of a wide node that is a node has a patch, in the place of a triangle's corners: a cylinder
around all triangles below it.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    DIRECTION,
    ORIGIN,
    at_most16,
    crossed16,
    least16,
    leaves_of,
    meet_boxes,
    meet_ray,
)
from ...tree.compiler import WIDTH, fma, inlined, lean_kernel, stack_array

# Of a distance in a snapshot's units, and of 1: twice what rounds it.
LOOSER = np.float32(2.0**-19)
TINY = np.float32(1e-30)
ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)


@inlined
def dot(a, b):
    return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2]))


@inlined
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def plus(a, share, step):
    return fma(share, step[0], a[0]), fma(share, step[1], a[1]), fma(share, step[2], a[2])


@inlined
def select(is_first, one, two):
    """One of two vectors, without a branch."""
    return (
        one[0] if is_first else two[0],
        one[1] if is_first else two[1],
        one[2] if is_first else two[2],
    )


@inlined
def on_edge(start, step):
    """The point of an edge that is closest to the origin."""
    share = -dot(start, step) / max(dot(step, step), TINY)
    return plus(start, min(max(share, ZERO), ONE), step)


@inlined
def closest(a, b, c):
    """About the point of a triangle that is closest to the origin."""
    u, v = minus(b, a), minus(c, a)
    point, other = on_edge(a, u), on_edge(a, v)
    point = select(dot(other, other) < dot(point, point), other, point)
    other = on_edge(b, minus(c, b))
    point = select(dot(other, other) < dot(point, point), other, point)
    uu, uv, vv, au, av = dot(u, u), dot(u, v), dot(v, v), dot(a, u), dot(a, v)
    s, t = fma(uv, av, -vv * au), fma(uv, au, -uu * av)
    area = fma(uu, vv, -uv * uv)
    per_area = ONE / max(area, TINY)
    foot = plus(plus(a, s * per_area, u), t * per_area, v)
    return select(min(s, t, area - s - t) >= ZERO, foot, point)


@inlined
def separation(a, b, c):
    """(What the distance of a triangle from the origin does not fall short of, up to rounding; a
    point of it, about the closest one; the inverse of its distance).

    The triangle lies beyond a plane across the line to any one point. The closest point makes that
    tight.
    """
    point = closest(a, b, c)
    inverse = ONE / np.sqrt(max(dot(point, point), TINY))
    return min(dot(a, point), dot(b, point), dot(c, point)) * inverse, point, inverse


@inlined
def corners_of(triangles, lane, place):
    """The corners of the triangle in a lane, as seen from a place."""
    x, y, z = lane, lane + WIDTH, lane + 2 * WIDTH
    a = triangles[x], triangles[y], triangles[z]
    b = triangles[x + 3 * WIDTH], triangles[y + 3 * WIDTH], triangles[z + 3 * WIDTH]
    c = triangles[x + 6 * WIDTH], triangles[y + 6 * WIDTH], triangles[z + 6 * WIDTH]
    return minus(a, place), minus(b, place), minus(c, place)


class Extent(NamedTuple):
    """How far a shape reaches from the middle of its box; lengths of the snapshot."""

    one: Any
    """The three half axes of a box."""
    two: Any
    three: Any
    radius: Any
    """By how much the box is to grow to hold the shape."""
    inner: Any
    """How much nearer than the middle the shape surely is."""


@inlined
def reach_of(extent, normal):
    """How far a shape reaches along a unit vector."""
    along = abs(dot(extent.one, normal)) + abs(dot(extent.two, normal))
    return along + abs(dot(extent.three, normal)) + extent.radius


@inlined
def bound_patch(triangles, lane, place, extent, slack):
    """(What the squared distance of a place, or of the shape around it, from the triangles in a
    patch does not fall short of; what it does not exceed): those of the cylinder's nearest and
    farthest points. A shape lies beyond a plane across the line to the nearest one.

    With e = 2**-24, and m for 1 + the largest coordinate of the place or the shape: place, center
    and corners are off by less than 6 e m, the height above the center by less than 12 e m, the
    distance from the axis by less than 30 e m. `slack` is 64 e m.
    """
    x, y, z = lane, lane + WIDTH, lane + 2 * WIDTH
    center = triangles[x], triangles[y], triangles[z]
    axis = triangles[x + 3 * WIDTH], triangles[y + 3 * WIDTH], triangles[z + 3 * WIDTH]
    half, radius = triangles[x + 6 * WIDTH] + slack, triangles[y + 6 * WIDTH] + slack
    step = minus(center, place)
    height = dot(step, axis)
    across = plus(step, -height, axis)
    above, radial = abs(height), np.sqrt(dot(across, across))
    low, near = max(above - half, ZERO), max(radial - radius, ZERO)
    high, far = above + half, radial + radius
    if extent is None:
        return low * low + near * near, high * high + far * far
    share = near / max(radial, TINY)
    towards = share * across[0], share * across[1], share * across[2]
    towards = plus(towards, math.copysign(low, height), axis)
    inverse = ONE / np.sqrt(max(low * low + near * near, TINY))
    normal = towards[0] * inverse, towards[1] * inverse, towards[2] * inverse
    slope = dot(normal, axis)
    flat = plus(normal, -slope, axis)
    reach = half * abs(slope) + radius * np.sqrt(dot(flat, flat)) + reach_of(extent, normal)
    low = max(dot(step, normal) - reach, ZERO)
    high = max(np.sqrt(high * high + far * far) - extent.inner, ZERO)
    return low * low, high * high


@inlined
def bound_children(wide, around, extent, node, lanes, nearest):
    """Leave out the lanes of a wide node whose triangles are surely too far away; `nearest`
    becomes the bits of squared distances that the others do not fall short of, and the limit no
    more than one that the nearest triangle surely does not exceed.

    `extent` is that of `around`: where it is None, the compiler leaves out what shapes need. It is
    inlined: to hand over all these arrays takes a third of the time.
    """
    squares, box, leaves = nearest.view(np.float32), around.box, leaves_of(wide, node)
    triangles = wide.triangles[node * (9 * WIDTH) : (node + 1) * (9 * WIDTH)]
    children = wide.children[node * WIDTH : (node + 1) * WIDTH]
    place = (box[0] + box[3]) * HALF, (box[1] + box[4]) * HALF, (box[2] + box[5]) * HALF
    largest = ONE
    for side in range(6):
        largest = max(largest, ONE + abs(box[side]))
    slack = LOOSER * largest
    if extent is not None:  # how far the shape reaches is rounded, too
        slack += slack
    limits = stack_array(WIDTH, np.float32)
    for lane in range(WIDTH):
        limits[lane] = np.inf
    if np.uint32(lanes & ~leaves) != np.uint32(0):
        for lane in range(WIDTH):
            low, high = bound_patch(triangles, lane, place, extent, slack + slack)
            is_node = children[lane] >= 0
            squares[lane] = max(squares[lane], low) if is_node else squares[lane]
            limits[lane] = high if is_node else limits[lane]
    if np.uint32(lanes & leaves) != np.uint32(0):
        for lane in range(WIDTH):
            low, point, inverse = separation(*corners_of(triangles, lane, place))
            low, high = low - slack, dot(point, point) * inverse + slack
            if extent is not None:
                normal = point[0] * inverse, point[1] * inverse, point[2] * inverse
                low, high = low - reach_of(extent, normal), high - extent.inner
            low, high = max(low, ZERO), max(high, ZERO)
            is_leaf = children[lane] < 0
            squares[lane] = max(squares[lane], low * low) if is_leaf else squares[lane]
            limits[lane] = high * high if is_leaf else limits[lane]
    around.limit[0] = min(around.limit[0], least16(limits))
    return np.uint32(lanes & at_most16(squares, 0, around.limit[0]))


@inlined
def meet_triangles(snapshot, around, node, nearest):
    """`meet_boxes` without what is surely too far away by `bound_children`."""
    lanes = meet_boxes(snapshot, around, node, nearest)
    if lanes == np.uint32(0):
        return lanes
    return bound_children(snapshot, around, around.extent, node, lanes, nearest)


# ---- the patch of a child: its triangles, and the cylinder around them


@lean_kernel
def fill_patches(planes, children, triangles, corners):
    """Fill in the patch of each child that is a node: its center, a unit vector along its axis,
    half its height, and its radius. `corners` is scratch.
    """
    for node in range(children.shape[0]):
        for lane in range(WIDTH):
            if children[node, lane] >= 0:
                count = corners_below(planes, children, triangles, children[node, lane], corners)
                fill_patch(corners, count, triangles[node, lane::WIDTH])


@lean_kernel
def corners_below(planes, children, triangles, node, corners):
    """Copy the corners of all triangles below a node, (3, n); return how many there are.

    Nodes lie in the order of breadth: on each level those below a node lie together.
    """
    first, last, count = np.int64(node), np.int64(node), 0
    while first <= last:
        begin, end = last + 1, last
        for below in range(first, last + 1):
            for lane in range(WIDTH):
                child = np.int64(children[below, lane])
                if child >= 0:
                    begin, end = (child if end == last else begin), child
                elif planes[below, lane] < np.inf:
                    for number in range(9):
                        row, corner = number % 3, count + number // 3
                        corners[row, corner] = triangles[below, number * WIDTH + lane]
                    count += 3
        first, last = begin, end
    return count


@inlined
def column(corners, k):
    return corners[0, k], corners[1, k], corners[2, k]


@lean_kernel
def fill_patch(corners, count, patch):
    """Fill in the patch around triangles, three corners each. Its axis is the sum of their
    normals, as long as twice their areas, each on the side of those before it.
    """
    axis, center, share = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0 / count
    for k in range(0, count, 3):
        a, b, c = column(corners, k), column(corners, k + 1), column(corners, k + 2)
        u, v = minus(b, a), minus(c, a)
        normal = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        axis = plus(axis, math.copysign(1.0, dot(axis, normal)), normal)
        center = plus(plus(plus(center, share, a), share, b), share, c)
    size = math.sqrt(dot(axis, axis))
    inverse = 1.0 / size if size > 0.0 else 0.0  # without an axis it is a ball
    axis = axis[0] * inverse, axis[1] * inverse, axis[2] * inverse
    lowest, highest, radius = np.inf, -np.inf, 0.0
    for k in range(count):
        step = minus(column(corners, k), center)
        height = dot(step, axis)
        across = plus(step, -height, axis)
        lowest, highest = min(lowest, height), max(highest, height)
        radius = max(radius, dot(across, across))
    center = plus(center, 0.5 * (lowest + highest), axis)
    for row in range(3):
        patch[row], patch[3 + row] = center[row], axis[row]
    patch[6], patch[7] = 0.5 * (highest - lowest), math.sqrt(radius)


# ---- triangles and balls


class Ball(NamedTuple):
    """A ball that is swept along a line; lengths of the mesh."""

    ray: Any
    """ORIGIN, and DIRECTION of length one."""
    radius: Any
    """What is no farther from the center may be touched."""


DOWN = np.float32(1.0 - 2.0**-19)
SLOPE = np.float32(2.0**-19)  # more than what rounds a slope
STEPS = 4  # with one or two, many triangles are left that the ball does not touch
# In the snapshot's units. What a ball touches is nearer: it begins within `FARTHEST_ORIGIN`.
NEVER = np.float32(1e8)


@lean_kernel
def bound_touches(wide, record, ball, node, lanes, nearest):
    """Leave out the lanes of a wide node whose triangles the ball surely does not touch within the
    limit of its record; `nearest` becomes the bits of where it surely touches no triangle yet.

    These are the steps of `shapes.approach_by`: from where the ball meets the first box it goes on
    until it touches a plane that keeps it off the triangle. There the next step begins.
    """
    entries, near, first = nearest.view(np.float32), np.uint32(0), np.float32(np.inf)
    triangles = wide.triangles[node * (9 * WIDTH) : (node + 1) * (9 * WIDTH)]
    children = wide.children[node * WIDTH : (node + 1) * WIDTH]
    for lane in range(WIDTH):
        first = min(first, entries[lane] if children[lane] < 0 else first)
    first *= DOWN
    s, far, start = np.float64(first) / record.unit, np.float32(0.0), stack_array(3, np.float32)
    for axis in range(3):
        place = ball.ray[ORIGIN, axis] + s * ball.ray[DIRECTION, axis]
        start[axis] = (place - wide.center[axis]) * wide.per_length
        far = max(far, abs(start[axis]))
    towards, radius = ball.ray[DIRECTION], np.float32(ball.radius * wide.per_length)
    origin = start[0], start[1], start[2]
    direction = np.float32(towards[0]), np.float32(towards[1]), np.float32(towards[2])
    unit, slack = np.float32(record.unit / wide.per_length), LOOSER * (ONE + far + radius)
    steps = stack_array(WIDTH, np.float32)  # how far the ball goes until it may touch
    for lane in range(WIDTH):
        steps[lane] = ZERO if children[lane] < 0 else NEVER
    for _ in range(STEPS):
        least = NEVER
        for lane in range(WIDTH):
            center = plus(origin, steps[lane], direction)
            gap, point, inverse = separation(*corners_of(triangles, lane, center))
            slope = dot(direction, point) * inverse
            step = max(gap - radius - slack, ZERO) / max(slope + SLOPE, TINY)
            steps[lane] = min(steps[lane] + step, NEVER)
        for lane in range(WIDTH):
            least = min(least, steps[lane])
        if (first + least * unit) * DOWN > record.limit:
            break
    for lane in range(WIDTH):
        bound = (first + steps[lane] * unit) * DOWN
        bound = max(entries[lane], bound) if children[lane] < 0 else entries[lane]
        bit = np.uint32(1) << np.uint32(lane)
        touched = (bound <= record.limit) & ((steps[lane] < NEVER) | (children[lane] >= 0))
        entries[lane] = bound
        near |= bit if touched else np.uint32(0)
    return np.uint32(lanes & near)


@inlined
def meet_touched(snapshot, query, node, nearest):
    """`meet_ray` for query = (ray, `Ball`), without the triangles that the ball surely does not
    touch.
    """
    ray, ball = query
    lanes = meet_ray(snapshot, ray, node, nearest)
    if np.uint32(lanes & leaves_of(snapshot, node)) == np.uint32(0):
        return lanes
    records, place = ray
    return bound_touches(snapshot, records[place[0]], ball, node, lanes, nearest)


# ---- triangles and lines
#
# Seen along the axis on which a line is steepest, and sheared so that the line is a point, the
# origin: it crosses what has the origin on one side of all edges (Woop, Benthin and Wald 2013,
# "Watertight Ray/Triangle Intersection"). In a snapshot's units the mesh lies within 1, and a line
# through it within 2 on the plane through the center. So with e = 2**-24 a sheared coordinate is
# off by less than 16 e, and a determinant of two corners no farther than m from the origin by less
# than 4 (16 e) m + 2 (16 e)**2 + 3 e m**2, where m is less than 8. `crossed16` allows for
# 2**-16 m + 2**-38.

LINE = 7  # numbers of a line
DEPTHS = 2 * WIDTH  # of `crossed16`
BEYOND = 2.0**-21  # of 1 and where a line begins: more than what rounds a depth


@inlined
def fill_line(snapshot, ray, line):
    """Fill in the numbers of a line, (LINE,) float32; return the axis on which it is steepest.

    Along each of the two axes after that, cyclically: how far the line goes for each step along
    it. The same: where it is on the plane through the center. Whether it goes up (1) or down (-1)
    its own axis; where it begins on that, times this; and more than what rounds a depth.
    """
    axis = 0
    for other in range(1, 3):
        if abs(ray[DIRECTION, other]) > abs(ray[DIRECTION, axis]):
            axis = other
    inverse, unit = 1.0 / ray[DIRECTION, axis], snapshot.per_length
    along = (ray[ORIGIN, axis] - snapshot.center[axis]) * unit
    for number in range(2):
        other = (axis + 1 + number) % 3
        slope = ray[DIRECTION, other] * inverse
        place = (ray[ORIGIN, other] - snapshot.center[other]) * unit - slope * along
        line[number], line[2 + number] = slope, place
    line[4] = math.copysign(1.0, inverse)
    line[5], line[6] = line[4] * along, BEYOND * (1.0 + abs(along))
    return axis


@inlined
def meet_crossed(snapshot, query, node, nearest):
    """`meet_ray` for query = (ray, (axis, numbers of its line)), without the triangles that the
    line surely does not cross.
    """
    ray, (axis, line) = query
    lanes, leaves = meet_ray(snapshot, ray, node, nearest), leaves_of(snapshot, node)
    if np.uint32(lanes & leaves) == np.uint32(0):
        return lanes
    depths = stack_array(DEPTHS, np.float32)
    return np.uint32(lanes & (crossed16(snapshot.triangles, node, axis, line, depths) | ~leaves))
