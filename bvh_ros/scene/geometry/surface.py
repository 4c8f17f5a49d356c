# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether triangles are the closed surface of one convex solid, given as exporters write them: in
float32, wound anyhow, each corner once a triangle, slivers and triangles without area among them.

Rounding moves a corner by up to `noise`. A surface may bend inwards by no more than the noise, and
corners within half the noise of each other on every axis become one. So nowhere do the given
surface, the hull of all given corners and the solid that is kept differ by more than the noise.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .convexity import lying

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

NOISE = 2.0**-22  # of the lengths that were rounded: float32 rounds by up to 2**-24 of them
SMALLEST, LARGEST = 1e-100, 1e100  # beyond, products of three lengths leave the range of doubles


class Surface(NamedTuple):
    """A closed convex surface."""

    vertices: Floats
    """(k, 3), each once."""
    corners: Integers
    """(m, 3) rows of vertices, one row a triangle."""
    normals: Floats
    """(m, 3) outward unit normals; a sliver has that of a plane that holds the solid there."""
    edges: Integers
    """(e, 2) rows of vertices, each edge once."""


class Closed(NamedTuple):
    """Triangles of which two meet at every edge."""

    used: Integers  # (k,) rows of the points
    corners: Integers  # (m, 3) rows of those
    row: Integers  # (m,) which of the given triangles they are
    edges: Integers  # (e, 2)


def surface_of(triangles: Floats) -> Surface:
    """The surface of finite triangles (m, 3, 3); ValueError, saying why, if it is not closed and
    convex.
    """
    given = triangles.reshape(-1, 3)
    lo, hi = given.min(axis=0), given.max(axis=0)
    extent, largest = float((hi - lo).max()), float(np.maximum(-lo, hi).max())
    if largest == 0.0 or extent == 0.0:
        raise ValueError('the mesh has no triangle with an area')
    if extent < SMALLEST or largest > LARGEST:
        raise ValueError('the mesh is too small or too large')
    first, number = coinciding(given)
    places, corners = given[first], number.reshape(-1, 3)
    # About the middle, in a power of two: nothing over- or underflows, and little is rounded.
    exponent = math.frexp(extent)[1]
    points = np.ldexp(places - (lo * 0.5 + hi * 0.5), -exponent)
    noise = math.ldexp(_noise(given, extent, largest), -exponent)
    _require_thickness(points, corners, noise)
    try:
        closed = _closed(corners, weld(points, 0.5 * noise))
    except ValueError as reason:
        try:  # a part finer than the noise may fold where it is welded
            closed = _closed(corners, np.arange(len(points)))
        except ValueError:
            raise reason from None
    vertices, rows = points[closed.used], closed.corners
    normals, heights, middle = _planes(vertices, rows)
    sliver = heights <= noise
    # Else a tetrahedron, which is convex. Every node makes one when it starts, and need not import
    # a library for that.
    if len(points) > 4 or sliver.any():
        lies = lying(points, closed.used[rows], noise)
        worst = int(np.argmax(lies.depths))
        if lies.depths[worst] > noise:
            depth, allowed = (math.ldexp(x, exponent) for x in (float(lies.depths[worst]), noise))
            raise ValueError(
                f'the mesh is not convex at triangle {int(closed.row[worst])}: it lies '
                f'{depth:.3g} m within the hull of all corners, and {allowed:.3g} m are allowed'
            )
        normals[sliver] = lies.normals[sliver]
    if not goes_around(vertices[rows] - middle, heights):
        raise ValueError('the mesh is not the surface of one convex solid')
    return Surface(places[closed.used], rows, normals, closed.edges)


def _noise(points: Floats, extent: float, largest: float) -> float:
    """How far corners may have been moved. They were rounded where they are if they are float32
    still, else next to their own origin.
    """
    with np.errstate(over='ignore', under='ignore'):
        single = np.array_equal(points.astype(np.float32), points)
    return NOISE * max(extent, largest if single else 0.0)


def coinciding(points: Floats, tolerance: float = 0.0) -> tuple[Integers, Integers]:
    """Chains of points (n, 3) with no wider gap on any axis: the first of each, and (n,) which
    chain each point belongs to. Without a tolerance these are the different points.
    """
    number, count = np.zeros(len(points), np.int64), 0
    while True:
        for axis in range(3):
            order = np.lexsort((points[:, axis], number))
            apart = np.diff(points[order, axis], prepend=-np.inf) > tolerance
            apart |= np.diff(number[order], prepend=-1) != 0
            number[order] = np.cumsum(apart) - 1
        if tolerance == 0.0 or number.max() + 1 == count:
            return np.unique(number, return_index=True)[1], number
        count = int(number.max()) + 1  # a gap on one axis may have parted a chain on another


def weld(points: Floats, tolerance: float) -> Integers:
    """Which point (n,) each of different points becomes: the first of those that are all within
    the tolerance of each other on every axis. A chain that is longer is a fine part of the
    surface, and stays as it is.
    """
    first, number = coinciding(points, tolerance)
    order = np.argsort(number, kind='stable')
    begins = np.searchsorted(number[order], np.arange(len(first)))
    longest = np.max(
        np.maximum.reduceat(points[order], begins) - np.minimum.reduceat(points[order], begins),
        axis=1,
    )
    return np.where(longest[number] <= tolerance, first[number], np.arange(len(points)))


def _closed(corners: Integers, becomes: Integers) -> Closed:
    """Triangles when each point becomes another; ValueError if they are not closed."""
    used, number = np.unique(becomes[corners], return_inverse=True)
    number = number.reshape(-1, 3)
    rows, row = _without_repeats(number)
    stray = np.ones(len(used), np.bool_)
    stray[rows] = False
    if stray.any():
        bad = int(np.argmax(stray[number].any(axis=1)))
        raise ValueError(f'triangle {bad} has no area, and is no part of the surface')
    edges = _edges(rows, row)
    if len(used) - len(edges) + len(rows) != 2:  # Euler: one surface without holes
        raise ValueError('the mesh is not the surface of one convex solid')
    return Closed(used, rows, row, edges)


def _without_repeats(corners: Integers) -> tuple[Integers, Integers]:
    """Triangles with three different corners, each once, and their rows.

    One whose corners coincide is an edge: its neighbours meet there without it.
    """
    ordered = np.sort(corners, axis=1)
    row = np.flatnonzero((np.diff(ordered, axis=1) > 0).all(axis=1))
    if not len(row):
        raise ValueError('the mesh has no triangle with an area')
    row = row[np.sort(np.unique(_one_number(ordered[row]), return_index=True)[1])]
    return corners[row], row


def _one_number(rows: Integers) -> Integers:
    """A number for each row, the same for equal rows."""
    number = rows[:, 0]
    for column in range(1, rows.shape[1]):
        number = np.unique(number * (rows.max() + 1) + rows[:, column], return_inverse=True)[1]
    return number.reshape(-1)


def _edges(corners: Integers, row: Integers) -> Integers:
    """Edges (e, 2); ValueError if there are not two triangles at each."""
    ends = np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    number = ends[:, 0] * (int(ends.max()) + 1) + ends[:, 1]
    _, first, which, count = np.unique(
        number, return_index=True, return_inverse=True, return_counts=True
    )
    if (count != 2).any():
        bad = int(np.flatnonzero(count[which] != 2)[0])
        raise ValueError(
            f'the mesh is not closed: an edge of triangle {int(row[bad // 3])} belongs to '
            f'{int(count[which[bad]])} triangles, not two'
        )
    return ends[first]


def _require_thickness(points: Floats, corners: Integers, noise: float) -> None:
    one, two, three = (points[corners[:, k]] for k in range(3))
    normals = np.cross(two - one, three - one)
    largest = normals[np.argmax(np.einsum('ni,ni->n', normals, normals))]
    length = np.linalg.norm(largest)
    if length == 0.0 or np.ptp(points @ (largest / length)) <= 4.0 * noise:
        raise ValueError('the mesh is flat: it has no inside')


def _planes(vertices: Floats, corners: Integers) -> tuple[Floats, Floats, Floats]:
    """Unit normals (m, 3) of the triangles, outwards; (m,) their heights over their longest edges;
    and the middle of the surface.
    """
    one, two, three = (vertices[corners[:, k]] for k in range(3))
    normals = np.cross(two - one, three - one)
    area = np.linalg.norm(normals, axis=1)
    sides = (two - one, three - two, one - three)
    heights = area / np.max([np.linalg.norm(side, axis=1) for side in sides], axis=0)
    middle = area @ (one + two + three) / (3.0 * area.sum())
    normals /= np.where(area > 0.0, area, 1.0)[:, None]
    normals[np.einsum('ni,ni->n', normals, one - middle) < 0] *= -1.0
    return normals, heights, middle


def goes_around(triangles: Floats, heights: Floats) -> bool:
    """Whether a closed surface near its hull goes around the origin: a line from there crosses it
    an odd number of times. (One side of a hull, there and back, is closed as well.)
    """
    way = (0.43, 0.31, 0.26) @ triangles[np.argmax(heights)]
    one, two, three = (triangles[:, k] for k in range(3))
    sides = np.array([np.cross(a, b) @ way for a, b in ((one, two), (two, three), (three, one))])
    volumes = np.einsum('ni,ni->n', one, np.cross(two, three))
    crossed = ((sides > 0.0) & (volumes > 0.0)) | ((sides < 0.0) & (volumes < 0.0))
    return bool(np.count_nonzero(crossed.all(axis=0)) % 2)
