# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which triangle of a mesh a ray meets, and where in it: against exact rational arithmetic."""

import pickle
from fractions import Fraction

import numpy as np
import pytest
from scene.reference import icosphere, scene_of
from scene.shapes.test_any_mesh import SOLIDS, SURFACES, determinants, holds, segments
from scipy.spatial.transform import Rotation

from bvh_ros.scene import NO_NODE, Mesh, Scene, Shapes

NO_AREA = np.array([[(0, 0, 0), (1, 1, 1), (3, 3, 3)]])


def with_gaps(triangles):
    """Triangles among others without area, so that rows as given are not those of the mesh.

    An even number of them: so what was closed is still.
    """
    half = len(triangles) // 2
    return np.insert(triangles, [0, 0, half, half], NO_AREA, axis=0)


# ---- What exact arithmetic says.


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


def first_triangles(triangles, starts, ways):
    """For each segment, a list of the row that it meets first: the lowest of several, or [-1].

    All of them where it runs in the planes of them all: there rounding chooses.
    """
    u, v, w, height = determinants(triangles, starts, ways)
    total, sides = u + v + w, np.stack((u, v, w))
    meets = ~((sides.min(axis=0) < 0) & (sides.max(axis=0) > 0))
    found = []
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
        within = [face for face in tied if face < 0 or total[row, face] == 0]
        found.append(tied if tied == within else tied[:1])
    return found


def on_surface(triangles, points):
    """Whether integer points (n, 3) lie on triangles, exactly."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    *_, height = determinants(triangles, points, np.ones_like(points))
    found = np.zeros(len(points), bool)
    for row, face in zip(*np.nonzero(height == 0), strict=True):
        away = triangles[face] - points[row]
        sides = [np.cross(away[k], away[(k + 1) % 3]) @ normals[face] for k in range(3)]
        found[row] |= min(sides) >= 0
    return found


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


# ---- Rays on an integer grid, through corners and along edges and faces.


@pytest.mark.parametrize('power', [-20, 0, 20])
@pytest.mark.parametrize('name', [*SOLIDS, *SURFACES])
def test_the_first_triangle_is_exact_and_the_lowest_row_of_several(name, power):
    rng, unit = np.random.default_rng(power + 77), 2.0**power
    triangles = with_gaps((SOLIDS | SURFACES)[name])
    starts, goals = segments(triangles, 300, rng)
    real = np.flatnonzero((np.cross(*np.diff(triangles, axis=1).swapaxes(0, 1)) != 0).any(axis=1))
    rows = np.append(real, -1)
    wanted = [rows[tied] for tied in first_triangles(triangles[real], starts, goals - starts)]
    for solid in (None, False):
        mesh = Mesh(triangles * unit, solid=solid)
        assert (mesh.dropped, mesh.solid) == (4, name in SOLIDS and solid is None)
        hits = scene_of(Shapes.of_meshes(mesh, [0, 0, 0])).raycast_many(
            starts * unit, (goals - starts) * unit, 1.0
        )
        inside = on_surface(triangles[real], starts)
        if mesh.solid:
            inside |= holds(triangles[real], starts, rng)
        for triangle, is_inside, tied in zip(hits.triangles, inside, wanted, strict=True):
            assert triangle in ([-1] if is_inside else tied)
        assert (hits.triangles >= 0).sum() > 50
        reach = np.abs(starts).max() * unit
        require_uv(hits, triangles * unit, 1e-14 * reach)


@pytest.mark.parametrize('decade', range(-6, 7, 2))
def test_a_ray_at_an_edge_or_corner_meets_the_lowest_row_of_all(decade):
    """Straight down on a terrain, at its corners and middles of edges, as its maker numbers it."""
    rng, unit, count = np.random.default_rng(decade + 9), 10.0**decade, 9
    x, y = np.meshgrid(np.arange(count) * unit, np.arange(count) * unit, indexing='ij')
    corners = np.stack((x, y, rng.uniform(0.0, 2.0, x.shape) * unit), axis=2).reshape(-1, 3)
    cell = np.arange(count * count).reshape(count, count)
    a, b, c, d = cell[:-1, :-1], cell[1:, :-1], cell[1:, 1:], cell[:-1, 1:]
    faces = [np.stack(three, axis=2).reshape(-1, 3) for three in ((a, b, c), (a, c, d))]
    faces = rng.permutation(np.concatenate(faces))
    scene = scene_of(Shapes.of_meshes(Mesh(corners, faces), [0, 0, 0]))
    at = corners.copy()
    at[:, 2] = 7.3 * unit
    hits = scene.raycast_many(at, [0, 0, -1])
    lowest = [np.flatnonzero((faces == k).any(axis=1))[0] for k in range(len(corners))]
    assert hits.triangles.tolist() == lowest
    require_uv(hits, corners[faces], 1e-14 * 9 * unit)
    # Along x and along y a middle is on the edge: nothing is rounded.
    ends = np.stack((a, b), axis=2).reshape(-1, 2)
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
    scene = Scene()
    mesh = Shapes.of_meshes(Mesh(triangles), place, turn.as_quat())
    scene.update('us', ['mesh'], mesh, stamp=0)
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


@pytest.mark.parametrize('name', FORMS)
def test_one_that_moves_is_met_where_it_is_by_then(name):
    """Frozen at a time, and while it passes: one by one, all hits, few and many."""
    rng, velocity = np.random.default_rng(4), np.array((0.5, -0.25, 0.125))
    turn, place, second = Rotation.random(random_state=7), np.zeros(3), 10**9
    triangles = FORMS[name]
    scene = Scene()
    shape = Shapes.of_meshes(Mesh(triangles), place, turn.as_quat())
    scene.update('us', ['mesh'], shape, stamp=0, velocities=[velocity])
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
    scene, at = Scene(), np.array([(40.0 * k, 0.0, 0.0) for k in range(len(meshes))])
    scene.update('us', list('abcd'), Shapes.of_meshes(meshes, at), stamp=0)
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


TETRAHEDRON = np.array(
    [np.delete(np.vstack((np.zeros(3), np.eye(3))), corner, axis=0) for corner in range(4)]
)


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
        scene = Scene(planar=planar)
        scene.update('us', ['box'], Shapes.boxes([(0, 0, 0)], 1.0), stamp=0)
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
