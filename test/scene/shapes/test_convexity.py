# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is kept of a mesh is nowhere farther from what was given than float32 rounds: in every
decade of size, however finely the surface is cut, however gently it bends inwards.
"""

import numpy as np
import pytest
from scene.cast.test_surface import shuffled, turned
from scene.meshes import CUBE, cut_cube, single
from scene.reference import bulging, icosphere, scene_of
from scipy.spatial import ConvexHull

from bvh_ros.scene import Mesh, Shapes, mesh_of

NOISE = 2.0**-22  # of the size: float32 rounds by up to 2**-24 of it

DECADES = (-320, -300, -101, -99, -90, -60, -30, 0, 30, 60, 90, 99, 101, 150, 300)


def prism(outline, height=0.5):
    """Triangles of a prism over a polygon (n, 2) that is a fan around its corner 0."""
    low, high = (np.column_stack([outline, np.full(len(outline), z)]) for z in (-height, height))
    a, b, c, d = low, np.roll(low, -1, 0), np.roll(high, -1, 0), high
    sides = [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    caps = [np.stack([np.broadcast_to(x[0], x[2:].shape), x[1:-1], x[2:]], 1) for x in (low, high)]
    return np.concatenate(sides + caps)


def duct(segments, angle, turn=0.0):
    """A sector of a ring with radii 1 and 2: bent inwards in many small steps."""
    angles = np.linspace(0, angle, segments + 1) + turn
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
    up = np.array([0, 0, 0.5])
    tube = np.array([ring, 2 * ring, 2 * ring + up, ring + up])
    triangles = []
    for i in range(4):
        a, b = tube[i], tube[(i + 1) % 4]
        triangles += [np.stack([a[:-1], a[1:], b[1:]], 1), np.stack([a[:-1], b[1:], b[:-1]], 1)]
    ends = [tube[[0, i, i + 1], k][None] for k in (0, -1) for i in (1, 2)]
    return np.concatenate(triangles + ends)


def fillet(radius, count):
    """A square whose one corner is rounded by so many points."""
    angles = np.linspace(0, np.pi / 2, count)
    arc = 0.5 - radius + radius * np.stack([np.cos(angles), np.sin(angles)], 1)
    return np.concatenate([[(-0.5, -0.5), (0.5, -0.5)], arc, [(-0.5, 0.5)]])


@pytest.mark.parametrize('segments', [50, 836, 2000])
def test_a_surface_that_bends_inwards_a_little_at_a_time_is_refused(segments):
    for angle, turn in ((np.pi / 3, 0.0), (np.pi / 3, 2.0), (0.02, 1.0)):
        for form in (lambda x: x, turned, lambda x: shuffled(single(x))):
            with pytest.raises(ValueError, match=r'not convex at triangle .* m within the hull'):
                mesh_of(form(duct(segments, angle, turn)).astype(np.float64), 'convex')


@pytest.mark.parametrize(('corners', 'step'), [(5, 1), (5, 2), (7, 2), (7, 3), (8, 3), (11, 5)])
def test_what_bends_outwards_everywhere_but_goes_around_more_than_once_is_not_convex(
    corners, step
):
    """Two pyramids over a star: they bend inwards at no edge. Over a polygon they are convex."""
    angles = 2.0 * np.pi * step * np.arange(corners) / corners
    rim = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], 1)
    star = pyramids(rim, 1.0)
    for form in (star, star * (1.0, 1.0, 1e-3), single(star + 3.0).astype(np.float64)):
        assert Mesh(form).convex == (step == 1)


def pyramids(rim, height):
    """Two pyramids over a rim in the plane, one upside down."""
    tips = (np.broadcast_to((0.0, 0.0, z), rim.shape) for z in (height, -height))
    return np.concatenate([np.stack([rim, np.roll(rim, -1, 0), tip], 1) for tip in tips])


@pytest.mark.parametrize('notch', [0.5, 0.7, 0.95])
def test_a_plate_with_a_notch_is_not_convex_however_thin(notch):
    """Its rim lies beside that of the hull, though hardly within it."""
    rim = np.array([(notch, 0, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0)])
    for height in (5e-7, 1e-6, 2e-6, 1e-5):
        assert not Mesh(pyramids(rim, height)).convex
    away = np.add(pyramids(rim, 5.2e-4), (1000, 0, 0))
    assert not Mesh(single(away).astype(np.float64)).convex
    rim[0] = 2.0, 0.0, 0.0
    assert Mesh(pyramids(rim, 1e-5)).convex


@pytest.mark.parametrize('height', [1e-5, 1e-3, 1.0])
def test_a_flat_pyramid_of_many_sides_is_convex(height):
    """Its edges bend by less than rounding may turn a normal of a triangle as long."""
    angles = 2.0 * np.pi * np.arange(5000) / 5000
    rim = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], 1)
    for turn in range(3):
        assert Mesh(np.roll(pyramids(rim, height), turn, axis=1)).convex


@pytest.mark.parametrize('count', [30, 300])
def test_one_corner_within_the_hull_is_found(count):
    """The hull of points on a ball bends outwards at each edge, and not if one of them sinks."""
    points = np.random.default_rng(count).normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    faces = ConvexHull(points).simplices
    assert Mesh(points, faces).convex
    assert Mesh(single(points).astype(np.float64), faces).convex
    for row in range(min(count, 30)):
        others = faces[(faces == row).any(axis=1)]
        around = points[np.setdiff1d(others, row)].mean(axis=0)
        sunk = points.copy()
        sunk[row] = around - 1e-3 * around / np.linalg.norm(around)
        assert not Mesh(sunk, faces).convex


def test_the_depth_of_a_dent_decides():
    """A cube whose one side has a shallow pit, around the limit; told rightly in metres."""
    plate = cut_cube(4)
    pit = (plate == (0.0, 0.0, 0.5)).all(axis=2)
    assert pit.any()
    for depth in (1e-8, 2.3e-7, 2.5e-7, 1e-6, 1e-3):
        given = plate.copy()
        given[pit, 2] -= depth
        if depth < NOISE:
            assert len(Mesh(given).corners) == len(given)
            continue
        with pytest.raises(ValueError, match='not convex') as refused:
            mesh_of(given, 'convex')
        told = float(str(refused.value).split('it lies ')[1].split(' m')[0])
        assert told == pytest.approx(depth, rel=0.01, abs=1e-8)


@pytest.mark.parametrize(('radius', 'count'), [(1e-3, 8000), (1e-5, 300), (2e-7, 9)])
def test_what_is_finer_than_the_noise_does_not_melt(radius, count):
    """A rounded edge whose points are nearer to each other than float32 rounds."""
    outline = fillet(radius, count)
    for given in (prism(outline), single(prism(outline)), turned(prism(outline))):
        mesh = Mesh(given)
        # Shaken a little: qhull takes minutes over a flat face of thousands of corners.
        corners = mesh.vertices + mesh.centre
        kept = ConvexHull(corners + np.random.default_rng(1).uniform(-1e-9, 1e-9, corners.shape))
        outside = -depth_within(given.reshape(-1, 3)[:: max(len(given) // 500, 1)], kept)
        assert outside.max() <= NOISE * mesh.size.max() + 2e-9


def depth_within(points, hull):
    """How deep points are in a hull, by all its planes."""
    return -(points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)


def test_what_is_taken_is_near_its_hull_everywhere():
    """Brute force over samples of all triangles, and from the given corners to the kept solid."""
    rng = np.random.default_rng(7)
    taken = 0
    for trial in range(60):
        triangles = [cut_cube(5), icosphere(2), bulging(rng, 40), prism(fillet(1e-2, 40))][
            trial % 4
        ]
        triangles = turned(triangles * rng.uniform(0.01, 1, 3), trial)
        size = np.ptp(triangles.reshape(-1, 3), axis=0).max()
        corners, which = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        moved = corners + rng.normal(size=corners.shape) * size * 10.0 ** rng.uniform(-9, -5)
        given = moved[which.reshape(-1, 3)]
        hull = ConvexHull(moved)
        noise = NOISE * np.ptp(moved, axis=0).max()
        shares = rng.dirichlet((1, 1, 1), 20)
        samples = np.einsum('sk,mki->msi', shares, given).reshape(-1, 3)
        deepest = depth_within(samples, hull).max()
        try:
            mesh = mesh_of(given, 'convex')
        except ValueError:
            assert deepest > 0.2 * noise
            continue
        taken += 1
        assert deepest <= noise
        assert depth_within(mesh.vertices + mesh.centre, hull).max() <= noise
        kept = ConvexHull(mesh.vertices + mesh.centre)
        assert -depth_within(moved, kept).min() <= noise
    assert 15 < taken < 50


def answers_about(mesh, size):
    """How far rays and balls go, and how far points are, in units of a size."""
    scene = scene_of(Shapes.of_meshes([mesh], [(0, 0, 0)]))
    places = size * np.array([(4, 0.1, 0.2), (0.1, 0.2, 3), (-2, 3, 4), (0.1, 0.2, 0.3)])
    goals = size * np.array([(0, 0.1, 0.2), (0.1, 0, 0), (0, 0, -0.1), (4, 4, 4)])
    rays, balls = scene.raycast_many(places, goals - places), scene.sweep_many(places, goals, size)
    gaps = [scene.nearest_many(places, signed=signed)[1][:, 0] / size for signed in (False, True)]
    singles = scene.raycast(places[0], goals[0]).t, scene.nearest((0, 0, 3 * size))[0].t / size
    return np.concatenate([rays.t, balls.t, *gaps, singles])


@pytest.mark.parametrize('power', DECADES)
def test_a_mesh_of_any_size_is_right_or_refused(power):
    size = 10.0**power
    for shape in (CUBE, turned(CUBE), icosphere(2)):
        if not 1e-100 < size < 1e100:
            with pytest.raises(ValueError, match=r'too small or too large|no area'):
                Mesh(shape * size)
            continue
        mesh, unit = Mesh(shape * size), Mesh(shape)
        assert mesh.normals == pytest.approx(unit.normals, abs=1e-9)
        corners = (m.vertices[m.corners] for m in (mesh, unit))
        assert next(corners) / size == pytest.approx(next(corners), abs=1e-12)
        found = answers_about(mesh, size)
        assert found == pytest.approx(answers_about(unit, 1.0), abs=1e-12)
