# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Triangles of meshes, convex and not, and where rays meet them: in exact arithmetic."""

from fractions import Fraction

import numpy as np
from scene.reference import box_of_triangles

FULL_TURN = 2.0 * np.pi
CUBE = box_of_triangles((1.0, 1.0, 1.0))
TETRAHEDRON = np.vstack((np.zeros(3), np.eye(3)))[[[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]]
NO_AREA = np.array([[(0, 0, 0), (1, 1, 1), (3, 3, 3)]])


def grid_triangles(grid):
    """Two triangles, (n, 3, k), a field of a grid of places (i, j, k)."""
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3, grid.shape[2])


def cut_cube(cuts):
    """A cube whose sides are cut into cuts x cuts squares of two triangles: most are coplanar."""
    steps = np.arange(-cuts, cuts + 1, 2) / (2.0 * cuts)
    x, y = np.meshgrid(steps, steps, indexing='ij')
    side = grid_triangles(np.stack([x, y, np.full_like(x, 0.5)], axis=2))
    return np.concatenate([sign * np.roll(side, k, axis=2) for k in range(3) for sign in (1, -1)])


def single(triangles):
    """Rounded to float32."""
    return triangles.astype(np.float32).astype(float)


def with_gaps(triangles):
    """Triangles among others without area, so that rows as given are not those of the mesh.

    An even number of them: so what was closed is still.
    """
    half = len(triangles) // 2
    return np.insert(triangles, [0, 0, half, half], NO_AREA, axis=0)


# ---- Meshes on an integer grid: rays through their corners, edges and faces are exactly that.


def box(lo, hi):
    """Twelve triangles of a box with integer corners."""
    lo, hi = np.array(lo), np.array(hi)
    return np.rint(box_of_triangles(hi - lo) + (lo + hi) / 2.0).astype(np.int64)


def ring(around, across, size):
    """A torus of integer corners."""
    u, v = np.meshgrid(np.arange(around + 1), np.arange(across + 1), indexing='ij')
    u, v = u % around * FULL_TURN / around, v % across * FULL_TURN / across
    wide = 1.0 + 0.4 * np.cos(v)
    grid = np.stack((wide * np.cos(u), wide * np.sin(u), 0.4 * np.sin(v)), axis=2)
    return grid_triangles(np.rint(size * grid).astype(np.int64))


def moebius(count=12):
    """A strip with half a twist, which has one side."""
    turn = np.arange(count + 1) * FULL_TURN / count
    rims = []
    for side in (-3, 3):
        wide = 10 + side * np.cos(turn / 2)
        rim = np.stack((wide * np.cos(turn), wide * np.sin(turn), side * np.sin(turn / 2)), 1)
        rims.append(np.rint(rim).astype(np.int64))
    return grid_triangles(np.stack(rims))


def soup(rng, flat=False):
    """Triangles anywhere."""
    corners = rng.integers(-12, 13, (60, 3, 3))
    if flat:
        corners[:, :, 2] = 0
    return corners[have_area(corners)]


def have_area(triangles):
    return np.cross(*np.diff(triangles, axis=1).swapaxes(0, 1)).any(axis=1)


TEETH = [box((x, -1, 1), (x + 1, 1, 7)) for x in range(-4, 5, 2)]
SOLIDS = {
    'ring': ring(10, 7, 12),
    'hollow': np.concatenate([box((-8,) * 3, (8,) * 3), box((-4,) * 3, (4,) * 3)]),
    'channel': np.concatenate(
        [box((-8, -4, -4), (8, -2, 4)), box((-8, 2, -4), (8, 4, 4)), box((-8, -2, -4), (8, 2, -2))]
    ),
    'comb': np.concatenate([box((-5, -1, -1), (5, 1, 1)), *TEETH]),
    'wall': np.concatenate([box((-8, -3, -3), (0, 3, 3)) * (side, 1, 1) for side in (-1, 1)]),
}
SURFACES = {
    'strip': moebius(),
    'soup': soup(np.random.default_rng(1)),
    'flat': soup(np.random.default_rng(2), flat=True),
}


# ---- What exact arithmetic says.


def determinants(triangles, origins, directions):
    """(u, v, w, height) of each ray (n,) at each triangle (m,), in int64."""
    a, b, c = (triangles[None, :, k] - origins[:, None] for k in range(3))
    along = directions[:, None]
    sides = [(along * np.cross(p, q)).sum(axis=2) for p, q in ((b, c), (c, a), (a, b))]
    return *sides, (a * np.cross(b, c)).sum(axis=2)


def holds(triangles, points, rng):
    """Whether solids hold points, by the parity of a line that touches no edge."""
    held, left = np.zeros(len(points), np.bool_), np.arange(len(points))
    while len(left):
        direction = np.broadcast_to(rng.integers(-999, 1000, 3), (len(left), 3))
        u, v, w, height = determinants(triangles, points[left], direction)
        total, sides = u + v + w, np.stack((u, v, w))
        meets = ~((sides.min(axis=0) < 0) & (sides.max(axis=0) > 0))
        on_surface = (meets & (height == 0) & (total != 0)).any(axis=1)
        unclear = (meets & (sides == 0).any(axis=0)).any(axis=1) & ~on_surface
        odd = (meets & (np.sign(height) * np.sign(total) > 0)).sum(axis=1) % 2 == 1
        held[left] = on_surface | odd
        left = left[unclear]
    return held


def entry_within_plane(triangle, start, way):
    """The t at which a ray enters a triangle in whose plane it runs, exactly; None: nowhere."""
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    axis = int(np.argmax(np.abs(normal)))
    y, z = (axis + 1) % 3, (axis + 2) % 3
    away = (triangle - start).tolist()
    way = way.tolist()
    sides = [way[y] * corner[z] - way[z] * corner[y] for corner in away]
    along = [Fraction(sum(a * b for a, b in zip(corner, way, strict=True))) for corner in away]
    times = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        if sides[i] == 0:
            times.append(along[i])
        elif sides[i] * sides[j] < 0:
            times.append(
                along[i] + (along[j] - along[i]) * Fraction(sides[i], sides[i] - sides[j])
            )
    if not times or max(times) < 0:
        return None
    return max(min(times), Fraction(0)) / sum(a * a for a in way)


def first_hits(triangles, starts, ways):
    """For each segment the t at which it first meets triangles, inf without any; and a list of the
    row that it meets: the lowest of several, or [-1].

    All of them where it runs in the plane of one: there rounding chooses.
    """
    u, v, w, height = determinants(triangles, starts, ways)
    total, sides = u + v + w, np.stack((u, v, w))
    meets = ~((sides.min(axis=0) < 0) & (sides.max(axis=0) > 0))
    times, found = np.full(len(starts), np.inf), []
    for row in range(len(starts)):
        best, tied = Fraction(1), [-1]
        for face in np.flatnonzero(meets[row]).tolist():
            if total[row, face] == 0:
                t = entry_within_plane(triangles[face], starts[row], ways[row])
            else:
                t = Fraction(int(height[row, face]), int(total[row, face]))
            if t is None or not 0 <= t <= best:
                continue
            if t < best or tied == [-1]:
                best, tied = t, []
            tied.append(face)
        within = [face for face in tied if total[row, face] == 0]
        found.append(tied if within else tied[:1])
        if tied != [-1]:
            times[row] = float(best)
    return times, found


def segments(triangles, count, rng):
    """Segments anywhere, through corners, and along edges; between integer places."""
    reach = int(np.abs(triangles).max()) + 4
    starts, goals = rng.integers(-reach, reach + 1, (2, count, 3))
    third, corners = count // 3, triangles.reshape(-1, 3)
    through = corners[rng.integers(0, len(corners), third)]
    goals[:third] = starts[:third] + (through - starts[:third]) * rng.integers(1, 4, (third, 1))
    faces, side = rng.integers(0, len(triangles), third), rng.integers(0, 3, third)
    a, b = triangles[faces, side], triangles[faces, (side + 1) % 3]
    starts[third : 2 * third] = a - (b - a) * rng.integers(-1, 3, (third, 1))
    goals[third : 2 * third] = a + (b - a) * rng.integers(-1, 3, (third, 1))
    moves = (starts != goals).any(axis=1)
    return starts[moves], goals[moves]


def places(triangles, rows, uv):
    """The points (n, 3) that rows and uv (n, 2) of triangles mean."""
    a, b, c = np.moveaxis(triangles[rows], 1, 0)
    u, v = uv[:, :1], uv[:, 1:]
    return (1.0 - u - v) * a + u * b + v * c


def require_uv(hits, triangles, tolerance):
    """u, v and u + v are from 0 to 1, and lead to the point, where a triangle is met."""
    met = hits.triangles >= 0
    assert np.isnan(hits.uv[~met]).all()
    uv, points = hits.uv[met], hits.points[met]
    assert uv.min(initial=0.0) >= 0.0
    assert uv.sum(axis=1).max(initial=0.0) <= 1.0
    apart = np.abs(places(triangles, hits.triangles[met], uv) - points)
    assert apart.max(initial=0.0) <= tolerance
    return met
