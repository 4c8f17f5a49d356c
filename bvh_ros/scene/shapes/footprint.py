# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Footprints: shapes seen from above, for planar scenes."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.compiler import chosen_by_types, inlined, lean_kernel, stack_array
from .hull import are_any, numbered_surface
from .mesh import CONVEX
from .shape import Floats, ShapeKind, Shapes, rotations
from .surface import closest_on_surface

# ---- Footprints: shapes seen from above, for planar scenes.
#
# A box casts a zonogon, the sum of three segments (its half axes seen from above): a rectangle
# if it stands upright, else up to six corners. A ball casts a disc; a capsule a disc drawn along
# a segment; a cylinder that stands a disc, one that lies a rectangle, and one that leans an
# oval: an ellipse (its disc seen from above) drawn along a segment (its axis seen from above). A
# mesh casts a polygon if it is convex, else the shadows of its triangles: these are kept with the
# meshes, see `shadow`.
#
# ____ ________ / \ ( ) / / zonogon ( -> ) oval: along ->, half length of the straight part,
# \____/ (______) and the half axes of the ellipse

# A zonogon is kept by its corners, counter-clockwise (some may coincide). A disc is a point grown
# by `radius`. All relative to `centre`.
FOOTPRINT = np.dtype(
    [
        ('centre', np.float64, (2,)),
        ('corners', np.float64, (6, 2)),
        ('radius', np.float64),
        ('along', np.float64, (2,)),
        ('straight', np.float64),
        ('half_axes', np.float64, (2,)),  # of the ellipse: along, across
        ('largest', np.float64),  # half size that has a part in the footprint
        ('oval', np.bool_),
        ('shaped', np.bool_),
        ('polygon', np.int32),  # of a mesh: 1 + the number of its shadow in the store; else 0
    ],
    align=True,
)


def footprints(shapes: Shapes, shaped: NDArray[np.bool_]) -> NDArray[np.void]:
    """Footprints of canonical shapes, shape (n,).

    Axis-aligned boxes are left to the tree's own box.
    """
    footprints = np.zeros(len(shapes.kind), FOOTPRINT)
    footprints['shaped'] = shaped
    rows = np.flatnonzero(shaped)
    if not len(rows):
        return footprints
    half = shapes.size[rows] * 0.5
    kind = shapes.kind[rows]
    matrices = rotations(shapes.orientation[rows])
    generators = np.moveaxis(matrices[:, :2, :] * half[:, None, :], 2, 1)  # (n, 3 axes, 2)
    some = footprints[rows]
    some['centre'] = shapes.position[rows, :2]
    upright = ~shapes.orientation[rows, :2].any(axis=1)
    some['largest'] = np.where(upright, half[:, :2].max(axis=1), half.max(axis=1))
    sphere, cylinder = kind == ShapeKind.SPHERE, kind == ShapeKind.CYLINDER
    axis = matrices[:, :, 2]
    slope = np.hypot(axis[:, 0], axis[:, 1])
    standing, lying = cylinder & (slope == 0.0), cylinder & (axis[:, 2] == 0.0)
    capsule = kind == ShapeKind.CAPSULE
    generators[sphere | standing] = 0.0
    generators[capsule, :2] = 0.0
    generators[capsule, 2] = axis[capsule, :2] * (half[capsule, 2:] - half[capsule, :1])
    some['radius'] = np.where(sphere | standing | capsule, half[:, 0], 0.0)
    flat = np.flatnonzero(lying)
    across = np.stack([-axis[flat, 1], axis[flat, 0]], axis=1)
    generators[flat, 0], generators[flat, 1] = across * half[flat, :1], 0.0
    some['oval'] = cylinder & ~standing & ~lying
    leaning = np.flatnonzero(some['oval'])
    some['along'][leaning] = axis[leaning, :2] / slope[leaning, None]
    some['straight'] = half[:, 2] * slope
    some['half_axes'][:, 0] = half[:, 0] * np.abs(axis[:, 2])
    some['half_axes'][:, 1] = half[:, 0]
    some['corners'] = zonogon(generators)
    footprints[rows] = some
    return footprints


def zonogon(generators: Floats) -> Floats:
    """Corners (n, 6, 2), counter-clockwise, of sums of three segments from -g to g, (n, 3, 2)."""
    # All into the upper half plane and by angle: walking along twice each is one half of the rim.
    down = (generators[:, :, 1] < 0) | ((generators[:, :, 1] == 0) & (generators[:, :, 0] < 0))
    upper = np.where(down[:, :, None], -generators, generators)
    angle = np.arctan2(upper[:, :, 1], upper[:, :, 0])
    upper = np.take_along_axis(upper, np.argsort(angle, axis=1)[:, :, None], axis=1)
    first = upper.sum(axis=1, keepdims=True)
    right = np.concatenate([-first, 2 * np.cumsum(upper[:, :2], axis=1) - first], axis=1)
    return np.concatenate([right, -right], axis=1)


# ---- The shadow of a leaning cylinder: an ellipse (its disc seen from above) drawn along a
# segment.
#
# v __________________________ / | | | \ A rectangle, and two ellipses about the middles of ( |
# +------|--------)-- u its ends: they overlap, nothing slips between.
# \______|_____________|_______/
#
# In its own frame: u along the segment, v across, from the middle. An oval is (straight, a, b):
# half the segment, and the half axes of the ellipse along u and v.

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


# ---- Footprints as kernels see them: the rim of a polygon, and what of a footprint is closest.

# What of a shape's surface a ray enters: below are the axes of flat faces, see `slab.INSIDE`.
ROUND = 3
FACE = 4  # the first triangle of a mesh, edge of a polygon, or shadow of a triangle


class Rim(NamedTuple):
    """That of a polygon."""

    corners: Any
    """(k, 2), counter-clockwise; some may coincide."""
    scale: Any
    """What they are to be multiplied by."""


@inlined
def corner_of(rim, i):
    return rim.corners[i, 0] * rim.scale, rim.corners[i, 1] * rim.scale


@lean_kernel
def edge_of(rim, i):
    """From a corner to the next: (x, y); outside is to the right."""
    here_x, here_y = corner_of(rim, i)
    x, y = corner_of(rim, (i + 1) % rim.corners.shape[0])
    return x - here_x, y - here_y


@lean_kernel
def cross_polygon(rim, origin, direction, slack):
    """(entry, leave, feature) of a line into a polygon, with the edge that is entered; (inf, -inf)
    if it misses it by more than `slack`.

    It crosses an edge whose corners are on different sides of it. A corner is the same in both its
    edges, so no line slips between them; and where it crosses is a point of the edge, however
    small the angle.
    """
    count = rim.corners.shape[0]
    x, y = corner_of(rim, count - 1)
    along = (x - origin[0]) * direction[0] + (y - origin[1]) * direction[1]
    aside = (y - origin[1]) * direction[0] - (x - origin[0]) * direction[1]
    entry, leave, feature = np.inf, -np.inf, np.int64(FACE)
    closest, passed, corner = np.inf, 0.0, 0
    for i in range(count):
        before, before_aside = along, aside
        x, y = corner_of(rim, i)
        along = (x - origin[0]) * direction[0] + (y - origin[1]) * direction[1]
        aside = (y - origin[1]) * direction[0] - (x - origin[0]) * direction[1]
        if abs(aside) < closest:
            closest, passed, corner = abs(aside), along, i
        if before_aside >= 0.0 >= aside and before_aside > aside:
            s = before + (along - before) * (before_aside / (before_aside - aside))
            if s < entry:
                entry, feature = s, np.int64(FACE + (i + count - 1) % count)
        elif before_aside <= 0.0 <= aside and before_aside < aside:
            s = before + (along - before) * (before_aside / (before_aside - aside))
            leave = max(leave, s)
    if entry <= leave:
        return entry, leave, feature
    if closest <= slack:
        return passed, passed, np.int64(FACE + corner)
    return np.inf, -np.inf, feature


@lean_kernel
def closest_on_rim(rim, point, out):
    """Fill `out` with the closest point of the rim; return the distance."""
    best = np.inf
    for i in range(rim.corners.shape[0]):
        corner_x, corner_y = corner_of(rim, i)
        x, y = edge_of(rim, i)
        edge, share = math.hypot(x, y), 0.0
        if edge > 0.0:
            along = (point[0] - corner_x) * (x / edge) + (point[1] - corner_y) * (y / edge)
            share = min(max(along / edge, 0.0), 1.0)
        near_x, near_y = corner_x + share * x, corner_y + share * y
        distance = math.hypot(point[0] - near_x, point[1] - near_y)
        if distance < best:
            best, out[0], out[1] = distance, near_x, near_y
    return best


@lean_kernel
def closest_on_polygon(rim, point, out):
    """As `closest_on_rim`; `point` itself and 0 inside."""
    out[0], out[1] = 1.0, 0.0
    entry, leave, _ = cross_polygon(rim, point, out, 0.0)
    if entry <= 0.0 <= leave:
        out[0], out[1] = point[0], point[1]
        return 0.0
    return closest_on_rim(rim, point, out)


@lean_kernel
def rim_of(footprint, hulls, scale):
    """The rim of a footprint that is no oval: what is seen of a mesh is kept with those."""
    if hulls is not None and footprint.polygon > 0:
        span = hulls.spans[footprint.polygon - 1].vertices
        return Rim(hulls.vertices[span[0] : span[1], :2], scale)
    return Rim(footprint.corners[:, :2], scale)


# ---- Meshes that are not convex: the shadows of their triangles.


@lean_kernel
def are_shadows(footprint, hulls):
    """Whether a footprint is that of a mesh that is not convex."""
    if not (footprint.shaped and footprint.polygon > 0):
        return False
    return hulls.spans[footprint.polygon - 1].form != CONVEX


@lean_kernel
def shadows_of(footprint, hulls):
    """The `Surface` of such a footprint: it lies at z = 0."""
    return numbered_surface(hulls, footprint.polygon - 1)


@lean_kernel
def rim_of_shadow(surface, face, scale, places):
    """The rim of a triangle's shadow; its corners are copied to `places` (3, 3)."""
    for number in range(3):
        corner = surface.vertices[surface.corners[face, number]]
        for axis in range(3):
            places[number, axis] = corner[axis]
    return Rim(places[:, :2], scale)


@lean_kernel
def closest_on_shadows(surface, scale, point, out):
    """As `closest_on_polygon`."""
    place, closest = stack_array(3, np.float64), stack_array(3, np.float64)
    place[0], place[1], place[2] = point[0] / scale, point[1] / scale, 0.0
    distance = closest_on_surface(surface, place, closest)
    out[0], out[1] = closest[0] * scale, closest[1] * scale
    return distance * scale


@lean_kernel
def closest_on_convex(footprint, hulls, scale, point, out):
    """`closest_on_core` of a polygon."""
    return closest_on_polygon(rim_of(footprint, hulls, scale), point, out)


@lean_kernel
def closest_on_any(footprint, hulls, scale, point, out):
    """`closest_on_core` of a polygon, or of the shadows of triangles."""
    if are_shadows(footprint, hulls):
        return closest_on_shadows(shadows_of(footprint, hulls), scale, point, out)
    return closest_on_convex(footprint, hulls, scale, point, out)


@chosen_by_types
def closest_on_core(footprint, hulls, scale, point, out):
    """`closest_on_polygon` of what a footprint, which is no oval, is without its radius."""
    return closest_on_any if are_any(hulls) else closest_on_convex


# ---- The closest point of a footprint.


@lean_kernel
def oval_of(footprint, scale):
    """See `oval`."""
    a, b = footprint.half_axes[0] * scale, footprint.half_axes[1] * scale
    return footprint.straight * scale, a, b


@lean_kernel
def closest_on_footprint(footprint, hulls, scale, point, out):
    """Fill `out` with a footprint's closest point, `point` itself inside; return the distance."""
    if footprint.oval:
        return look_out_of_oval(footprint, scale, point, out, out)
    distance = closest_on_core(footprint, hulls, scale, point, out)
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
    along, across = footprint.along, stack_array((2, 2), np.float64)
    across[0, 0], across[0, 1] = to_oval(along, point)
    _, distance = measure_oval(oval_of(footprint, scale), across[0], across[1])
    u, v = across[1, 0], across[1, 1]
    x, y = u * along[0] - v * along[1], u * along[1] + v * along[0]
    normal[0], normal[1] = x, y
    closest[0], closest[1] = point[0] - distance * x, point[1] - distance * y
    return distance
