# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A thin ray, or a disc swept along it, against one footprint: `contact` in two dimensions.

Everything is relative to the footprint's centre. An axis-aligned rectangle has its corners
in the tree, which are exact.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import DIRECTION, INSIDE, NONE, ORIGIN, RAY_ROWS, intersect_exact
from ...tree.compiler import chosen_by_types, inlined, lean_kernel, stack_array
from ..shapes.footprint import (
    FACE,
    ROUND,
    are_shadows,
    closest_on_core,
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
    rim_of_shadow,
    shadows_of,
    slab,
    to_oval,
)
from ..shapes.hull import are_any
from ..shapes.shape import length, scale_of
from ..shapes.surface import first_flat, visit_ball
from .mesh import MINUTE, Touch, come_near, in_lengths_of, time_in
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
def to_centre(footprint, pair, radius, local):
    """Fill `local` with origin and unit direction as seen from the centre; return the `Frame`."""
    (ray, lo, hi, doubt), largest = pair, 0.0
    size = max(radius, footprint.largest if footprint.shaped else 0.0)
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
    slack = FRAME_SLACK * size + COORDINATES * (largest * scale) + doubt * scale
    return Frame(pace, scale, slack)


@lean_kernel
def enter_convex(footprint, hulls, pair, radius, t_max, work):
    """`enter_footprint` of a convex one."""
    ray, lo, hi, doubt = pair
    if not footprint.shaped and radius == 0.0:
        hit, t, axis = intersect_exact(lo, hi, ray, t_max)
        return (t if hit else np.inf), axis
    frame = to_centre(footprint, pair, radius, work)
    origin, direction, ball = work[0, :2], work[1, :2], radius * frame.scale
    reach = reach_of(t_max, frame.pace)
    if not footprint.shaped:
        low, high = work[2, :2], work[3, :2]
        for axis in range(2):
            low[axis], high[axis] = lo[axis] * frame.scale, hi[axis] * frame.scale
        s, feature = enter_rounded_box(origin, direction, low, high, ball, reach)
        if s == np.inf and doubt > 0.0:
            ball += doubt * frame.scale
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


# ---- the shadows of a mesh that is not convex


@lean_kernel
def enter_thin_shadows(surface, footprint, pair, t_max):
    """(t, feature) at which a thin ray enters the shadows of triangles, t up to t_max. Apart from
    how far the ray's origin is from the footprint's centre nothing is rounded before the decision.
    """
    given, ray, largest = pair.ray, stack_array((RAY_ROWS, 3), np.float64), 0.0
    for axis in range(2):
        largest = max(largest, abs(given[DIRECTION, axis]))
    exponent = -math.frexp(largest)[1]
    ray[ORIGIN, 2] = ray[DIRECTION, 2] = 0.0
    for axis in range(2):
        place = given[ORIGIN, axis] - footprint.centre[axis]
        direction = math.ldexp(given[DIRECTION, axis], exponent)
        ray[ORIGIN, axis] = place if abs(place) >= MINUTE * surface.radius else 0.0
        ray[DIRECTION, axis] = direction if abs(direction) >= MINUTE else 0.0
    reach = math.ldexp(t_max, -exponent)
    if largest == 0.0:
        ray[DIRECTION, 0], reach = 1.0, 0.0
    begin = come_near(surface.radius, ray)
    if not begin <= reach:
        return np.inf, np.int64(ROUND)
    s, face = first_flat(surface, ray, reach - begin)
    if face == NONE:
        return np.inf, np.int64(ROUND)
    if s == 0.0 and begin == 0.0:
        return 0.0, np.int64(INSIDE)
    return time_in(begin + s, exponent, t_max), np.int64(FACE + face)


class DiscQuery(NamedTuple):
    """What `_visit_shadow` needs."""

    frame: Any
    radius: Any
    reach: Any
    work: Any
    offset: Any
    """Scratch, (2,)."""
    places: Any
    """Scratch, (3, 3)."""


@inlined
def _visit_shadow(surface, ray, face, zero, touch):
    query, work = touch.query, touch.query.work
    rim = rim_of_shadow(surface, face, query.frame.scale, query.places)
    until = min(touch.s, query.reach)
    s = enter_rounded_rim(rim, work[0, :2], work[1, :2], query.radius, until, query.offset)
    touch = Touch(min(touch.s, s), query)
    return touch, min(touch.s, query.reach) / query.frame.scale


@lean_kernel
def approach_shadows(surface, frame, radius, reach, work):
    """How far a disc from outside goes until it touches the shadow of a triangle, inf if it does
    not. Rows of `work`: where it starts, the unit vector along its path, one to work in.
    """
    ray, places = stack_array((RAY_ROWS, 3), np.float64), stack_array((3, 3), np.float64)
    grown = in_lengths_of(surface, frame, radius, work, ray)
    touch = Touch(np.inf, DiscQuery(frame, radius, reach, work, work[2, :2], places))
    return visit_ball(surface, ray, grown, reach / frame.scale, touch, _visit_shadow).s


@lean_kernel
def enter_shadows(footprint, hulls, pair, radius, t_max, work):
    """`enter_footprint` of a mesh that is not convex."""
    surface = shadows_of(footprint, hulls)
    if radius == 0.0:
        return enter_thin_shadows(surface, footprint, pair, t_max)
    frame = to_centre(footprint, pair, radius, work)
    ball, reach, s = radius * frame.scale, reach_of(t_max, frame.pace), np.inf
    work[0, 2] = work[1, 2] = 0.0
    gap = closest_on_core(footprint, hulls, frame.scale, work[0, :2], work[2, :2])
    for _ in range(2):
        if gap <= ball:
            return 0.0, np.int64(INSIDE)
        s = approach_shadows(surface, frame, ball, reach, work)
        if s < np.inf:
            break
        ball += frame.slack  # what misses by less touches
    return time_of(s, frame.pace, t_max), np.int64(ROUND)


@lean_kernel
def enter_any(footprint, hulls, pair, radius, t_max, work):
    """`enter_footprint` of any one."""
    if are_shadows(footprint, hulls):
        return enter_shadows(footprint, hulls, pair, radius, t_max, work)
    return enter_convex(footprint, hulls, pair, radius, t_max, work)


@chosen_by_types
def enter_footprint(footprint, hulls, pair, radius, t_max, work):
    """(t, feature) as `contact.enter_shape`.

    The feature of a thin ray is FACE and the edge of a polygon that is entered, or the shadow of a
    triangle; or ROUND.
    """
    return enter_any if are_any(hulls) else enter_convex


# ---- where a ray hits a footprint


@lean_kernel
def edge_of_polygon(footprint, hulls, scale, feature, place, direction):
    """`edge_met` of a polygon."""
    return edge_of(rim_of(footprint, hulls, scale), feature - FACE)


ALONG = 2.0**-40  # of its length: an edge that crosses a line by less runs along it


@lean_kernel
def edge_of_any(footprint, hulls, scale, feature, place, direction):
    """The same, or the edge of a triangle's shadow through which a line from a place enters it."""
    if not are_shadows(footprint, hulls):
        return edge_of_polygon(footprint, hulls, scale, feature, place, direction)
    places = stack_array((3, 3), np.float64)
    rim = rim_of_shadow(shadows_of(footprint, hulls), feature - FACE, scale, places)
    # Without one, along an edge or past a corner, what faces the line.
    best, found_x, found_y = np.inf, direction[1], -direction[0]
    for i in range(3):
        corner_x, corner_y = corner_of(rim, i)
        x, y = edge_of(rim, i)
        offset_x, offset_y = corner_x - place[0], corner_y - place[1]
        before = offset_y * direction[0] - offset_x * direction[1]
        after = (offset_y + y) * direction[0] - (offset_x + x) * direction[1]
        if before >= 0.0 >= after and before - after > ALONG * (abs(x) + abs(y)):
            share = before / (before - after)
            s = (offset_x + share * x) * direction[0] + (offset_y + share * y) * direction[1]
            if s < best:
                best, found_x, found_y = s, x, y
    return found_x, found_y


@chosen_by_types
def edge_met(footprint, hulls, scale, feature, place, direction):
    """From one end of the edge that a feature is to the other: (x, y); outside is to the right."""
    return edge_of_any if are_any(hulls) else edge_of_polygon


@lean_kernel
def look_out(footprint, hulls, scale, point, normal, closest):
    """`look_out_of_oval` of any footprint; of a polygon the direction from its rim, which is zero
    or noise at it.
    """
    if footprint.oval:
        return look_out_of_oval(footprint, scale, point, normal, closest)
    closest_on_core(footprint, hulls, scale, point, closest)
    normal[0], normal[1] = point[0] - closest[0], point[1] - closest[1]
    return closest_on_footprint(footprint, hulls, scale, point, closest)


@lean_kernel
def touch_footprint(footprint, hulls, pair, hit, radius, work, point, normal):
    """Fill in the footprint's point of a hit (t, feature), and the outward normal.

    The normal of a disc is zero where its centre is in the footprint, or no farther from it than
    rounding: there it would be noise.
    """
    ray, lo, hi, _ = pair
    t, feature = hit
    frame = to_centre(footprint, pair, radius, work)
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
        x, y = edge_met(footprint, hulls, scale, feature, centre, direction)
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
