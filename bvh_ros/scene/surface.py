# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether triangles are the closed surface of one convex solid, given as exporters write them: in
float32, wound anyhow, each corner once a triangle, slivers and triangles without area among them.

Rounding moves a corner by up to `noise`, and turns the plane of a triangle by noise / its height:
so far inwards, at the distance that is looked at, a surface may bend and is taken for convex.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

NOISE = 2.0**-22  # of the lengths that were rounded: float32 rounds by up to 2**-24 of them
MOST_PAIRS = 2**24  # of triangles and corners that are compared: 0.1 s


class Surface(NamedTuple):
    """A closed convex surface."""

    vertices: Floats
    """(k, 3), each once."""
    corners: Integers
    """(m, 3) rows of vertices, one row a triangle."""
    normals: Floats
    """(m, 3) outward unit normals; a sliver has that of a neighbour."""
    edges: Integers
    """(e, 2) rows of vertices, each edge once."""


class Facets(NamedTuple):
    """Triangles and the planes through them."""

    corners: Integers
    normals: Floats  # (m, 3) outward unit normals
    offsets: Floats  # (m,) n . p on the plane
    heights: Floats  # (m,) of each triangle over its longest edge
    lengths: Floats  # (m,) of that edge


def surface_of(triangles: Floats) -> Surface:
    """The surface of finite triangles (m, 3, 3); ValueError, saying why, if it is not closed and
    convex.
    """
    points = triangles.reshape(-1, 3)
    noise = _noise(points)
    vertices, number = weld(points, noise)
    corners, row = _without_repeats(number.reshape(-1, 3))
    used = np.unique(corners)
    if len(used) < len(vertices):
        stray = np.flatnonzero(~np.isin(number, used))[0]
        raise ValueError(f'triangle {int(stray) // 3} has no area, and is no part of the surface')
    _require_thickness(vertices, corners, noise)
    edges, pairs = _edges(corners, row)
    if len(vertices) - len(edges) + len(corners) != 2:  # Euler: one surface without holes
        raise ValueError('the mesh is not the surface of one convex solid')
    facets = _facets(vertices, corners, pairs, noise)
    _require_convexity(vertices, facets, pairs, row, noise)
    return Surface(vertices, corners, facets.normals, edges)


def _noise(points: Floats) -> float:
    """How far corners may have been moved. They were rounded where they are if they are float32
    still, else next to their own origin.
    """
    extent = float(np.ptp(points, axis=0).max())
    with np.errstate(over='ignore'):
        single = np.array_equal(points.astype(np.float32), points)
    return NOISE * max(extent, float(np.abs(points).max()) if single else 0.0)


def weld(points: Floats, noise: float) -> tuple[Floats, Integers]:
    """Points (k, 3) that differ by more than the noise on some axis, and (n,) which each is."""
    number = np.zeros(len(points), np.int64)
    for axis in range(3):
        order = np.argsort(points[:, axis], kind='stable')
        apart = np.diff(points[order, axis], prepend=-np.inf) > noise
        step = np.empty(len(points), np.int64)
        step[order] = np.cumsum(apart)
        number = np.unique(number * (len(points) + 1) + step, return_inverse=True)[1].reshape(-1)
    first = np.unique(number, return_index=True)[1]
    return points[first], number


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


def _edges(corners: Integers, row: Integers) -> tuple[Integers, Integers]:
    """Edges (e, 2), and the two triangles (e, 2) at each; ValueError if there are not two."""
    ends = np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    number = _one_number(ends)
    _, first, count = np.unique(number, return_index=True, return_counts=True)
    if (count != 2).any():
        bad = int(np.flatnonzero(count[number] != 2)[0])
        raise ValueError(
            f'the mesh is not closed: an edge of triangle {int(row[bad // 3])} belongs to '
            f'{int(count[number[bad]])} triangles, not two'
        )
    return ends[first], np.argsort(number, kind='stable').reshape(-1, 2) // 3


def _facets(vertices: Floats, corners: Integers, pairs: Integers, noise: float) -> Facets:
    """Planes of the triangles, away from the middle. A sliver narrower than the noise has no plane
    of its own.
    """
    one, two, three = (vertices[corners[:, k]] for k in range(3))
    normals = np.cross(two - one, three - one)
    area = np.linalg.norm(normals, axis=1)
    sides = (two - one, three - two, one - three)
    lengths = np.max([np.linalg.norm(side, axis=1) for side in sides], axis=0)
    heights = area / lengths
    flat = heights <= noise
    normals /= np.where(flat, 1.0, area)[:, None]
    inwards = np.einsum('ni,ni->n', normals, one - vertices.mean(axis=0)) < 0
    normals[inwards] *= -1.0
    if flat.all():
        raise ValueError('the mesh has no triangle that is wider than its rounding')
    while flat.any():
        for here, there in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
            takes = flat[here] & ~flat[there]
            normals[here[takes]] = normals[there[takes]]
            flat[here[takes]] = False
    offsets = np.einsum('ni,nki->nk', normals, vertices[corners]).max(axis=1)
    return Facets(corners, normals, offsets, heights, lengths)


def _require_thickness(vertices: Floats, corners: Integers, noise: float) -> None:
    one, two, three = (vertices[corners[:, k]] for k in range(3))
    normals = np.cross(two - one, three - one)
    largest = normals[np.argmax(np.einsum('ni,ni->n', normals, normals))]
    length = np.linalg.norm(largest)
    if length == 0.0 or np.ptp(vertices @ (largest / length)) <= 4.0 * noise:
        raise ValueError('the mesh is flat: it has no inside')


def _require_convexity(
    vertices: Floats, facets: Facets, pairs: Integers, row: Integers, noise: float
) -> None:
    """Closed, connected and bulging nowhere inwards at an edge is convex (Tietze and Nakajima). As
    what is lost in noise at every edge may add up to a dent, corners are held against the planes
    of far triangles too: all of them, or of the widest as many as is done in a moment.
    """
    corners, normals, offsets, heights, lengths = facets

    def require(which: Integers, places: Floats, reach: Any) -> None:
        heights_there = np.maximum(heights[which], 5e-324)
        with np.errstate(over='ignore'):
            allowed = noise * (1.0 + 2.0 * reach / heights_there)
        excess = places - offsets[which] - allowed
        if excess.max() > 0.0:
            worst = int(row[which[np.argmax(excess)]])
            raise ValueError(f'the mesh is not convex at triangle {worst}')

    middle = vertices.mean(axis=0)
    every = np.arange(len(corners))
    require(every, np.where(heights > noise, normals @ middle, -np.inf), 0.0)
    for here, there in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
        places = np.einsum('ni,nki->nk', normals[here], vertices[corners[there]]).max(axis=1)
        require(here, places, lengths[there])
    extent = float(np.ptp(vertices, axis=0).max())
    widest = np.argsort(-heights, kind='stable')[: max(MOST_PAIRS // len(vertices), 1)]
    for begin in range(0, len(widest), 256):
        which = widest[begin : begin + 256]
        require(which, (normals[which] @ vertices.T).max(axis=1), extent)
