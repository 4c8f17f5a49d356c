# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which triangle of a mesh a ray meets, and where in it: against exact rational arithmetic."""

import pickle

import numpy as np
import pytest
from scene.meshes import (
    SOLIDS,
    SURFACES,
    TETRAHEDRON,
    grid_triangles,
    places,
    require_uv,
    with_gaps,
)
from scene.reference import icosphere, scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import NO_NODE, Mesh, Shapes

# ---- At edges and corners, and on both sides; `test_any_mesh` casts rays on an integer grid.


@pytest.mark.parametrize('decade', range(-6, 7, 2))
def test_a_ray_at_an_edge_or_corner_meets_the_lowest_row_of_all(decade):
    """Straight down on a terrain, at its corners and middles of edges, as its maker numbers it."""
    rng, unit, count = np.random.default_rng(decade + 9), 10.0**decade, 9
    x, y = np.meshgrid(np.arange(count) * unit, np.arange(count) * unit, indexing='ij')
    corners = np.stack((x, y, rng.uniform(0.0, 2.0, x.shape) * unit), axis=2).reshape(-1, 3)
    cell = np.arange(count * count).reshape(count, count)
    faces = rng.permutation(grid_triangles(cell[:, :, None])[:, :, 0])
    scene = scene_of(Shapes.of_meshes(Mesh(corners, faces), [0, 0, 0]))
    at = corners.copy()
    at[:, 2] = 7.3 * unit
    hits = scene.raycast_many(at, [0, 0, -1])
    lowest = [np.flatnonzero((faces == k).any(axis=1))[0] for k in range(len(corners))]
    assert hits.triangles.tolist() == lowest
    require_uv(hits, corners[faces], 1e-14 * 9 * unit)
    # Along x and along y a middle is on the edge: nothing is rounded.
    ends = np.stack((cell[:-1, :-1], cell[1:, :-1]), axis=2).reshape(-1, 2)
    at = 0.5 * corners[ends[:, 0]] + 0.5 * corners[ends[:, 1]]
    at[:, 2] = 7.3 * unit
    hits = scene.raycast_many(at, [0, 0, -1])
    lowest = [np.flatnonzero(np.isin(faces, pair).sum(axis=1) == 2)[0] for pair in ends]
    assert hits.triangles.tolist() == lowest


def test_triangles_wound_on_both_sides_are_hit_in_the_lower_row():
    """Exporters write a sheet twice: the corners in another order round another way."""
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1.0, 1.0, (1, 3, 3)) + np.array((0.0, 0.0, 3.0))
    both = np.concatenate((corners[:, [1, 0, 2]], corners))
    for triangles in (both, both[::-1]):
        mesh = Mesh(triangles, solid=False)
        scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]))
        shares = rng.dirichlet(np.ones(3), 300)
        hits = scene.raycast_many(np.zeros(3), shares @ corners[0] * 2.0, 1.0)
        assert (hits.triangles == 0).all()
        require_uv(hits, triangles, 1e-14)


# ---- Where in the triangle: any pose, all doors.

FORMS = {
    'ball': icosphere(2),
    'ring': with_gaps(SOLIDS['ring']) / 12.0,
    'strip': SURFACES['strip'] / 12.0,
}


def posed(name, unit, turn, place):
    """(scene of a mesh among boxes, its triangles in the world)."""
    triangles = FORMS[name] * unit
    world = turn.apply(triangles.reshape(-1, 3)).reshape(-1, 3, 3) + place
    mesh = Shapes.of_meshes(Mesh(triangles), place, turn.as_quat())
    scene = scene_of(mesh, names=['mesh'], source='us', stamp=0)
    boxes = Shapes.boxes(place + np.array([(3.0, 0, 0), (0, -3.0, 0)]) * unit, 0.5 * unit)
    scene.update('us', ['box', 'turned'], boxes, stamp=0)
    return scene, world


def aimed(count, unit, place, rng):
    starts = place + rng.normal(size=(count, 3)) * 3.0 * unit
    return starts, starts + (place + rng.normal(size=(count, 3)) * 0.6 * unit - starts) * 2.0


@pytest.mark.parametrize('name', FORMS)
@pytest.mark.parametrize('decade', [-6, -3, 0, 3, 6])
def test_u_and_v_lead_to_the_point_in_any_pose(name, decade):
    rng, unit = np.random.default_rng(decade + 50), 10.0**decade
    turn = Rotation.random(random_state=decade + 10)
    place = rng.uniform(-5.0, 5.0, 3) * unit
    scene, world = posed(name, unit, turn, place)
    starts, goals = aimed(500, unit, place, rng)
    hits = scene.sweep_many(starts, goals)
    met = require_uv(hits, world, 1e-13 * 20 * unit)
    assert met.sum() > 100
    of_mesh = hits.handles == scene.get('mesh').handle
    assert (of_mesh[met]).all()
    assert (hits.triangles[of_mesh & hits.normals.any(axis=1)] >= 0).all()
    # The triangle is one that brute force meets there.
    t, apart = distances_along(world, starts[met], goals[met])
    first = np.nanmin(t, axis=1)
    assert first == pytest.approx(hits.t[met], abs=1e-9)
    mine = t[np.arange(met.sum()), hits.triangles[met]]
    assert np.abs(mine - first)[apart].max() < 1e-9


def distances_along(triangles, starts, goals):
    """t (n, m) at which lines cross triangles, NaN where they do not; and which lines are far
    enough from all edges for doubles to tell.
    """
    a, b, c = (triangles[None, :, k] - starts[:, None] for k in range(3))
    way = (goals - starts)[:, None]
    sides = [(way * np.cross(p, q)).sum(axis=2) for p, q in ((b, c), (c, a), (a, b))]
    total = sum(sides)
    with np.errstate(divide='ignore', invalid='ignore'):
        shares = np.stack(sides) / total
        t = (a * np.cross(b, c)).sum(axis=2) / total
    within = (shares.min(axis=0) >= -1e-12) & (t >= -1e-12) & (t <= 1.0)
    clear = (np.abs(shares).min(axis=0) > 1e-9) | ~within
    return np.where(within, t, np.nan), clear.all(axis=1)


@pytest.mark.parametrize('name', FORMS)
def test_all_doors_say_the_same(name):
    rng = np.random.default_rng(8)
    turn, place = Rotation.random(random_state=5), np.array((1.0, -2.0, 0.5))
    scene, _ = posed(name, 1.0, turn, place)
    starts, goals = aimed(200, 1.0, place, rng)
    hits = scene.raycast_many(starts, goals - starts, 1.0)
    others = (
        scene.sweep_many(starts, goals),
        scene.sweep_many(starts, goals, threads=3),
        scene.raycast_many(starts, goals - starts, 1.0, radius=np.zeros(200)),
        scene.raycast_many(starts, goals - starts, 1.0, mask=np.ones(200, np.uint32)),
    )
    for other in others:
        np.testing.assert_array_equal(other.triangles, hits.triangles)
        np.testing.assert_array_equal(other.uv, hits.uv)
    for row in range(200):
        one = scene.raycast(starts[row], goals[row])
        if one is None:
            assert (hits.handles[row], hits.triangles[row]) == (NO_NODE, -1)
            continue
        assert one.triangle == hits.triangles[row]
        np.testing.assert_array_equal(one.uv, hits.uv[row])
        every = scene.raycast_all(starts[row], goals[row])
        assert (every[0].name, every[0].triangle) == (one.name, one.triangle)
        np.testing.assert_array_equal(every[0].uv, one.uv)
        assert all((hit.triangle >= 0) == (hit.name == 'mesh') for hit in every if hit.t > 0.0)


@pytest.mark.slow  # kernels of its own; for single rays see `test_mesh_distances`
@pytest.mark.parametrize('name', FORMS)
def test_one_that_moves_is_met_where_it_is_by_then(name):
    """Frozen at a time, and while it passes: one by one, all hits, few and many."""
    rng, velocity = np.random.default_rng(4), np.array((0.5, -0.25, 0.125))
    turn, place, second = Rotation.random(random_state=7), np.zeros(3), 10**9
    triangles = FORMS[name]
    shape = Shapes.of_meshes(Mesh(triangles), place, turn.as_quat())
    scene = scene_of(shape, names=['mesh'], source='us', stamp=0, velocities=[velocity])
    box = Shapes.boxes([(9.0, 9.0, 9.0)], 1.0)
    scene.update('us', ['box'], box, stamp=0, velocities=[velocity])
    local = turn.apply(triangles.reshape(-1, 3)).reshape(-1, 3, 3)
    for count in (40, 2000):
        starts, goals = aimed(count, 1.0, 2.0 * velocity, rng)
        for until in (None, 3 * second):
            hits = scene.sweep_many(starts, goals, at=2 * second, until=until)
            met = np.flatnonzero(hits.triangles >= 0)
            assert len(met) > 0.2 * count
            assert set(met) == set(np.flatnonzero(hits.normals.any(axis=1)))
            passed = 2.0 + (0.0 if until is None else hits.t[met])
            back = hits.points[met] - np.outer(passed, velocity)
            apart = places(local, hits.triangles[met], hits.uv[met]) - back
            assert np.abs(apart).max() < 1e-13
            for row in range(20):
                one = scene.raycast(starts[row], goals[row], at=2 * second, until=until)
                every = scene.raycast_all(starts[row], goals[row], at=2 * second, until=until)
                assert (one is None) == (every == [])
                for hit in every:
                    assert hit.triangle == one.triangle == hits.triangles[row]
                    np.testing.assert_array_equal(hit.uv, hits.uv[row])


def test_many_meshes_each_have_rows_of_their_own():
    """Equal triangles that were given in other rows are told apart, also when others are gone."""
    triangles = SOLIDS['ring']
    meshes = [Mesh(triangles), Mesh(with_gaps(triangles)), Mesh(icosphere(1)), Mesh(TETRAHEDRON)]
    at = np.array([(40.0 * k, 0.0, 0.0) for k in range(len(meshes))])
    scene = scene_of(Shapes.of_meshes(meshes, at), names=list('abcd'), source='us', stamp=0)
    assert scene.stats()['meshes'] == 4
    starts, goals = at + np.array((0.0, 0.0, 30.0)), at + np.array((0.1, 0.2, -30.0))
    starts[:2, 0] += 12.3
    goals[:2, 0] += 12.3
    hits = scene.sweep_many(starts, goals)
    assert (hits.triangles >= 0).all()
    given = [triangles, with_gaps(triangles), icosphere(1), TETRAHEDRON]
    for row, corners in enumerate(given):
        one = hits.triangles[[row]], hits.uv[[row]]
        assert places(corners + at[row], *one)[0] == pytest.approx(hits.points[row], abs=1e-12)
    shift = hits.triangles[1] - hits.triangles[0]
    assert shift in (2, 4)
    scene.remove('us', ['a', 'c'])
    assert scene.sweep_many(starts, goals).triangles.tolist() == [
        -1, hits.triangles[1], -1, hits.triangles[3]
    ]  # fmt: skip


# ---- A hit is a value; what has no triangle says so.


def test_a_hit_stays_as_it_was_when_the_scene_changes():
    scene, world = posed('ring', 1.0, Rotation.identity(), np.zeros(3))
    starts, goals = aimed(200, 1.0, np.zeros(3), np.random.default_rng(2))
    rows, again = (scene.sweep_many(starts, goals) for _ in range(2))
    row = int(np.flatnonzero(rows.triangles >= 0)[0])
    hit = scene.raycast(starts[row], goals[row])
    before = again.triangles.copy(), again.uv.copy()
    other = Shapes.of_meshes(Mesh(SURFACES['strip'] / 9.0), [0, 0, 0])
    scene.update('us', ['mesh'], other, stamp=1)
    scene.update('us', [f'more {k}' for k in range(50)], other.take([0] * 50), stamp=1)
    scene.clear()
    np.testing.assert_array_equal(rows.triangles, before[0])
    np.testing.assert_array_equal(rows.uv, before[1])
    assert (hit.triangle, hit.uv.tolist()) == (before[0][row], before[1][row].tolist())
    assert places(world, [hit.triangle], hit.uv[None])[0] == pytest.approx(hit.point, abs=1e-13)


def test_a_hit_keeps_its_triangle_when_it_is_copied():
    scene, _ = posed('ball', 1.0, Rotation.identity(), np.zeros(3))
    rows = scene.sweep_many([[0.1, 0.2, 9.0]] * 2, [[0.1, 0.2, -9.0]] * 2)
    hit = scene.raycast((0.1, 0.2, 9.0), (0.1, 0.2, -9.0))
    assert len(hit) == 6
    assert len(rows) == 4
    name, handle, *_ = hit
    assert (name, handle) == (hit.name, hit.handle)
    for copied in (pickle.loads(pickle.dumps(hit)), hit._replace(stamp=9)):
        assert (copied.triangle, copied.uv.tolist()) == (hit.triangle, hit.uv.tolist())
    for copied in (pickle.loads(pickle.dumps(rows)), rows._replace(t=rows.t)):
        np.testing.assert_array_equal(copied.triangles, rows.triangles)
        np.testing.assert_array_equal(copied.uv, rows.uv)
    assert f'triangle={hit.triangle}, uv=[' in repr(hit)


def test_what_has_no_triangle_says_so():
    """Other shapes, balls, starts in a solid, overlaps and nearest obstacles."""
    scene, _ = posed('ring', 1.0, Rotation.identity(), np.zeros(3))
    down = np.array((1.0, 0.0, 5.0)), np.array((1.0, 0.0, -5.0))
    assert scene.raycast(*down).triangle >= 0
    none = [
        scene.raycast((3.0, 0.0, 5.0), (3.0, 0.0, -5.0)),
        scene.raycast(*down, radius=0.1),
        scene.raycast_all(*down, radius=0.1)[0],
        scene.raycast((1.0, 0.0, 0.0), down[1]),
        scene.overlap((0.9, -0.1, -0.1), (1.1, 0.1, 0.1))[0],
        scene.nearest((1.0, 0.0, 5.0))[0],
    ]
    for hit in none:
        assert hit.triangle == -1
        assert hit.uv.shape == (2,)
        assert np.isnan(hit.uv).all()
        assert 'triangle' not in repr(hit)
    rows = scene.sweep_many(down[0], [down[1]] * 2, radius=[0.0, 0.1])
    assert rows.triangles[0] >= 0
    assert rows.triangles[1] == -1
    assert np.isnan(rows.uv[1]).all()


def test_a_scene_without_meshes_and_a_planar_one_have_none():
    for planar in (False, True):
        scene = scene_of(Shapes.boxes([(0, 0, 0)], 1.0), planar)
        for _ in range(2):
            hits = scene.sweep_many([[-5, 0, 0], [-5, 3, 0]], [[5, 0, 0], [5, 3, 0]])
            assert hits.t[0] < 1.0
            assert hits.triangles.tolist() == [-1, -1]
            assert hits.uv.shape == (2, 2)
            assert np.isnan(hits.uv).all()
            assert scene.raycast([-5, 0, 0], [5, 0, 0]).triangle == -1
            ball = Shapes.spheres([(9.0, 9.0, 9.0)], 1.0)
            scene.update('us', ['ball'], ball, stamp=0)
    mesh = Shapes.of_meshes(Mesh(icosphere(1)), [0, 7, 0])
    assert scene.update('us', ['mesh'], mesh, stamp=0) == []
    hit, rows = scene.raycast([-5, 7, 0], [5, 7, 0]), scene.sweep_many([-5, 7, 0], [[5, 7, 0]])
    assert (hit.name, hit.triangle, rows.triangles.tolist()) == ('mesh', -1, [-1])
