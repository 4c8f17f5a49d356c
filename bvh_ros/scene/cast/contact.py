# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One obstacle of any shape: into its own frame, where a ray enters it, what point is closest.

`shape` is a record of `columns.GEOMETRY`. The corners lo and hi of an axis-aligned box are
exact, in the world's frame. Every other shape lies at the origin of its own frame.
"""

import math

import numpy as np

from ...tree.access import DIRECTION, INSIDE, ORIGIN, intersect_exact
from ...tree.compiler import inlined, lean_kernel
from ..distance.narrow_phase import closest_on_mesh
from ..shapes.footprint import ROUND
from ..shapes.shape import BOX, CAPSULE, CYLINDER, MESH, SPHERE, length, rotate, scale_of
from .arguments import clear_triangle
from .mesh import enter_mesh, touch_mesh
from .shapes import (
    COORDINATES,
    FRAME_SLACK,
    Frame,
    enter_box,
    enter_cylinder,
    enter_rounded_box,
    enter_rounded_cylinder,
    enter_sphere,
    point_along,
    reach_of,
    time_of,
)


@lean_kernel
def to_frame(shape, pair, radius, local):
    """Fill `local` with origin and unit direction in the shape's frame."""
    (ray, lo, hi, doubt), largest, size = pair, 0.0, radius
    for axis in range(3):
        largest = max(largest, abs(ray[ORIGIN, axis]))
        if shape.shaped:
            largest = max(largest, abs(shape.position[axis]))
            size = max(size, shape.half[axis])
        else:
            largest = max(largest, abs(lo[axis]), abs(hi[axis]))
    scale = scale_of(max(largest, size))
    size *= scale
    for axis in range(3):
        local[0, axis] = ray[ORIGIN, axis] * scale
        if shape.shaped:
            local[0, axis] -= shape.position[axis] * scale
        size = max(size, abs(local[0, axis]))
    pace = point_along(ray, scale, local[1, :3])
    if shape.shaped and shape.kind != SPHERE:
        rotate(shape.orientation, local[0], -1.0)
        rotate(shape.orientation, local[1], -1.0)
    slack = FRAME_SLACK * size + COORDINATES * (largest * scale) + doubt * scale
    return Frame(pace, scale, slack)


@lean_kernel
def enter_shape(shape, hulls, pair, radius, t_max, work):
    """(t, feature) at which a ray, radius 0, or a ball swept along it, meets the shape; t inf if
    never.

    t is in units of the ray's direction. What misses, but would not if the shape were larger by
    the frame's slack, touches: so rounding makes no hit a miss. An axis-aligned box is larger by
    the doubt of the pair alone.
    """
    ray, lo, hi, doubt = pair
    if not shape.shaped and radius == 0.0:
        hit, t, axis = intersect_exact(lo, hi, ray, t_max)
        return (t if hit else np.inf), axis
    frame = Frame(1.0, 1.0, 0.0)  # a thin ray meets a mesh in the mesh's own frame
    if shape.kind != MESH or radius > 0.0:
        frame = to_frame(shape, pair, radius, work)
    scale = frame.scale
    slack = frame.slack if shape.shaped else doubt * scale
    reach, ball, half = reach_of(t_max, frame.pace), radius * scale, shape.half
    s, feature = np.inf, np.int64(INSIDE)
    if shape.kind == CYLINDER and ball > 0.0:
        base, height = half[0] * scale, half[2] * scale
        s, feature = enter_rounded_cylinder(base, height, ball, reach, slack, work)
    elif shape.kind != MESH:
        s, feature = enter_form(shape, lo, hi, scale, ball, 0.0, reach, work)
        if s == np.inf and slack > 0.0:
            s, feature = enter_form(shape, lo, hi, scale, ball, slack, reach, work)
    elif hulls is not None:  # last: compiled meanwhile in another process, see `compile_jobs`
        return enter_mesh(hulls, shape, frame, pair, ball, t_max, work)
    return time_of(s, frame.pace, t_max), feature


@lean_kernel
def enter_form(shape, lo, hi, scale, ball, slack, reach, work):
    """(s, feature) of a shape that has a closed form, larger by `slack`."""
    origin, direction, low, high, half = work[0], work[1], work[2], work[3], shape.half
    if shape.kind == SPHERE:
        return enter_sphere(origin, direction, half[0] * scale + ball + slack, reach)
    if shape.kind == CYLINDER:
        radius, height = half[0] * scale + slack, half[2] * scale + slack
        return enter_cylinder(origin, direction, radius, height, reach)
    for axis in range(3):
        low[axis] = -half[axis] * scale if shape.shaped else lo[axis] * scale
        high[axis] = half[axis] * scale if shape.shaped else hi[axis] * scale
    if shape.kind == CAPSULE:  # a box without width, grown
        ball += half[0] * scale
        low[0] = low[1] = high[0] = high[1] = 0.0
        low[2], high[2] = low[2] + half[0] * scale, high[2] - half[0] * scale
    if ball > 0.0:
        return enter_rounded_box(origin, direction, low, high, ball + slack, reach)
    for axis in range(3):
        low[axis] -= slack
        high[axis] += slack
    return enter_box(origin, direction, low, high, reach)


@lean_kernel
def closest_point(shape, hulls, scale, point, out):
    """The point of a shape, times scale, at the origin of its frame that is closest to `point`.

    `point` itself inside.
    """
    if shape.kind == MESH:
        if hulls is not None:
            closest_on_mesh(hulls, shape, scale, point, out)
        return
    radius, height = shape.half[0] * scale, shape.half[2] * scale
    if shape.kind == BOX:
        for axis in range(3):
            half = shape.half[axis] * scale
            out[axis] = min(max(point[axis], -half), half)
        return
    if shape.kind == CYLINDER:
        far, level = math.hypot(point[0], point[1]), min(max(point[2], -height), height)
        out[2] = level
    else:
        level = axis_point(shape, scale, point[2])
        far = math.hypot(math.hypot(point[0], point[1]), point[2] - level)
    shrink = radius / far if far > radius else 1.0
    out[0], out[1] = point[0] * shrink, point[1] * shrink
    if shape.kind != CYLINDER:
        out[2] = level + (point[2] - level) * shrink if shrink < 1.0 else point[2]


@lean_kernel
def axis_point(shape, scale, z):
    """z of the closest point on a capsule's axis without its ends; of a sphere that is its
    centre.
    """
    straight = (shape.half[2] - shape.half[0]) * scale
    return min(max(z, -straight), straight)


@inlined
def contact(shape, hulls, pair, hit, radius, work, point, normal, triangle):
    """Fill in the obstacle's point of a hit (t, feature), the outward normal, and the triangle,
    see `arguments.room_for_triangles`.
    """
    if shape.kind == MESH and radius == 0.0:
        if hulls is not None:
            touch_mesh(hulls, shape, pair.ray, hit, point, normal, triangle)
    else:
        clear_triangle(triangle)
        touch_shape(shape, hulls, pair, hit, radius, work, point, normal)


@lean_kernel
def touch_shape(shape, hulls, pair, hit, radius, work, point, normal):
    """Fill in the point and the normal where a thin ray hits no mesh, or a ball any shape.

    The normal of a ball is zero where its centre is in the obstacle, or no farther from it than
    rounding: there it would be noise.
    """
    ray, lo, hi, _ = pair
    t, feature = hit
    frame = to_frame(shape, pair, radius, work)
    s = t * frame.pace if t > 0.0 else 0.0
    centre, direction, closest, outward, scale = work[0], work[1], work[2], work[3], frame.scale
    noise = frame.slack + FRAME_SLACK * s
    for axis in range(3):
        centre[axis] += s * direction[axis]
        outward[axis] = 0.0
        if not shape.shaped:  # in metres: what lies on a face lies there exactly
            centre[axis] = ray[ORIGIN, axis] + t * ray[DIRECTION, axis]
            closest[axis] = min(max(centre[axis], lo[axis]), hi[axis])
    if not shape.shaped:
        scale, noise = 1.0, noise / scale
    else:
        closest_point(shape, hulls, scale, centre, closest)
    if radius > 0.0:
        for axis in range(3):
            outward[axis] = centre[axis] - closest[axis]
        if length(outward) <= noise:
            outward[0] = outward[1] = outward[2] = 0.0
    elif feature != INSIDE:
        face_normal(shape, lo, hi, feature, scale, work)
    to_world(shape, scale, closest, outward, point, normal)
    if feature == INSIDE and length(normal) == 0.0:
        for axis in range(3):
            point[axis] = ray[ORIGIN, axis]


@lean_kernel
def face_normal(shape, lo, hi, feature, scale, work):
    """Fill in the direction outwards where a thin ray enters; a flat face's point lies on it."""
    centre, direction, closest, outward = work[0], work[1], work[2], work[3]
    if feature == ROUND:
        outward[0], outward[1] = centre[0], centre[1]
        if shape.kind != CYLINDER:
            outward[2] = centre[2] - axis_point(shape, scale, centre[2])
    else:
        outward[feature] = -math.copysign(1.0, direction[feature])
        if shape.shaped:
            closest[feature] = outward[feature] * (shape.half[feature] * scale)
        else:
            closest[feature] = lo[feature] if direction[feature] > 0.0 else hi[feature]


@lean_kernel
def to_world(shape, scale, closest, outward, point, normal):
    """Bring a point and a direction of any length back from the shape's frame.

    The direction becomes a unit vector or zero.
    """
    total = length(outward)
    for axis in range(3):
        point[axis] = closest[axis] / scale
        normal[axis] = outward[axis] / total if total > 0.0 else 0.0
    if shape.shaped:
        if shape.kind != SPHERE:
            rotate(shape.orientation, point, 1.0)
            rotate(shape.orientation, normal, 1.0)
        for axis in range(3):
            point[axis] += shape.position[axis]
