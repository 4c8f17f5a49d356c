# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes that are not convex: rays in exact integers, distances triangle by triangle."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scene.meshes import (
    SOLIDS,
    SURFACES,
    first_hits,
    have_area,
    holds,
    require_uv,
    ring,
    segments,
    with_gaps,
)
from scene.reference import icosphere, refilled, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Shapes


@pytest.mark.parametrize('power', [-20, 0, 20])
@pytest.mark.parametrize('name', [*SOLIDS, *SURFACES])
def test_rays_are_exact(name, power):
    """No ray slips through an edge or corner, or is stopped by nothing; of several triangles at a
    place the lowest row is told.
    """
    rng, unit, plain = np.random.default_rng(power + 77), 2.0**power, (SOLIDS | SURFACES)[name]
    triangles = with_gaps(plain)
    rows = np.append(np.flatnonzero(have_area(triangles)), -1)
    for solid in (None, False):
        mesh = Mesh(triangles * unit, solid=solid)
        assert (mesh.convex, mesh.closed, mesh.dropped) == (False, name in SOLIDS, 4)
        assert mesh.solid == (name in SOLIDS and solid is None)
        scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]))
        starts, goals = segments(plain, 600, rng)
        wanted, tied = first_hits(plain, starts, goals - starts)
        if mesh.solid:
            wanted[holds(plain, starts, rng)] = 0.0
        hits = scene.raycast_many(starts * unit, (goals - starts) * unit, 1.0)
        assert np.array_equal(np.isfinite(hits.t), np.isfinite(wanted))
        hit = np.isfinite(wanted)
        assert hits.t[hit] == pytest.approx(wanted[hit], abs=1e-12)
        for triangle, t, faces in zip(hits.triangles, wanted, tied, strict=True):
            assert triangle in (rows[faces] if t > 0.0 else [-1])
        assert require_uv(hits, triangles * unit, 1e-14 * np.abs(starts).max() * unit).sum() > 50
        endless = scene.raycast_many(starts * unit, (goals - starts) * unit).t
        assert np.array_equal(endless[hit], hits.t[hit])
        assert (endless[~hit] > 1.0).all()
        one = scene.raycast(starts[0] * unit, goals[0] * unit)
        assert (np.inf if one is None else one.t) == hits.t[0]


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
        scene = refilled(Shapes.of_meshes(mesh, [0, 0, 0]))
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
        scene = refilled(Shapes.of_meshes(Mesh([triangle, *far]), [0, 0, 0]))
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
