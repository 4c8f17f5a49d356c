# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shadow of a leaning cylinder: an ellipse (its disc seen from above) drawn along a segment.

                     v
         __________________________
       /      |      |      |       \\        A rectangle, and two ellipses about the middles of
      (       |      +------|--------)-- u   its ends: they overlap, nothing slips between.
       \\______|_____________|_______/

In its own frame: u along the segment, v across, from the middle. An oval is (straight, a, b): half
the segment, and the half axes of the ellipse along u and v.
"""

import math

import numpy as np

from ...tree.compiler import inlined, lean_kernel

MOST_STEPS = 64
STILL = 1e-150  # a way along an axis that leads nowhere
POINT = 1e-70  # an ellipse that is one, from where one looks: squares would vanish


@inlined
def to_oval(along, vector):
    """A vector (x, y) in the oval's frame."""
    return vector[0] * along[0] + vector[1] * along[1], vector[1] * along[0] - vector[0] * along[1]


@inlined
def slab(place, rate, half):
    """(entry, leave) of a line into |place + s * rate| <= half."""
    if abs(rate) < STILL:
        return (-np.inf, np.inf) if abs(place) <= half else (np.inf, -np.inf)
    middle, width = -place / rate, abs(half / rate)
    return middle - width, middle + width


@lean_kernel
def cross_ellipse(a, b, x, y, way_x, way_y, slack):
    """(entry, leave) of a line into an ellipse, (inf, -inf) if it misses it by more than `slack`.

    The ellipse reaches hypot(a n_x, b n_y) along a unit vector n. So a line passes it or not as
    its distance from the centre is larger or smaller than that across it, which is as well known
    for the flattest of ellipses.
    """
    size, offset = math.hypot(b * way_x, a * way_y), abs(x * way_y - y * way_x)
    if offset > size + slack:
        return np.inf, -np.inf
    if size == 0.0:  # a needle along the line, or a point
        middle = -(x * way_x + y * way_y)
        return middle - b, middle + b
    over_x, over_y = b * way_x / size, a * way_y / size  # a unit vector, on the unit circle
    middle = -(x * (b * over_x / size) + y * (a * over_y / size))
    deep = 0.0  # in passing, by so many sizes perhaps that their ratio overflows
    if offset < size:
        deep = math.sqrt((size - offset) / size) * math.sqrt((size + offset) / size)
    half = a / size * b * deep
    return middle - half, middle + half


@lean_kernel
def cross_oval(oval, along, origin, direction, slack):
    """(entry, leave) of a line into an oval, (inf, -inf) if it misses it by more than `slack`."""
    straight, a, b = oval
    u, v = to_oval(along, origin)
    way_u, way_v = to_oval(along, direction)
    entry, leave = slab(u, way_u, straight)
    first, last = slab(v, way_v, b)
    entry, leave = max(entry, first), min(leave, last)
    if entry > leave:
        entry, leave = np.inf, -np.inf
    for side in (-straight, straight):
        first, last = cross_ellipse(a, b, u + side, v, way_u, way_v, slack)
        entry, leave = min(entry, first), max(leave, last)
    return entry, leave


@lean_kernel
def measure_oval(oval, point, normal):
    """`approach`'s measure, in the oval's frame: distances and the normal at the closest point."""
    straight, a, b = oval
    u, v = point[0], point[1]
    x, y = abs(u) - straight, abs(v)
    near_x, near_y, across_x, across_y = min(x, 0.0), min(y, b), 0.0, 1.0
    if x > 0.0:
        near_x, near_y, across_x, across_y = closest_on_ellipse(a, b, x, y)
    high = math.hypot(x - near_x, y - near_y)
    normal[0], normal[1] = math.copysign(across_x, u), math.copysign(across_y, v)
    low = across_x * x + across_y * y - math.hypot(a * across_x, b * across_y)
    return low, high


@lean_kernel
def closest_on_ellipse(a, b, x, y):
    """(x, y) of the point of a solid ellipse closest to a point in the first quadrant, and (x, y)
    of the unit normal at the rim there, or, from inside, next to there.

    Outside, (a^2 x / (t + a^2), b^2 y / (t + b^2)) with the t > 0 that puts it on the ellipse
    (Eberly, Distance from a Point to an Ellipse, 2013). What that is too large by falls and is
    convex, so Newton's steps from below end at the root, or where rounding lets them go no
    further; an inexact t still gives a point of the rim and the normal there.
    """
    far = math.hypot(x, y)
    if b <= POINT * far:
        return 0.0, 0.0, x / far if far > 0.0 else 0.0, y / far if far > 0.0 else 1.0
    inside = math.hypot(x / a, y / b) <= 1.0
    t = 0.0 if inside else max((x - a) * a, (y - b) * b, 0.0)
    for _ in range(0 if inside else MOST_STEPS):
        over_x, over_y = a * x / (t + a * a), b * y / (t + b * b)
        over = (over_x - 1.0) * (over_x + 1.0) + over_y * over_y
        fall = over_x * over_x / (t + a * a) + over_y * over_y / (t + b * b)
        following = t + 0.5 * over / fall
        if not following > t:
            break
        t = following
    over_x, over_y = a * x / (t + a * a), b * y / (t + b * b)
    size = math.hypot(over_x, over_y)
    if size == 0.0:
        return x, y, 0.0, 1.0
    over_x, over_y = over_x / size, over_y / size
    across_x, across_y = b * over_x, a * over_y
    size = math.hypot(across_x, across_y)
    across_x, across_y = across_x / size, across_y / size
    return (x, y, across_x, across_y) if inside else (a * over_x, b * over_y, across_x, across_y)
