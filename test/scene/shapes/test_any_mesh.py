# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes that are not convex: rays in exact integers, distances triangle by triangle."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scene.reference import box_of_triangles, icosphere, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Scene, Shapes

FULL_TURN = 2.0 * np.pi


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
    grid = np.rint(size * grid).astype(np.int64)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    parts = [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    return np.concatenate(parts)


def moebius(count=12):
    """A strip with half a twist, which has one side."""
    turn = np.arange(count + 1) * FULL_TURN / count
    rims = []
    for side in (-3, 3):
        wide = 10 + side * np.cos(turn / 2)
        rim = np.stack((wide * np.cos(turn), wide * np.sin(turn), side * np.sin(turn / 2)), 1)
        rims.append(np.rint(rim).astype(np.int64))
    low, high = rims
    parts = (low[:-1], high[:-1], low[1:]), (high[:-1], high[1:], low[1:])
    return np.concatenate([np.stack(corners, axis=1) for corners in parts])


def soup(rng, flat=False):
    """Triangles anywhere."""
    corners = rng.integers(-12, 13, (60, 3, 3))
    if flat:
        corners[:, :, 2] = 0
    return corners[np.cross(*np.diff(corners, axis=1).swapaxes(0, 1)).any(axis=1)]


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


def within_plane(triangle, origin, direction):
    """The t at which a ray enters a triangle in whose plane it runs; inf if it does not."""
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    axis = np.argmax(np.abs(normal))
    y, z = (axis + 1) % 3, (axis + 2) % 3
    away = triangle - origin
    sides = direction[y] * away[:, z] - direction[z] * away[:, y]
    along = away @ direction
    times = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        if sides[i] == 0:
            times.append(along[i])
        elif sides[i] * sides[j] < 0:
            times.append(along[i] + (along[j] - along[i]) * sides[i] / (sides[i] - sides[j]))
    times = np.array(times) / (direction @ direction)
    if not len(times) or times.max() < 0.0 or times.min() > 1.0:
        return np.inf
    return max(times.min(), 0.0)


def first_hits(triangles, solid, starts, goals, rng):
    """The t of the first hit of each segment, inf without any."""
    directions = goals - starts
    u, v, w, height = determinants(triangles, starts, directions)
    total, sides = u + v + w, np.stack((u, v, w))
    meets = ~((sides.min(axis=0) < 0) & (sides.max(axis=0) > 0))
    times = np.full(total.shape, np.inf)
    np.divide(height, total, out=times, where=meets & (total != 0))
    times[(times < 0.0) | (times > 1.0)] = np.inf
    first = times.min(axis=1)
    for row, face in zip(*np.nonzero(meets & (total == 0)), strict=True):
        t = within_plane(triangles[face], starts[row], directions[row])
        first[row] = min(first[row], t)
    if solid:
        first[holds(triangles, starts, rng)] = 0.0
    return first


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


@pytest.mark.parametrize('power', [-20, 0, 20])
@pytest.mark.parametrize('name', [*SOLIDS, *SURFACES])
def test_rays_are_exact(name, power):
    """No ray slips through an edge or corner, or is stopped by nothing."""
    rng, unit = np.random.default_rng(power + 99), 2.0**power
    triangles = (SOLIDS | SURFACES)[name]
    for solid in (None, False):
        mesh = Mesh(triangles * unit, solid=solid)
        assert (mesh.convex, mesh.closed) == (False, name in SOLIDS)
        scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]))
        starts, goals = segments(triangles, 600, rng)
        wanted = first_hits(triangles, mesh.solid, starts, goals, rng)
        found = scene.raycast_many(starts * unit, (goals - starts) * unit, 1.0).t
        assert np.array_equal(np.isfinite(found), np.isfinite(wanted))
        hit = np.isfinite(wanted)
        assert found[hit] == pytest.approx(wanted[hit], abs=1e-12)
        endless = scene.raycast_many(starts * unit, (goals - starts) * unit).t
        assert np.array_equal(endless[hit], found[hit])
        assert (endless[~hit] > 1.0).all()
        one = scene.raycast(starts[0] * unit, goals[0] * unit)
        assert (np.inf if one is None else one.t) == found[0]


@pytest.mark.parametrize('spare', [0, 200])
@pytest.mark.parametrize('power', [-20, 0, 20])
def test_a_ray_in_the_plane_of_a_triangle_touches_its_edges_exactly(power, spare):
    """It begins, or ends, on an edge of the only triangle, and is beside it else. The other
    triangles are far away: with them the mesh has a snapshot.
    """
    rng, unit = np.random.default_rng(power + spare + 99), 2.0**power
    far = rng.integers(500, 520, (spare, 3, 3))
    far = far[np.cross(*np.diff(far, axis=1).swapaxes(0, 1)).any(axis=1)]
    met, count = 0, 0
    while count < 25:
        axes, at = rng.integers(-5, 6, (2, 3)), rng.integers(-9, 10, 3)
        step, third = rng.integers(-4, 5, (2, 2))
        ways = rng.integers(-9, 10, (80, 2))
        side = step[0] * third[1] - step[1] * third[0]
        beside = side * (step[0] * ways[:, 1] - step[1] * ways[:, 0]) < 0
        if not (np.cross(*axes).any() and side and beside.any()):
            continue
        count += 1
        corners = at + np.array([(0, 0), 7 * step, third]) @ axes
        mesh = Mesh(np.concatenate((corners[None], far)) * unit)
        scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]))
        ways = (ways[beside] @ axes) * unit
        places = (at + rng.integers(0, 8, (len(ways), 1)) * (step @ axes)) * unit
        for begins, way, limit in ((places, ways, 1.0), (places + 3.0 * ways, -ways, 3.0)):
            hits = scene.raycast_many(begins, way, limit)
            assert hits.t == pytest.approx(np.full(len(ways), 0.0 if limit == 1.0 else 3.0))
            assert (hits.t <= limit).all()
            one = scene.raycast(begins[0], begins[0] + limit * way[0])
            assert one.t == pytest.approx(hits.t[0] / limit)
        for hits in (
            scene.raycast_many(places + 3.0 * ways, -ways, np.nextafter(3.0, 0.0)),
            scene.raycast_many(places, ways, skip_inside=True),
        ):
            assert np.isinf(hits.t).all()
        met += len(ways)
    assert met > 300


def exact_entry(triangle, origin, direction):
    """The exact t at which a line of doubles enters a triangle; inf without one, None if it runs
    in the plane.
    """
    a, b, c, d = (np.array([Fraction(x) for x in place]) for place in (*triangle, direction))
    start = np.array([Fraction(x) for x in origin])
    a, b, c = a - start, b - start, c - start
    u, v, w = d @ np.cross(b, c), d @ np.cross(c, a), d @ np.cross(a, b)
    if min(u, v, w) < 0 < max(u, v, w):
        return np.inf
    return a @ np.cross(b, c) / (u + v + w) if u + v + w else None


@pytest.mark.parametrize('spare', [0, 200])
def test_a_ray_almost_in_the_plane_of_a_triangle_ends_where_it_crosses_it(spare):
    """Only rounding lifts it out of the plane, so nearly all digits of its slope cancel."""
    rng = np.random.default_rng(spare)
    far, hits, misses = rng.uniform(500, 520, (spare, 3, 3)), 0, 0
    for _ in range(60):
        triangle = rng.normal(size=(3, 3)) + rng.normal(size=3)
        scene = scene_of(Shapes.of_meshes(Mesh([triangle, *far]), [0, 0, 0]))
        a, b, c = triangle[rng.permutation(3)]
        share, beyond = rng.uniform(0.0, 1.0, (20, 1)), rng.uniform(0.2, 3.0, (20, 1))
        starts = a + share * (b - a) + beyond * (a - c)
        ways = (a + b + c) / 3.0 - starts
        for limit in (1.0, np.inf):
            found = scene.raycast_many(starts, ways, limit).t
            for start, way, t in zip(starts, ways, found, strict=True):
                exact = exact_entry(triangle, start, way)
                if exact is None:
                    continue
                if not 0 <= exact <= limit:
                    assert t > 100.0  # those far away
                    misses += 1
                else:
                    assert t == pytest.approx(float(exact), rel=1e-10)
                    hits += 1
    assert min(hits, misses) > 100


@pytest.mark.parametrize('name', [*SOLIDS, *SURFACES])
def test_a_ray_from_a_surface_begins_in_the_obstacle(name):
    """As from a box: t is 0, without a normal or a triangle, and `skip_inside` leaves it out."""
    rng, triangles = np.random.default_rng(4), 4 * (SOLIDS | SURFACES)[name]
    scene = scene_of(Shapes.of_meshes(Mesh(triangles, solid=False), [0, 0, 0]))
    a, b, c = triangles[rng.integers(0, len(triangles), 200)].swapaxes(0, 1)
    places = np.concatenate((a, (a + b) // 2, (2 * a + b + c) // 4))
    ways = rng.integers(-9, 10, places.shape)
    hits = scene.raycast_many(places, ways)
    assert not hits.t.any()
    assert not hits.normals.any()
    assert (hits.triangles == -1).all()
    assert np.isinf(scene.raycast_many(places, ways, skip_inside=True).t).all()
    one = scene.raycast(places[0], places[0] + ways[0])
    assert (one.t, one.triangle, one.normal.any()) == (0.0, -1, False)
    assert scene.raycast(places[0], places[0] + ways[0], skip_inside=True) is None
    assert scene.raycast(places[0], places[0]).triangle == -1


@pytest.mark.parametrize('name', [name for name in (*SOLIDS, *SURFACES) if name != 'wall'])
def test_a_surface_on_both_sides_is_that_on_one(name):
    """Else a solid would hold nothing by parity, and a sheet would be closed."""
    rng, triangles = np.random.default_rng(7), (SOLIDS | SURFACES)[name]
    both = np.concatenate((triangles, triangles[:, ::-1]))
    one, other = Mesh(triangles), Mesh(both)
    assert (other.closed, other.solid, other.convex) == (one.closed, one.solid, False)
    assert (len(other.corners), other.dropped) == (len(triangles), len(triangles))
    starts, goals = segments(triangles, 300, rng)
    hits = [
        scene_of(Shapes.of_meshes(mesh, [0, 0, 0])).raycast_many(starts, goals - starts, 1.0)
        for mesh in (one, other)
    ]
    assert np.array_equal(hits[0].t, hits[1].t)
    assert np.array_equal(hits[0].triangles, hits[1].triangles)
    if not one.closed:
        with pytest.raises(ValueError, match='a solid mesh must be closed'):
            Mesh(both, solid=True)


def test_what_a_mesh_says_of_itself():
    ball, shell = Mesh(icosphere(2)), Mesh(icosphere(2), solid=False)
    assert (ball.convex, ball.closed, ball.solid) == (True, True, True)
    assert (shell.convex, shell.closed, shell.solid) == (False, True, False)
    strip = Mesh(SURFACES['strip'])
    assert (strip.convex, strip.closed, strip.solid) == (False, False, False)
    torus = Mesh(SOLIDS['ring'])
    assert (torus.solid, torus.not_convex != '') == (True, True)
    no_area = np.concatenate([SOLIDS['ring'], [[(0, 0, 0), (1, 1, 1), (3, 3, 3)]] * 2])
    assert (Mesh(no_area).dropped, Mesh(no_area).closed) == (2, True)
    assert Mesh(no_area).rows.tolist() == list(range(len(torus.corners)))
    assert ball.not_convex == ''
    assert repr(torus).startswith('Mesh(solid of 140 triangles')


def test_vertices_and_faces():
    corners, faces = np.unique(SOLIDS['ring'].reshape(-1, 3), axis=0, return_inverse=True)
    given = Mesh(corners, faces.reshape(-1, 3))
    assert given.key == Mesh(SOLIDS['ring']).key
    for bad, words in (
        ([[0, 1, 99999]], r'row 0 is \[0, 1, 99999\]'),
        ([[0, 1, -1]], 'must name rows'),
        ([[0.0, 1.0, 2.0]], 'integers'),
        ([0, 1, 2], r'shape \(m, 3\)'),
        ([[0, 0, 1]], 'no triangle with an area'),
    ):
        with pytest.raises(ValueError, match=words):
            Mesh(corners, bad)
    with pytest.raises(ValueError, match='an odd number of triangles'):
        Mesh(SOLIDS['ring'][1:], solid=True)


# ---- Distances: brute force over all triangles.


def distances(triangles, points):
    """(n,) distances of points from triangles: from corners, edges and faces."""
    best = np.full(len(points), np.inf)
    for triangle in triangles:
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        inside = np.ones(len(points), np.bool_)
        for i in range(3):
            a, b = triangle[i], triangle[(i + 1) % 3]
            share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            gap = np.linalg.norm(points - a - share[:, None] * (b - a), axis=1)
            best = np.minimum(best, gap)
            inside &= np.cross(b - a, points - a) @ normal >= 0.0
        height = np.abs((points - triangle[0]) @ normal) / np.linalg.norm(normal)
        best = np.where(inside, np.minimum(best, height), best)
    return best


@pytest.fixture(scope='module', params=['ring', 'hollow', 'strip'])
def placed(request):
    """A mesh in a pose, its triangles in the world, and a scene that holds it."""
    triangles = (SOLIDS | SURFACES)[request.param] / 8.0
    mesh, turn = Mesh(triangles), Rotation.from_quat((0.3, -0.2, 0.5, 0.8))
    place = np.array((3.0, -2.0, 1.0))
    world = turn.apply(triangles.reshape(-1, 3)).reshape(-1, 3, 3) + place
    scene = scene_of(Shapes.of_meshes(mesh, place, turn.as_quat()))
    rng = np.random.default_rng(5)
    points = rng.uniform(-2.5, 2.5, (300, 3)) + place
    gaps = distances(world, points)
    inside = np.zeros(len(points), np.bool_)
    if mesh.solid:
        grid = np.rint(turn.inv().apply(points - place) * 8.0 * 2**12).astype(np.int64)
        inside = holds(np.int64(2**12) * (triangles * 8.0).astype(np.int64), grid, rng)
    return mesh, scene, points, gaps, inside


def test_nearest_and_depth_of_points(placed):
    _, scene, points, gaps, inside = placed
    _, found, _ = scene.nearest_many(points)
    assert found[:, 0] == pytest.approx(np.where(inside, 0.0, gaps), abs=1e-12)
    _, found, places = scene.nearest_many(points, signed=True)
    assert found[:, 0] == pytest.approx(np.where(inside, -gaps, gaps), abs=1e-12)
    away = np.linalg.norm(places[:, 0] - points, axis=1)
    assert away == pytest.approx(gaps, abs=1e-12)


@pytest.mark.parametrize('size', [1e-6, 1e-12, 1e-18, 1e-25])
def test_far_points_of_a_tiny_triangle(size):
    """So far that rounding leaves no side of its edges."""
    tiny = [(0, 0, 0), (size, 0, 0), (0.3 * size, size, 0.2 * size)]
    scene = scene_of(Shapes.of_meshes(Mesh([tiny, np.full((3, 3), -1e3) + np.eye(3)]), [0, 0, 0]))
    points = np.random.default_rng(7).normal(size=(200, 3)) + 20.0
    _, found, places = scene.nearest_many(points)
    assert found[:, 0] == pytest.approx(np.linalg.norm(points, axis=1), rel=3e-6 * size / 1e-6)
    assert (abs(places) <= 2.0 * size + 1e-14).all()


def test_a_crack_of_one_rounding_seen_from_above():
    u, v = np.nextafter(0.3, 1), np.nextafter(0.4, 1)
    crack = [(0.3, 0.4, 0), (u, 0.4, 0.7), (0.3, v, 1)]
    wall = [(0.3, 0.4, 0), (1.3, 0.4, 0), (1.3, 0.4, 1)]
    mesh = Mesh([wall, crack], solid=False)
    scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]), planar=True)
    for point in ((-30.0, 7.0), (-2.0, 5.0)):
        (hit,) = scene.nearest(point)
        assert hit.t == pytest.approx(math.dist(point, (0.3, 0.4)), rel=1e-15)


def test_clearance_and_overlap_of_balls(placed):
    mesh, scene, points, gaps, inside = placed
    radius = np.random.default_rng(6).uniform(0.01, 0.5, len(points))
    balls = Shapes.spheres(points, radius)
    outside = np.where(inside, 0.0, gaps)
    _, found, _, _ = scene.clearance_many(balls)
    assert found == pytest.approx(np.maximum(outside - radius, 0.0), abs=1e-12)
    touches = scene.overlap_shape_many(Shapes.spheres([0, 0, 0], 0.2), points, tolerance=0.1)
    assert np.array_equal(touches, outside <= 0.3)
    if mesh.solid:
        _, found, _, _ = scene.clearance_many(balls, signed=True)
        assert found == pytest.approx(np.where(inside, -gaps, gaps) - radius, abs=1e-12)
    else:
        with pytest.raises(ValueError, match='no signed distance'):
            scene.clearance_many(balls, signed=True)


@pytest.fixture(scope='module')
def rocks():
    """(A scene with one mesh of many triangles, and one with each triangle as an obstacle.)"""
    rng, count = np.random.default_rng(8), 400
    triangles = rng.uniform(-1.0, 1.0, (count, 1, 3)) + rng.uniform(-0.1, 0.1, (count, 3, 3))
    triangles[:80] = 0.4 * icosphere(1)  # they share corners
    place, turn = np.array((3.0, -2.0, 1.0)), (0.3, -0.2, 0.5, 0.8)
    each = [Mesh(triangle[None], solid=False) for triangle in triangles]
    places, turns = np.tile(place, (count, 1)), np.tile(turn, (count, 1))
    whole = Shapes.of_meshes(Mesh(triangles, solid=False), place, turn)
    return scene_of(whole), scene_of(Shapes.of_meshes(each, places, turns))


@pytest.mark.parametrize('size', [1e-3, 0.1, 1.0, 30.0])
@pytest.mark.parametrize('kind', ['box', 'ball', 'capsule', 'cylinder', 'stick', 'ring'])
def test_a_mesh_is_as_near_as_its_triangles_one_by_one(rocks, kind, size):
    mesh, apart = rocks
    rng, count = np.random.default_rng(9), 100
    places = rng.normal(size=(count, 3)) * rng.choice([0.5, 2.0, 20.0], (count, 1)) + (3, -2, 1)
    turns, ones = Rotation.random(count, random_state=4).as_quat(), np.full(count, size)
    shapes = {
        'box': lambda: Shapes.boxes(places, size * rng.uniform(0.1, 1.0, (count, 3)), turns),
        'ball': lambda: Shapes.spheres(places, ones),
        'capsule': lambda: Shapes.capsules(places, 0.1 * ones, ones, turns),
        'cylinder': lambda: Shapes.cylinders(places, 0.1 * ones, ones, turns),
        'stick': lambda: Shapes.boxes(places, size * np.array([[1.0, 1e-4, 1e-6]] * count), turns),
        'ring': lambda: Shapes.of_meshes(Mesh(SOLIDS['ring'] * (size / 16.0)), places, turns),
    }[kind]()
    _, found, mine, theirs = mesh.clearance_many(shapes)
    _, expected, _, _ = apart.clearance_many(shapes)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12 * max(size, 1.0))
    gaps = np.linalg.norm(mine - theirs, axis=1)
    assert gaps == pytest.approx(found, abs=1e-12 * max(size, 10.0))
    assert (found > 0.0).any() or size > 1.0


def test_boxes_and_meshes_touch_where_their_distance_is_zero(placed):
    """Distances, points and overlaps agree, also of one mesh in another."""
    mesh, scene, points, _, inside = placed
    rng = np.random.default_rng(7)
    turns = Rotation.random(60, random_state=3).as_quat()
    boxes = Shapes.boxes(points[:60], rng.uniform(0.05, 1.0, (60, 3)), turns)
    _, found, mine, theirs = scene.clearance_many(boxes)
    touches = scene.overlap_many(points[:60], boxes.size, turns)
    assert np.array_equal(found == 0.0, touches)
    assert (touches | ~inside[:60]).all()
    assert np.linalg.norm(mine - theirs, axis=1) == pytest.approx(found, abs=1e-12)
    shell = Mesh(mesh.vertices[mesh.corners], solid=False)
    thin = Shapes.of_meshes(shell, points[:60], turns)
    solid = Shapes.of_meshes(mesh, points[:60], turns)
    _, of_shells, _, _ = scene.clearance_many(thin)
    _, of_solids, _, _ = scene.clearance_many(solid)
    assert (of_solids <= of_shells).all()
    assert np.array_equal(of_solids[of_solids > 0.0], of_shells[of_solids > 0.0])
    touches = scene.overlap_shape_many(solid.take([0]), points[:60], turns)
    assert np.array_equal(touches, of_solids == 0.0)


def test_swept_balls_touch_first_where_they_are_first_near(placed):
    scene, points = placed[1:3]
    starts, goals = points[:100], points[100:200]
    radius, times = 0.2, np.linspace(0.0, 1.0, 201)
    found = scene.sweep_many(starts, goals, radius).t
    for i, t in enumerate(found):
        path = starts[i] + times[:, None] * (goals[i] - starts[i])
        _, apart, _ = scene.nearest_many(path)
        touching = times[apart[:, 0] <= radius - 1e-9]
        assert not len(touching) or t <= touching[0]
        if np.isfinite(t):
            _, apart, _ = scene.nearest_many([starts[i] + t * (goals[i] - starts[i])])
            assert apart[0, 0] <= radius + 1e-9


def test_a_box_turns_into_a_ring_and_out_of_it():
    """Sweeps of shapes, checked at many poses: never free where a pose touches."""
    ring_mesh = Mesh(SOLIDS['ring'] / 8.0)
    scene = scene_of(Shapes.of_meshes(ring_mesh, [0, 0, 0]))
    rng = np.random.default_rng(8)
    starts, goals = rng.uniform(-2.5, 2.5, (2, 40, 3))
    turns, goal_turns = (Rotation.random(40, random_state=k) for k in (1, 2))
    for body in (
        Shapes.boxes([0, 0, 0], (0.8, 0.3, 0.2)),
        Shapes.of_meshes(Mesh(SOLIDS['comb'] / 20.0), [0, 0, 0]),
    ):
        poses = starts, turns.as_quat(), goals, goal_turns.as_quat()
        found = scene.sweep_shape_many(body, *poses)
        met = 0
        for t in np.linspace(0.0, 1.0, 60):
            half = (turns.inv() * goal_turns).as_rotvec()
            between = (turns * Rotation.from_rotvec(t * half)).as_quat()
            places = starts + t * (goals - starts)
            touches = scene.overlap_shape_many(body, places, between)
            met += touches.sum()
            assert (found.t[touches] <= t + 1e-9).all()
        assert met > 20
        assert (found.t < np.inf).sum() < 40


def test_what_is_inside_touches_and_a_hollow_is_free():
    """A small box inside a solid touches it; inside a hollow, or a shell, it does not."""
    small = Shapes.boxes([0.0, 0.0, 0.0], (1, 1, 1))
    hollow = Mesh(SOLIDS['hollow'])
    for mesh, wanted in (
        (hollow, False),
        (Mesh(SOLIDS['wall']), True),
        (Mesh(SOLIDS['comb']), True),
        (Mesh(icosphere(2) * 9, solid=False), False),
    ):
        scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]))
        assert len(scene.overlap_shape(small)) == wanted
        assert bool(scene.overlap_shape_many(small, [[0, 0, 0]])[0]) == wanted
        scene.update('test', ['small'], small, stamp=1)
        assert len(scene.overlap_pairs()) == wanted
        assert (scene.clearance('small').distance == 0.0) == wanted


def assert_same_at(scene, at, still):
    """At a time nearest points, boxes, rays and balls see what they see in a scene that stands
    still; return the points, and where rays go from each.
    """
    rng = np.random.default_rng(9)
    points, goals = rng.uniform(-3, 4, (2, 60, 3))
    found = scene.nearest_many(points, at=at)[1]
    assert found == pytest.approx(still.nearest_many(points)[1], abs=1e-12)
    boxes = Shapes.boxes(points, (0.4, 0.4, 0.4))
    assert scene.clearance_many(boxes, at=at)[1] == pytest.approx(
        still.clearance_many(boxes)[1], abs=1e-12
    )
    for radius in (0.0, 0.2):
        for start, goal in zip(points[:20], goals[:20], strict=True):
            moved = scene.raycast(start, goal, radius, at=at)
            stood = still.raycast(start, goal, radius)
            assert (moved is None) == (stood is None)
            assert moved is None or moved.t == pytest.approx(stood.t, abs=1e-12)
    return points, goals


def test_one_that_moves():
    """At a time a ring stands elsewhere: rays, points and boxes see it there."""
    scene = Scene()
    ring_shape = Shapes.of_meshes(Mesh(SOLIDS['ring'] / 8.0), [0, 0, 0])
    scene.update('test', ['ring'], ring_shape, stamp=0, velocities=[[1, 0, 0]])
    still = scene_of(Shapes.of_meshes(Mesh(SOLIDS['ring'] / 8.0), [2, 0, 0]))
    assert_same_at(scene, 2 * 10**9, still)


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('decade', [100, 155, 307])
@pytest.mark.parametrize('solid', [None, False])
def test_what_reaches_a_mesh_from_beyond_all_squares_touches_it(solid, decade, planar):
    """From there the mesh, 3 km across, is no larger than what rounds a distance."""
    triangles, far = ring(9, 5, 1609), 10.0**decade
    scene = scene_of(Shapes.of_meshes([Mesh(triangles, solid=solid)], [[5, 6, 7]]), planar)
    turn = Rotation.from_euler('zyx', (0.7, 0.0 if planar else 0.4, 0.0)).as_quat()
    for way in (*np.eye(3)[: 2 if planar else 3], np.array([-1.0, 0.0, 0.0])):
        point = way * far
        cube = Shapes.boxes([point], 0.1 * far, [turn])  # which reaches 0.05 to 0.087 far
        for reach, tolerance, touches in ((0.99, 0.91, False), (1.01, 0.96, True)):
            reach, tolerance = reach * far, tolerance * far
            ball = Shapes.spheres([point], reach)
            assert bool(scene.overlap(point, point, tolerance=reach)) == touches
            assert bool(scene.overlap_shape(ball)) == touches
            assert bool(scene.overlap_shape(cube, tolerance)) == touches
        (nearest,) = scene.nearest(point)
        assert np.isclose(nearest.t, far, rtol=1e-12)
        assert np.linalg.norm(nearest.point[:2]) < 3000
        found = scene.clearance_many(Shapes.spheres([point], 0.5 * far))
        assert np.isclose(found.distances[0], 0.5 * far, rtol=1e-12)
        found = scene.clearance_many(cube)
        assert 0.91 * far < found.distances[0] < 0.96 * far


@pytest.mark.parametrize('size', [1e-20, 3e-12, 1.7, 3.0, 1.3e8, 1e21])
def test_a_point_off_a_triangle_by_less_than_doubles_hold(size):
    """Its foot has lost digits there: it is the nearest point all the same."""
    triangle = np.array([[(0, 0, 0), (1, 0, 0), (0, 0, 1)]]) * size
    scene = scene_of(Shapes.of_meshes(Mesh(triangle), [0, 0, 0]))
    off = np.concatenate([10.0 ** np.arange(-323.0, -200.0), [5e-324, 0.0]])
    places = np.random.default_rng(1).uniform(0.1, 0.4, (len(off), 3)) * size
    for side in (-1.0, 1.0):
        places[:, 1] = side * off
        found = scene.nearest_many(places).distances[:, 0]
        assert (found <= np.maximum(2.0 * off, 1e-50 * size)).all()
