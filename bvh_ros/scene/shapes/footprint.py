# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Footprints: shapes seen from above, for planar scenes."""

import math
from typing import Any, ClassVar, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from ...tree.access import node_dtype
from ...tree.compiler import inlined, lean_kernel, stack_array
from .mesh import CONVEX, LANES, NUMBERS, Mesh, convex_polygon, digest
from .shape import FINE, MESH, NOT_CONVEX, Canonical, Floats, ShapeKind, Shapes, rotations

# ---- Convex polygons: meshes seen from above, for planar scenes.


class Polygon:
    """What is seen of a mesh in one pose: all that a planar scene needs of it.

    It stands in for the mesh in a `MeshStore`, as one without triangles.
    """

    discs: ClassVar[Floats] = np.empty((0, NUMBERS, LANES))
    corners: ClassVar[NDArray[np.int32]] = np.empty((0, 3), np.int32)
    rows: ClassVar[NDArray[np.int32]] = np.empty(0, np.int32)
    normals: ClassVar[Floats] = np.empty((0, 3))
    tree: ClassVar[tuple[NDArray[Any], int]] = (np.empty(0, node_dtype(3)), 0)
    radius: ClassVar[float] = 0.0
    form: ClassVar[int] = CONVEX

    def __init__(self, mesh: Mesh, orientation: Floats) -> None:
        self.mesh = mesh
        """Kept, so that `mesh_of` knows it while it is in use."""
        turn = rotations(orientation[None])[0]
        upright = not orientation[:2].any()
        corners = mesh.outline if upright else convex_polygon(mesh.vertices @ turn[:2].T)
        if upright:
            corners = corners @ turn[:2, :2].T
        self.vertices: Floats = np.column_stack((corners, np.zeros(len(corners))))
        """(k, 3) corners counter-clockwise, turned, from the centre; z is 0."""
        self.seeds: Floats = self.vertices[:1]
        self.key = digest(self.vertices)
        """The same for equal polygons."""


_in_use: WeakValueDictionary[tuple[bytes, bytes], Polygon] = WeakValueDictionary()


def mark_not_convex(meshes: NDArray[np.object_], form: Canonical) -> None:
    """Mark the canonical rows whose meshes are not convex: they have no polygon."""
    for row in np.flatnonzero((form.records['kind'] == MESH) & (form.faults == FINE)).tolist():
        if not meshes[row].convex:
            form.faults[row] = NOT_CONVEX


def outlined(meshes: NDArray[np.object_] | None, form: Canonical) -> NDArray[np.object_] | None:
    """The polygons of the meshes of canonical rows; that of a mesh which only moves is there
    already. A row whose mesh is not convex gets a fault.
    """
    if meshes is None:
        return None
    polygons = np.empty(len(meshes), object)
    mark_not_convex(meshes, form)
    is_mesh = (form.records['kind'] == MESH) & (form.faults == FINE)
    for row in np.flatnonzero(is_mesh).tolist():
        mesh, orientation = meshes[row], form.records['orientation'][row]
        key = mesh.key, orientation.tobytes()
        polygons[row] = _in_use.get(key) or Polygon(mesh, orientation)
        _in_use[key] = polygons[row]
    return polygons


# ---- Footprints: shapes seen from above, for planar scenes.
#
# A box casts a zonogon, the sum of three segments (its half axes seen from above): a rectangle
# if it stands upright, else up to six corners. A ball casts a disc; a capsule a disc drawn along
# a segment; a cylinder that stands a disc, one that lies a rectangle, and one that leans an
# oval: an ellipse (its disc seen from above) drawn along a segment (its axis seen from above). A
# mesh casts a polygon, which is kept with the meshes.
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
        ('polygon', np.int32),  # of a mesh: 1 + its number in the store; else 0
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
FACE = 4  # the first triangle of a mesh, or edge of a polygon


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
    along, across = footprint.along, stack_array((2, 2), np.float64)
    across[0, 0], across[0, 1] = to_oval(along, point)
    _, distance = measure_oval(oval_of(footprint, scale), across[0], across[1])
    u, v = across[1, 0], across[1, 1]
    x, y = u * along[0] - v * along[1], u * along[1] + v * along[0]
    normal[0], normal[1] = x, y
    closest[0], closest[1] = point[0] - distance * x, point[1] - distance * y
    return distance
