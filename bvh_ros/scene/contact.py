# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One obstacle of any shape: into its own frame, where a ray enters it, what point is closest.

`shape` is a record of `columns.GEOMETRY`. An axis-aligned box is met in the world's frame by its
corners lo and hi, which are exact; every other shape in its own frame, where it lies at the
origin.
"""

import math

import numpy as np

from ..tree.compiling import lean_kernel
from ..tree.slab import DIRECTION, INSIDE, ORIGIN, meets
from .hull import MESH, closest_on_hull, enter_mesh, hull_of
from .mesh_rays import FACE
from .ray_shapes import (
    ROUND,
    enter_box,
    enter_cylinder,
    enter_rounded_box,
    enter_rounded_cylinder,
    enter_sphere,
    length,
)

BOX, SPHERE, CYLINDER, CAPSULE = range(4)  # ShapeKind, as a kernel can read it


@lean_kernel
def rotate(quaternion, vector, sign):
    """Turn a vector in place by a unit quaternion, or back by it with sign -1."""
    x, y, z, w = sign * quaternion[0], sign * quaternion[1], sign * quaternion[2], quaternion[3]
    a, b, c = vector[0], vector[1], vector[2]
    u, v, n = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    vector[0] = a + w * u + y * n - z * v
    vector[1] = b + w * v + z * u - x * n
    vector[2] = c + w * n + x * v - y * u


@lean_kernel
def to_frame(shape, ray, local):
    """Fill `local` with origin and unit direction in the shape's frame.

    Return the direction's length.
    """
    total = length(ray[DIRECTION])
    for axis in range(3):
        local[0, axis] = ray[ORIGIN, axis]
        local[1, axis] = ray[DIRECTION, axis] / total if total > 0.0 else 0.0
        if shape.shaped:
            local[0, axis] -= shape.position[axis]
    if shape.shaped and shape.kind != SPHERE:
        rotate(shape.orientation, local[0], -1.0)
        rotate(shape.orientation, local[1], -1.0)
    return total


@lean_kernel
def enter_shape(shape, hulls, lo, hi, ray, radius, t_max, work):
    """(t, feature) at which a ray, or a ball swept along it, meets the shape; t inf if never.

    t is in units of the ray's direction.
    """
    if not shape.shaped and radius == 0.0:
        hit, t, axis = meets(lo, hi, ray, t_max)
        return (t if hit else np.inf), axis
    total = to_frame(shape, ray, work)
    origin, way, low, high = work[0], work[1], work[2], work[3]
    reach = t_max * total
    half = shape.half
    s, feature = np.inf, np.int64(INSIDE)
    if shape.kind == MESH:
        if hulls is not None:
            s, feature = enter_mesh(hulls, shape, origin, way, radius, reach, low)
    elif shape.kind == SPHERE:
        s, feature = enter_sphere(origin, way, half[0] + radius, reach)
    elif shape.kind == CYLINDER:
        if radius == 0.0:
            s, feature = enter_cylinder(origin, way, half[0], half[2], reach)
        else:
            s, feature = enter_rounded_cylinder(origin, way, half[0], half[2], radius, reach)
    else:
        for axis in range(3):
            low[axis] = -half[axis] if shape.shaped else lo[axis]
            high[axis] = half[axis] if shape.shaped else hi[axis]
        if shape.kind == CAPSULE:  # a box without width, grown
            radius += half[0]
            low[0] = low[1] = high[0] = high[1] = 0.0
            low[2], high[2] = half[0] - half[2], half[2] - half[0]
        if radius == 0.0:
            s, feature = enter_box(origin, way, low, high, reach)
        else:
            s, feature = enter_rounded_box(origin, way, low, high, radius, reach)
    return (min(s / total, t_max) if 0.0 < s < np.inf else s), feature


@lean_kernel
def closest_point(shape, hulls, point, out):
    """The point of a shape at the origin of its frame that is closest to `point`.

    `point` itself inside.
    """
    half = shape.half
    if shape.kind == MESH:
        if hulls is not None:
            closest_on_hull(hull_of(hulls, shape), point, out)
        return
    if shape.kind == BOX:
        for axis in range(3):
            out[axis] = min(max(point[axis], -half[axis]), half[axis])
        return
    if shape.kind == CYLINDER:
        far, level = math.hypot(point[0], point[1]), min(max(point[2], -half[2]), half[2])
        out[2] = level
    else:
        level = axis_point(shape, point[2])
        far = math.hypot(math.hypot(point[0], point[1]), point[2] - level)
    shrink = half[0] / far if far > half[0] else 1.0
    out[0], out[1] = point[0] * shrink, point[1] * shrink
    if shape.kind != CYLINDER:
        out[2] = level + (point[2] - level) * shrink if shrink < 1.0 else point[2]


@lean_kernel
def axis_point(shape, z):
    """z of the closest point on a capsule's axis without its ends; of a sphere that is its
    centre.
    """
    straight = shape.half[2] - shape.half[0]
    return min(max(z, -straight), straight)


@lean_kernel
def contact(shape, hulls, lo, hi, ray, t, feature, radius, work, point, normal):
    """Fill in the obstacle's point that is met at t, and the outward normal.

    Zero if the start lies in the obstacle.
    """
    s = t * to_frame(shape, ray, work)
    centre, way, closest, outward = work[0], work[1], work[2], work[3]
    for axis in range(3):
        if shape.shaped:
            centre[axis] += s * way[axis]
        else:
            centre[axis] += t * ray[DIRECTION, axis]
        inside = min(max(centre[axis], lo[axis]), hi[axis])
        closest[axis] = centre[axis] if shape.shaped else inside
        outward[axis] = 0.0
    if shape.shaped and (radius > 0.0 or shape.kind != MESH):  # a thin ray is on the mesh already
        closest_point(shape, hulls, centre, closest)
    if feature == INSIDE or radius > 0.0:
        for axis in range(3):
            outward[axis] = centre[axis] - closest[axis]
        if (
            length(outward) == 0.0 and feature != INSIDE
        ):  # the ball is smaller than the rounding of its place
            for axis in range(3):
                outward[axis] = -way[axis]
    elif feature >= FACE:
        if hulls is not None:
            face = hulls.spans[shape.mesh].faces[0] + feature - FACE
            for axis in range(3):
                outward[axis] = hulls.normals[face, axis]
    elif feature == ROUND:
        outward[0], outward[1] = centre[0], centre[1]
        if shape.kind != CYLINDER:
            outward[2] = centre[2] - axis_point(shape, centre[2])
    else:
        outward[feature] = -math.copysign(1.0, way[feature])
        if shape.shaped:
            closest[feature] = outward[feature] * shape.half[feature]
        else:
            closest[feature] = lo[feature] if way[feature] > 0.0 else hi[feature]
    to_world(shape, closest, outward, point, normal)
    if feature == INSIDE and length(normal) == 0.0:
        for axis in range(3):
            point[axis] = ray[ORIGIN, axis]


@lean_kernel
def to_world(shape, closest, outward, point, normal):
    """Bring a point and a direction of any length back from the shape's frame.

    The direction becomes a unit vector or zero.
    """
    total = length(outward)
    for axis in range(3):
        point[axis] = closest[axis]
        normal[axis] = outward[axis] / total if total > 0.0 else 0.0
    if shape.shaped:
        if shape.kind != SPHERE:
            rotate(shape.orientation, point, 1.0)
            rotate(shape.orientation, normal, 1.0)
        for axis in range(3):
            point[axis] += shape.position[axis]
