# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The nearest and the first triangles of large meshes, which float32 sorts out, are those of small
meshes, where float64 looks at every triangle.
"""

import numpy as np
import pytest
from scene.meshes import cut_cube, grid_triangles
from scene.reference import icosphere, random_turns, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Shapes

PART = 16  # triangles: so few have no snapshot
EYE = (0.0, 0.0, 0.0, 1.0)


def needles(rng):
    """Long and narrow: with a normal that float32 sees, or not."""
    start, along, across = rng.normal(size=(3, 240, 3))
    width = 10.0 ** rng.uniform(-9, 0, (240, 1))
    end = start + along
    return np.stack([start, end, start + rng.random((240, 1)) * along + width * across], axis=1)


def decades(rng):
    """Small and large ones."""
    size = 10.0 ** rng.uniform(-6, 0, (240, 1, 1))
    return rng.normal(size=(240, 1, 3)) + size * rng.normal(size=(240, 3, 3))


def layers(rng):
    """So close to each other that float32 does not tell which one is nearer."""
    corners = rng.uniform(-1, 1, (240, 3, 3))
    corners[:, :, 2] = 10.0 ** rng.uniform(-12, -6, (240, 1))
    turned = Rotation.random(random_state=1).apply(corners.reshape(-1, 3))
    return turned.reshape(-1, 3, 3)


FAMILIES = {
    'needles': needles,
    'decades': decades,
    'layers': layers,
    'sphere': lambda rng: icosphere(2),
    'far from its origin': lambda rng: 1000.0 + needles(rng),
}


def sheet(rng):
    """Open, of fields that are longer than wide."""
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 41), indexing='ij')
    return grid_triangles(np.stack([x, y, 0.2 * np.sin(3 * x) * np.cos(4 * y)], axis=2))


def waves(rng):
    """A ring with waves."""
    u, v = np.meshgrid(np.arange(33) % 32 / 32, np.arange(21) % 20 / 20, indexing='ij')
    u, v = 2 * np.pi * u, 2 * np.pi * v
    thick = 0.4 + 0.06 * np.sin(7 * u) * np.cos(3 * v)
    wide = 1.0 + thick * np.cos(v)
    return grid_triangles(
        np.stack([wide * np.cos(u), wide * np.sin(u), thick * np.sin(v)], axis=2)
    )


def soup(rng):
    """Of all sizes, through each other."""
    return rng.normal(size=(1000, 1, 3)) + rng.random((1000, 1, 1)) * rng.normal(size=(1000, 3, 3))


LARGE = {
    'ring': waves,
    'sheet': sheet,
    'box': lambda rng: 2.0 * cut_cube(8),  # many triangles in one plane, and at one distance
    'soup': soup,
    'sphere': FAMILIES['sphere'],
}


def points_around(triangles, rng):
    """At corners and on triangles, hardly beside them, beside them, and far away."""
    shares = rng.dirichlet((1, 1, 1), 40)
    rows = rng.integers(0, len(triangles), 40)
    on = (shares[:, :, None] * triangles[rows]).sum(axis=1)
    hardly = on + rng.normal(size=on.shape) * 10.0 ** rng.uniform(-12, -3, (40, 1))
    beside = on + rng.normal(size=on.shape)
    far = on + rng.normal(size=on.shape) * 10.0 ** rng.uniform(1, 5, (40, 1))
    return np.concatenate([triangles[rows[:20], 0], on, hardly, beside, far])


def scenes_of(triangles):
    """A scene with a mesh of triangles, and scenes with their parts."""
    one = np.zeros((1, 3))
    parts = [triangles[i : i + PART] for i in range(0, len(triangles), PART)]
    whole, *apart = (
        scene_of(Shapes.of_meshes(Mesh(part, solid=False), one)) for part in (triangles, *parts)
    )
    return whole, apart


@pytest.mark.parametrize('decade', [-6, 0, 6])
@pytest.mark.parametrize('name', FAMILIES)
def test_no_nearer_triangle_is_left_out(name, decade):
    rng = np.random.default_rng(3)
    triangles = FAMILIES[name](rng)
    points = points_around(triangles, rng) * 10.0**decade
    triangles = triangles * 10.0**decade
    whole, apart = scenes_of(triangles)
    size = rng.random((len(points), 3)) * 10.0**decade * 0.3
    turn = random_turns(rng, len(points))
    turn[::2] = EYE
    rows = np.arange(0, len(points), 4)
    bodies = [
        Shapes.spheres(points, 1e-3 * 10.0**decade),
        Shapes.boxes(points, size, turn),
        Shapes.of_meshes(
            Mesh(icosphere(1) * 0.1 * 10.0**decade, solid=False), points[rows], turn[rows]
        ),
    ]
    rounded = 1e-14 * (np.abs(points).max(axis=1) + np.abs(triangles).max())
    _, found, _ = whole.nearest_many(points)
    assert_least(found[:, 0], [scene.nearest_many(points)[1][:, 0] for scene in apart], rounded)
    for body in bodies:
        _, found, _, _ = whole.clearance_many(body)
        each = [scene.clearance_many(body)[1] for scene in apart]
        assert_least(found, each, rounded if len(found) == len(rounded) else rounded[::4])


@pytest.mark.parametrize('decade', [-6, 0, 6])
@pytest.mark.parametrize('name', LARGE)
def test_no_patch_of_nearer_triangles_is_left_out(name, decade):
    rng = np.random.default_rng(6)
    triangles = LARGE[name](rng)
    within = rng.uniform(triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1)), (100, 3))
    points = np.concatenate([points_around(triangles, rng), within, [[0.0, 0.0, 0.0]]])
    points, triangles = points * 10.0**decade, triangles * 10.0**decade
    whole, apart = scenes_of(triangles)
    _, found, _ = whole.nearest_many(points)
    each = [scene.nearest_many(points)[1][:, 0] for scene in apart]
    assert found[:, 0].tolist() == np.min(each, axis=0).tolist()


@pytest.mark.parametrize('name', LARGE)
def test_a_patch_holds_its_triangles(name):
    triangles = LARGE[name](np.random.default_rng(7)) + 0.1
    mesh = Mesh(triangles, solid=False)
    wide, held = mesh.wide, 0
    lanes = wide.triangles.reshape(-1, 9, wide.children.shape[1]).transpose(0, 2, 1)
    places = (mesh.vertices - wide.center) * wide.per_length
    below = {}  # the triangles below each node; deeper nodes come later
    for node in range(len(wide.children) - 1, -1, -1):
        below[node] = []
        for lane, child in enumerate(wide.children[node]):
            if child < 0:
                is_there = np.isfinite(wide.planes[node, lane])
                below[node] += [~child] if is_there else []
                continue
            below[node] += below[child]
            center, axis, (half, radius) = np.split(lanes[node, lane, :8].astype(float), [3, 6])
            steps = places[mesh.corners[below[child]]].reshape(-1, 3) - center
            heights = steps @ axis
            beside = np.linalg.norm(steps - heights[:, None] * axis, axis=1)
            assert np.linalg.norm(axis) == pytest.approx(1.0, abs=2.0**-22)
            assert np.abs(heights).max() == pytest.approx(half, abs=2.0**-21)
            assert beside.max() == pytest.approx(radius, abs=2.0**-21)
            held += 1
    assert len(below[0]) == len(mesh.corners)
    assert held == len(wide.children) - 1


def assert_least(found, each, rounded):
    wanted = np.min(each, axis=0)
    assert (np.abs(found - wanted) <= 1e-9 * wanted + rounded).all()
    assert (found > 0.0).any()


@pytest.mark.parametrize('decade', [-6, 0, 6])
@pytest.mark.parametrize('name', FAMILIES)
def test_no_crossed_triangle_is_left_out(name, decade):
    rng = np.random.default_rng(4)
    triangles = FAMILIES[name](rng)
    goals = np.concatenate([points_around(triangles, rng)[:100], triangles[::8].mean(axis=1)])
    away = rng.normal(size=goals.shape) * 10.0 ** rng.uniform(-6, 2, (len(goals), 1))
    away[::3] = np.roll(triangles[:, 0], 1, axis=0)[: len(away[::3])] - goals[::3]
    origins, directions = (goals - away) * 10.0**decade, away * 10.0**decade
    # Between triangles, so that lines cross some behind their origins.
    corners = rng.choice(triangles.reshape(-1, 3), (2, 400)) * 10.0**decade
    origins = np.concatenate([origins, corners.mean(axis=0)])
    directions = np.concatenate([directions, rng.normal(size=(400, 3)) * 10.0**decade])
    whole, apart = scenes_of(triangles * 10.0**decade)
    wanted = np.min([scene.raycast_many(origins, directions).t for scene in apart], axis=0)
    some = slice(0, 40)  # so few go one by one
    for found, rows in (
        (whole.raycast_many(origins, directions).t, slice(None)),
        (whole.raycast_many(origins[some], directions[some]).t, some),
    ):
        assert (np.isinf(found) == np.isinf(wanted[rows])).all()
        hit = np.isfinite(found)
        assert hit.any()
        assert found[hit] == pytest.approx(wanted[rows][hit], rel=1e-9, abs=1e-300)


@pytest.mark.parametrize('decade', [-6, 0, 6])
@pytest.mark.parametrize('name', FAMILIES)
def test_no_touched_triangle_is_left_out(name, decade):
    """Balls that hit triangles, graze them, begin at them and go away from them."""
    rng = np.random.default_rng(5)
    triangles = FAMILIES[name](rng)
    goals = points_around(triangles, rng)[:100]
    aside = rng.normal(size=goals.shape)
    radius = 10.0 ** rng.uniform(-4, 0, len(goals))
    share = rng.choice([0.0, 0.9, 0.999999, 1.000001, 30.0], (len(goals), 1))
    goals = goals + share * radius[:, None] * aside / np.linalg.norm(aside, axis=1, keepdims=True)
    away = rng.normal(size=goals.shape) * 10.0 ** rng.uniform(-3, 1.5, (len(goals), 1))
    starts, goals = (goals - away) * 10.0**decade, (goals + away) * 10.0**decade
    radius = radius * 10.0**decade
    whole, apart = scenes_of(triangles * 10.0**decade)
    found = whole.sweep_many(starts, goals, radius).t
    wanted = np.min([scene.sweep_many(starts, goals, radius).t for scene in apart], axis=0)
    # Rounding decides whether a ball that grazes hits.
    size = np.abs(triangles).max() * 10.0**decade + np.abs(starts).max(axis=1)
    less = np.min([s.sweep_many(starts, goals, radius - 1e-12 * size).t for s in apart], axis=0)
    more = np.min([s.sweep_many(starts, goals, radius + 1e-12 * size).t for s in apart], axis=0)
    assert (more * (1.0 - 1e-9) <= found).all()
    assert (found <= less * (1.0 + 1e-9)).all()
    assert (np.isinf(found) == np.isinf(wanted)).mean() > 0.95
    assert (np.isfinite(found) & (found > 0.0)).any()
    assert np.isinf(found).any()
    assert found[:10].tolist() == [
        whole.raycast(start, goal, reach).t if np.isfinite(t) else np.inf
        for start, goal, reach, t in zip(starts, goals, radius, found[:10].tolist(), strict=False)
    ]
