# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes: whether triangles are convex or closed, and what kernels need of them."""

import functools
import hashlib
import math
import os
from collections.abc import Callable
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree.access import OpenTree, checks, take_snapshot
from ...tree.compiler import WIDTH, entry_point, inlined, lean_kernel, stack_array
from .lazy import LazyProperty
from .triangles32 import fill_patches

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# ---- The convex polygon around points in the plane.


DIRECTIONS = 32  # first guess of a polygon: what is farthest along each of so many


def convex_polygon(points: Floats) -> Floats:
    """Corners (k, 2), counter-clockwise, of the convex hull of points (n, 2) that span an area."""
    points = points[_candidates(points)]
    order = np.lexsort((points[:, 1], points[:, 0]))
    places = points[order].tolist()
    lower, upper = _chain(places), _chain(places[::-1])
    return np.array(lower[:-1] + upper[:-1])


def _candidates(points: Floats) -> NDArray[np.bool_]:
    """Which points are not strictly within the polygon of those that are farthest along some
    directions.
    """
    angle = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    directions = np.column_stack((np.cos(angle), np.sin(angle)))
    rim = points[np.argmax(directions @ points.T, axis=1)]
    step = np.roll(rim, -1, axis=0) - rim
    outside = np.zeros(len(points), np.bool_)
    for (x, y), (along_x, along_y) in zip(rim.tolist(), step.tolist(), strict=True):
        if along_x or along_y:
            outside |= along_x * (points[:, 1] - y) <= along_y * (points[:, 0] - x)
    return outside


def _chain(places: list[list[float]]) -> list[list[float]]:
    """Half of the rim, along sorted points, turning left only (Andrew's monotone chain, 1979)."""
    chain: list[list[float]] = []
    for x, y in places:
        while len(chain) > 1:
            (a, b), (c, d) = chain[-2], chain[-1]
            if (c - a) * (y - b) > (d - b) * (x - a):
                break
            chain.pop()
        chain.append([x, y])
    return chain


# ---- How deep a surface lies within the convex hull of its corners, proved for the whole of it.
#
# That a surface bends inwards at no edge by more than rounding says little: a thousand such
# edges add up to a dent. So each triangle is held against the hull of all corners (Barber,
# Dobkin and Huhdanpaa, The Quickhull Algorithm for Convex Hulls, 1996). No point is above a
# plane of the hull: a triangle whose corners are at most so far below one such plane is nowhere
# deeper in the hull.


AT_ONCE = 2**17  # triangles times planes that are compared in one go: what a cache holds
SAMPLE = 64  # triangles that are looked at first
WIDEST = 64  # faces of the hull that every triangle is held against
NEARBY = 8  # planes that each triangle is held against at each of its corners
SHAKEN = 2.0**-30  # by how much points are moved along each axis, of the largest coordinate


class Lying(NamedTuple):
    """How deep triangles lie in the hull, and below which plane of it."""

    depths: Floats  # (m,) at most
    normals: Floats  # (m, 3) of those planes, outward unit vectors


def lying(points: Floats, corners: Integers, enough: float) -> Lying:
    """How deep triangles, rows (m, 3) of points (k, 3), lie in the hull of all points.

    Where that is more than `enough`, no plane of the hull says less; the search ends with the
    first such triangles, and says 0 of those that it did not look at. Else some plane that says so
    little is taken.
    """
    equations, faces = _hull(points)
    found = Lying(np.full(len(corners), np.inf), np.zeros((len(corners), 3)))
    row, face = _shared(corners, faces, len(points))
    found.depths[row], found.normals[row] = 0.0, equations[face, :3]
    rest = np.flatnonzero(found.depths > enough)
    if len(rest) > 4 * SAMPLE:
        # Of a mesh that is not convex some lie deep, which takes far less time to see than of all.
        some = rest[:: len(rest) // SAMPLE]
        step = AT_ONCE // len(faces) + 1
        for begin in range(0, len(some), step):
            _hold_against(points, corners, some[begin : begin + step], equations, found)
        if found.depths[some].max() > enough:
            found.depths[np.isinf(found.depths)] = 0.0
            return found
    one, two, three = (points.take(row, axis=0) for row in faces.T)
    areas = np.linalg.norm(np.cross(two - one, three - one), axis=1)
    widest = np.argsort(-areas)[:WIDEST]
    for begin in range(0, len(rest), AT_ONCE // WIDEST):
        rows = rest[begin : begin + AT_ONCE // WIDEST]
        _hold_against(points, corners, rows, equations[widest], found)
    rest = _hold_against_near(points, corners, rest, equations, faces, enough, found)
    rest = rest[np.argsort(-found.depths[rest])]
    step = AT_ONCE // len(faces) + 1
    for begin in range(0, len(rest), step):
        rows = rest[begin : begin + step]
        _hold_against(points, corners, rows, equations, found)
        if found.depths[rows].max() > enough:
            found.depths[rest[begin + step :]] = 0.0
            break
    return found


def _hull(points: Floats) -> tuple[Floats, Integers]:
    """Planes (f, 4) of the hull of points, outward unit normal n and d, n . x + d <= 0 within it;
    and the triangles (f, 3) of its surface that they go through.
    """
    # Only meshes need this library: it is imported when the first one comes.
    from scipy.spatial import ConvexHull, QhullError

    # A flat face of ten thousand corners would take it minutes. So its points are moved, by far
    # less than what is looked for, and the planes outwards by as much.
    by = SHAKEN * float(np.abs(points).max())
    try:
        hull = ConvexHull(points + np.random.default_rng(1).uniform(-by, by, points.shape))
    except QhullError:
        raise ValueError('the mesh is flat: it has no inside') from None
    equations = hull.equations - [0.0, 0.0, 0.0, math.sqrt(3.0) * by]
    return equations, hull.simplices.astype(np.int64)


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
    points: Floats,
    corners: Integers,
    rows: Integers,
    equations: Floats,
    faces: Integers,
    enough: float,
    found: Lying,
) -> Integers:
    """Hold triangles against planes that meet near their corners; return those that lie deeper."""
    rows = rows[found.depths[rows] > enough]
    if not len(rows):
        return rows
    from scipy.spatial import cKDTree

    number = np.argsort(faces, axis=None, kind='stable') // 3  # of planes, by the hull's corners
    times = np.bincount(faces.ravel(), minlength=len(points))
    first, nearest = np.cumsum(times) - times, np.arange(len(points))
    of_hull, within = np.flatnonzero(times), np.flatnonzero(times == 0)
    nearest[within] = of_hull[cKDTree(points[of_hull]).query(points[within])[1]]
    for corner in range(3):
        for share in range(NEARBY):
            at = nearest[corners[rows, corner]]
            plane = number[first[at] + share * times[at] // NEARBY]
            _note(points, corners, rows, equations.take(plane, axis=0), found)
            rows = rows[found.depths[rows] > enough]
    return rows


def _hold_against(
    points: Floats, corners: Integers, rows: Integers, equations: Floats, found: Lying
) -> None:
    """Hold triangles against all of some planes."""
    one, two, three = (points.take(row, axis=0) @ equations[:, :3].T for row in corners[rows].T)
    lowest = np.minimum(np.minimum(one, two), three) + equations[:, 3]
    best = np.argmax(lowest, axis=1)
    _note(points, corners, rows, equations.take(best, axis=0), found)


def _note(
    points: Floats, corners: Integers, rows: Integers, equations: Floats, found: Lying
) -> None:
    """Hold each triangle against one plane, and note what is less than was known."""
    places = points.take(corners.take(rows, axis=0), axis=0)
    heights = np.einsum('nki,ni->nk', places, equations[:, :3])
    depths = -heights.min(axis=1) - equations[:, 3]
    less = depths < found.depths[rows]
    found.depths[rows[less]], found.normals[rows[less]] = depths[less], equations[less, :3]


# ---- Which triangles count, and whether they are closed. Exporters write them in float32, wound
# anyhow, each corner once a triangle, with slivers and triangles without area among them.
#
# They are closed if an even number meets at every edge, no more: parts may touch, cross and lie in
# each other. A triangle without area is crossed by no line, but may close the seam between others:
# so it counts for the edges, and is left out afterwards.
#
# Rounding moves a corner by up to `noise`. So corners of open edges that are within half the noise
# of each other on every axis become one, if that closes the surface.


NOISE = 2.0**-22  # of the lengths that were rounded: float32 rounds by up to 2**-24 of them


class Surface(NamedTuple):
    """The triangles of a mesh."""

    vertices: Floats
    """(k, 3), each once."""
    corners: Integers
    """(m, 3) rows of vertices, one row a triangle."""
    rows: Integers
    """(m,) rows of the triangles as given."""
    normals: Floats
    """(m, 3) unit normals. Of a convex surface they point outwards, and a sliver has that of a
    plane that holds the solid there."""


class Linked:
    """Triangles, rows (m, 3) of points, and which of them meet."""

    def __init__(self, corners: Integers) -> None:
        self.corners = corners

    def moved(self, becomes: Integers) -> 'Linked':
        """The same when each point becomes another."""
        if (becomes == np.arange(len(becomes))).all():
            return self
        return Linked(becomes.take(self.corners))

    def part(self, rows: Integers) -> 'Linked':
        """Some of them, in their order."""
        return self if len(rows) == len(self.corners) else Linked(self.corners[rows])

    @LazyProperty
    def sets(self) -> Integers:
        """(m, 3) the corners in ascending order."""
        return np.sort(self.corners, axis=1)

    @LazyProperty
    def first(self) -> Integers:
        """(m,) the first triangle with the same three corners."""
        return _first_alike(self.sets, int(self.corners.max()) + 1)

    @LazyProperty
    def by_edge(self) -> tuple[Integers, Integers]:
        """(3 m,) edges, 3 times a triangle's row, and which, so that the same follow each other;
        and how many triangles meet at each edge of each, 0 if its ends coincide.
        """
        one, two = self.corners.ravel(), self.corners.take([1, 2, 0], axis=1).ravel()
        low, high = np.minimum(one, two), np.maximum(one, two)
        order, begins = _runs(low * (int(high.max()) + 1) + high)
        times = np.diff(begins, append=len(order))
        count = np.empty(len(order), np.int64)
        count[order] = np.repeat(times, times)
        count[low == high] = 0
        return order, count

    @property
    def open_edges(self) -> Integers:
        """Those of them at which an odd number of triangles meets."""
        return np.flatnonzero(self.by_edge[1] & 1)


class Given:
    """Finite triangles, rows (m, 3) of places (n, 3), but for those that are surely no part of a
    surface. ValueError if there are no others.
    """

    def __init__(self, places: Floats, rows: Integers) -> None:
        places = places + 0.0  # of zeros one sign
        first, number = different(places)
        self.points: Floats = places.take(first, axis=0)
        """(k, 3), each once."""
        self.linked = Linked(number.take(rows))
        """Rows of these."""
        self.rows = _joined(self.points, self.linked)
        """(m,) which of the given triangles they are."""
        if not len(self.rows):
            raise ValueError('the mesh has no triangle with an area')
        if len(self.rows) < len(rows):
            used, corners = _used(self.linked.corners[self.rows])
            self.points, self.linked = self.points[used], Linked(corners)
        lo, hi = _bounds(self.points)
        self.middle: Floats = lo * 0.5 + hi * 0.5
        self.farthest: Floats = np.maximum(-lo, hi)
        self.extent, self.largest = float((hi - lo).max()), float(self.farthest.max())

    @property
    def noise(self) -> Floats:
        """(3,) how far corners may have been moved along each axis. They were rounded where they
        are if they are float32 still, else next to their own origin.
        """
        with np.errstate(over='ignore', under='ignore'):
            single = np.array_equal(self.points.astype(np.float32), self.points)
        return NOISE * np.maximum(self.extent, self.farthest * single)


def _joined(points: Floats, linked: Linked) -> Integers:
    """Rows of triangles but for those without an area that join no others: two of their corners
    are one, or they have an edge of their own.
    """
    low, middle, high = linked.sets.T
    kept = np.flatnonzero((low < middle) & (middle < high))
    first = linked.first[kept]
    once = kept[first == kept]
    while len(once):
        form = linked.part(once)
        alone = np.flatnonzero((form.by_edge[1].reshape(-1, 3) == 1).any(axis=1))
        strays = alone[~_have_area(points, form.corners[alone])]
        if not len(strays):
            break
        once = np.delete(once, strays)
    return kept if len(once) == len(kept) else kept[np.isin(first, once)]


def closed_if_possible(given: Given, stitch: bool) -> tuple[Integers, Linked]:
    """(rows of those that count, these), closed if they can be: as given; or `stitch`, with seams
    that exporters rounded welded. Else each once.
    """
    found = _closed_rows(given.linked)
    if found is None and stitch:
        found = _closed_rows(_stitched(given))
    return found or _each_once(given.linked)


def _each_once(linked: Linked) -> tuple[Integers, Linked]:
    once = np.flatnonzero(linked.first == np.arange(len(linked.first)))
    return once, linked.part(once)


def _closed_rows(linked: Linked) -> tuple[Integers, Linked] | None:
    """Each triangle once, if these are closed, or all, if only they are; None if neither are.

    By parity, a part that is given twice would hold nothing. But two boxes may share a wall that
    both have. A sheet on both sides is no closed surface.
    """
    once, form = _each_once(linked)
    if not len(form.open_edges):
        return once, form
    if (np.bincount(linked.first) & 1).any() and not len(linked.open_edges):
        return np.arange(len(linked.first)), linked
    return None


def _stitched(given: Given) -> Linked:
    """Triangles whose corners along open edges are welded, as if exporters had rounded them; as
    they are if one of them would be gone: one that loses its area must lie along an edge of one
    that does not.
    """
    linked, count = given.linked, len(given.points)
    _, form = _each_once(linked)
    open_at, at_rim, becomes = form.open_edges, np.zeros(count, np.bool_), np.arange(count)
    at_rim[form.corners.take(open_at)] = True
    at_rim[form.corners.take([1, 2, 0], axis=1).take(open_at)] = True
    rim = np.flatnonzero(at_rim)
    becomes[rim] = rim[weld(given.points[rim], 0.5 * given.noise)]
    welded = linked.moved(becomes)
    moved = np.flatnonzero((welded.corners != linked.corners).any(axis=1))
    before, after = (_have_area(given.points, form.corners[moved]) for form in (linked, welded))
    gone = moved[before & ~after]
    if not len(gone):
        return welded
    kept = _have_area(given.points, welded.corners)
    edges = welded.sets[kept][:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2) @ (count, 1)
    low, middle, high = welded.sets[gone].T
    along = ((low == middle) | (middle == high)) & np.isin(low * count + high, edges)
    return welded if along.all() else linked


SPREAD = 0x1E3779B97F4A7C15  # an odd number that spreads the bits of what it multiplies


def _runs(numbers: Integers) -> tuple[Integers, Integers]:
    """Rows of numbers (n,) in ascending order, equal ones by rows; where each run of equal ones
    begins there.
    """
    order = np.argsort(numbers, kind='stable')  # which is fast where some are in order already
    ascending = numbers.take(order)
    return order, np.flatnonzero(np.r_[True, ascending[1:] != ascending[:-1]])


def _first_alike(rows: Integers, base: int) -> Integers:
    """The first row (n,) that is the same as each of some rows (n, 3)."""
    one, two, three = rows.T
    order, begins = _runs((one * base + two) * base + three)
    first = np.empty(len(rows), np.int64)
    first[order] = np.repeat(order[begins], np.diff(begins, append=len(order)))
    if np.array_equal(rows.take(first, axis=0), rows):
        return first
    # Different rows have one number by chance.
    _, begin, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return begin[which.reshape(-1)]


def different(points: Floats) -> tuple[Integers, Integers]:
    """The different ones of points (n, 3) without -0.0, by x, y and z: the first of each, and (n,)
    which of these each point is.
    """
    # Told apart by their bits: most corners of a mesh are those of six triangles.
    bits = points.view(np.uint64)
    bits = bits ^ (bits >> np.uint64(32))  # numbers that were float32 end in zeros
    same = _first_alike(bits.view(np.int64), SPREAD)
    first = np.flatnonzero(same == np.arange(len(points)))
    first = first[np.argsort(points[first, 0], kind='stable')]
    alike = np.diff(points[first, 0]) == 0.0
    tied = np.flatnonzero(np.r_[False, alike] | np.r_[alike, False])
    first[tied] = first[tied][np.lexsort(points[first[tied]].T[::-1])]
    number = np.empty(len(points), np.int64)
    number[first] = np.arange(len(first))
    return first, number.take(same)


def weld(points: Floats, tolerance: Floats) -> Integers:
    """Which point (n,) each of different points becomes: the first of those that are all within
    the tolerance (3,) of each other on every axis. A chain that is longer is a fine part of the
    surface, and stays as it is.
    """
    becomes = np.arange(len(points))
    # Chains of points with no wider gap on any axis; what is alone is left out.
    rows, chain = becomes, np.zeros(len(points), np.int64)
    axis, unbroken = 0, 0
    while len(rows) and unbroken < 3:  # a gap on one axis may have parted a chain on another
        order = np.lexsort((points[rows, axis], chain))
        rows, chain = rows[order], chain[order]
        gap = (np.diff(points[rows, axis]) > tolerance[axis]) & (np.diff(chain) == 0)
        chain[1:] += np.cumsum(gap)
        linked = np.diff(chain) == 0
        several = np.r_[False, linked] | np.r_[linked, False]
        rows, chain = rows[several], chain[several]
        axis, unbroken = (axis + 1) % 3, 0 if gap.any() else unbroken + 1
    if len(rows):
        begins = np.flatnonzero(np.diff(chain, prepend=-1))
        places, count = points[rows], np.diff(begins, append=len(rows))
        spread = np.maximum.reduceat(places, begins) - np.minimum.reduceat(places, begins)
        near = np.repeat((spread <= tolerance).all(axis=1), count)
        becomes[rows[near]] = np.repeat(np.minimum.reduceat(rows, begins), count)[near]
    return becomes


def _have_area(points: Floats, corners: Integers) -> NDArray[np.bool_]:
    """Which triangles, rows (m, 3) of points, have an area, exactly: those that seem to have none
    are looked at in whole numbers.
    """
    one, two, three = _places(np.ldexp(points, -math.frexp(np.abs(points).max())[1]), corners)
    sides = two - one, three - one
    longer = np.maximum(*(_squares(side) for side in sides))
    have = _squares(_crossed(*sides)) > (DOUBTFUL * longer) ** 2 + TINY
    left = np.flatnonzero(~have)
    if len(left):
        parts, exponents = np.frexp(points.take(corners[left], axis=0))
        shifts = np.where(parts == 0.0, 0, exponents - exponents.min()).astype(object)
        a, b, c = ((parts * 2.0**53).astype(np.int64).astype(object) << shifts).transpose(1, 2, 0)
        have[left] = _crossed(b - a, c - a).any(axis=0)
    return have


# A cross product below may be all rounding: a share of the longer side's square; and a square of
# such products that may have left the range of doubles.
DOUBTFUL, TINY = 2.0**-40, 2.0**-1000


def _used(corners: Integers) -> tuple[Integers, Integers]:
    """Which points (k,) triangles have for corners; and the triangles (m, 3) as rows of these."""
    there = np.zeros(int(corners.max()) + 1, np.bool_)
    there[corners.ravel()] = True
    number = np.cumsum(there) - 1
    return np.flatnonzero(there), number.take(corners)


# Coordinates lie in columns here, all x before all y: numpy is several times as fast along a long
# last axis as along one of three.


def _bounds(points: Floats) -> tuple[Floats, Floats]:
    """The least and the largest coordinates of points (k, 3)."""
    columns = np.ascontiguousarray(points.T)
    return columns.min(axis=1), columns.max(axis=1)


def _places(points: Floats, corners: NDArray[Any]) -> Floats:
    """Coordinates (3, 3, m) by corner and axis of triangles, rows (m, 3) of points (k, 3)."""
    columns, rows = np.ascontiguousarray(points.T), np.ascontiguousarray(corners.T)
    return np.stack([columns.take(row, axis=1) for row in rows])


def _crossed(one: Floats, two: Floats) -> Floats:
    """Cross products (3, m) of columns (3, m)."""
    return np.stack([one[i - 2] * two[i - 1] - one[i - 1] * two[i - 2] for i in range(3)])


def _squares(columns: Floats) -> Floats:
    """Squared lengths (m,) of columns (3, m)."""
    x, y, z = columns
    return x * x + y * y + z * z


# ---- Whether closed triangles are the surface of one convex solid.
#
# A surface may bend inwards by no more than the noise. So nowhere do the given surface, the hull
# of all corners and the solid that is kept differ by more.


FLAT = 2.0**-46  # of a mesh's size: what rounding may make of a height in it, and more
SMALLEST, LARGEST = 1e-100, 1e100  # beyond, products of three lengths leave the range of doubles


class Closed(NamedTuple):
    """Triangles of which two meet at every edge."""

    used: Integers  # (k,) rows of the points
    corners: Integers  # (m, 3) rows of those
    kept: Integers  # (m,) which of the triangles they are
    meeting: Integers  # (3 m / 2, 2) edges that are one: 3 times a triangle's row, and which


def convex_surface(given: Given, rows: Integers, linked: Linked) -> Surface:
    """The surface of triangles, which are `rows` of those given; ValueError, saying why, if it is
    not closed and convex.
    """
    if given.extent < SMALLEST or given.largest > LARGEST:
        raise ValueError('the mesh is too small or too large')
    # About the middle, in a power of two: nothing over- or underflows, and little is rounded.
    exponent = math.frexp(given.extent)[1]
    points = (given.points - given.middle) * math.ldexp(1.0, -exponent)
    noise = math.ldexp(float(given.noise.max()), -exponent)
    _require_thickness(points, given.linked.corners, noise)
    rows = given.rows[rows]
    closed = _closed(rows, linked)
    vertices, corners = points[closed.used], closed.corners
    normals, heights, middle = _planes(vertices, corners)
    sliver = heights <= noise
    if sliver.any() or not bends_outwards(vertices - middle, closed, normals, heights):
        lies = lying(points, closed.used[corners], noise)
        worst = int(np.argmax(lies.depths))
        if lies.depths[worst] > noise:
            depth, allowed = (math.ldexp(x, exponent) for x in (float(lies.depths[worst]), noise))
            raise ValueError(
                f'the mesh is not convex at triangle {int(rows[closed.kept[worst]])}: it lies '
                f'{depth:.3g} m within the hull of all corners, and {allowed:.3g} m are allowed'
            )
        normals[sliver] = lies.normals[sliver]
        around = goes_around(vertices.take(corners, axis=0) - middle, heights)
        if not around or parts_of(corners)[0] > 1:
            raise ValueError('the mesh is not the surface of one convex solid')
    real = ~sliver
    real[sliver] = _have_area(given.points, closed.used[corners[sliver]])
    used, corners = _used(corners[real])
    vertices = given.points[closed.used[used]]
    return Surface(vertices, corners, rows[closed.kept[real]], normals[real])


def _closed(rows: Integers, linked: Linked) -> Closed:
    """Those with three different corners, `rows` as given; ValueError if they are not closed. One
    whose corners have become one is an edge: its neighbours meet there without it.
    """
    low, middle, high = linked.sets.T
    kept = np.flatnonzero((low < middle) & (middle < high))
    surface = linked.part(kept)
    order, count = surface.by_edge
    if (count != 2).any():
        is_open = len(surface.open_edges) > 0
        bad = int(surface.open_edges[0] if is_open else np.argmax(count != 2))
        what = 'closed' if is_open else 'the surface of one convex solid'
        raise ValueError(
            f'the mesh is not {what}: an edge of triangle {int(rows[kept[bad // 3]])} belongs to '
            f'{int(count[bad])} triangles, not two'
        )
    used, corners = _used(surface.corners)
    if 2 * len(used) - len(kept) != 4:  # Euler: one surface without holes
        raise ValueError('the mesh is not the surface of one convex solid')
    return Closed(used, corners, kept, order.reshape(-1, 2))


def _require_thickness(points: Floats, corners: Integers, noise: float) -> None:
    one, two, three = _places(points, corners)
    normals = _crossed(two - one, three - one)
    largest = normals[:, np.argmax(_squares(normals))]
    length = np.linalg.norm(largest)
    if length == 0.0 or np.ptp(points @ (largest / length)) <= 4.0 * noise:
        raise ValueError('the mesh is flat: it has no inside')


def _planes(vertices: Floats, corners: Integers) -> tuple[Floats, Floats, Floats]:
    """Unit normals (m, 3) of the triangles, outwards; (m,) their heights over their longest edges;
    and the middle of the surface.
    """
    one, two, three = (vertices.take(row, axis=0) for row in corners.T)
    normals = np.cross(two - one, three - one)
    area = np.linalg.norm(normals, axis=1)
    sides = (two - one, three - two, one - three)
    longest = np.max([np.linalg.norm(side, axis=1) for side in sides], axis=0)
    heights = area / np.where(longest > 0.0, longest, 1.0)
    middle = area @ (one + two + three) / (3.0 * area.sum())
    normals /= np.where(area > 0.0, area, 1.0)[:, None]
    normals[np.einsum('ni,ni->n', normals, one - middle) < 0] *= -1.0
    return normals, heights, middle


def bends_outwards(vertices: Floats, closed: Closed, normals: Floats, heights: Floats) -> bool:
    """Whether a closed surface is surely convex, without its hull: at each edge both triangles lie
    below the plane of the other one, the origin lies below all planes, and the surface goes around
    it once. Then each line from the origin leaves it once, so it does not cross itself; and what
    bends outwards everywhere is convex (Tietze, 1928).
    """
    rounded = FLAT / heights  # unit normals of thin triangles have fewer digits
    corners, (one, two) = closed.corners.ravel(), closed.meeting.T
    for edge, other in ((one, two), (two, one)):
        here, opposite = edge // 3, other // 3 * 3 + (other + 2) % 3
        away = vertices.take(corners.take(opposite), axis=0)
        away -= vertices.take(corners.take(edge), axis=0)
        above = np.einsum('ni,ni->n', normals.take(here, axis=0), away)
        if (above >= -rounded.take(here) * np.linalg.norm(away, axis=1)).any():
            return False
    one, two, three = _places(vertices, closed.corners)
    if (np.einsum('ni,in->n', normals, one) <= rounded).any():
        return False
    # The solid angle under which each triangle is seen (Van Oosterom and Strackee, 1983).
    one, two, three = (place / np.sqrt(_squares(place)) for place in (one, two, three))
    volumes = np.abs((one * _crossed(two, three)).sum(axis=0))
    cosines = (one * two + two * three + three * one).sum(axis=0)
    return round(float(np.arctan2(volumes, 1.0 + cosines).sum()) / (2.0 * math.pi)) == 1


def goes_around(triangles: Floats, heights: Floats) -> bool:
    """Whether a closed surface near its hull goes around the origin: a line from there crosses it
    an odd number of times. (One side of a hull, there and back, is closed as well.)
    """
    direction = (0.43, 0.31, 0.26) @ triangles[np.argmax(heights)]
    one, two, three = (triangles[:, k] for k in range(3))
    sides = np.array(
        [np.cross(a, b) @ direction for a, b in ((one, two), (two, three), (three, one))]
    )
    volumes = np.einsum('ni,ni->n', one, np.cross(two, three))
    crossed = ((sides > 0.0) & (volumes > 0.0)) | ((sides < 0.0) & (volumes < 0.0))
    return bool(np.count_nonzero(crossed.all(axis=0)) % 2)


# ---- The vertex of a mesh that is farthest along a direction: of all of them, whatever they
# are.
#
# Few are looked at one by one. Many are arranged so that neighbours follow each other, in LEAVES
# groups; eight groups that follow each other are one of the level above. Each group lies in a
# disc, a flat cylinder along its least extent. The search goes into the discs that reach
# farthest, and leaves out those that reach no farther than the best vertex yet (branch and
# bound). So it ends at the true maximum, where climbing from neighbour to neighbour ends on the
# first bump.
#
# `discs` (blocks, 8 numbers, 8 lanes) holds eight groups a block: centre, unit axis, half height
# and radius. Below lane k of block b is block 8 b + 1 + k, or a leaf. It is empty for few
# vertices.


FEW = 64
LANES = 8
AXIS, HEIGHT, RADIUS, NUMBERS = 3, 6, 7, 8
ROOM = 96  # seven lanes wait on each of up to twelve levels
TIED = 2.0**-50  # of a mesh's radius: what rounds its vertices' heights


@lean_kernel
def farthest_vertex(hull, x, y, z):
    """Row of the vertex of a `hull.Hull` that is farthest along (x, y, z), up to rounding."""
    best, height, direction = np.int64(0), -np.inf, (x, y, z)
    blocks, count = hull.discs.shape[0], hull.places.shape[0]
    if blocks == 0:
        return highest(hull.places, 0, count, direction, best, height)[0]
    nodes, tops = stack_array(ROOM, np.int64), stack_array(ROOM, np.float64)
    leaves = (LANES - 1) * blocks + 1
    tied = TIED * hull.radius * max(abs(x), abs(y), abs(z))
    waiting = push_lanes(hull.discs, 0, direction, -np.inf, nodes, tops, 0)
    while waiting > 0:
        waiting -= 1
        if tops[waiting] <= height + tied:
            continue
        block = nodes[waiting]
        if block < blocks:
            waiting = push_lanes(hull.discs, block, direction, height + tied, nodes, tops, waiting)
            continue
        leaf = block - blocks
        first, stop = count * leaf // leaves, count * (leaf + 1) // leaves
        best, height = highest(hull.places, first, stop, direction, best, height)
    return best


@lean_kernel
def highest(places, first, stop, direction, best, height):
    """The same among some rows, if that is higher than `height`; and its height."""
    x, y, z = direction
    for vertex in range(first, stop):
        here = x * places[vertex, 0] + y * places[vertex, 1] + z * places[vertex, 2]
        if here > height:
            best, height = np.int64(vertex), here
    return best, height


@lean_kernel
def push_lanes(discs, block, direction, least, nodes, tops, waiting):
    """Put the groups of a block that reach above `least` along a direction on the stack, the
    farthest last.
    """
    x, y, z = direction
    disc, reach = discs[block], stack_array(LANES, np.float64)
    for k in range(LANES):
        a, b, c = disc[AXIS, k], disc[AXIS + 1, k], disc[AXIS + 2, k]
        u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
        along = disc[HEIGHT, k] * abs(x * a + y * b + z * c)
        along += disc[RADIUS, k] * math.sqrt(u * u + v * v + w * w)
        reach[k] = x * disc[0, k] + y * disc[1, k] + z * disc[2, k] + along
    farthest, top = least, waiting
    for k in range(LANES):
        if reach[k] > least:
            nodes[top], tops[top] = LANES * block + 1 + k, reach[k]
            if reach[k] > farthest:
                farthest = reach[k]
            elif top > waiting:
                nodes[top], nodes[top - 1] = nodes[top - 1], nodes[top]
                tops[top], tops[top - 1] = tops[top - 1], tops[top]
            top += 1
    return top


def levels(count: int) -> int:
    """How many levels of groups so many vertices have."""
    return max(round(math.log(count / LANES, LANES)), 1) if count > FEW else 0


def _starts(count: int, groups: int) -> NDArray[np.int64]:
    starts: NDArray[np.int64] = count * np.arange(groups, dtype=np.int64) // groups
    return starts


def arranged(places: Floats) -> NDArray[np.int64]:
    """The rows of vertices (k, 3) so that neighbours follow each other: halves of halves, each cut
    across its longest side.
    """
    count, order = len(places), np.arange(len(places))
    columns = np.ascontiguousarray(places.T)
    for half in range(3 * levels(count)):
        starts = _starts(count, 1 << half)
        counts = np.diff(starts, append=count)
        here = columns.take(order, axis=1)
        sides = np.maximum.reduceat(here, starts, axis=1) - np.minimum.reduceat(
            here, starts, axis=1
        )
        # Each group is sorted on its own, in a row of a table.
        filled = np.arange(counts.max()) < counts[:, None]
        along = np.full(filled.shape, np.inf)
        axis = np.repeat(np.argmax(sides, axis=0), counts)
        along[filled] = here[axis, np.arange(count)]
        order = order.take((np.argsort(along, axis=1, kind='stable') + starts[:, None])[filled])
    return order


def discs(places: Floats) -> Floats:
    """What `farthest_vertex` needs, of arranged vertices (k, 3)."""
    found = [
        _around(places, _starts(len(places), LANES ** (level + 1)))
        for level in range(levels(len(places)))
    ]
    return np.concatenate([np.empty((0, NUMBERS, LANES)), *found])


def _around(places: Floats, starts: NDArray[np.int64]) -> Floats:
    """Discs (blocks, NUMBERS, LANES) around groups of vertices."""
    counts = np.diff(starts, append=len(places))
    group = np.repeat(np.arange(len(starts)), counts)
    middle = np.maximum.reduceat(places, starts) * 0.5 + np.minimum.reduceat(places, starts) * 0.5
    away = places - middle[group]
    spread = np.add.reduceat(away[:, :, None] * away[:, None, :], starts)
    centred = np.add.reduceat(away, starts)
    spread -= centred[:, :, None] * centred[:, None, :] / counts[:, None, None]
    axis = np.linalg.eigh(spread)[1][:, :, 0]
    heights = np.einsum('ni,ni->n', away, axis[group])
    high, low = np.maximum.reduceat(heights, starts), np.minimum.reduceat(heights, starts)
    across = np.linalg.norm(away - heights[:, None] * axis[group], axis=1)
    rows = np.empty((len(starts), NUMBERS))
    rows[:, :AXIS] = middle + (high * 0.5 + low * 0.5)[:, None] * axis
    rows[:, AXIS:HEIGHT] = axis
    rows[:, HEIGHT], rows[:, RADIUS] = (
        high * 0.5 - low * 0.5,
        np.maximum.reduceat(across, starts),
    )
    return np.ascontiguousarray(rows.reshape(-1, LANES, NUMBERS).transpose(0, 2, 1))


# ---- How far a mesh reaches along any direction, for the box around it in a new pose.
#
# Along a sum of directions a mesh reaches at most as far as along each of them together. So
# interpolation between the points of a grid, on the six faces of a cube, bounds the reach along
# any direction. Of a ball the bound is up to 0.4 % of the radius too large, at a sharp edge up to
# 6 %. Along a point of the grid, as the axes are, it is the reach itself. Of few vertices all are
# looked at.


GRID = 16  # squares along each edge of the cube
CORNERS = GRID + 1
RAISED = 2.0**-47  # of a mesh's radius: more than what rounds a reach in the grid
VERTICES = 256  # that are taken with all directions at once: what a cache holds


def grid_of_reaches(vertices: Floats, radius: float) -> Floats:
    """How far a mesh reaches along all points of the grid, and along their opposites, (3, CORNERS,
    CORNERS, 2). At [axis, i, j] that axis is 1, and the next two go from -1 to 1.
    """
    grid, steps = np.ones((3, CORNERS, CORNERS, 3)), np.linspace(-1.0, 1.0, CORNERS)
    for axis in range(3):
        grid[axis, :, :, (axis + 1) % 3] = steps[:, None]
        grid[axis, :, :, (axis + 2) % 3] = steps
    directions = grid.reshape(-1, 3).T
    ahead, behind = np.full((2, directions.shape[1]), -np.inf)
    for begin in range(0, len(vertices), VERTICES):
        along = vertices[begin : begin + VERTICES] @ directions
        np.maximum(ahead, along.max(axis=0), out=ahead)
        np.maximum(behind, -along.min(axis=0), out=behind)
    reaches = np.stack((ahead, behind), axis=1) + RAISED * radius
    return reaches.reshape(3, CORNERS, CORNERS, 2)


@lean_kernel
def reach_both_ways(vertices, reaches, x, y, z):
    """How far a mesh reaches along (x, y, z), which is not zero, and the opposite way, at most.
    Without a grid it is how far it does.
    """
    if reaches.shape[0] == 0:
        ahead, behind = -np.inf, -np.inf
        for row in range(vertices.shape[0]):
            place = vertices[row]
            along = x * place[0] + y * place[1] + z * place[2]
            ahead, behind = max(ahead, along), max(behind, -along)
        return ahead, behind
    axis, largest, second, third = 0, x, y, z
    if abs(y) > abs(largest):
        axis, largest, second, third = 1, y, z, x
    if abs(z) > abs(largest):
        axis, largest, second, third = 2, z, x, y
    u = (second / largest + 1.0) * (GRID / 2)
    v = (third / largest + 1.0) * (GRID / 2)
    i, j = min(int(u), GRID - 1), min(int(v), GRID - 1)
    square, weights = reaches[axis, i : i + 2, j : j + 2], (u - i, v - j)
    first, other = interpolated(square, 0, weights), interpolated(square, 1, weights)
    first, other = first * abs(largest), other * abs(largest)
    return (first, other) if largest > 0.0 else (other, first)


@inlined
def interpolated(square, side, weights):
    """Between four points of the grid."""
    u, v = weights
    low = square[0, 0, side] * (1.0 - v) + square[0, 1, side] * v
    high = square[1, 0, side] * (1.0 - v) + square[1, 1, side] * v
    return low * (1.0 - u) + high * u


NO_REACHES = np.empty((0, CORNERS, CORNERS, 2))

# ---- The surface of any triangles.


CONVEX, SOLID, SHELL = range(3)  # forms of a mesh


def any_surface(
    given: Given, rows: Integers, linked: Linked, solid: bool | None
) -> tuple[Surface, bool]:
    """(triangles that have an area, `rows` of those given, whether all of them are closed);
    ValueError if they have to be closed, as they are `solid`, and are not.
    """
    if not (given.extent > SMALLEST_SURFACE and given.largest < LARGEST_SURFACE):
        raise ValueError(
            'the mesh is too small or too large: unless it is convex, it must be larger than '
            f'{SMALLEST_SURFACE} m, and lie within {LARGEST_SURFACE} m'
        )
    open_at, rows = linked.open_edges, given.rows[rows]
    if len(open_at) and solid:
        raise ValueError(
            'a solid mesh must be closed: an odd number of triangles meets at an edge of '
            f'triangle {int(rows[open_at[0] // 3])}'
        )
    real = np.flatnonzero(_have_area(given.points, linked.corners))
    if not len(real):
        raise ValueError('the mesh has no triangle with an area')
    used, corners = _used(linked.corners[real])
    vertices = given.points[used]
    one, two, three = _places(vertices / given.extent, corners)
    normals = _crossed(two - one, three - one)  # as they are wound
    length = np.sqrt(_squares(normals))
    normals /= np.where(length > 0.0, length, 1.0)
    normals = np.ascontiguousarray(normals.T)
    return Surface(vertices, corners, rows[real], normals), not len(open_at)


def _each(value: ArrayLike) -> tuple[Floats, Integers]:
    """Corners (3 m, 3) of triangles (m, 3, 3), and their rows (m, 3)."""
    wanted = 'triangles must have shape (m, 3, 3), or be vertices with faces, not'
    if isinstance(value, np.ndarray) and value.shape[1:] != (3, 3):
        raise ValueError(f'{wanted} {value.shape}')
    corners = checks.floats('triangles', value)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3) or not len(corners):
        raise ValueError(f'{wanted} {corners.shape}')
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


MOST_VERTICES = 2**31 - 1  # a row of them is an int32


def _indexed(vertices: ArrayLike, faces: ArrayLike) -> tuple[Floats, Integers]:
    """Those vertices (k, 3) that are used, and their rows (m, 3)."""
    wanted = 'triangles must be vertices of shape (k, 3) where there are faces, not'
    if isinstance(vertices, np.ndarray) and vertices.shape[1:] != (3,):
        raise ValueError(f'{wanted} {vertices.shape}')
    if isinstance(vertices, np.ndarray) and len(vertices) > MOST_VERTICES:
        raise ValueError(f'triangles must be at most {MOST_VERTICES} vertices')
    places = checks.floats('triangles', vertices)
    if places.ndim != 2 or places.shape[1] != 3 or not len(places):
        raise ValueError(f'{wanted} {places.shape}')
    try:
        rows = np.asarray(faces)
        checks.refuse_masked(faces, rows)
    except checks.FOREIGN as error:
        raise ValueError(f'faces must be rows of vertices: {error}') from None
    if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows):
        raise ValueError(f'faces must have shape (m, 3), not {rows.shape}')
    if rows.dtype.kind not in 'iu':
        raise ValueError(f'faces must be integers, not {rows.dtype}')
    if rows.min() < 0 or rows.max() >= len(places):
        bad = int(np.argmax(((rows < 0) | (rows >= len(places))).any(axis=1)))
        raise ValueError(
            f'faces must name rows of {len(places)} vertices: row {bad} is {rows[bad].tolist()}'
        )
    used, rows = _used(rows)
    return places.take(used, axis=0), rows


# ---- Meshes of any triangles.


# By how much the boxes in a mesh's tree are larger than its triangles, in shares of the mesh.
PAD = 2.0**-44
# Beyond, exact products of six lengths of a mesh that is not convex leave the range of doubles.
SMALLEST_SURFACE, LARGEST_SURFACE = 1e-30, 1e30
NEGLIGIBLE = 2.0**-200  # of a mesh's size: coordinates below become 0


FEWEST_WIDE = 32  # triangles: of fewer the tree itself is as fast


class WideNodes(NamedTuple):
    """The snapshot of a mesh's tree, see `tree.batch.snapshot`."""

    planes: NDArray[np.float32]
    """(n, 6 WIDTH)"""
    children: NDArray[np.int32]
    """(n, WIDTH)"""
    triangles: NDArray[np.float32]
    """(n, 9 WIDTH): the corners of the triangles that are children, in the snapshot's units: x of
    the first corner of all, its y, and so on; of a child that is a node its patch, see
    `triangles32`."""
    center: Floats
    """(3,)"""
    per_length: float
    depth: int
    """Levels of nodes."""


NO_WIDE = WideNodes(
    np.empty((0, 6 * WIDTH), np.float32),
    np.empty((0, WIDTH), np.int32),
    np.empty((0, 9 * WIDTH), np.float32),
    np.zeros(3),
    1.0,
    0,
)


@functools.cache
def _patches_entry() -> Callable[..., Any]:
    return entry_point(fill_patches, *NO_WIDE[:3], np.empty((3, 0)))


class Mesh:
    """Triangles: a convex solid, a solid of any form, or a surface.

    Parameters
    ----------
    triangles : array_like, shape (m, 3, 3)
        Corners, m; the winding does not matter. With `faces`: vertices, shape (k, 3).
    faces : array_like of int, shape (m, 3), optional
        Rows of the vertices, one row a triangle.
    solid : bool, optional
        Whether the inside is occupied. None: where the mesh is closed, that is where an even
        number of triangles meets at every edge. True demands a closed mesh. False makes a shell,
        which is its surface alone.

    Notes
    -----
    A mesh is convex if it is the closed surface of one convex solid. The triangles are taken as
    rounded to float32 for that: by 2.4e-7 of its size the surface may lie within the hull of its
    corners. Corners along open edges that are within half of that become one, if that closes the
    mesh and no triangle is lost; those of a shell never do.

    A point is inside a solid if a line from there crosses the surface an odd number of times. So
    of two nested closed surfaces the inner one is a hollow. A triangle that is given several times
    counts once, unless the mesh is closed only with all of them, as two boxes that share a wall.
    A sheet on both sides is not closed. Triangles without an area are left out; before that, they
    may close the seam between others.

    Raises
    ------
    ValueError
        If the triangles are not finite, none has an area, an index is out of range, or the mesh
        is not closed where `solid` is True.

    Examples
    --------
    >>> from bvh_ros import Mesh
    >>> Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, 3]])
    Mesh(surface of 2 triangles, 1 x 1 x 1 m)
    """

    def __init__(
        self, triangles: ArrayLike, faces: ArrayLike | None = None, *, solid: bool | None = None
    ) -> None:
        if solid is not None and not isinstance(solid, (bool, np.bool_)):
            raise ValueError(f'solid must be True, False or None, not {checks.shown_short(solid)}')
        places, rows = _each(triangles) if faces is None else _indexed(triangles, faces)
        if not np.isfinite(places).all():
            bad = int(np.argmin(np.isfinite(places[rows]).all(axis=(1, 2))))
            raise ValueError(f'triangle {bad} is not finite')
        self.not_convex = 'it is a shell' if solid is False else ''
        """Why it is no convex solid; empty if it is one."""
        self.closed = True
        """Whether an even number of triangles meets at every edge."""
        given = Given(places, rows)
        counted = closed_if_possible(given, solid is not False)
        try:
            if self.not_convex:
                raise ValueError(self.not_convex)
            surface = convex_surface(given, *counted)
        except ValueError as reason:
            self.not_convex = str(reason)
            surface, self.closed = any_surface(given, *counted, solid)
        self.convex = not self.not_convex
        """Whether it is the surface of one convex solid, and solid."""
        self.solid = self.closed and solid is not False
        """Whether the inside is occupied."""
        self.rows: NDArray[np.int32] = surface.rows.astype(np.int32)
        """(m,) rows of the triangles as given."""
        self.dropped = len(rows) - len(self.rows)
        """How many of these had no area, or repeated others that count for them."""
        lo, hi = _bounds(surface.vertices)
        inside = bool((lo <= 0.0).all() and (hi >= 0.0).all())
        as_given = inside or not self.convex
        self.centre: Floats = np.zeros(3) if as_given else lo * 0.5 + hi * 0.5
        """(3,) of the box around a convex mesh, in the frame of the triangles; their origin if the
        box holds that, or the mesh is not convex: then nothing is rounded."""
        self.size: Floats = hi - lo
        """(3,) edges of that box."""
        order = arranged(surface.vertices)
        row = np.empty(len(order), np.int32)
        row[order] = np.arange(len(order))
        self.vertices: Floats = surface.vertices[order] - self.centre
        """(k, 3) seen from the centre, neighbours next to each other."""
        if not self.convex:
            tiny = np.abs(self.vertices) < NEGLIGIBLE * float(self.size.max())
            self.vertices[tiny] = 0.0
        self.corners: NDArray[np.int32] = row.take(surface.corners)
        """(m, 3) rows of `vertices`, one row a triangle."""
        self.normals: Floats = surface.normals
        """(m, 3) unit normals of the triangles, outwards if the mesh is convex."""
        self.form = CONVEX if self.convex else SOLID if self.solid else SHELL
        """As kernels have it."""
        self.key = digest(self.vertices, self.corners, self.rows, np.array(self.form))
        """The same for equal meshes."""
        farthest = float(np.linalg.norm(self.vertices, axis=1).max())
        self.radius = math.ldexp(1.0, math.frexp(farthest)[1])
        """A power of two beyond the farthest vertex: steps of it round nothing away."""

    @classmethod
    def from_file(
        cls,
        path: str | os.PathLike[str],
        scale: ArrayLike = 1.0,
        *,
        solid: bool | None = None,
        max_triangles: int = 1_000_000,
        max_bytes: int = 2**28,
    ) -> 'Mesh':
        """The mesh in an STL, OBJ, PLY, GLB or DAE file; GLB and DAE need the extra [meshes].

        Parameters
        ----------
        path : path-like
            Its ending tells its kind. No other file is opened: textures are not read.
        scale : array_like, shape () or (3,)
            What the coordinates are multiplied by, for instance 0.001 for a file in mm.
        solid : bool, optional
            As of `Mesh`.
        max_triangles, max_bytes : int
            A file with more is refused.

        Notes
        -----
        The frame is the file's own: no axis is exchanged, and only the unit of a DAE file is
        applied, as RViz does. Polygons become fans of triangles; lines and points are left out.
        A file in which anything else is not understood, or cut off, is refused. It is read in
        this process: a hostile DAE file may take long and much memory.

        Raises
        ------
        OSError
            If the file cannot be opened.
        ImportError
            If what reads such files is not installed.
        ValueError
            If an argument or the file cannot be used, or its triangles make no `Mesh`.
        """
        from .mesh_file import read

        file, factors = checks.path('path', path), checks.floats('scale', scale)
        if factors.shape not in ((), (3,)) or not (np.isfinite(factors) & (factors != 0.0)).all():
            raise ValueError(
                'scale must be one or three finite numbers other than 0, '
                f'not {checks.shown_short(scale)}'
            )
        most = checks.whole('max_triangles', max_triangles, 1)
        size = checks.whole('max_bytes', max_bytes, 1)
        try:
            with np.errstate(over='ignore'):  # to what is not finite
                triangles = read(file, most, size) * factors
            return cls(triangles, solid=solid)
        except ValueError as error:
            scaled = '' if (factors == 1.0).all() else f' times scale {factors.tolist()}'
            raise ValueError(f'{file!r:.200}{scaled}: {error}') from error

    def __repr__(self) -> str:
        edges = ' x '.join(f'{edge:g}' for edge in self.size)
        kind = 'convex solid' if self.convex else 'solid' if self.solid else 'surface'
        return f'Mesh({kind} of {len(self.corners):,} triangles, {edges} m)'

    @property
    def tree(self) -> tuple[NDArray[Any], int]:
        """Nodes and root of a tree of the boxes around the triangles; slot k is triangle k."""
        return self._trees[:2]

    @property
    def wide(self) -> 'WideNodes':
        """Its snapshot; without nodes for few triangles, or where float32 sees too little."""
        return self._trees[2]

    @LazyProperty
    def _trees(self) -> 'tuple[NDArray[Any], int, WideNodes]':
        tree = tree_over(self.vertices, self.corners, float(self.size.max()))
        snapshot, wide = None, NO_WIDE
        if len(self.corners) >= FEWEST_WIDE:
            snapshot = take_snapshot(tree.view())
        if snapshot is not None:
            planes = snapshot.planes.reshape(-1, 6 * WIDTH)[: snapshot.size]
            children = snapshot.children.reshape(-1, WIDTH)[: snapshot.size]
            units = snapshot.center, snapshot.per_length
            triangles = np.zeros((*children.shape, 9), np.float32)
            leaves = children < 0
            places = ((self.vertices - units[0]) * units[1]).astype(np.float32)
            corners = self.corners.take(~children[leaves], axis=0)
            triangles[leaves] = places.take(corners, axis=0).reshape(-1, 9)
            lanes = triangles.transpose(0, 2, 1).reshape(-1, 9 * WIDTH)
            _patches_entry()(planes, children, lanes, np.empty((3, self.corners.size)))
            wide = WideNodes(planes, children, lanes, *units, snapshot.depth)
        nodes, _, _, root = tree.arrays()
        return nodes, int(root), wide

    @LazyProperty
    def outline(self) -> Floats:
        """(k, 2) corners, counter-clockwise, of what is seen from above of the unturned mesh, if
        that is convex.
        """
        return convex_polygon(self.vertices[:, :2])

    @LazyProperty
    def shadow(self) -> tuple[Floats, NDArray[np.int32]]:
        """The same of any mesh: see `flattened`."""
        return flattened(self.vertices, self.corners)

    @LazyProperty
    def discs(self) -> Floats:
        """What `farthest_vertex` needs of a convex mesh."""
        return discs(self.vertices if self.convex else self.vertices[:0])

    @LazyProperty
    def reaches(self) -> Floats:
        """What `reach_both_ways` needs: nothing of few vertices."""
        many = len(self.vertices) > FEW
        return grid_of_reaches(self.vertices, self.radius) if many else NO_REACHES

    @LazyProperty
    def seeds(self) -> Floats:
        """(k, 3) a corner of each part whose triangles hang together."""
        if self.convex:
            return self.vertices[:1]
        return self.vertices[np.unique(parts_of(self.corners)[1], return_index=True)[1]]


def parts_of(corners: NDArray[Any]) -> tuple[int, NDArray[Any]]:
    """How many parts of triangles (m, 3) do not hang together, and (k,) in which each vertex is;
    all vertices are corners.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    one, two, three = corners.T
    links = np.ones(2 * len(one), np.bool_), (np.r_[one, two], np.r_[two, three])
    count = int(corners.max()) + 1
    number, part = connected_components(coo_matrix(links, (count, count)), directed=False)
    return int(number), part


def tree_over(places: Floats, corners: NDArray[np.int32], size: float) -> OpenTree:
    """A tree of the boxes around triangles, rows (m, 3) of places, of a mesh of some size."""
    triangles, pad = _places(places, corners), PAD * size
    return OpenTree.from_boxes(triangles.min(axis=0).T - pad, triangles.max(axis=0).T + pad)


def flattened(places: Floats, corners: NDArray[np.int32]) -> tuple[Floats, NDArray[np.int32]]:
    """The shadows of triangles, rows (m, 3) of places (k, 3), at z = 0: their different places,
    and different rows of these, counter-clockwise. A triangle that stands upright is a segment,
    with one corner twice; what lies along an edge of others is left out.
    """
    flat = places * (1.0, 1.0, 0.0) + 0.0  # of zeros one sign
    first, number = different(flat)
    flat, linked = flat[first], Linked(number.take(corners))
    rows = linked.sets[linked.first == np.arange(len(corners))]
    rows = rows[np.lexsort(rows.T[::-1])]
    upright = (np.diff(rows, axis=1) == 0).any(axis=1)
    segments, rows = rows[upright], rows[~upright]
    edges = rows[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2)
    ends = segments[:, [0, 2]]
    known = np.isin(ends @ (len(flat), 1), edges @ (len(flat), 1))
    rows = np.concatenate([rows, ends[~known][:, [0, 1, 1]]])
    one, two, three = (flat[rows[:, k]] for k in range(3))
    clockwise = np.cross(two - one, three - one)[:, 2] < 0.0
    rows[clockwise] = rows[clockwise][:, ::-1]
    return flat, rows.astype(np.int32)


def digest(*arrays: NDArray[Any]) -> bytes:
    """A short key of what the arrays hold."""
    sha = hashlib.blake2b(digest_size=32)
    for array in arrays:
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.digest()


_in_use: WeakValueDictionary[bytes, Mesh] = WeakValueDictionary()
AS_CONVEX, AS_SOLID, AS_SURFACE = 'convex', 'solid', 'surface'  # what `mesh_of` makes


def mesh_of(triangles: Floats, form: str = AS_SOLID) -> Mesh:
    """A mesh of triangles, or the one that was made of them while anything holds it: publishers
    repeat themselves, and to examine a surface takes far longer than to recognise it.

    `form`: AS_SOLID, solid where it is closed; AS_SURFACE, a shell; AS_CONVEX, a convex solid,
    with a ValueError that says why it is none.
    """
    key = digest(triangles, np.array(form == AS_SURFACE))
    mesh = _in_use.get(key)
    if mesh is None:
        solid = False if form == AS_SURFACE else None
        mesh = _in_use[key] = Mesh(triangles, solid=solid)
    if form == AS_CONVEX and not mesh.convex:
        raise ValueError(mesh.not_convex)
    return mesh
