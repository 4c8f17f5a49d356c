# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How deep a surface lies within the convex hull of its corners, proved for the whole of it.

That a surface bends inwards at no edge by more than rounding says little: a thousand such edges
add up to a dent. So each triangle is held against the hull of all corners (Barber, Dobkin and
Huhdanpaa, The Quickhull Algorithm for Convex Hulls, 1996). No point is above a plane of the hull:
a triangle whose corners are at most so far below one such plane is nowhere deeper in the hull.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

AT_ONCE = 2**19  # triangles times planes that are compared in one go
WIDEST = 64  # faces of the hull that every triangle is held against
NEARBY = 8  # planes that each triangle is held against at each of its corners
SHAKEN = 2.0**-30  # by how much points are moved along each axis, of the largest coordinate


class Lying(NamedTuple):
    """How deep triangles lie in the hull, and below which plane of it."""

    depths: Floats  # (m,) at most
    normals: Floats  # (m, 3) of those planes, outward unit vectors


class Hull(NamedTuple):
    """Planes of a hull, and which of them meet at the corner nearest each of its points."""

    equations: Floats  # (f, 4) outward unit normal n and d: n . x + d <= 0 in the hull
    areas: Floats  # (f,) of the faces
    first: Integers  # (k,) where the planes of each point begin in `number`
    times: Integers  # (k,) how many they are
    number: Integers


def lying(points: Floats, corners: Integers, enough: float) -> Lying:
    """How deep triangles, rows (m, 3) of points (k, 3), lie in the hull of all points.

    Where that is more than `enough`, no plane of the hull says less; the search ends with the
    first such triangles. Else some plane that says so little is taken.
    """
    hull, faces = _hull(points)
    found = Lying(np.full(len(corners), np.inf), np.zeros((len(corners), 3)))
    row, face = _shared(corners, faces, len(points))
    found.depths[row], found.normals[row] = 0.0, hull.equations[face, :3]
    rest = np.flatnonzero(found.depths > enough)
    widest = np.argsort(-hull.areas)[:WIDEST]
    for begin in range(0, len(rest), AT_ONCE // WIDEST):
        rows = rest[begin : begin + AT_ONCE // WIDEST]
        _hold_against(points, corners, rows, hull.equations[widest], found)
    rest = _hold_against_near(points, corners, rest, hull, enough, found)
    rest = rest[np.argsort(-found.depths[rest])]
    step = AT_ONCE // len(faces) + 1
    for begin in range(0, len(rest), step):
        rows = rest[begin : begin + step]
        _hold_against(points, corners, rows, hull.equations, found)
        if found.depths[rows].max() > enough:
            break
    return found


def _hull(points: Floats) -> tuple[Hull, Integers]:
    """The hull of points, and the triangles (f, 3) of its surface."""
    # Only meshes need this library: it is imported when the first one comes.
    from scipy.spatial import ConvexHull, QhullError, cKDTree

    # A flat face of ten thousand corners would take it minutes. So its points are moved, by far
    # less than what is looked for, and the planes outwards by as much.
    by = SHAKEN * float(np.abs(points).max())
    try:
        hull = ConvexHull(points + np.random.default_rng(1).uniform(-by, by, points.shape))
    except QhullError:
        raise ValueError('the mesh is flat: it has no inside') from None
    faces = hull.simplices.astype(np.int64)
    order = np.argsort(faces, axis=None, kind='stable')
    count = np.bincount(faces.ravel(), minlength=len(points))
    on_hull = np.flatnonzero(count)
    nearest = np.arange(len(points))
    within = np.flatnonzero(count == 0)
    nearest[within] = on_hull[cKDTree(points[on_hull]).query(points[within])[1]]
    first = np.cumsum(count) - count
    one, two, three = (points[faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(two - one, three - one), axis=1)
    equations = hull.equations - [0.0, 0.0, 0.0, math.sqrt(3.0) * by]
    return Hull(equations, areas, first[nearest], count[nearest], order // 3), faces


def _shared(corners: Integers, faces: Integers, count: int) -> tuple[Integers, Integers]:
    """Rows of triangles that are faces of the hull, and of which."""
    mine, theirs = (
        (ordered[:, 0] * count + ordered[:, 1]) * count + ordered[:, 2]
        for ordered in (np.sort(rows, axis=1) for rows in (corners, faces))
    )
    order = np.argsort(theirs)
    place = np.minimum(np.searchsorted(theirs[order], mine), len(faces) - 1)
    row = np.flatnonzero(theirs[order[place]] == mine)
    return row, order[place[row]]


def _hold_against_near(
    points: Floats, corners: Integers, rows: Integers, hull: Hull, enough: float, found: Lying
) -> Integers:
    """Hold triangles against planes that meet near their corners; return those that lie deeper."""
    for corner in range(3):
        for share in range(NEARBY):
            rows = rows[found.depths[rows] > enough]
            at = corners[rows, corner]
            number = hull.number[hull.first[at] + share * hull.times[at] // NEARBY]
            _note(points, corners, rows, hull.equations[number], found)
    return rows[found.depths[rows] > enough]


def _hold_against(
    points: Floats, corners: Integers, rows: Integers, equations: Floats, found: Lying
) -> None:
    """Hold triangles against all of some planes."""
    heights = points[corners[rows]] @ equations[:, :3].T + equations[:, 3]
    best = np.argmax(heights.min(axis=1), axis=1)
    _note(points, corners, rows, equations[best], found)


def _note(
    points: Floats, corners: Integers, rows: Integers, equations: Floats, found: Lying
) -> None:
    """Hold each triangle against one plane, and note what is less than was known."""
    heights = np.einsum('nki,ni->nk', points[corners[rows]], equations[:, :3])
    depths = -heights.min(axis=1) - equations[:, 3]
    less = depths < found.depths[rows]
    found.depths[rows[less]], found.normals[rows[less]] = depths[less], equations[less, :3]
