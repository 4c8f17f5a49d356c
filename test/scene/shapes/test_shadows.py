# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes that are not convex in planar scenes: the union of the shadows of their triangles."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scene.inside import store_of
from scene.reference import icosphere, scene_of
from scene.shapes.test_any_mesh import SOLIDS, SURFACES, assert_same_at, box, segments
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bvh_ros.scene import NO_NODE, Mesh, NodeScene, Scene, Shapes

CORNER = np.concatenate([box((0, 0, 0), (9, 3, 2)), box((0, 0, 0), (3, 9, 2))])  # an L
FENCE = np.array([((0, 0, 0), (6, 0, 0), (6, 0, 3)), ((0, 0, 0), (6, 0, 3), (0, 0, 3))])
WALLS = np.concatenate([FENCE, FENCE[:, :, [1, 0, 2]] + (6, 0, 0)])  # they stand upright
MESHES = SOLIDS | SURFACES | {'corner': CORNER, 'walls': WALLS}

# Turns that take integers to integers: seen from above, from the side and from behind, mirrored.
TURNS = {
    'above': ((0, 0, 0, 1), np.eye(3, dtype=int)),
    'side': ((0.5, 0.5, 0.5, 0.5), np.array([(0, 0, 1), (1, 0, 0), (0, 1, 0)])),
    'behind': ((-0.5, -0.5, -0.5, 0.5), np.array([(0, 1, 0), (0, 0, 1), (1, 0, 0)])),
    'below': ((1, 0, 0, 0), np.diag((1, -1, -1))),
}


# ---- What exact arithmetic says.


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def first_hits(triangles, starts, goals):
    """The t at which each segment (n,) first meets any triangle (m, 3, 2), inf if none; decided in
    int64. It begins in one, or meets an edge.
    """
    first, along = np.full(len(starts), np.inf), goals - starts
    for a, b, c in triangles:
        sides = [cross(q - p, starts - p) for p, q in ((a, b), (b, c), (c, a))]
        if cross(b - a, c - a):
            first[(np.min(sides, axis=0) >= 0) | (np.max(sides, axis=0) <= 0)] = 0.0
        for p, q in ((a, b), (b, c), (c, a)):
            before, after = cross(q - p, starts - p), cross(q - p, goals - p)
            one, other = cross(along, p - starts), cross(along, q - starts)
            meets = (np.sign(before) * np.sign(after) <= 0) & (np.sign(one) * np.sign(other) <= 0)
            within = (one == 0) & (other == 0)
            meets &= ~within
            t = before[meets] / (before[meets] - after[meets])
            first[meets] = np.minimum(first[meets], t)
            for row in np.flatnonzero(within & (before == 0)):
                way, square = along[row], int(along[row] @ along[row])
                if square == 0:  # a point on the line of the edge
                    low, high = np.minimum(p, q), np.maximum(p, q)
                    held = ((low <= starts[row]) & (starts[row] <= high)).all()
                    first[row] = 0.0 if held else first[row]
                    continue
                ends = [int((end - starts[row]) @ way) for end in (p, q)]
                if max(ends) >= 0 and min(ends) <= square:
                    first[row] = min(first[row], max(min(ends), 0) / square)
    return first


@pytest.mark.parametrize('power', [-20, 0, 20])
@pytest.mark.parametrize('name', MESHES)
def test_rays_are_exact(name, power):
    """No ray slips between two triangles, or is stopped by nothing; from any side."""
    rng, unit = np.random.default_rng(power + 99), 2.0**power
    mesh = Mesh(MESHES[name] * unit)
    assert not mesh.convex
    for quaternion, matrix in TURNS.values():
        turned = MESHES[name] @ matrix.T
        scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0], [quaternion]), planar=True)
        starts, goals = segments(turned, 400, rng)
        wanted = first_hits(turned[:, :, :2], starts[:, :2], goals[:, :2])
        found = scene.raycast_many(starts * unit, (goals - starts) * unit, 1.0)
        assert np.array_equal(np.isfinite(found.t), np.isfinite(wanted))
        hit = np.isfinite(wanted)
        assert 10 < hit.sum() < len(hit)
        assert found.t[hit] == pytest.approx(wanted[hit], abs=1e-12)
        along = goals - starts
        places = (starts + np.where(hit, wanted, 0.0)[:, None] * along) * unit
        assert found.points[hit, :2] == pytest.approx(places[hit, :2], abs=1e-11 * unit)
        facing = np.einsum('ni,ni->n', found.normals[:, :2], along[:, :2].astype(float))
        enters = hit & (wanted > 0.0)
        assert (facing[enters] < 0.0).all()
        assert np.linalg.norm(found.normals[enters], axis=1) == pytest.approx(1.0)
        assert not found.normals[hit & (wanted == 0.0)].any()
        one = scene.raycast(starts[0] * unit, goals[0] * unit)
        assert (np.inf if one is None else one.t) == found.t[0]


def clipped(triangle, start, goal):
    """The part of a segment, from 0 to 1, in a triangle: (entry, leave), Fractions, or None."""
    a, b, c = triangle
    if cross(b - a, c - a) < 0:
        b, c = c, b
    entry, leave = Fraction(0), Fraction(1)
    for p, q in ((a, b), (b, c), (c, a)):
        here, there = int(cross(q - p, start - p)), int(cross(q - p, goal - p))
        if here < 0 and there < 0:
            return None
        if here < 0 <= there:
            entry = max(entry, Fraction(here, here - there))
        elif there < 0 <= here:
            leave = min(leave, Fraction(here, here - there))
    return (entry, leave) if entry <= leave else None


def test_rays_are_clipped_by_rational_numbers():
    """Another way to say it: the parts of a segment in each shadow."""
    rng = np.random.default_rng(4)
    scene = scene_of(Shapes.of_meshes(Mesh(SOLIDS['ring']), [0, 0, 0]), planar=True)
    flat = SOLIDS['ring'][:, :, :2]
    flat = flat[cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]) != 0]
    starts, goals = rng.integers(-20, 21, (2, 150, 2))
    for start, goal in zip(starts, goals, strict=True):
        parts = [part for part in (clipped(t, start, goal) for t in flat) if part]
        hit = scene.raycast(start, goal)
        assert (hit is None) == (not parts)
        if parts:
            assert hit.t == pytest.approx(float(min(parts)[0]), rel=1e-14)


def test_nothing_slips_between_triangles_however_they_are_turned():
    """A plate of many triangles, tilted anyhow: every place on an edge of it is in its shadow."""
    rng, count = np.random.default_rng(6), 9
    grid = rng.uniform(-0.3, 0.3, (count + 1, count + 1, 2))
    grid[[0, -1]] = grid[:, [0, -1]] = 0.0
    grid += np.stack(np.meshgrid(*[np.arange(count + 1.0)] * 2, indexing='ij'), axis=2)
    grid = np.concatenate([grid, np.zeros((count + 1, count + 1, 1))], axis=2)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    plate = [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    plate = np.concatenate(plate)
    mesh = Mesh(plate)
    inside = (plate > 0.5).all(axis=(1, 2)) & (plate[:, :, :2] < count - 0.5).all(axis=(1, 2))
    inner = plate[np.flatnonzero((plate[:, :, :2] % count > 0).all(axis=(1, 2)) | inside)]
    for turn in Rotation.random(12, random_state=5):
        place = rng.uniform(-50, 50, 3)
        scene = scene_of(Shapes.of_meshes(mesh, place, [turn.as_quat()]), planar=True)
        ends = turn.apply(inner.reshape(-1, 3)).reshape(-1, 3, 3) + place
        share = rng.uniform(0, 1, (len(ends), 3, 1))
        points = (ends + share * (np.roll(ends, -1, axis=1) - ends)).reshape(-1, 3)
        points = np.concatenate([points, ends.reshape(-1, 3)])
        found = scene.raycast_many(points, np.zeros_like(points), 1.0)
        assert (found.t == 0.0).all()
        assert (scene.nearest_many(points)[1] <= 1e-13).all()
        rays = scene.raycast_many(points, rng.normal(size=points.shape))
        assert (rays.t == 0.0).all()


# ---- Distances: brute force over all triangles.


def distances(triangles, points):
    """(n,) distances of points (n, 2) from the union of triangles (m, 3, 2)."""
    best = np.full(len(points), np.inf)
    for triangle in triangles:
        sides = []
        for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            edge, away = b - a, points - a
            share = np.clip(away @ edge / max(edge @ edge, 1e-300), 0.0, 1.0)
            best = np.minimum(best, np.linalg.norm(away - share[:, None] * edge, axis=1))
            sides.append(cross(edge, away))
        area = cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        if abs(area) > 1e-9:
            sides = np.array(sides) * np.sign(area)
            best[(sides > 0.0).all(axis=0)] = 0.0
    return best


def gap_between(one, other):
    """The distance of two unions of triangles (m, 3, 2), 0 where they overlap: that of a corner of
    one from the other, unless edges cross.
    """
    a, c = one.reshape(-1, 1, 2), other.reshape(1, -1, 2)
    b = np.roll(one, -1, axis=1).reshape(-1, 1, 2)
    d = np.roll(other, -1, axis=1).reshape(1, -1, 2)
    apart = cross(b - a, c - a) * cross(b - a, d - a) >= 0.0
    apart |= cross(d - c, a - c) * cross(d - c, b - c) >= 0.0
    if not apart.all():
        return 0.0
    return min(distances(one, c[0]).min(), distances(other, a[:, 0]).min())


PLACED = {
    'ring': (SOLIDS['ring'] / 8.0, (0, 0, 0.6, 0.8)),
    'tilted ring': (SOLIDS['ring'] / 8.0, (0.3, -0.2, 0.5, 0.8)),
    'corner': (CORNER / 4.0, (0, 0, -0.28, 0.96)),
    'tilted comb': (SOLIDS['comb'] / 4.0, (-0.4, 0.1, 0.2, 0.9)),
    'strip': (SURFACES['strip'] / 8.0, (0.1, 0.1, 0.5, 0.8)),
    'walls': (WALLS / 4.0, (0, 0, 0.6, 0.8)),
}


@pytest.fixture(scope='module', params=PLACED)
def placed(request):
    """A mesh in a pose, the shadows of its triangles, a scene that holds it, and points."""
    triangles, quaternion = PLACED[request.param]
    turn = Rotation.from_quat(quaternion)
    place = np.array((3.0, -2.0, 7.0))
    world = turn.apply(triangles.reshape(-1, 3)).reshape(-1, 3, 3) + place
    mesh = Mesh(triangles)
    scene = scene_of(Shapes.of_meshes(mesh, place, [turn.as_quat()]), planar=True)
    points = np.random.default_rng(5).uniform(-2.5, 2.5, (300, 3)) + place
    flat = world[:, :, :2]
    return mesh, scene, flat, points, distances(flat, points[:, :2])


def test_nearest_points(placed):
    _, scene, _, points, gaps = placed
    _, found, places = scene.nearest_many(points)
    assert found[:, 0] == pytest.approx(gaps, abs=1e-12)
    away = np.linalg.norm(places[:, 0, :2] - points[:, :2], axis=1)
    assert away == pytest.approx(gaps, abs=1e-12)
    hit = scene.nearest(points[0])[0]
    assert hit.t == found[0, 0]
    assert hit.point[2] == points[0, 2]


def test_balls(placed):
    _, scene, _, points, gaps = placed
    radius = np.random.default_rng(6).uniform(0.01, 0.5, len(points))
    _, found, mine, theirs = scene.clearance_many(Shapes.spheres(points, radius))
    assert found == pytest.approx(np.maximum(gaps - radius, 0.0), abs=1e-12)
    away = np.linalg.norm((mine - theirs)[:, :2], axis=1)
    assert away == pytest.approx(found, abs=1e-12)
    touches = scene.overlap_shape_many(Shapes.spheres([0, 0, 0], 0.2), points, tolerance=0.1)
    assert np.array_equal(touches, gaps <= 0.3)
    assert [len(scene.overlap(p, p, tolerance=0.3)) for p in points[:20]] == touches[:20].tolist()


def footprint_of(shapes, row):
    """Triangles that make up what is seen of a box from above."""
    signs = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    turn = Rotation.from_quat(shapes.orientation[row])
    corners = turn.apply(signs * shapes.size[row]) + shapes.position[row]
    rim = corners[ConvexHull(corners[:, :2]).vertices, :2]
    return np.array([rim[[0, i, i + 1]] for i in range(1, len(rim) - 1)])


def test_turned_boxes(placed):
    _, scene, flat, points, _ = placed
    rng = np.random.default_rng(7)
    turns = Rotation.random(60, random_state=3).as_quat()
    turns[:30, :2] = 0.0
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    boxes = Shapes.boxes(points[:60], rng.uniform(0.05, 1.0, (60, 3)), turns)
    wanted = [gap_between(footprint_of(boxes, i), flat) for i in range(60)]
    _, found, mine, theirs = scene.clearance_many(boxes)
    assert found == pytest.approx(wanted, abs=1e-10)
    away = np.linalg.norm((mine - theirs)[:, :2], axis=1)
    assert away == pytest.approx(found, abs=1e-11)
    touches = np.concatenate(
        [scene.overlap_shape_many(boxes.take([i]), boxes.position[[i]]) for i in range(60)]
    )
    assert np.array_equal(touches, found == 0.0)
    assert 0 < touches.sum() < 60


def test_meshes(placed):
    """Convex ones and others, as queries and as obstacles of one scene."""
    mesh, scene, flat, points, _ = placed
    turns = Rotation.random(25, random_state=4)
    for other in (mesh, Mesh(icosphere(1) * 0.4), Mesh(SOLIDS['hollow'] / 20.0)):
        shapes = Shapes.of_meshes(other, points[:25], turns.as_quat())
        _, found, mine, theirs = scene.clearance_many(shapes)
        corners = other.vertices[other.corners] + other.centre
        for row, turn in enumerate(turns):
            seen = turn.apply(corners.reshape(-1, 3)).reshape(-1, 3, 3) + points[row]
            wanted = gap_between(seen[:, :, :2], flat)
            assert found[row] == pytest.approx(wanted, abs=1e-10)
        away = np.linalg.norm((mine - theirs)[:, :2], axis=1)
        assert away == pytest.approx(found, abs=1e-11)
        touches = scene.overlap_shape_many(shapes.take([0]), points[:25], turns.as_quat())
        assert np.array_equal(touches, found == 0.0)
        for row in range(4):
            world = Scene(planar=True)
            world.update('test', ['placed'], scene_shapes(scene, mesh), stamp=1)
            world.update('test', ['other'], shapes.take([row]), stamp=1)
            assert len(world.overlap_pairs()) == (found[row] == 0.0)
            assert world.clearance('other').distance == pytest.approx(found[row], abs=1e-12)
            there = world.clearance('placed')
            assert there.distance == pytest.approx(found[row], abs=1e-12)


def scene_shapes(scene, mesh):
    """The only obstacle of a scene, which has this mesh."""
    known = scene.get('0')
    return Shapes.of_meshes(mesh, known.position, [known.orientation])


def test_swept_balls_touch_first_where_they_are_first_near(placed):
    _, scene, flat, points, gaps = placed
    starts, goals = points[:100], points[100:200]
    radius, times = 0.2, np.linspace(0.0, 1.0, 201)
    found = scene.sweep_many(starts, goals, radius)
    for i, t in enumerate(found.t):
        path = starts[i] + times[:, None] * (goals[i] - starts[i])
        touching = times[distances(flat, path[:, :2]) <= radius - 1e-9]
        assert not len(touching) or t <= touching[0]
        if np.isfinite(t):
            at = starts[i] + t * (goals[i] - starts[i])
            (apart,) = distances(flat, at[None, :2])
            assert apart <= radius + 1e-9
            if t > 0.0:
                way = (at - found.points[i])[:2]
                assert np.linalg.norm(way) == pytest.approx(radius, abs=1e-9)
                assert found.normals[i, :2] == pytest.approx(way / radius, abs=1e-6)
    assert np.array_equal(found.t == 0.0, gaps[:100] <= radius)


def test_shapes_that_turn(placed):
    """Never free where a pose touches; what they touch is as near as the resolution."""
    scene, points = placed[1], placed[3]
    starts, goals = points[:30], points[30:60]
    turns, goal_turns = (Rotation.random(30, random_state=k) for k in (1, 2))
    for body in (
        Shapes.boxes([0, 0, 0], (0.8, 0.3, 0.2)),
        Shapes.of_meshes(Mesh(SOLIDS['comb'] / 20.0), [0, 0, 0]),
        Shapes.of_meshes(Mesh(icosphere(1) * 0.3), [0, 0, 0]),
    ):
        found = scene.sweep_shape_many(
            body, starts, turns.as_quat(), goals, goal_turns.as_quat(), resolution=1e-3
        )
        half, met = (turns.inv() * goal_turns).as_rotvec(), 0
        for t in np.linspace(0.0, 1.0, 40):
            between = (turns * Rotation.from_rotvec(t * half)).as_quat()
            places = starts + t * (goals - starts)
            touches = scene.overlap_shape_many(body, places, between)
            met += touches.sum()
            assert (found.t[touches] <= t + 1e-9).all()
        assert met > 5
        for row in np.flatnonzero(np.isfinite(found.t)):
            t = found.t[row]
            turn = (turns[row] * Rotation.from_rotvec(t * half[row])).as_quat()
            place = starts[row] + t * (goals[row] - starts[row])
            near = scene.overlap_shape_many(body, [place], [turn], tolerance=1e-3 + 1e-9)
            assert near.all()


# ---- What is meant.


def test_a_hole_of_the_shadow_is_free():
    """A ring lies on the ground: its hole is free. It stands up: there is none."""
    ring = Mesh(SOLIDS['ring'] / 8.0)
    scene = scene_of(Shapes.of_meshes(ring, [4, 0, 0]), planar=True)
    assert scene.raycast((3.6, 0), (4.4, 0)) is None
    assert not scene.overlap((3.6, -0.2), (4.4, 0.2))
    assert scene.raycast((3.6, 0), (4.4, 0), radius=0.3) is None
    assert scene.raycast((4, 0), (9, 0)).t == pytest.approx(0.9 / 5, abs=0.03)
    (hit,) = scene.nearest((4, 0))
    assert 0.7 < hit.t < 0.95
    box_in_hole = Shapes.boxes([4, 0, 0], (0.5, 0.5, 99.0))
    assert not scene.overlap_shape(box_in_hole)
    assert scene.sweep_shape(box_in_hole, (4, 0.3, 5)) is None
    assert scene.sweep_shape(box_in_hole, (4, 2)).t > 0.2
    scene.update('test', ['0'], Shapes.of_meshes(ring, [4, 0, 0], [(0.2, 0, 0, 0.98)]), stamp=2)
    assert scene.raycast((3.6, 0), (4.4, 0)) is None  # it leans a little: an ellipse
    standing = Shapes.of_meshes(ring, [4, 0, 0], [(math.sqrt(0.5), 0, 0, math.sqrt(0.5))])
    scene.update('test', ['0'], standing, stamp=3)
    assert scene.raycast((3.6, 0), (4.4, 0)).t == 0.0
    assert scene.overlap_shape(box_in_hole)


def test_the_nook_of_a_corner_is_free():
    scene = scene_of(Shapes.of_meshes(Mesh(CORNER), [0, 0, 0]), planar=True)
    hit = scene.raycast((8, 8), (1, 1))
    assert hit.t == pytest.approx(5 / 7)
    assert hit.point[:2] == pytest.approx((3, 3))
    assert scene.raycast((8, 4), (4, 8)) is None
    assert scene.raycast((8, 4), (8, 2)).normal.tolist() == [0.0, 1.0, 0.0]
    assert scene.raycast((8, 8), (8, 0), radius=1.0).t == pytest.approx(0.5)
    assert scene.raycast((1, 1), (20, 20)).normal.tolist() == [0.0, 0.0, 0.0]
    assert scene.raycast((1, 1), (20, 20), skip_inside=True) is None


def test_an_upright_wall_stops_rays():
    """A fence without thickness: across, along, past its end, and at its end."""
    scene = scene_of(Shapes.of_meshes(Mesh(FENCE), [0, 0, 0]), planar=True)
    hit = scene.raycast((2, 4), (2, -4))
    assert (hit.t, hit.normal.tolist(), hit.point.tolist()) == (0.5, [0, 1, 0], [2, 0, 0])
    assert scene.raycast((2, -4), (2, 4)).normal.tolist() == [0, -1, 0]
    along = scene.raycast((-6, 0), (9, 0))
    assert (along.t, along.normal.tolist()) == (0.4, [-1, 0, 0])
    assert scene.raycast((9, 0), (7, 0)) is None
    assert scene.raycast((9, 0), (6, 0)).t == 1.0
    assert scene.raycast((6, 3), (6, -3)).t == 0.5
    assert scene.raycast((6.0001, 3), (6.0001, -3)) is None
    assert scene.raycast((9, 0), (7, 0), radius=1.0).t == 1.0
    assert scene.raycast((2, 4), (2, -4), radius=1.0).t == pytest.approx(3 / 8)
    assert scene.overlap((1, -1), (2, 1))
    assert scene.nearest((9, 4))[0].t == pytest.approx(5.0)
    assert scene.sweep_shape(Shapes.boxes([3, 4, 0], (1, 1, 1)), (3, -4, 0)).t < 0.44


def test_heights_do_not_count():
    """The same at any height, also beside a mesh that lies far above."""
    for height in (0.0, 1e3, -1e6):
        shape = Shapes.of_meshes(Mesh(CORNER), [0, 0, height], [(0, 0, 0.6, 0.8)])
        scene = scene_of(shape, planar=True)
        other = Shapes.of_meshes(Mesh(CORNER / 9.0), [6, 9, 0])
        _, found, _, _ = scene.clearance_many(other)
        if height == 0.0:
            wanted = found
            assert 0.0 < found[0] < 9.0
        assert found == pytest.approx(wanted, abs=1e-9)
        assert scene.overlap_shape(other, tolerance=float(found[0]) + 1e-6)
        assert scene.raycast((-9, 3, 5), (9, 3, -5)) is not None


def test_signed_distances_are_refused_where_something_touches():
    scene = scene_of(Shapes.of_meshes(Mesh(CORNER), [0, 0, 0]), planar=True)
    assert scene.nearest((8, 8), signed=True)[0].t == 5.0
    assert scene.nearest_many([(8, 8), (-3, 0)], signed=True)[1][:, 0].tolist() == [5.0, 3.0]
    ball = Shapes.spheres([(8, 8, 0)], 1.0)
    assert scene.clearance_many(ball, signed=True)[1].tolist() == [4.0]
    for ask in (
        lambda: scene.nearest((1, 1), signed=True),
        lambda: scene.nearest_many([(8, 8), (1, 1)], signed=True),
        lambda: scene.clearance_many(Shapes.spheres([(1, 1, 0)], 1.0), signed=True),
        lambda: (
            scene.overlap_shape(ball)
            or scene.clearance_many(Shapes.boxes([(4, 4, 0)], (3, 3, 3)), signed=True)
        ),
    ):
        with pytest.raises(ValueError, match=r'no signed distance in a planar scene.*obstacle 0'):
            ask()


def test_one_that_moves():
    """At a time it stands elsewhere: rays, points and shapes see it there."""
    scene = Scene(planar=True)
    ring = Shapes.of_meshes(Mesh(SOLIDS['ring'] / 8.0), [0, 0, 0], [(0.2, 0, 0.3, 0.93)])
    scene.update('test', ['ring'], ring, stamp=0, velocities=[[1, 0, 0]])
    still = scene_of(ring._replace(position=np.array([(2.0, 0.0, 0.0)])), planar=True)
    at = 2 * 10**9
    points, goals = assert_same_at(scene, at, still)
    body = Shapes.boxes([0, 0, 0], (0.4, 0.3, 0.2))
    for start, goal in zip(points[:20], goals[:20], strict=True):
        body = body._replace(position=start[None])
        moved = scene.sweep_shape(body, goal, at=at, until=at)
        stood = still.sweep_shape(body, goal)
        assert (moved is None) == (stood is None)
        assert moved is None or moved.t == pytest.approx(stood.t, abs=1e-4)
    with pytest.raises(ValueError, match='no signed distance in a planar scene'):
        scene.nearest_many(points, signed=True, at=at)


def test_a_shadow_is_shared_and_kept_while_its_mesh_only_moves():
    shape = Shapes.of_meshes([Mesh(CORNER)] * 2, [(0, 0, 0), (20, 0, 5)], [(0, 0, 0.6, 0.8)] * 2)
    scene = scene_of(shape, planar=True)
    assert scene.stats()['meshes'] == 1
    hulls = store_of(scene).columns.meshes.hulls
    scene.update('test', ['0'], shape.take([0])._replace(position=np.ones((1, 3))), stamp=2)
    assert store_of(scene).columns.meshes.hulls is hulls
    # The sides of both boxes lie along edges of their tops.
    assert len(hulls.corners) == len(Mesh(CORNER).corners) - 16
    scene.update('test', ['0'], shape.take([0])._replace(orientation=np.eye(4)[[3]]), stamp=3)
    assert scene.stats()['meshes'] == 2
    scene.clear()
    scene.update('test', ['box'], Shapes.boxes([(1, 2, 3)], (1, 1, 1)), stamp=4)
    assert scene.raycast((1, -9), (1, 9)).name == 'box'


def test_a_picture_shows_the_triangles():
    """Not what is around them: the nook of a corner stays empty."""
    pyplot = pytest.importorskip('matplotlib.pyplot', reason='matplotlib is not installed')
    pyplot.switch_backend('agg')
    scene = scene_of(Shapes.of_meshes(Mesh(CORNER), [0, 0, 0]), planar=True)
    faces = [path.vertices for path in scene.plot(levels=0).collections[0].get_paths()]
    assert len(faces) == len(Mesh(CORNER).corners)
    assert all((face <= (9, 3)).all() or (face <= (3, 9)).all() for face in faces)
    pyplot.close('all')


def test_other_obstacles_stay_as_they_are():
    """Boxes, balls, cylinders and convex meshes beside one that is not convex."""
    turned = [(0, 0, 0.6, 0.8)]
    shapes = [
        Shapes.boxes([[20, 0, 0]], (2, 1, 1)),
        Shapes.boxes([[20, 9, 0]], (2, 1, 1), turned),
        Shapes.spheres([[20, 18, 0]], 1.0),
        Shapes.cylinders([[20, 27, 0]], 1.0, 2.0, [(0.3, 0, 0, 0.95)]),
        Shapes.of_meshes(Mesh(icosphere(1)), [20, 36, 0], turned),
    ]
    plain, mixed = Scene(planar=True), Scene(planar=True)
    for scene in (plain, mixed):
        for i, shape in enumerate(shapes):
            scene.update('test', [f'{i}'], shape, stamp=1)
    mixed.update('test', ['corner'], Shapes.of_meshes(Mesh(CORNER), [-90, 0, 0]), stamp=1)
    kinds = {type(store_of(scene).columns.hulls) for scene in (plain, mixed)}
    assert len(kinds) == 2  # beside convex ones alone nothing else is compiled
    rng = np.random.default_rng(3)
    starts = np.column_stack([rng.uniform(14, 26, 200), rng.uniform(-4, 40, 200)])
    goals = np.column_stack([rng.uniform(14, 26, 200), rng.uniform(-4, 40, 200)])
    for radius in (0.0, 0.4):
        one, other = (scene.sweep_many(starts, goals, radius) for scene in (plain, mixed))
        assert all(map(np.array_equal, one[:2], other[:2]))
        assert (one.handles != NO_NODE).any()
    one, other = (scene.nearest_many(starts, 2, 8.0) for scene in (plain, mixed))
    assert np.array_equal(one[0], other[0])
    assert np.array_equal(one[1], other[1])
    one, other = (scene.overlap_many(starts, [1, 1], want='count') for scene in (plain, mixed))
    assert np.array_equal(one, other)


def test_paths_of_a_node_collide_where_no_depth_is_known():
    scene = NodeScene(planar=True)
    scene.update('test', ['corner'], Shapes.of_meshes(Mesh(CORNER), [0, 0, 0]), stamp=1)
    boxes = Shapes.boxes([(8, 8, 0), (4, 1, 0)], (1, 1, 1))
    handles, found, mine, theirs = scene.collisions_many(boxes, 1, 1)
    assert found.tolist() == [4.5, 0.0]
    assert (handles != NO_NODE).all()
    assert np.array_equal(mine[1], theirs[1])
