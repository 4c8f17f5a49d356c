# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes that are not convex in planar scenes: the union of the shadows of their triangles."""

import math

import numpy as np
import pytest
from scene.inside import store_of
from scene.meshes import SOLIDS, SURFACES, box, grid_triangles, segments
from scene.reference import icosphere, scene_of
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
        assert found.t[hit] == pytest.approx(wanted[hit], rel=1e-14)
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


def test_nothing_slips_between_triangles_however_they_are_turned():
    """A plate of many triangles, tilted anyhow: every place on an edge of it is in its shadow."""
    rng, count = np.random.default_rng(6), 9
    grid = rng.uniform(-0.3, 0.3, (count + 1, count + 1, 2))
    grid[[0, -1]] = grid[:, [0, -1]] = 0.0
    grid += np.stack(np.meshgrid(*[np.arange(count + 1.0)] * 2, indexing='ij'), axis=2)
    grid = np.concatenate([grid, np.zeros((count + 1, count + 1, 1))], axis=2)
    plate = grid_triangles(grid)
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


def test_sides_that_lie_along_edges_of_tops_have_no_shadow():
    scene = scene_of(Shapes.of_meshes(Mesh(CORNER), [0, 0, 0], [(0, 0, 0.6, 0.8)]), planar=True)
    hulls = store_of(scene).columns.meshes.hulls
    assert len(hulls.corners) == len(Mesh(CORNER).corners) - 16


def test_a_picture_shows_the_triangles(pyplot):
    """Not what is around them: the nook of a corner stays empty."""
    scene = scene_of(Shapes.of_meshes(Mesh(CORNER), [0, 0, 0]), planar=True)
    faces = [path.vertices for path in scene.plot(levels=0).collections[0].get_paths()]
    assert len(faces) == len(Mesh(CORNER).corners)
    assert all((face <= (9, 3)).all() or (face <= (3, 9)).all() for face in faces)


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
    scene = scene_of(Shapes.of_meshes(Mesh(CORNER), [0, 0, 0]), planar=True, of=NodeScene)
    boxes = Shapes.boxes([(8, 8, 0), (4, 1, 0)], (1, 1, 1))
    handles, found, mine, theirs = scene.collisions_many(boxes, 1, 1)
    assert found.tolist() == [4.5, 0.0]
    assert (handles != NO_NODE).all()
    assert np.array_equal(mine[1], theirs[1])
