# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A thin ray, or a disc swept along it, against one footprint: `contact` in two dimensions.

Everything is relative to the footprint's centre. An axis-aligned rectangle is met by its corners
in the tree, which are exact.
"""

import math

import numpy as np

from ...tree.access import DIRECTION, INSIDE, ORIGIN, intersect_exact
from ...tree.compiler import lean_kernel
from ..shapes.footprint import (
    FACE,
    ROUND,
    closest_on_footprint,
    closest_on_polygon,
    corner_of,
    cross_oval,
    cross_polygon,
    edge_of,
    look_out_of_oval,
    measure_oval,
    oval_of,
    rim_of,
    slab,
    to_oval,
)
from ..shapes.shape import length, scale_of
from .shapes import (
    COORDINATES,
    FRAME_SLACK,
    Frame,
    approach_by,
    enter_rounded_box,
    enter_sphere,
    point_along,
    reach_of,
    time_of,
)

# ---- a polygon that a disc grows


@lean_kernel
def enter_rounded_rim(rim, origin, direction, radius, reach, offset):
    """Where a ray from outside enters a grown polygon. That is covered by discs about the corners,
    rectangles on the edges, as thick as the discs, and the polygon itself; the ray enters where it
    first meets one.
    """
    best = np.inf
    for i in range(rim.corners.shape[0]):
        x, y = corner_of(rim, i)
        offset[0], offset[1] = origin[0] - x, origin[1] - y
        x, y = edge_of(rim, i)
        edge = math.hypot(x, y)
        if edge == 0.0 and i > 0:
            continue
        best = min(best, enter_sphere(offset, direction, radius, reach)[0])
        if edge == 0.0:
            continue
        x, y = x / edge, y / edge
        facing = direction[0] * y - direction[1] * x  # the outward normal is (y, -x)
        if facing < 0.0:
            along, rate = offset[0] * x + offset[1] * y, direction[0] * x + direction[1] * y
            entry, leave = slab(along - 0.5 * edge, rate, 0.5 * edge)
            first, last = slab(offset[0] * y - offset[1] * x, facing, radius)
            entry = max(entry, first, 0.0)
            if entry <= min(leave, last, reach):
                best = min(best, entry)
    return best


# ---- one footprint


approach_oval = approach_by(measure_oval)


@lean_kernel
def to_centre(footprint, lo, hi, ray, radius, local):
    """Fill `local` with origin and unit direction as seen from the centre; return the `Frame`."""
    largest, size = 0.0, max(radius, footprint.largest if footprint.shaped else 0.0)
    for axis in range(2):
        largest = max(largest, abs(ray[ORIGIN, axis]), abs(lo[axis]), abs(hi[axis]))
        size = max(size, hi[axis] * 0.5 - lo[axis] * 0.5)
    scale = scale_of(max(largest, size))
    size *= scale
    for axis in range(2):
        local[0, axis] = ray[ORIGIN, axis] * scale
        if footprint.shaped:
            local[0, axis] -= footprint.centre[axis] * scale
        size = max(size, abs(local[0, axis]))
    pace = point_along(ray, scale, local[1, :2])
    return Frame(pace, scale, FRAME_SLACK * size + COORDINATES * (largest * scale))


@lean_kernel
def enter_footprint(footprint, hulls, pair, radius, t_max, work):
    """(t, feature) as `contact.enter_shape`.

    The feature of a thin ray is FACE and the edge of a polygon that is entered, or ROUND.
    """
    ray, lo, hi = pair
    if not footprint.shaped and radius == 0.0:
        hit, t, axis = intersect_exact(lo, hi, ray, t_max)
        return (t if hit else np.inf), axis
    frame = to_centre(footprint, lo, hi, ray, radius, work)
    origin, direction, ball = work[0, :2], work[1, :2], radius * frame.scale
    reach = reach_of(t_max, frame.pace)
    if not footprint.shaped:
        low, high = work[2, :2], work[3, :2]
        for axis in range(2):
            low[axis], high[axis] = lo[axis] * frame.scale, hi[axis] * frame.scale
        s, feature = enter_rounded_box(origin, direction, low, high, ball, reach)
    elif footprint.oval and ball > 0.0:
        s, feature = enter_rounded_oval(footprint, frame, ball, reach, work)
    elif ball + footprint.radius > 0.0:
        ball += footprint.radius * frame.scale
        s, feature = enter_rounded_polygon(footprint, hulls, frame, ball, reach, work)
        if s == np.inf:
            ball += frame.slack
            s, feature = enter_rounded_polygon(footprint, hulls, frame, ball, reach, work)
    else:
        s, feature = enter_thin(footprint, hulls, frame, reach, work)
    return time_of(s, frame.pace, t_max), feature


@lean_kernel
def enter_thin(footprint, hulls, frame, reach, work):
    """(s, feature) of a thin ray. Where its line crosses the footprint, but before the ray or
    beyond it, the end of the ray that is next to there may touch it.
    """
    origin, direction, place, closest = work[0, :2], work[1, :2], work[2, :2], work[3, :2]
    place[0], place[1] = direction[0], direction[1]
    if direction[0] == 0.0 and direction[1] == 0.0:  # a point: any line through it
        place[0], reach = 1.0, 0.0
    feature = np.int64(ROUND)
    if footprint.oval:
        oval = oval_of(footprint, frame.scale)
        entry, leave = cross_oval(oval, footprint.along, origin, place, frame.slack)
    else:
        rim = rim_of(footprint, hulls, frame.scale)
        entry, leave, feature = cross_polygon(rim, origin, place, frame.slack)
    if entry > leave or entry <= 0.0 <= leave:
        return (np.inf if entry > leave else 0.0), np.int64(INSIDE)
    if 0.0 < entry <= reach:
        return entry, feature
    s = reach if entry > 0.0 else 0.0
    for axis in range(2):
        place[axis] = origin[axis] + s * direction[axis]
    gap = closest_on_footprint(footprint, hulls, frame.scale, place, closest)
    return (s if gap <= frame.slack else np.inf), (feature if s > 0.0 else np.int64(INSIDE))


@lean_kernel
def enter_rounded_polygon(footprint, hulls, frame, ball, reach, work):
    """(s, feature) of a disc, or of a thin ray against a disc or capsule."""
    origin, direction, closest = work[0, :2], work[1, :2], work[2, :2]
    rim = rim_of(footprint, hulls, frame.scale)
    if closest_on_polygon(rim, origin, closest) <= ball:
        return 0.0, np.int64(INSIDE)
    s = enter_rounded_rim(rim, origin, direction, ball, reach, closest)
    return s, np.int64(ROUND)


@lean_kernel
def enter_rounded_oval(footprint, frame, ball, reach, work):
    """(s, feature) of a disc."""
    local, along = work[:, :2], footprint.along
    for row in range(2):
        local[row, 0], local[row, 1] = to_oval(along, local[row])
    oval = oval_of(footprint, frame.scale)
    s, _ = approach_oval(oval, ball, reach, frame.slack, local)
    return s, np.int64(INSIDE if s == 0.0 else ROUND)


@lean_kernel
def look_out(footprint, hulls, scale, point, normal, closest):
    """`look_out_of_oval` of any footprint; of a polygon the direction from its rim, which is zero
    or noise at it.
    """
    if footprint.oval:
        return look_out_of_oval(footprint, scale, point, normal, closest)
    closest_on_polygon(rim_of(footprint, hulls, scale), point, closest)
    normal[0], normal[1] = point[0] - closest[0], point[1] - closest[1]
    return closest_on_footprint(footprint, hulls, scale, point, closest)


@lean_kernel
def touch_footprint(footprint, hulls, pair, hit, radius, work, point, normal):
    """Fill in the footprint's point that is met by a hit (t, feature), and the outward normal.

    The normal of a disc is zero where its centre is in the footprint, or no farther from it than
    rounding: there it would be noise.
    """
    ray, lo, hi = pair
    t, feature = hit
    frame = to_centre(footprint, lo, hi, ray, radius, work)
    s = t * frame.pace if t > 0.0 else 0.0
    centre, direction, closest, scale = work[0, :2], work[1, :2], work[2, :2], frame.scale
    noise = frame.slack + FRAME_SLACK * s
    for axis in range(2):
        centre[axis] += s * direction[axis]
        if not footprint.shaped:  # in metres: what lies on an edge lies there exactly
            centre[axis] = ray[ORIGIN, axis] + t * ray[DIRECTION, axis]
            closest[axis] = min(max(centre[axis], lo[axis]), hi[axis])
            normal[axis] = centre[axis] - closest[axis]
    gap = length(normal[:2])
    if footprint.shaped:
        gap = look_out(footprint, hulls, scale, centre, normal, closest)
    else:
        scale, noise = 1.0, noise / scale
    if feature == INSIDE and (radius == 0.0 or gap <= noise):
        point[0], point[1], normal[0], normal[1] = ray[ORIGIN, 0], ray[ORIGIN, 1], 0.0, 0.0
        return
    if radius > 0.0:
        if gap <= noise:
            normal[0] = normal[1] = 0.0
    elif feature >= FACE:
        x, y = edge_of(rim_of(footprint, hulls, scale), feature - FACE)
        if x == 0.0 and y == 0.0:  # a corner, in passing
            side = math.copysign(1.0, direction[1] * closest[0] - direction[0] * closest[1])
            x, y = side * direction[0], side * direction[1]
        normal[0], normal[1] = y, -x
    elif feature != ROUND:  # an edge of a rectangle
        normal[0] = normal[1] = 0.0
        normal[feature] = -math.copysign(1.0, direction[feature])
        closest[feature] = lo[feature] if direction[feature] > 0.0 else hi[feature]
    total = length(normal[:2])
    for axis in range(2):
        normal[axis] = normal[axis] / total if total > 0.0 else 0.0
        point[axis] = closest[axis] / scale + (footprint.centre[axis] if footprint.shaped else 0.0)
