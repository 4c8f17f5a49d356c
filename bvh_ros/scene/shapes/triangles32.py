# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sixteen triangles of a mesh at once, in float32: how near they may be.

The box of a triangle may be much nearer than the triangle: of a fine mesh, tens of boxes are
nearer than the closest point. What float32 tells of a triangle is a bound; float64 decides on the
few triangles that are left.
"""

import numpy as np

from ...tree.access import meet_boxes
from ...tree.compiler import WIDTH, inlined, lean_kernel

# Of a distance in a snapshot's units, and of 1: twice what rounds it.
LOOSER = np.float32(2.0**-19)
TINY = np.float32(1e-30)
ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)


@inlined
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def plus(a, share, step):
    return a[0] + share * step[0], a[1] + share * step[1], a[2] + share * step[2]


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
    s, t, area = uv * av - vv * au, uv * au - uu * av, uu * vv - uv * uv
    per_area = ONE / max(area, TINY)
    foot = plus(plus(a, s * per_area, u), t * per_area, v)
    return select(min(s, t, area - s - t) >= ZERO, foot, point)


@inlined
def distance_bound(a, b, c):
    """What the distance of a triangle from the origin does not fall short of, up to rounding.

    The triangle lies beyond a plane across the line to any one point. The closest point makes that
    tight.
    """
    point = closest(a, b, c)
    along = min(dot(a, point), dot(b, point), dot(c, point))
    return along / np.sqrt(max(dot(point, point), TINY))


@lean_kernel
def bound_triangles(wide, around, node, lanes, nearest):
    """Leave out the lanes of a wide node whose triangles are surely too far away; `nearest`
    becomes the bits of squared distances that the others do not fall short of.
    """
    squares, box, near = nearest.view(np.float32), around.box, np.uint32(0)
    triangles = wide.triangles[node * (9 * WIDTH) : (node + 1) * (9 * WIDTH)]
    children = wide.children[node * WIDTH : (node + 1) * WIDTH]
    place = (box[0] + box[3]) * HALF, (box[1] + box[4]) * HALF, (box[2] + box[5]) * HALF
    slack = LOOSER * (ONE + max(abs(place[0]), abs(place[1]), abs(place[2])))
    for lane in range(WIDTH):
        x, y, z = lane, lane + WIDTH, lane + 2 * WIDTH
        a = triangles[x], triangles[y], triangles[z]
        b = triangles[x + 3 * WIDTH], triangles[y + 3 * WIDTH], triangles[z + 3 * WIDTH]
        c = triangles[x + 6 * WIDTH], triangles[y + 6 * WIDTH], triangles[z + 6 * WIDTH]
        bound = distance_bound(minus(a, place), minus(b, place), minus(c, place))
        bound = max(bound - slack, ZERO)
        squares[lane] = bound * bound if children[lane] < 0 else squares[lane]
    for lane in range(WIDTH):
        bit = np.uint32(1) << np.uint32(lane)
        near |= bit if squares[lane] <= around.limit else np.uint32(0)
    return np.uint32(lanes & near)


@inlined
def meet_triangles(snapshot, around, node, nearest):
    """`meet_boxes` for a point, without the triangles that are surely too far away."""
    lanes, leaves = meet_boxes(snapshot, around, node, nearest), np.uint32(0)
    children = snapshot.children[node * WIDTH : (node + 1) * WIDTH]
    for lane in range(WIDTH):
        leaves |= np.uint32(children[lane] < 0) << np.uint32(lane)
    if np.uint32(lanes & leaves) == np.uint32(0):
        return lanes
    return bound_triangles(snapshot, around, node, lanes, nearest)
