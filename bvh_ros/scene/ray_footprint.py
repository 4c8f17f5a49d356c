# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A thin ray, or a disc swept along it, against one footprint; the planar sister of `contact`.

Everything is relative to the footprint's centre. An axis-aligned rectangle is met by its corners
in the tree, which are exact.
"""

import math

import numpy as np

from ..tree.compiling import lean_kernel
from ..tree.slab import DIRECTION, INSIDE, ORIGIN, meets
from .mesh_rays import FACE
from .ray_polygon import (
    closest_on_polygon,
    closest_on_rim,
    edge_of,
    enter_polygon,
    enter_rounded_rim,
)
from .ray_shapes import NEWTON_STEPS, ROUND, ROUNDING, enter_box, enter_rounded_box, length


@lean_kernel
def to_centre(footprint, ray, local):
    """Fill `local` with origin and unit direction as seen from the centre.

    Return the direction's length.
    """
    total = length(ray[DIRECTION])
    for axis in range(2):
        local[0, axis] = ray[ORIGIN, axis] - (footprint.centre[axis] if footprint.shaped else 0.0)
        local[1, axis] = ray[DIRECTION, axis] / total if total > 0.0 else 0.0
    return total


@lean_kernel
def enter_footprint(footprint, hulls, lo, hi, ray, radius, t_max, work):
    """(t, feature) as `contact.enter_shape`.

    The feature of a thin ray is the strip that is entered, or FACE and the edge of a polygon.
    """
    if not footprint.shaped and radius == 0.0:
        hit, t, axis = meets(lo, hi, ray, t_max)
        return (t if hit else np.inf), axis
    total = to_centre(footprint, ray, work)
    origin, way, reach = work[0, :2], work[1, :2], t_max * total
    s, feature = np.inf, np.int64(INSIDE)
    if not footprint.shaped:
        s, feature = enter_rounded_box(origin, way, lo, hi, radius, reach)
    elif footprint.polygon > 0:
        if hulls is not None:
            s, feature = enter_mesh_outline(
                footprint, hulls, origin, way, radius, reach, work[2, :2]
            )
    elif footprint.oval:
        s, feature = approach_oval(footprint, origin, way, radius, reach, work[2, :2], work[3, :2])
    elif radius + footprint.radius == 0.0:
        across, rate, low = work[2], work[3], work[4]
        for k in range(3):
            normal = footprint.normals[k]
            across[k] = normal[0] * origin[0] + normal[1] * origin[1]
            rate[k] = normal[0] * way[0] + normal[1] * way[1]
            low[k] = -footprint.widths[k]
        s, feature = enter_box(across, rate, low, footprint.widths, reach)
    else:
        grown = radius + footprint.radius
        s, feature = np.float64(0.0), np.int64(INSIDE)
        if closest_on_zonogon(footprint, origin, work[2, :2]) > grown:
            corners = footprint.corners
            s = enter_rounded_rim(corners, origin, way, grown, reach, work[2, :2])
            feature = np.int64(ROUND)
    return (min(s / total, t_max) if 0.0 < s < np.inf else s), feature


@lean_kernel
def corner_span(footprint, hulls):
    """Rows of the corners of the polygon that is seen of a mesh: from, up to."""
    span = hulls.spans[footprint.polygon - 1].vertices
    return span[0], span[1]


@lean_kernel
def enter_mesh_outline(footprint, hulls, origin, way, radius, reach, closest):
    """`enter_footprint` for a mesh: (s, feature)."""
    first, stop = corner_span(footprint, hulls)
    corners = hulls.vertices[first:stop]
    if radius == 0.0:
        return enter_polygon(corners, origin, way, reach)
    if closest_on_polygon(corners, origin, closest) <= radius:
        return 0.0, np.int64(INSIDE)
    return enter_rounded_rim(corners, origin, way, radius, reach, closest), np.int64(ROUND)


@lean_kernel
def approach_oval(footprint, origin, way, radius, reach, point, closest):
    """Newton's iteration for distance(s) = radius, see `ray_shapes.approach_rim`."""
    point[0], point[1] = origin[0], origin[1]
    distance = closest_on_oval(footprint, point, closest)
    if distance <= radius:
        return 0.0, INSIDE
    s = 0.0
    for _ in range(NEWTON_STEPS):
        slope = 0.0
        for axis in range(2):
            slope += (point[axis] - closest[axis]) / distance * way[axis]
        if slope >= 0.0:
            return np.inf, ROUND
        step = (radius - distance) / slope
        s += step
        if s > reach:
            return np.inf, ROUND
        for axis in range(2):
            point[axis] = origin[axis] + s * way[axis]
        distance = closest_on_oval(footprint, point, closest)
        if distance <= radius or step <= ROUNDING * s:
            break
    return s, ROUND


@lean_kernel
def closest_on_footprint(footprint, hulls, point, out):
    """Fill `out` with a footprint's closest point, `point` itself inside; return the distance."""
    if hulls is not None and footprint.polygon > 0:
        first, stop = corner_span(footprint, hulls)
        return closest_on_polygon(hulls.vertices[first:stop], point, out)
    if footprint.oval:
        return closest_on_oval(footprint, point, out)
    distance = closest_on_zonogon(footprint, point, out)
    if distance <= footprint.radius:
        out[0], out[1] = point[0], point[1]
        return 0.0
    for axis in range(2):
        out[axis] += (point[axis] - out[axis]) * (footprint.radius / distance)
    return distance - footprint.radius


@lean_kernel
def closest_on_zonogon(footprint, point, out):
    """As `closest_on_footprint`, without the radius."""
    inside = True
    for k in range(3):
        normal = footprint.normals[k]
        inside = inside and abs(normal[0] * point[0] + normal[1] * point[1]) <= footprint.widths[k]
    if inside:
        out[0], out[1] = point[0], point[1]
        return 0.0
    return closest_on_rim(footprint.corners, point, out)


@lean_kernel
def closest_on_oval(footprint, point, out):
    """As `closest_on_footprint`, for a leaning cylinder: in its first quadrant, by symmetry."""
    along = footprint.along
    u, v = point[0] * along[0] + point[1] * along[1], point[1] * along[0] - point[0] * along[1]
    x, y = abs(u) - footprint.straight, abs(v)
    long, across = footprint.half_axes[0], footprint.half_axes[1]
    if x <= 0.0:
        near_x, near_y = x, min(y, across)
    else:
        near_x, near_y = closest_on_ellipse(long, across, x, y)
    distance = math.hypot(x - near_x, y - near_y)
    near_u, near_v = math.copysign(near_x + footprint.straight, u), math.copysign(near_y, v)
    out[0] = near_u * along[0] - near_v * along[1]
    out[1] = near_u * along[1] + near_v * along[0]
    if distance == 0.0:
        out[0], out[1] = point[0], point[1]
    return distance


@lean_kernel
def closest_on_ellipse(a, b, x, y):
    """Point of a solid ellipse closest to (x, y) in the first quadrant; half axes a <= b.

    Outside, (a^2 x / (t + a^2), b^2 y / (t + b^2)) with the t > 0 that puts it on the ellipse
    (Eberly, Distance from a Point to an Ellipse, 2013); by bisection, which is never misled.
    """
    if (x / a) ** 2 + (y / b) ** 2 <= 1.0:
        return x, y
    low, high = 0.0, b * math.hypot(x, y)
    while True:
        t = 0.5 * (low + high)
        if not low < t < high:
            break
        if (a * x / (t + a * a)) ** 2 + (b * y / (t + b * b)) ** 2 > 1.0:
            low = t
        else:
            high = t
    return a * a * x / (high + a * a), b * b * y / (high + b * b)


@lean_kernel
def oval_normal(footprint, point, normal):
    """Direction outwards at the oval's rim next to `point`: the gradient, or straight across."""
    along = footprint.along
    u, v = point[0] * along[0] + point[1] * along[1], point[1] * along[0] - point[0] * along[1]
    x, y = abs(u) - footprint.straight, abs(v)
    a, b = footprint.half_axes[0], footprint.half_axes[1]
    x, y = closest_on_ellipse(a, b, max(x, 0.0), y) if x > 0.0 else (0.0, 1.0)
    x, y = math.copysign(x * (b / a), u), math.copysign(y * (a / b), v)
    normal[0], normal[1] = x * along[0] - y * along[1], x * along[1] + y * along[0]


@lean_kernel
def look_out(footprint, hulls, centre, closest, normal):
    """Fill in a shaped footprint's closest point to `centre` and the direction outwards there;
    return the distance.
    """
    if footprint.oval:
        oval_normal(footprint, centre, normal)
        return closest_on_oval(footprint, centre, closest)
    if footprint.polygon == 0:
        closest_on_zonogon(footprint, centre, closest)
        normal[0], normal[1] = centre[0] - closest[0], centre[1] - closest[1]
        return closest_on_footprint(footprint, hulls, centre, closest)
    gap = closest_on_footprint(footprint, hulls, centre, closest)
    normal[0], normal[1] = centre[0] - closest[0], centre[1] - closest[1]
    return gap


@lean_kernel
def touch_footprint(footprint, hulls, lo, hi, ray, t, feature, work, point, normal):
    """Fill in the footprint's point that is met at t and the outward normal there."""
    s = t * to_centre(footprint, ray, work)
    centre, way, closest = work[0, :2], work[1, :2], work[2, :2]
    for axis in range(2):
        if footprint.shaped:
            centre[axis] += s * way[axis]
        else:
            centre[axis] += t * ray[DIRECTION, axis]
        closest[axis] = min(max(centre[axis], lo[axis]), hi[axis])
        normal[axis] = centre[axis] - closest[axis]
    gap = length(normal[:2])
    if footprint.shaped:
        gap = look_out(footprint, hulls, centre, closest, normal)
    if feature == INSIDE and gap == 0.0:
        point[0], point[1], normal[0], normal[1] = ray[ORIGIN, 0], ray[ORIGIN, 1], 0.0, 0.0
        return
    if feature >= FACE:
        if hulls is not None:
            first, stop = corner_span(footprint, hulls)
            x, y = edge_of(hulls.vertices[first:stop], feature - FACE)
            normal[0], normal[1] = y, -x
    elif feature >= 0 and feature != ROUND:
        flat_normal(footprint, lo, hi, way, feature, closest, normal)
    total = length(normal[:2])
    for axis in range(2):
        normal[axis] = normal[axis] / total if total > 0.0 else -way[axis]
        point[axis] = closest[axis] + (footprint.centre[axis] if footprint.shaped else 0.0)


@lean_kernel
def flat_normal(footprint, lo, hi, way, feature, closest, normal):
    """The normal of the strip that a thin ray enters.

    A rectangle's point is on its edge exactly.
    """
    if footprint.shaped:
        across = footprint.normals[feature]
        sign = -math.copysign(1.0, across[0] * way[0] + across[1] * way[1])
        normal[0], normal[1] = sign * across[0], sign * across[1]
        return
    normal[0] = normal[1] = 0.0
    normal[feature] = -math.copysign(1.0, way[feature])
    closest[feature] = lo[feature] if way[feature] > 0.0 else hi[feature]
