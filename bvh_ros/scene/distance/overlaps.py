# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles touch a query shape, and which touch each other.

Broad phase, exact decision between axis-aligned boxes, narrow phase for the others.
"""

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.boxes.overlapping import overlap_many
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import lean_kernel
from ...tree.nodes import SLOT_MASK, box_dtype, leaf_box
from ..geometry import hull, shapes
from ..geometry.query_shape import QueryShape
from ..geometry.shapes import Floats, ShapeKind
from ..results import require_few
from ..store.columns import Columns
from ..store.mesh_store import NO_HULLS
from ..store.registry import Slots
from . import narrow_phase, overlap_footprint


class Touching(NamedTuple):
    """Obstacles that touch a query, one a row in no order, and how each lies to its centre."""

    slots: Slots
    distances: Floats
    points: Floats
    normals: Floats


def find(
    tree: DynamicBVH, columns: Columns, query: QueryShape, mask: np.uint32, most: int | None = None
) -> Touching:
    """The obstacles whose distance from the query's shape is at most its tolerance;
    TooManyHitsError if they are more than `most`.
    """
    ndim = tree.ndim
    slots = _reached(tree, query, mask)
    records = columns.geometry[slots]
    touches = np.ones(len(slots), np.bool_)
    narrow = records['shaped'] if query.aligned else touches.copy()
    if query.tolerance > 0.0:
        lo, hi = corners(records[~narrow])
        within = lo[:, :ndim], hi[:, :ndim], query.lo[:ndim], query.hi[:ndim]
        touches[~narrow] = boxes_within(*within, query.tolerance)
    if narrow.any():
        found = np.empty(np.count_nonzero(narrow), np.bool_)
        hulls = columns.hulls(), query.hulls
        if hulls != (None, None):
            hulls = hulls[0] or NO_HULLS, hulls[1] or NO_HULLS
        planar = columns.footprint is not None
        columns.pairs_compared += len(found)
        columns.pairs_in_more_digits += narrow_phase.near_query(
            records[narrow], hulls[0], query.solid, hulls[1], query.tolerance, planar, found
        )
        touches[narrow] = found
    slots = slots[touches]
    require_few(len(slots), most)
    closest = closest_points if columns.footprint is None else closest_footprint_points
    points, distances, normals = closest(columns, slots, query.centre)
    if ndim == 2:
        points[:, 2] = query.height
    return Touching(slots, distances, points, normals)


def find_boxes(
    tree: DynamicBVH, query: QueryShape, mask: np.uint32, most: int | None = None
) -> Touching:
    """`find` where all obstacles are axis-aligned boxes, and the query is one: by the tree's boxes
    alone.
    """
    slots = _reached(tree, query, mask)
    if query.tolerance > 0.0:
        nodes, tight, _, _ = tree.arrays()
        boxes = tight[slots] if len(tight) else nodes[2 * slots]
        lo, hi = query.lo[: tree.ndim], query.hi[: tree.ndim]
        slots = slots[boxes_within(boxes['lo'], boxes['hi'], lo, hi, query.tolerance)]
    require_few(len(slots), most)
    return around(tree, slots, query.centre, query.height)


def around(tree: DynamicBVH, slots: Slots, centre: Floats, height: float) -> Touching:
    """How axis-aligned boxes lie to a centre, by the tree's boxes; in the plane at a height."""
    nodes, tight, _, _ = tree.arrays()
    points = np.empty((len(slots), 3))
    closest_in_boxes(nodes, tight, slots, centre, height, points)
    distances, normals = from_centre(points, centre, tree.ndim)
    return Touching(slots, distances, points, normals)


def _reached(tree: DynamicBVH, query: QueryShape, mask: np.uint32) -> Slots:
    """Slots of the boxes that touch the one around the grown query, in no order."""
    box = np.empty(1, box_dtype(tree.ndim))
    lo, hi = query.reach()
    box['lo'], box['hi'] = lo[: tree.ndim], hi[: tree.ndim]
    masks, sizes = np.array([mask]), np.empty(1, np.int64)
    handles: Slots = overlap_many(tree.view(), box, masks, 0, 1, sizes)
    return handles & SLOT_MASK


def find_pairs(tree: DynamicBVH, columns: Columns, mask: int) -> Slots:
    """Slots (m, 2) of all obstacles that touch each other, the older of a pair first, sorted."""
    pairs = tree.overlap_pairs(mask) & SLOT_MASK
    narrow = columns.geometry['shaped'][pairs].any(axis=1)
    if not narrow.any():
        return pairs
    touches = ~narrow
    found = np.empty(np.count_nonzero(narrow), np.bool_)
    planar = columns.footprint is not None
    columns.pairs_compared += len(found)
    columns.pairs_in_more_digits += narrow_phase.near_pairs(
        columns.geometry, columns.hulls(), pairs[narrow], planar, found
    )
    touches[narrow] = found
    return pairs[touches]


def each_once(columns: Columns, pairs: Slots) -> Slots:
    """Pairs of different obstacles, each once, where one may stand at two places."""
    handles = columns.node_handle[pairs]
    order = np.argsort(handles, axis=1)
    pairs, handles = np.take_along_axis(pairs, order, 1), np.take_along_axis(handles, order, 1)
    row = np.unique(handles, axis=0, return_index=True)[1]
    return pairs[row[handles[row, 0] != handles[row, 1]]]


def corners(records: NDArray[np.void]) -> tuple[Floats, Floats]:
    """Lowest and highest corners of axis-aligned boxes, the same doubles that the tree holds."""
    return records['position'] - records['half'], records['position'] + records['half']


def lengths(vectors: Floats) -> Floats:
    """Euclidean lengths of rows.

    Scaled by a power of two, so that squares neither overflow nor vanish.
    """
    exponent = np.frexp(np.abs(vectors).max(axis=1, initial=0.0))[1]
    scaled = np.ldexp(vectors, -exponent[:, None])
    result: Floats = np.ldexp(np.sqrt((scaled * scaled).sum(axis=1)), exponent)
    return result


def boxes_within(
    lo: Floats, hi: Floats, query_lo: Floats, query_hi: Floats, tolerance: float
) -> NDArray[np.bool_]:
    """Whether axis-aligned boxes are within the tolerance of another, as real arithmetic
    decides.
    """
    distances = lengths(np.maximum(np.maximum(lo - query_hi, query_lo - hi), 0.0))
    near: NDArray[np.bool_] = distances <= tolerance
    # A gap is rounded once, the length a few times: only next to the tolerance may that decide.
    close = np.flatnonzero(np.abs(distances - tolerance) <= 2.0**-49 * tolerance)
    gaps = _exact_gaps(lo[close], hi[close], query_lo, query_hi)
    axes = (gaps[:, 0] > 0.0).sum(axis=1)
    # Along one axis: a sum that rounds to the tolerance is larger if its second part is positive.
    first, rest = gaps.sum(axis=2).T
    near[close] = (first < tolerance) | ((first == tolerance) & (rest <= 0.0))
    slanted = close[axes > 1]
    if len(slanted):  # voxels that far away are many, but their gaps few
        known, of = np.unique(
            gaps[axes > 1].reshape(len(slanted), -1), axis=0, return_inverse=True
        )
        limit = Fraction(tolerance) ** 2
        squares = (
            sum((Fraction(a) + Fraction(b)) ** 2 for a, b in row)
            for row in known.reshape(len(known), 2, -1).transpose(0, 2, 1).tolist()
        )
        near[slanted] = np.array([square <= limit for square in squares])[of.ravel()]
    return near


def _exact_gaps(lo: Floats, hi: Floats, query_lo: Floats, query_hi: Floats) -> Floats:
    """The gaps (n, 2, ndim) between boxes and another along each axis, unrounded: each is the sum
    of two doubles, the second below the last digit of the first (Knuth's TwoSum).
    """
    above, below = lo - query_hi, query_lo - hi
    a = np.where(above > 0.0, lo, query_lo)
    b = np.where(above > 0.0, query_hi, hi)
    gap = np.maximum(np.maximum(above, below), 0.0)
    part = gap - a
    lost = (a - (gap - part)) + (-b - part)
    return np.stack((gap, np.where(gap > 0.0, lost, 0.0)), axis=1)


def from_centre(points: Floats, centre: Floats, ndim: int) -> tuple[Floats, Floats]:
    """How far points (n, 3) are from a centre along the first axes, and the unit vectors to it;
    zero at the centre.
    """
    distances, normals = np.empty(len(points)), np.zeros(points.shape)
    look_back(points, centre, ndim, distances, normals)
    return distances, normals


@lean_kernel
def look_back(points, centre, ndim, distances, normals):
    for i in range(points.shape[0]):
        largest = 0.0
        for axis in range(ndim):
            normals[i, axis] = centre[axis] - points[i, axis]
            largest = max(largest, abs(normals[i, axis]))
        # By a power of two, so that squares neither overflow nor vanish.
        exponent, square = math.frexp(largest)[1], 0.0
        for axis in range(ndim):
            scaled = math.ldexp(normals[i, axis], -exponent)
            square += scaled * scaled
        distances[i] = math.ldexp(math.sqrt(square), exponent)
        if distances[i] > 0.0:
            for axis in range(ndim):
                normals[i, axis] /= distances[i]


@lean_kernel
def closest_in_boxes(nodes, tight, slots, centre, height, points):
    """Fill in the point of each leaf's box closest to `centre`; in the plane at `height`."""
    for i in range(slots.shape[0]):
        lo, hi = leaf_box(nodes, tight, 2 * slots[i])
        points[i, 2] = height
        for axis in range(lo.shape[0]):
            points[i, axis] = min(max(centre[axis], lo[axis]), hi[axis])


def closest_points(
    columns: Columns, slots: Slots, centre: Floats
) -> tuple[Floats, Floats, Floats]:
    """The point of each shape closest to `centre`; the centre itself where it lies inside. Then
    how far it is, and the unit vector to the centre, or zero.

    Far from the world's origin points are rounded more than distances.
    """
    records = columns.geometry[slots]
    lo, hi = corners(records)
    points = np.clip(centre, lo, hi)
    turned = np.flatnonzero(records['shaped'])
    if not len(turned):
        return points, *from_centre(points, centre, 3)
    records = records[turned]
    matrices = shapes.rotations(records['orientation'])
    local = np.einsum('nij,ni->nj', matrices, centre - records['position'])
    closest = closest_in_frames(records['kind'], records['half'], local)
    for row in np.flatnonzero(records['kind'] == ShapeKind.MESH).tolist():
        mesh = columns.meshes[int(records['mesh'][row])]
        vertices = hull.Hull(mesh.vertices, mesh.discs, mesh.radius)
        hull.closest_on_hull(vertices, local[row], closest[row])
    inside = (closest == local).all(axis=1)
    points[turned] = np.einsum('nij,nj->ni', matrices, closest) + records['position']
    points[turned[inside]] = centre
    distances, normals = from_centre(points, centre, 3)
    distances[turned] = lengths(local - closest)
    return points, distances, normals


def closest_in_frames(kind: NDArray[np.uint8], half: Floats, local: Floats) -> Floats:
    """The same in the frame of each shape, where it lies at the origin."""
    closest: Floats = np.clip(local, -half, half)
    rows = np.flatnonzero(kind == ShapeKind.CYLINDER)
    far = lengths(local[rows, :2])
    closest[rows, :2] = local[rows, :2] * (half[rows, 0] / np.maximum(far, half[rows, 0]))[:, None]
    rows = np.flatnonzero((kind == ShapeKind.SPHERE) | (kind == ShapeKind.CAPSULE))
    axis = np.zeros((len(rows), 3))
    straight = half[rows, 2] - half[rows, 0]
    axis[:, 2] = np.clip(local[rows, 2], -straight, straight)
    away, radius = local[rows] - axis, half[rows, :1]
    far = lengths(away)[:, None]
    on_surface = axis + away * (radius / np.maximum(far, radius))
    closest[rows] = np.where(far > radius, on_surface, local[rows])
    return closest


# ---- seen from above


def closest_footprint_points(
    columns: Columns, slots: Slots, centre: Floats
) -> tuple[Floats, Floats, Floats]:
    """`closest_points` seen from above; z is that of the centre."""
    points = np.clip(centre, *corners(columns.geometry[slots]))
    points[:, 2] = centre[2]
    footprints = columns.footprint_arrays()
    turned = np.flatnonzero(columns.geometry['shaped'][slots])
    if footprints is not None and len(turned):
        places = np.empty((len(turned), 2))
        shapes, hulls = footprints
        overlap_footprint.closest_points(shapes[slots[turned]], hulls, centre[:2].copy(), places)
        points[turned, :2] = places
    return points, *from_centre(points, centre, 2)
