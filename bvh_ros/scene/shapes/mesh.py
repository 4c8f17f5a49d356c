# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes: triangles in one form, and what kernels need of them."""

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
from .triangles import (
    Given,
    Linked,
    any_surface,
    bounds_of,
    closed_if_possible,
    convex_surface,
    different,
    parts_of,
    places_of,
    used_by,
)
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

# ---- Triangles as they are given.


CONVEX, SOLID, SHELL = range(3)  # forms of a mesh


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
    used, rows = used_by(rows)
    return places.take(used, axis=0), rows


# ---- Meshes of any triangles.


# By how much the boxes in a mesh's tree are larger than its triangles, in shares of the mesh.
PAD = 2.0**-44
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
    counts once, or twice where only that closes the mesh, as the wall that two boxes share. A
    sheet on both sides alone is not closed. Triangles without an area are left out; before that,
    they may close the seam between others.

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
        lo, hi = bounds_of(surface.vertices)
        inside = bool((lo <= 0.0).all() and (hi >= 0.0).all())
        as_given = inside or not self.convex
        self.centre: Floats = np.zeros(3) if as_given else lo * 0.5 + hi * 0.5
        """(3,) of the box around a convex mesh, in the frame of the triangles; their origin if the
        box holds that, or the mesh is not convex: then nothing is rounded."""
        self.size: Floats = hi - lo
        """(3,) edges of that box."""
        count = len(surface.vertices)
        order = arranged(surface.vertices) if self.convex else np.arange(count)
        row = np.empty(count, np.int32)
        row[order] = np.arange(count)
        self.vertices: Floats = surface.vertices[order] - self.centre
        """(k, 3) seen from the centre; of a convex mesh neighbours are next to each other."""
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


def tree_over(places: Floats, corners: NDArray[np.int32], size: float) -> OpenTree:
    """A tree of the boxes around triangles, rows (m, 3) of places, of a mesh of some size."""
    triangles, pad = places_of(places, corners), PAD * size
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
