# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Triangles as they are given: which make a surface, and whether that is closed and convex."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .lazy import LazyProperty

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

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
    area: float  # of the hull


def lying(points: Floats, corners: Integers, enough: float) -> Lying:
    """How deep triangles, rows (m, 3) of points (k, 3), lie in the hull of all points.

    Where that is more than `enough`, no plane of the hull says less; the search ends with the
    first such triangles, and says 0 of those that it did not look at. Else some plane that says so
    little is taken.
    """
    hull = _hull(points)
    equations, faces = hull.equations, hull.corners
    found = Lying(np.full(len(corners), np.inf), np.zeros((len(corners), 3)), hull.area)
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


class ConvexHull(NamedTuple):
    """The hull of points."""

    equations: Floats  # (f, 4) of planes: outward unit normal n and d, n . x + d <= 0 within it
    corners: Integers  # (f, 3) rows of the points, one row a triangle in such a plane
    area: float


def _hull(points: Floats) -> ConvexHull:
    # Only meshes need this library: it is imported when the first one comes.
    from scipy import spatial

    # A flat face of ten thousand corners would take it minutes. So its points are moved, by far
    # less than what is looked for, and the planes outwards by as much.
    by = SHAKEN * float(np.abs(points).max())
    try:
        hull = spatial.ConvexHull(points + np.random.default_rng(1).uniform(-by, by, points.shape))
    except spatial.QhullError:
        raise ValueError('the mesh is flat, as far as float32 tells') from None
    equations = hull.equations - [0.0, 0.0, 0.0, math.sqrt(3.0) * by]
    return ConvexHull(equations, hull.simplices.astype(np.int64), float(hull.area))


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


class Edges(NamedTuple):
    """Of triangles (m, 3), edge 3 k + i goes from corner i of row k to the next."""

    order: Integers
    """(3 m,) edges so that those between the same points follow each other."""
    number: Integers
    """(3 m,) that of the two points."""
    times: Integers
    """(3 m,) how many edges have this number; 0 if both points are one."""


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
    def proper(self) -> Integers:
        """Rows of those with three different corners."""
        low, middle, high = self.sets.T
        return np.flatnonzero((low < middle) & (middle < high))

    @LazyProperty
    def first(self) -> Integers:
        """(m,) the first triangle with the same three corners."""
        return _first_alike(self.sets, int(self.corners.max()) + 1)

    @LazyProperty
    def edges(self) -> Edges:
        """Which triangles meet at an edge."""
        one, two = self.corners.ravel(), self.corners.take([1, 2, 0], axis=1).ravel()
        low, high = np.minimum(one, two), np.maximum(one, two)
        order, begins = _runs(low * (int(high.max()) + 1) + high)
        times = np.diff(begins, append=len(order))
        number = np.empty(len(order), np.int64)
        number[order] = np.repeat(np.arange(len(times)), times)
        count = times.take(number)
        count[low == high] = 0
        return Edges(order, number, count)

    @property
    def open_edges(self) -> Integers:
        """Those at which an odd number of triangles meets."""
        return np.flatnonzero(self.edges.times & 1)


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
            used, corners = used_by(self.linked.corners[self.rows])
            self.points, self.linked = self.points[used], Linked(corners)
        lo, hi = bounds_of(self.points)
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


NOTHING = -1  # instead of a row


def _joined(points: Floats, linked: Linked) -> Integers:
    """Rows of triangles but for those without an area that join no others: two of their corners
    are one, or they have an edge of their own, perhaps after others have been left out.
    """
    proper = linked.proper
    first = linked.first[proper]
    once = proper[first == proper]
    if not len(once):
        return once
    form = linked.part(once)
    alone = np.flatnonzero((form.edges.times.reshape(-1, 3) == 1).any(axis=1))
    waiting = alone[~_have_area(points, form.corners[alone])].tolist()
    if not waiting:
        return proper
    flat, number = (~_have_area(points, form.corners)).tolist(), form.edges.number
    count = np.bincount(number).tolist()
    rows = np.bincount(number, np.arange(len(number)) // 3).astype(np.int64).tolist()  # their sum
    while waiting:
        row = waiting.pop()
        if once[row] == NOTHING:
            continue
        once[row] = NOTHING
        for edge in number[3 * row : 3 * row + 3].tolist():
            count[edge], rows[edge] = count[edge] - 1, rows[edge] - row
            if count[edge] == 1 and flat[rows[edge]]:
                waiting.append(rows[edge])
    return proper[np.isin(first, once)]


def closed_if_possible(given: Given, stitch: bool) -> tuple[Integers, Linked]:
    """(rows of those that count, these), closed if they can be: as given; or `stitch`, with seams
    that exporters rounded welded. Else each once.
    """
    found = _closed_rows(given, given.linked)
    if found is None and stitch:
        found = _closed_rows(given, _stitched(given))
    return found or _each_once(given.linked)


def _each_once(linked: Linked) -> tuple[Integers, Linked]:
    once = np.flatnonzero(linked.first == np.arange(len(linked.first)))
    return once, linked.part(once)


def _closed_rows(given: Given, linked: Linked) -> tuple[Integers, Linked] | None:
    """Each triangle once, if these are closed, or some of them twice, if only they are; None if
    neither are.

    By parity, a part that is given twice would hold nothing. But two boxes may share a wall that
    both have. A sheet on both sides is no closed surface.
    """
    once, form = _each_once(linked)
    if len(form.open_edges) and len(once) < len(linked.first):
        rows = np.sort(np.r_[once, _second_copies(given, linked, once)])
        once, form = rows, linked.part(rows)
    return None if len(form.open_edges) else (once, form)


def _second_copies(given: Given, linked: Linked, once: Integers) -> Integers:
    """The second rows of triangles that count twice: of those given an even number of times, once
    all numbers are divided by what they have in common. A closed part of these counts once.

    In a closed part of repeated triangles the others may count twice as well: then those with less
    area do.
    """
    order, begins = _runs(linked.first)
    copies = np.diff(begins, append=len(order))
    copies //= np.gcd.reduce(copies)
    repeated = np.flatnonzero(copies > 1)
    if not len(repeated):
        return repeated
    one, two, three = places_of(given.points / given.extent, linked.corners[once[repeated]])
    area = np.sqrt(_squares(_crossed(two - one, three - one)))
    twice = copies[repeated] % 2 == 0
    for rows in (np.flatnonzero(twice), np.arange(len(repeated))):
        if len(rows):
            part, is_closed = _closed_parts(linked.part(once[repeated[rows]]))
            saved = np.bincount(part, np.where(twice[rows], area[rows], -area[rows]))
            twice[rows] ^= (is_closed & (saved > 0.0))[part]
    return order[begins[repeated] + 1][twice]


def _closed_parts(linked: Linked) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """In which part (m,) each triangle is, by common edges; whether each part is closed."""
    number = linked.edges.number
    count, part = parts_of(number.reshape(-1, 3))
    part = part[number[::3]]
    return part, np.bincount(part[linked.open_edges // 3], minlength=count) == 0


def _stitched(given: Given) -> Linked:
    """Triangles whose corners along open edges are welded, as if exporters had rounded them; as
    they are if one of them would be lost: one that loses its area must lie along an edge of one
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
    lost = moved[before & ~after]
    if not len(lost):
        return welded
    real = _have_area(given.points, welded.corners)
    edges = welded.sets[real][:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2) @ (count, 1)
    low, middle, high = welded.sets[lost].T
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
    one, two, three = places_of(np.ldexp(points, -math.frexp(np.abs(points).max())[1]), corners)
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


def used_by(corners: Integers) -> tuple[Integers, Integers]:
    """Which points (k,) triangles have for corners; and the triangles (m, 3) as rows of these."""
    there = np.zeros(int(corners.max()) + 1, np.bool_)
    there[corners.ravel()] = True
    number = np.cumsum(there) - 1
    return np.flatnonzero(there), number.take(corners)


# Coordinates lie in columns here, all x before all y: numpy is several times as fast along a long
# last axis as along one of three.


def bounds_of(points: Floats) -> tuple[Floats, Floats]:
    """The least and the largest coordinates of points (k, 3)."""
    columns = np.ascontiguousarray(points.T)
    return columns.min(axis=1), columns.max(axis=1)


def places_of(points: Floats, corners: NDArray[Any]) -> Floats:
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


# Of the product of a triangle's shorter sides over twice its area, which is at least 1: its unit
# normal is off by less than 2**-50, and the height of another corner above its plane by less than
# 2**-49 times how far that is.
TURNED = 2.0**-48
EVEN = 2.0**-16  # by how much of its area a surface may differ from its hull
SMALLEST, LARGEST = 1e-100, 1e100  # beyond, products of three lengths leave the range of doubles


class Closed(NamedTuple):
    """Triangles of which two meet at every edge."""

    used: Integers  # (k,) rows of the points
    corners: Integers  # (m, 3) rows of those
    row: Integers  # (m,) which of the triangles they are
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
    planes = _planes(vertices, corners)
    sliver = planes.heights <= noise
    if sliver.any() or not bends_outwards(vertices, closed, planes):
        lies = lying(points, closed.used[corners], noise)
        worst = int(np.argmax(lies.depths))
        if lies.depths[worst] > noise:
            depth, allowed = (math.ldexp(x, exponent) for x in (float(lies.depths[worst]), noise))
            raise ValueError(
                f'the mesh is not convex at triangle {int(rows[closed.row[worst]])}: it lies '
                f'{depth:.3g} m within the hull of all corners, and {allowed:.3g} m are allowed'
            )
        planes.normals[sliver] = lies.normals[sliver]
        # A thin rim may lie as deep as is allowed, and yet far beside that of the hull.
        even = abs(planes.area - lies.area) <= EVEN * lies.area
        around = goes_around(vertices.take(corners, axis=0) - planes.middle, planes.heights)
        if not (even and around) or parts_of(corners)[0] > 1:
            raise ValueError('the mesh is not the surface of one convex solid')
    real = ~sliver
    real[sliver] = _have_area(given.points, closed.used[corners[sliver]])
    used, corners = used_by(corners[real])
    vertices = given.points[closed.used[used]]
    return Surface(vertices, corners, rows[closed.row[real]], planes.normals[real])


def _closed(rows: Integers, linked: Linked) -> Closed:
    """Those with three different corners, `rows` as given; ValueError if they are not closed. One
    whose corners have become one is an edge: its neighbours meet there without it.
    """
    proper = linked.proper
    surface = linked.part(proper)
    count = surface.edges.times
    if (count != 2).any():
        is_open = len(surface.open_edges) > 0
        bad = int(surface.open_edges[0] if is_open else np.argmax(count != 2))
        what = 'closed' if is_open else 'the surface of one convex solid'
        raise ValueError(
            f'the mesh is not {what}: an edge of triangle {int(rows[proper[bad // 3]])} belongs '
            f'to {int(count[bad])} triangles, not two'
        )
    used, corners = used_by(surface.corners)
    if 2 * len(used) - len(proper) != 4:  # Euler: one surface without holes
        raise ValueError('the mesh is not the surface of one convex solid')
    return Closed(used, corners, proper, surface.edges.order.reshape(-1, 2))


def _require_thickness(points: Floats, corners: Integers, noise: float) -> None:
    one, two, three = places_of(points, corners)
    normals = _crossed(two - one, three - one)
    largest = normals[:, np.argmax(_squares(normals))]
    length = np.linalg.norm(largest)
    if length == 0.0 or np.ptp(points @ (largest / length)) <= 4.0 * noise:
        raise ValueError('the mesh is flat, as far as float32 tells')


class Planes(NamedTuple):
    """Those of the triangles of a closed surface."""

    normals: Floats  # (m, 3) unit normals, outwards
    doubts: Floats  # (m,) by how much rounding may turn them
    heights: Floats  # (m,) of the triangles over their longest edges
    middle: Floats  # (3,) of the surface
    area: float  # of the surface


def _planes(vertices: Floats, corners: Integers) -> Planes:
    # From the corner across from the longest edge rounding turns a normal least.
    one, two, three = places_of(vertices, corners)
    lengths = np.sqrt([_squares(side) for side in (two - one, three - two, one - three)])
    turn = (np.argmax(lengths, axis=0)[:, None] + np.array([2, 0, 1])) % 3
    one, two, three = (
        vertices.take(row, axis=0) for row in np.take_along_axis(corners, turn, axis=1).T
    )
    normals = np.cross(two - one, three - one)
    area = np.linalg.norm(normals, axis=1)
    lengths.sort(axis=0)
    heights = area / np.where(lengths[2] > 0.0, lengths[2], 1.0)
    middle = area @ (one + two + three) / (3.0 * area.sum())
    some = np.where(area > 0.0, area, 1.0)
    normals /= some[:, None]
    normals[np.einsum('ni,ni->n', normals, one - middle) < 0] *= -1.0
    return Planes(
        normals, TURNED * lengths[0] * lengths[1] / some, heights, middle, area.sum() / 2
    )


def bends_outwards(vertices: Floats, closed: Closed, planes: Planes) -> bool:
    """Whether a closed surface is surely convex, without its hull: at each edge both triangles lie
    below the plane of the other one, the middle lies below all planes, and the surface goes around
    it once. Then each line from the middle leaves it once, so it does not cross itself; and what
    bends outwards everywhere is convex (Tietze, 1928).
    """
    corners, (one, two) = closed.corners.ravel(), closed.meeting.T
    for edge, other in ((one, two), (two, one)):
        here, opposite = edge // 3, other // 3 * 3 + (other + 2) % 3
        away = vertices.take(corners.take(opposite), axis=0)
        away -= vertices.take(corners.take(edge), axis=0)
        above = np.einsum('ni,ni->n', planes.normals.take(here, axis=0), away)
        if (above >= -planes.doubts.take(here) * np.linalg.norm(away, axis=1)).any():
            return False
    one, two, three = (
        place - planes.middle[:, None] for place in places_of(vertices, closed.corners)
    )
    if (np.einsum('ni,in->n', planes.normals, one) <= 2.0 * planes.doubts).any():
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


# ---- The surface of any triangles.


# Beyond, exact products of six lengths of a mesh that is not convex leave the range of doubles.
SMALLEST_SURFACE, LARGEST_SURFACE = 1e-30, 1e30


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
    used, corners = used_by(linked.corners[real])
    vertices = given.points[used]
    one, two, three = places_of(vertices / given.extent, corners)
    normals = _crossed(two - one, three - one)  # as they are wound
    length = np.sqrt(_squares(normals))
    normals /= np.where(length > 0.0, length, 1.0)
    normals = np.ascontiguousarray(normals.T)
    return Surface(vertices, corners, rows[real], normals), not len(open_at)


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
