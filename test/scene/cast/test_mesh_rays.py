# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Thin rays against convex meshes: exact clipping, edges and corners, from inside, along faces."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene.reference import box_of_triangles, hull_of, icosphere, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Shapes


def exact_planes(mesh):
    """(normal, offset) of each triangle, outwards, in rationals: inside normal . p <= offset."""
    corners = [[Fraction(float(x)) for x in place] for place in mesh.vertices]
    middle = [sum(x) / len(corners) for x in zip(*corners, strict=True)]
    planes = []
    for triangle in mesh.corners.tolist():
        one, two, three = (corners[i] for i in triangle)
        a, b = ([x - y for x, y in zip(other, one, strict=True)] for other in (two, three))
        normal = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        offset = dot(normal, one)
        if dot(normal, middle) > offset:
            normal, offset = [-x for x in normal], -offset
        planes.append((normal, offset))
    return planes


def dot(one, other):
    return sum(x * y for x, y in zip(one, other, strict=True))


def exact_interval(planes, origin, way):
    """The t from 0 to 1 at which origin + t * way is within all planes; entry > leave if none."""
    origin, way = ([Fraction(float(x)) for x in vector] for vector in (origin, way))
    entry, leave = Fraction(0), Fraction(1)
    for normal, offset in planes:
        height, slope = offset - dot(normal, origin), dot(normal, way)
        if slope > 0:
            leave = min(leave, height / slope)
        elif slope < 0:
            entry = max(entry, height / slope)
        elif height < 0:
            return Fraction(1), Fraction(0)
    return entry, leave


def check_rays(mesh, starts, goals):
    """Compare with exact clipping: place and decision, but for what rounding may move."""
    scene = scene_of(Shapes.of_meshes([mesh], [-mesh.centre]))
    planes = exact_planes(mesh)
    extent = float(mesh.size.max())
    met = 0
    for start, goal in zip(starts, goals, strict=True):
        way = goal - start
        entry, leave = exact_interval(planes, start, way)
        hit = scene.raycast(start, goal)
        length = max(np.linalg.norm(way), 1e-300)
        rounding = 1e-13 * (extent + np.linalg.norm(start))
        if hit is None:
            assert float(leave - entry) * length <= rounding * 1e3
            continue
        met += 1
        where = start + hit.t * way
        beyond = max(
            float(dot(n, [Fraction(float(x)) for x in where]) - d)
            / max(float(dot(n, n)) ** 0.5, 1e-300)
            for n, d in planes
        )
        assert abs(beyond) <= rounding or (hit.t == 0.0 and beyond < rounding)
        if entry <= leave:
            assert (hit.t == 0.0) == (entry == 0) or float(entry) * length < rounding
            assert (hit.t > 0.0) == hit.normal.any()
    return met


@pytest.mark.parametrize('count', [4, 8, 20, 60])
def test_rays_are_clipped_as_exact_arithmetic_says(count):
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3))
    points *= rng.uniform(0.2, 1, 3) / np.linalg.norm(points, axis=1)[:, None]
    mesh = Mesh(hull_of(points - points.mean(axis=0)))
    starts = rng.normal(size=(60, 3))
    met = check_rays(mesh, starts, 2 * rng.normal(size=(60, 3)) * 0.2 - starts)
    assert met > 15


def aimed_at(mesh, rng, count):
    """Points on edges and corners of a mesh, shape (n, 3)."""
    places = mesh.vertices
    sides = np.sort(mesh.corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges = rng.permutation(np.unique(sides, axis=0))[:count]
    share = rng.choice([0.25, 0.5, rng.random()], (len(edges), 1))
    on_edges = places[edges[:, 0]] * share + places[edges[:, 1]] * (1 - share)
    return np.concatenate([places[rng.permutation(len(places))[:count]], on_edges])


@pytest.mark.parametrize('splits', [0, 2, 4])
def test_no_ray_slips_through_an_edge_or_a_corner(splits):
    """Straight at them, from outside and far away, and from behind through the middle."""
    rng = np.random.default_rng(splits)
    mesh = Mesh(icosphere(splits) @ np.diag((1.0, 0.7, 0.4)))
    place, turn = np.array((3.0, -2.0, 1.0)), rng.normal(size=4)
    turn /= np.linalg.norm(turn)
    rotation = Rotation.from_quat(turn)
    scene = scene_of(Shapes.of_meshes([mesh], [place], [turn]))
    targets = rotation.apply(aimed_at(mesh, rng, 200) * (1 - 1e-12) + mesh.centre) + place
    middle = rotation.apply(mesh.centre) + place
    outwards = targets - middle
    for distance in (0.5, 1e3, 1e6):
        starts = middle + outwards * (1 + distance)
        _, t, points, normals = scene.raycast_many(starts, middle - starts)
        assert np.isfinite(t).all()
        assert np.abs(points - targets).max() < 1e-9 * (1 + 1e-3 * distance)
        assert (np.einsum('ni,ni->n', normals, outwards) > 0).all()
    _, t, _, normals = scene.raycast_many(np.tile(middle, (len(targets), 1)), outwards * 9)
    assert (t == 0.0).all()
    assert not normals.any()


def test_rays_along_the_faces_of_a_cube_touch_it():
    scene = scene_of(Shapes.of_meshes([Mesh(box_of_triangles((2, 2, 2)))], [(0, 0, 0)]))
    for axis, (start, goal), y, z in itertools.product(
        range(3), [(-4.0, 4.0), (4.0, -4.0)], (-1.0, -0.5, 0.0, 1.0), (-1.0, 1.0)
    ):
        one, other = np.empty((2, 3))
        one[[axis, (axis + 1) % 3, (axis + 2) % 3]] = start, y, z
        other[:] = one
        other[axis] = goal
        hit = scene.raycast(one, other)
        assert hit.t == 0.375
        assert scene.raycast(one * 1.001, other * 1.001) is None


@pytest.mark.parametrize(
    ('start', 'goal', 't'),
    [
        ((-1, 0, 0), (-2, 0, 0), 0.0),  # begins on a face
        ((-3, 0, 0), (-1, 0, 0), 1.0),  # ends on it
        ((-3, 0, 0), (-1.001, 0, 0), None),
        ((1.001, 0, 0), (3, 0, 0), None),  # flies away
        ((1, 1, 1), (1, 1, 1), 0.0),  # a corner, as a point
        ((1, 1, 1.001), (1, 1, 1.001), None),
        ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5), 0.0),
        ((0, 0, 0), (9, 9, 9), 0.0),
        ((2, 2, 2), (-2, -2, -2), 0.25),  # into a corner
    ],
)
def test_ends_of_rays(start, goal, t):
    scene = scene_of(Shapes.of_meshes([Mesh(box_of_triangles((2, 2, 2)))], [(0, 0, 0)]))
    hit = scene.raycast(start, goal)
    assert hit is None if t is None else hit.t == t


coordinates = st.integers(-8, 8)


@settings(max_examples=60)
@given(st.lists(st.tuples(*[coordinates] * 4), min_size=1, max_size=8), st.randoms())
def test_rays_in_a_plane_are_clipped_as_exact_arithmetic_says(rays, random):
    """An octahedron on its tip is a square on its corner."""
    corners = np.array([(4, 0, 0), (0, 4, 0), (-4, 0, 0), (0, -4, 0), (0, 0, 4), (0, 0, -4)])
    scene = scene_of(Shapes.of_meshes([Mesh(hull_of(corners))], [(0, 0, 0)]), planar=True)
    planes = [(normal, 4) for normal in itertools.product((1, -1), repeat=2)]
    for x, y, to_x, to_y in rays:
        entry, leave = exact_interval(planes, (x, y), (to_x - x, to_y - y))
        if entry == leave:  # touched in one point: the direction's rounding decides
            continue
        hit = scene.raycast((x, y, 0), (to_x, to_y, random.random()))
        assert (hit is not None) == (entry < leave)
        if hit is not None:
            assert hit.t == pytest.approx(float(entry), rel=1e-15)
            assert abs(hit.point[:2]).sum() == pytest.approx(4, rel=1e-15) or hit.t == 0.0
