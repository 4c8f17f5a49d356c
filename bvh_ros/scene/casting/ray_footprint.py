# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A thin ray, or a disc swept along it, against one footprint; the planar sister of `contact`.

Everything is relative to the footprint's centre. An axis-aligned rectangle is met by its corners
in the tree, which are exact.
"""

import math

import numpy as np

from ...tree.jit.compiling import lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.rays.slab import DIRECTION, INSIDE, ORIGIN, intersect_exact
from ..geometry.oval import approach_oval, cross_oval, measure_oval, to_oval
from .frame import COORDINATES, SLACK, Frame, point_along, reach_of, scale_of, time_of
from .mesh_rays import FACE
from .ray_polygon import Rim, closest_on_polygon, cross_polygon, edge_of, enter_rounded_rim
from .ray_shapes import ROUND, enter_rounded_box, length


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
    return Frame(pace, scale, SLACK * size + COORDINATES * (largest * scale))


@lean_kernel
def enter_footprint(footprint, hulls, lo, hi, ray, radius, t_max, work):
    """(t, feature) as `contact.enter_shape`.

    The feature of a thin ray is FACE and the edge of a polygon that is entered, or ROUND.
    """
    if not footprint.shaped and radius == 0.0:
        hit, t, axis = intersect_exact(lo, hi, ray, t_max)
        return (t if hit else np.inf), axis
    frame = to_centre(footprint, lo, hi, ray, radius, work)
    origin, way, ball = work[0, :2], work[1, :2], radius * frame.scale
    reach = reach_of(t_max, frame.pace)
    if not footprint.shaped:
        low, high = work[2, :2], work[3, :2]
        for axis in range(2):
            low[axis], high[axis] = lo[axis] * frame.scale, hi[axis] * frame.scale
        s, feature = enter_rounded_box(origin, way, low, high, ball, reach)
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
def rim_of(footprint, hulls, scale):
    """The rim of a footprint that is no oval: what is seen of a mesh is kept with those."""
    if hulls is not None and footprint.polygon > 0:
        span = hulls.spans[footprint.polygon - 1].vertices
        return Rim(hulls.vertices[span[0] : span[1], :2], scale)
    return Rim(footprint.corners[:, :2], scale)


@lean_kernel
def oval_of(footprint, scale):
    """See `oval`."""
    a, b = footprint.half_axes[0] * scale, footprint.half_axes[1] * scale
    return footprint.straight * scale, a, b


@lean_kernel
def enter_thin(footprint, hulls, frame, reach, work):
    """(s, feature) of a thin ray. Where its line crosses the footprint, but before the ray or
    beyond it, the end of the ray that is next to there may touch it.
    """
    origin, way, place, closest = work[0, :2], work[1, :2], work[2, :2], work[3, :2]
    place[0], place[1] = way[0], way[1]
    if way[0] == 0.0 and way[1] == 0.0:  # a point: any line through it
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
        place[axis] = origin[axis] + s * way[axis]
    gap = closest_on_footprint(footprint, hulls, frame.scale, place, closest)
    return (s if gap <= frame.slack else np.inf), (feature if s > 0.0 else np.int64(INSIDE))


@lean_kernel
def enter_rounded_polygon(footprint, hulls, frame, ball, reach, work):
    """(s, feature) of a disc, or of a thin ray against a disc or capsule."""
    origin, way, closest = work[0, :2], work[1, :2], work[2, :2]
    rim = rim_of(footprint, hulls, frame.scale)
    if closest_on_polygon(rim, origin, closest) <= ball:
        return 0.0, np.int64(INSIDE)
    s = enter_rounded_rim(rim, origin, way, ball, reach, closest)
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
def closest_on_footprint(footprint, hulls, scale, point, out):
    """Fill `out` with a footprint's closest point, `point` itself inside; return the distance."""
    if footprint.oval:
        return look_out_of_oval(footprint, scale, point, out, out)
    distance = closest_on_polygon(rim_of(footprint, hulls, scale), point, out)
    radius = footprint.radius * scale
    if distance <= radius:
        out[0], out[1] = point[0], point[1]
        return 0.0
    for axis in range(2):
        out[axis] += (point[axis] - out[axis]) * (radius / distance)
    return distance - radius


@lean_kernel
def look_out_of_oval(footprint, scale, point, normal, closest):
    """Fill in the direction outwards at the oval's rim next to a point, then the closest point,
    itself inside; return the distance.
    """
    along, across = footprint.along, stack_array(4, np.float64).reshape(2, 2)
    across[0, 0], across[0, 1] = to_oval(along, point)
    _, distance = measure_oval(oval_of(footprint, scale), across[0], across[1])
    u, v = across[1, 0], across[1, 1]
    x, y = u * along[0] - v * along[1], u * along[1] + v * along[0]
    normal[0], normal[1] = x, y
    closest[0], closest[1] = point[0] - distance * x, point[1] - distance * y
    return distance


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
def touch_footprint(footprint, hulls, lo, hi, ray, t, feature, radius, work, point, normal):
    """Fill in the footprint's point that is met at t and the outward normal there.

    The normal of a disc is zero where its centre is in the footprint, or no farther from it than
    rounding: there it would be noise.
    """
    frame = to_centre(footprint, lo, hi, ray, radius, work)
    s = t * frame.pace if t > 0.0 else 0.0
    centre, way, closest, scale = work[0, :2], work[1, :2], work[2, :2], frame.scale
    noise = frame.slack + SLACK * s
    for axis in range(2):
        centre[axis] += s * way[axis]
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
            side = math.copysign(1.0, way[1] * closest[0] - way[0] * closest[1])
            x, y = side * way[0], side * way[1]
        normal[0], normal[1] = y, -x
    elif feature != ROUND:  # an edge of a rectangle
        normal[0] = normal[1] = 0.0
        normal[feature] = -math.copysign(1.0, way[feature])
        closest[feature] = lo[feature] if way[feature] > 0.0 else hi[feature]
    total = length(normal[:2])
    for axis in range(2):
        normal[axis] = normal[axis] / total if total > 0.0 else 0.0
        point[axis] = closest[axis] / scale + (footprint.centre[axis] if footprint.shaped else 0.0)
