# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes in planar scenes: convex polygons, against boxes, sampling and exact arithmetic."""

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene.reference import (
    box_of_triangles,
    bulging,
    first_contact,
    icosphere,
    scene_of,
    widest_gap,
)
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Scene, Shapes
from bvh_ros.scene.shapes.mesh import convex_polygon


class Outline(NamedTuple):
    """A mesh seen from above, by its vertices alone."""

    position: np.ndarray
    vertices: np.ndarray

    def distances_from_above(self, points):
        return widest_gap(points[:, :2] - self.position[:2], self.support)

    def support(self, normals):
        return (normals @ self.vertices[:, :2].T).max(axis=-1)


def world(rng, count):
    """Meshes about the origin, some upright: rows, and what is seen of them."""
    meshes = [Mesh(bulging(rng, int(rng.integers(5, 30)))) for _ in range(count)]
    turns, places = rng.normal(size=(count, 4)), rng.uniform(-3, 3, (count, 3))
    turns[: count // 2, :2] = 0.0
    turns[0] = 0.0
    unit = Rotation.from_quat(np.where(turns.any(axis=1)[:, None], turns, (0, 0, 0, 1)))
    seen = [
        Outline(place + turn.apply(mesh.centre), turn.apply(mesh.vertices))
        for place, turn, mesh in zip(places, unit, meshes, strict=True)
    ]
    return Shapes.of_meshes(meshes, places, turns), seen


def test_boxes_given_as_triangles_answer_as_boxes():
    rng = np.random.default_rng(2)
    count = 30
    sizes, places = rng.uniform(0.2, 2, (count, 3)), rng.uniform(-4, 4, (count, 3))
    turns = rng.normal(size=(count, 4))
    turns[:10, :2] = 0.0
    turns[:5] = 0.0
    plain = scene_of(Shapes.boxes(places, sizes, turns), planar=True)
    meshes = [Mesh(box_of_triangles(size)) for size in sizes]
    meshed = scene_of(Shapes.of_meshes(meshes, places, turns), planar=True)
    assert sorted(plain.overlap_pairs()) == sorted(meshed.overlap_pairs()) != []
    hits = 0

    def same(one, other):
        assert [hit.name for hit in one] == [hit.name for hit in other]
        for hit, twin in zip(one, other, strict=True):
            assert twin.t == pytest.approx(hit.t, abs=1e-9)
            assert twin.point == pytest.approx(hit.point, abs=1e-6)
            assert twin.normal == pytest.approx(hit.normal, abs=1e-6)

    for _ in range(100):
        start, goal = rng.uniform(-6, 6, (2, 3))
        for radius in (0.0, 0.4):
            one = plain.raycast_all(start, goal, radius)
            same(one, meshed.raycast_all(start, goal, radius))
            first = plain.raycast(start, goal, radius), meshed.raycast(start, goal, radius)
            assert [hit and hit.name for hit in first] == [one[0].name if one else None] * 2
            hits += len(one)
        for tolerance in (0.0, 0.5):
            query = (start, start + goal / 3, (0, 0, *rng.normal(size=2)), tolerance)
            same(plain.overlap(*query), meshed.overlap(*query))
        same(plain.nearest(start, 3), meshed.nearest(start, 3))
    assert hits > 200
    for name in map(str, range(count)):
        one, other = plain.clearance(name), meshed.clearance(name)
        assert other.distance == pytest.approx(one.distance, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize('radius', [0.0, 0.3])
def test_rays_and_discs_as_sampling_finds(radius):
    rng = np.random.default_rng([5, int(radius > 0)])
    shapes, seen = world(rng, 8)
    scene = scene_of(shapes, planar=True)
    met = 0
    for _ in range(20):
        start, goal = rng.uniform(-4, 4, (2, 3))
        hits = {int(hit.name): hit for hit in scene.raycast_all(start, goal, radius)}
        for row, outline in enumerate(seen):
            t, _ = first_contact(outline, start, goal, radius, planar=True)
            if math.isinf(t) != math.isinf(
                first_contact(outline, start, goal, radius + 1e-6, planar=True)[0]
            ):
                continue  # it grazes
            assert (row in hits) == (t < math.inf)
            if row in hits:
                met += 1
                hit = hits[row]
                assert hit.t == pytest.approx(t, abs=1e-6)
                assert hit.point[2] == start[2]
                assert outline.distances_from_above(hit.point[None])[0] < 1e-9
                if t > 0.0:
                    assert hit.normal @ (goal - start) < 0.0
                    centre = start + hit.t * (goal - start)
                    to_centre = (hit.point + radius * hit.normal - centre)[:2]
                    assert np.abs(to_centre).max() < 1e-6
    assert met > 10


def test_overlaps_and_nearest_as_sampling_finds():
    rng = np.random.default_rng(6)
    shapes, seen = world(rng, 25)
    scene = scene_of(shapes, planar=True)
    touched = 0
    for _ in range(40):
        centre = rng.uniform(-4, 4, 3)
        distances = np.array([o.distances_from_above(centre[None])[0] for o in seen])
        found = scene.nearest(centre, 25)
        assert [hit.t for hit in found] == pytest.approx(np.sort(distances), abs=1e-7)
        for hit in found:
            assert seen[int(hit.name)].distances_from_above(hit.point[None])[0] < 1e-9
        near = {hit.name for hit in scene.overlap(centre, centre, (0, 0, 0, 0), 0.7)}
        assert near == {str(row) for row in np.flatnonzero(distances <= 0.7)}
        touched += len(near)
    assert touched > 50


def test_a_mesh_asks_as_it_answers():
    """overlap_shape, pairs and clearance look at the same polygons."""
    rng = np.random.default_rng(7)
    shapes, _ = world(rng, 25)
    scene = scene_of(shapes, planar=True)
    pairs = set(scene.overlap_pairs())
    for row in range(25):
        found = {hit.name for hit in scene.overlap_shape(shapes.take([row]))} - {str(row)}
        assert found == {
            one if other == str(row) else other for one, other in pairs if str(row) in (one, other)
        }
        assert (scene.clearance(str(row)).distance == 0.0) == bool(found)
    assert 5 < len(pairs) < 250


def test_a_polygon_is_shared_and_kept_while_its_mesh_only_moves():
    ball = icosphere(3)
    tilted = np.array([(0.3, 0.1, 0.2, 1.0)] * 3)
    meshes = [Mesh(ball), Mesh(ball), Mesh(ball * 2)]
    scene = scene_of(Shapes.of_meshes(meshes, np.eye(3) * 9, tilted), planar=True)
    store = scene._held.columns.meshes
    assert len(store) == 2
    before, hulls = store[0], store.hulls
    moved = Shapes.of_meshes([Mesh(ball)], [(5, 2, 3)], tilted[:1])
    assert scene.update('test', ['0'], moved, stamp=2) == []
    assert store[0] is before
    assert store.hulls is hulls
    assert scene.raycast((5, -9, 0), (5, 9, 0)).t == pytest.approx(10 / 18, abs=1e-3)
    turned = moved._replace(orientation=np.array([(0.0, 0.0, 0.5, 1.0)]))
    assert scene.update('test', ['0'], turned, stamp=3) == []
    assert len(store) == 3
    assert scene.stats()['meshes'] == 3
    scene.clear()
    assert scene.stats()['meshes'] == 0
    scene.update('test', ['box'], Shapes.boxes([(1, 2, 3)], (1, 1, 1), [(0, 0, 0.2, 1)]), stamp=4)
    assert scene.raycast((1, -9, 0), (1, 9, 0)).name == 'box'


def test_a_scene_without_meshes_has_no_polygons():
    scene = scene_of(Shapes.boxes(np.eye(3), (1, 1, 1), np.ones((3, 4))), planar=True)
    assert scene._held.columns.hulls is None
    assert Scene(planar=True)._held.columns.meshes.nbytes == 0


coordinates = st.integers(-8, 8)


@settings(max_examples=200)
@given(st.lists(st.tuples(coordinates, coordinates), min_size=3, max_size=40))
def test_polygons_are_hulls_exactly(points):
    """Whole numbers: many in a line, many twice."""
    places = np.array(points, float)
    if np.linalg.matrix_rank(places - places[0]) < 2:
        return
    polygon = convex_polygon(places)
    expected = places[ConvexHull(places).vertices]
    assert {tuple(p) for p in polygon.tolist()} == {tuple(p) for p in expected.tolist()}
    assert len(polygon) == len(expected)
    one, two, three = (np.roll(polygon, -k, axis=0) for k in range(3))
    (x, y), (u, v) = (two - one).T, (three - two).T
    assert (x * v > y * u).all()


@settings(max_examples=60)
@given(st.lists(st.tuples(*[coordinates] * 4), min_size=1, max_size=8), st.randoms())
def test_thin_rays_are_clipped_exactly(rays, random):
    """An octahedron on its tip is a square on its corner."""
    corners = np.array([(4, 0, 0), (0, 4, 0), (-4, 0, 0), (0, -4, 0), (0, 0, 4), (0, 0, -4)])
    mesh = Mesh(corners[ConvexHull(corners).simplices])
    scene = scene_of(Shapes.of_meshes([mesh], [(0, 0, 0)]), planar=True)
    for x, y, to_x, to_y in rays:
        entry, leave = Fraction(0), Fraction(1)
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            height, slope = 4 - a * x - b * y, a * (to_x - x) + b * (to_y - y)
            if slope > 0:
                leave = min(leave, Fraction(height, slope))
            elif slope < 0:
                entry = max(entry, Fraction(height, slope))
            elif height < 0:
                leave = Fraction(-1)
        if entry == leave:  # touched in one point: the direction's rounding decides
            continue
        hit = scene.raycast((x, y, 0), (to_x, to_y, random.random()))
        assert (hit is not None) == (entry < leave)
        if hit is not None:
            assert hit.t == pytest.approx(float(entry), rel=1e-15)
            assert abs(hit.point[:2]).sum() == pytest.approx(4, rel=1e-15) or hit.t == 0.0
