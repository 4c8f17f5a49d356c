# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far things are from meshes, convex or not, or from their shadows in planar scenes: against
brute force over all triangles.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scene.meshes import CUBE, SOLIDS, SURFACES, holds
from scene.reference import Floats, changed, icosphere, scene_of, surface_distances
from scene.shapes.test_shadows import CORNER, WALLS
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Scene, Shapes

LEANING = (0.3, -0.2, 0.5, 0.8)
STONES = np.random.default_rng(9).integers(-12, 13, (60, 3))
PLACED = {
    # whether the scene is planar, triangles, how much smaller, orientation
    'ring': (False, SOLIDS['ring'], 8.0, LEANING),
    'hollow': (False, SOLIDS['hollow'], 8.0, LEANING),
    'cube': (False, 8 * np.rint(CUBE / abs(CUBE).max()).astype(np.int64), 8.0, LEANING),
    'stone': (False, STONES[ConvexHull(STONES).simplices], 8.0, LEANING),
    'strip': (False, SURFACES['strip'], 8.0, LEANING),
    'ring from above': (True, SOLIDS['ring'], 8.0, (0, 0, 0.6, 0.8)),
    'leaning ring from above': (True, SOLIDS['ring'], 8.0, LEANING),
    'corner from above': (True, CORNER, 4.0, (0, 0, -0.28, 0.96)),
    'comb from above': (True, SOLIDS['comb'], 4.0, (-0.4, 0.1, 0.2, 0.9)),
    'strip from above': (True, SURFACES['strip'], 8.0, (0.1, 0.1, 0.5, 0.8)),
    'walls from above': (True, WALLS, 4.0, (0, 0, 0.6, 0.8)),
}


class Placed(NamedTuple):
    mesh: Mesh
    scene: Scene
    world: Floats
    """Its triangles in the world; in planar scenes without their heights."""
    points: Floats
    gaps: Floats
    """Distances of the points from the triangles."""
    inside: Floats

    @property
    def axes(self) -> slice:
        return slice(2 if self.scene.planar else 3)

    @property
    def outside(self) -> Floats:
        return np.where(self.inside, 0.0, self.gaps)

    def from_triangles(self, points: Floats) -> Floats:
        seen = points.copy()
        seen[:, 2] *= not self.scene.planar
        return surface_distances(seen, self.world)

    def lengths(self, ways: Floats) -> Floats:
        return np.linalg.norm(ways[..., self.axes], axis=-1)


@pytest.fixture(scope='module', params=PLACED)
def placed(request):
    planar, triangles, smaller, quaternion = PLACED[request.param]
    mesh, turn = Mesh(triangles / smaller), Rotation.from_quat(quaternion)
    place = np.array((3.0, -2.0, 7.0 if planar else 1.0))
    world = turn.apply(triangles.reshape(-1, 3) / smaller).reshape(-1, 3, 3) + place
    world[:, :, 2] *= not planar
    scene = scene_of(Shapes.of_meshes(mesh, place, [turn.as_quat()]), planar)
    rng = np.random.default_rng(5)
    points = rng.uniform(-2.5, 2.5, (300, 3)) + place
    found = Placed(mesh, scene, world, points, np.empty(0), np.zeros(len(points), np.bool_))
    if mesh.solid and not planar:
        grid = np.rint(turn.inv().apply(points - place) * smaller * 2**12).astype(np.int64)
        found.inside[:] = holds(np.int64(2**12) * triangles, grid, rng)
    return Placed(*found[:4], found.from_triangles(points), found.inside)


def test_nearest_and_depth_of_points(placed):
    scene, points, gaps = placed.scene, placed.points, placed.gaps
    _, found, places = scene.nearest_many(points)
    assert found[:, 0] == pytest.approx(placed.outside, abs=1e-12)
    assert placed.lengths(places[:, 0] - points) == pytest.approx(placed.outside, abs=1e-12)
    hit = scene.nearest(points[0])[0]
    assert (hit.t, hit.point.tolist()) == (found[0, 0], places[0, 0].tolist())
    if scene.planar:
        assert hit.point[2] == points[0, 2]
        return
    _, found, places = scene.nearest_many(points, signed=True)
    assert found[:, 0] == pytest.approx(np.where(placed.inside, -gaps, gaps), abs=1e-12)
    assert placed.lengths(places[:, 0] - points) == pytest.approx(gaps, abs=1e-12)


def test_normals_next_to_a_surface_are_unit_vectors(placed):
    scene, middles = placed.scene, placed.world.mean(axis=1)
    normals = np.cross(placed.world[:, 1] - placed.world[:, 0], placed.world[:, 2] - middles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    for depth in (1e-15, 1e-12, 1e-8):
        for point in np.concatenate([middles + depth * normals, middles - depth * normals])[::7]:
            hit = scene.nearest(point, signed=not scene.planar)[0]
            if hit.t != 0.0:
                assert np.linalg.norm(hit.normal) == pytest.approx(1.0, abs=1e-14)
                assert abs(hit.t) <= depth + 1e-14


def test_clearance_and_overlap_of_balls(placed):
    scene, points, gaps = placed.scene, placed.points, placed.gaps
    radius = np.random.default_rng(6).uniform(0.01, 0.5, len(points))
    balls = Shapes.spheres(points, radius)
    _, found, mine, theirs = scene.clearance_many(balls)
    assert found == pytest.approx(np.maximum(placed.outside - radius, 0.0), abs=1e-12)
    assert placed.lengths(mine - theirs) == pytest.approx(found, abs=1e-12)
    touches = scene.overlap_shape_many(Shapes.spheres([0, 0, 0], 0.2), points, tolerance=0.1)
    assert np.array_equal(touches, placed.outside <= 0.3)
    assert [len(scene.overlap(p, p, tolerance=0.3)) for p in points[:20]] == touches[:20].tolist()
    if placed.mesh.solid and not scene.planar:
        _, found, _, _ = scene.clearance_many(balls, signed=True)
        assert found == pytest.approx(np.where(placed.inside, -gaps, gaps) - radius, abs=1e-12)
    else:
        with pytest.raises(ValueError, match='no signed distance'):
            scene.clearance_many(balls, signed=True)


def test_swept_balls_touch_first_where_they_are_first_near(placed):
    starts, goals = placed.points[:100], placed.points[100:200]
    radius, times = 0.2, np.linspace(0.0, 1.0, 201)
    found = placed.scene.sweep_many(starts, goals, radius)
    for i, t in enumerate(found.t):
        path = starts[i] + times[:, None] * (goals[i] - starts[i])
        touching = times[placed.from_triangles(path) <= radius - 1e-9]
        assert not len(touching) or t <= touching[0]
        if np.isfinite(t) and not placed.inside[i]:
            at = starts[i] + t * (goals[i] - starts[i])
            assert placed.from_triangles(at[None])[0] <= radius + 1e-9
            if t > 0.0:
                way = (at - found.points[i])[placed.axes]
                assert np.linalg.norm(way) == pytest.approx(radius, abs=1e-9)
                normal = found.normals[i, placed.axes]
                assert normal == pytest.approx(way / radius, abs=1e-6)
    assert np.array_equal(found.t == 0.0, placed.outside[:100] <= radius)


def test_shapes_that_turn(placed):
    """Never free where a pose touches; what they touch is as near as the resolution."""
    scene, starts, goals = placed.scene, placed.points[:30], placed.points[30:60]
    turns, goal_turns = (Rotation.random(30, random_state=k) for k in (1, 2))
    half = (turns.inv() * goal_turns).as_rotvec()
    for body in (
        Shapes.boxes([0, 0, 0], (0.8, 0.3, 0.2)),
        Shapes.of_meshes(Mesh(SOLIDS['comb'] / 20.0), [0, 0, 0]),
        Shapes.of_meshes(Mesh(icosphere(1) * 0.3), [0, 0, 0]),
    ):
        found = scene.sweep_shape_many(
            body, starts, turns.as_quat(), goals, goal_turns.as_quat(), resolution=1e-3
        )
        met = 0
        for t in np.linspace(0.0, 1.0, 40):
            between = (turns * Rotation.from_rotvec(t * half)).as_quat()
            places = starts + t * (goals - starts)
            touches = scene.overlap_shape_many(body, places, between)
            met += touches.sum()
            assert (found.t[touches] <= t + 1e-9).all()
        assert met > 5
        assert scene.planar or (found.t < np.inf).sum() < 30
        for row in np.flatnonzero(np.isfinite(found.t)):
            t = found.t[row]
            turn = (turns[row] * Rotation.from_rotvec(t * half[row])).as_quat()
            place = starts[row] + t * (goals[row] - starts[row])
            near = scene.overlap_shape_many(body, [place], [turn], tolerance=1e-3 + 1e-9)
            assert near.all()


# ---- Boxes and other meshes.


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def gap_between(one, other):
    """The distance of two unions of flat triangles (m, 3, 3), 0 where they overlap: that of a
    corner of one from the other, unless edges cross.
    """
    a, c = one.reshape(-1, 1, 3), other.reshape(1, -1, 3)
    b = np.roll(one, -1, axis=1).reshape(-1, 1, 3)
    d = np.roll(other, -1, axis=1).reshape(1, -1, 3)
    apart = cross(b - a, c - a) * cross(b - a, d - a) >= 0.0
    apart |= cross(d - c, a - c) * cross(d - c, b - c) >= 0.0
    if not apart.all():
        return 0.0
    return min(surface_distances(c[0], one).min(), surface_distances(a[:, 0], other).min())


def footprint_of(shapes, row):
    """Triangles that make up what is seen of a box from above."""
    signs = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    turn = Rotation.from_quat(shapes.orientation[row])
    corners = turn.apply(signs * shapes.size[row]) + shapes.position[row]
    rim = corners[ConvexHull(corners[:, :2]).vertices] * (1, 1, 0)
    return np.array([rim[[0, i, i + 1]] for i in range(1, len(rim) - 1)])


def test_turned_boxes(placed):
    """Distances, points and overlaps agree; seen from above they are those of the footprints."""
    scene, points = placed.scene, placed.points[:60]
    rng = np.random.default_rng(7)
    turns = Rotation.random(60, random_state=3).as_quat()
    if scene.planar:
        turns[:30, :2] = 0.0
        turns /= np.linalg.norm(turns, axis=1)[:, None]
    boxes = Shapes.boxes(points, rng.uniform(0.05, 1.0, (60, 3)), turns)
    _, found, mine, theirs = scene.clearance_many(boxes)
    assert placed.lengths(mine - theirs) == pytest.approx(found, abs=1e-11)
    touches = scene.overlap_many(points, boxes.size, turns)
    assert np.array_equal(touches, found == 0.0)
    each = [scene.overlap_shape_many(boxes.take([i]), points[[i]], turns[[i]]) for i in range(60)]
    assert np.array_equal(touches, np.concatenate(each))
    assert 0 < touches.sum() < 60
    assert (touches | ~placed.inside[:60]).all()
    if scene.planar:
        wanted = [gap_between(footprint_of(boxes, i), placed.world) for i in range(60)]
        assert found == pytest.approx(wanted, abs=1e-10)


def test_meshes(placed):
    """Convex ones and others, as queries and as obstacles of one scene."""
    mesh, scene, points = placed.mesh, placed.scene, placed.points[:25]
    turns = Rotation.random(25, random_state=4)
    for other in (mesh, Mesh(icosphere(1) * 0.4), Mesh(SOLIDS['hollow'] / 20.0)):
        shapes = Shapes.of_meshes(other, points, turns.as_quat())
        _, found, mine, theirs = scene.clearance_many(shapes)
        assert placed.lengths(mine - theirs) == pytest.approx(found, abs=1e-11)
        corners = other.vertices[other.corners] + other.centre
        if scene.planar:
            for row, turn in enumerate(turns):
                seen = turn.apply(corners.reshape(-1, 3)).reshape(-1, 3, 3) + points[row]
                wanted = gap_between(seen * (1, 1, 0), placed.world)
                assert found[row] == pytest.approx(wanted, abs=1e-10)
        elif other is mesh:
            thin = Shapes.of_meshes(Mesh(corners, solid=False), points, turns.as_quat())
            _, of_shells, _, _ = scene.clearance_many(thin)
            apart = found > 0.0
            if mesh.convex:  # as one solid; its shell goes triangle by triangle
                assert (found <= of_shells + 1e-12).all()
                assert found[apart] == pytest.approx(of_shells[apart], abs=1e-12)
            else:
                assert (found <= of_shells).all()
                assert np.array_equal(found[apart], of_shells[apart])
        touches = scene.overlap_shape_many(shapes.take([0]), points, turns.as_quat())
        assert np.array_equal(touches, found == 0.0)
        for row in range(4):
            known = scene.get('0')
            it = Shapes.of_meshes(mesh, known.position, [known.orientation])
            world = scene_of(it, planar=scene.planar, names=['placed'])
            world.update('test', ['other'], shapes.take([row]), stamp=1)
            assert len(world.overlap_pairs()) == (found[row] == 0.0)
            for name in ('other', 'placed'):
                gap = world.clearance(name).distance
                assert gap == pytest.approx(found[row], abs=1e-12)


@pytest.mark.parametrize('planar', [False, pytest.param(True, marks=pytest.mark.slow)])
def test_one_that_moves(planar):
    """At a time it stands elsewhere: rays, balls, points and shapes see it there."""
    ring = Shapes.of_meshes(Mesh(SOLIDS['ring'] / 8.0), [0, 0, 0], [(0.2, 0, 0.3, 0.93)])
    at = 2 * 10**9
    scene = scene_of(ring, planar=planar, names=['ring'], stamp=0, velocities=[[1, 0, 0]])
    still = scene_of(changed(ring, position=np.array([(2.0, 0.0, 0.0)])), planar)
    points, goals = np.random.default_rng(9).uniform(-3, 4, (2, 60, 3))
    found = scene.nearest_many(points, at=at)[1]
    assert found == pytest.approx(still.nearest_many(points)[1], abs=1e-12)
    boxes = Shapes.boxes(points, (0.4, 0.3, 0.2))
    found, stood = scene.clearance_many(boxes, at=at)[1], still.clearance_many(boxes)[1]
    assert found == pytest.approx(stood, abs=1e-12)
    for start, goal in zip(points[:20], goals[:20], strict=True):
        for radius in (0.0, 0.2):
            moved = scene.raycast(start, goal, radius, at=at)
            stood = still.raycast(start, goal, radius)
            assert (moved is None) == (stood is None)
            if moved is not None:
                assert moved.t == pytest.approx(stood.t, abs=1e-12)
                assert moved.triangle == stood.triangle
                np.testing.assert_allclose(moved.uv, stood.uv, atol=1e-9)
    if planar:
        for row, goal in enumerate(goals[:20]):
            body = boxes.take([row])
            moved = scene.sweep_shape(body, goal, at=at, until=at)
            stood = still.sweep_shape(body, goal)
            assert (moved is None) == (stood is None)
            assert moved is None or moved.t == pytest.approx(stood.t, abs=1e-4)
        with pytest.raises(ValueError, match='no signed distance in a planar scene'):
            scene.nearest_many(points, signed=True, at=at)


@pytest.fixture(scope='module')
def rocks():
    """(A scene with one mesh of many triangles, and one with each triangle as an obstacle.)"""
    rng, count = np.random.default_rng(8), 400
    triangles = rng.uniform(-1.0, 1.0, (count, 1, 3)) + rng.uniform(-0.1, 0.1, (count, 3, 3))
    triangles[:80] = 0.4 * icosphere(1)  # they share corners
    place, turn = np.array((3.0, -2.0, 1.0)), LEANING
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
