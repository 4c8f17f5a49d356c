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
from scene.reference import bulging, first_contact, icosphere, scene_of, widest_gap
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Shapes


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


coordinates = st.integers(-8, 8)


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
