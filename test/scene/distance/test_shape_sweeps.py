# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes that go from pose to pose: against distances in more digits, and against many poses."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scene.reference import bulging, changed, hull_of, random_shapes, random_turns, scene_of
from scipy.spatial.transform import Rotation, Slerp

from bvh_ros.scene import NO_NODE, Mesh, Scene, ShapeKind, Shapes

Long = np.longdouble
SECOND = 10**9
UPRIGHT = [0.0, 0.0, 0.0, 1.0]


def product(p, q):
    """Of quaternions (n, 4)."""
    (a, b, c, d), (x, y, z, w) = p.T, q.T
    rows = d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x
    return np.stack((*rows, d * z + a * y - b * x + c * w, d * w - a * x - b * y - c * z), axis=1)


class Ways:
    """Poses on n ways, with 64 digits or more."""

    def __init__(self, starts, turns, goals, goal_turns):
        self.start, self.way = starts.astype(Long), goals.astype(Long) - starts
        first, last = (
            q / np.sqrt((q * q).sum(axis=1, keepdims=True))
            for q in (turns.astype(Long), goal_turns.astype(Long))
        )
        last = np.where((first * last).sum(axis=1, keepdims=True) < 0, -last, last)
        change = product(last, first * np.array([-1, -1, -1, 1], Long))
        sine = np.sqrt((change[:, :3] ** 2).sum(axis=1))
        self.half_angle, self.first = np.arctan2(sine, change[:, 3]), first
        self.axis = change[:, :3] / np.where(sine > 0, sine, 1)[:, None]

    def distances(self, kind, size, points, t):
        """Of points (n, 3) from a shape on the ways at t (n,)."""
        angle = t.astype(Long) * self.half_angle
        turn = np.column_stack((self.axis * np.sin(angle)[:, None], np.cos(angle)))
        turn = product(turn, self.first)
        v, u, w = points - (self.start + t[:, None] * self.way), -turn[:, :3], turn[:, 3:]
        across = np.cross(u, v)
        x, y, z = np.abs(v + 2 * (w * across + np.cross(u, across))).T
        half = size.astype(Long) / 2
        if kind == ShapeKind.BOX:
            gaps = (np.maximum(a - h, 0) for a, h in zip((x, y, z), half, strict=True))
            return np.sqrt(sum(gap * gap for gap in gaps))
        if kind == ShapeKind.CYLINDER:
            return np.hypot(np.maximum(np.hypot(x, y) - half[0], 0), np.maximum(z - half[2], 0))
        z = np.maximum(z - (half[2] - half[0]), 0)
        return np.maximum(np.sqrt(x * x + y * y + z * z) - half[0], 0)

    def closest(self, kind, size, points):
        """The least distance, and t."""
        steps = np.linspace(0, 1, 129)
        count = len(points)
        rows = [self.distances(kind, size, points, np.full(count, t)) for t in steps]
        best = np.argmin(rows, axis=0)
        lo, hi = (
            steps[np.maximum(best - 1, 0)].astype(Long),
            steps[np.minimum(best + 1, 128)].astype(Long),
        )
        share = (np.sqrt(Long(5)) - 1) / 2
        for _ in range(90):
            left, right = hi - share * (hi - lo), lo + share * (hi - lo)
            lower = self.distances(kind, size, points, left) < self.distances(
                kind, size, points, right
            )
            lo, hi = np.where(lower, lo, left), np.where(lower, right, hi)
        t = (lo + hi) / 2
        return self.distances(kind, size, points, t), t


@pytest.mark.parametrize(
    ('scale', 'resolution'), [(1.0, 1e-4), (1.0, 1e-9), (1e-6, 1e-4), (1e5, 1e-6)]
)
@pytest.mark.parametrize('kind', [ShapeKind.BOX, ShapeKind.CYLINDER, ShapeKind.CAPSULE])
@pytest.mark.parametrize('motion', ['both', 'turn', 'move'])
def test_grazing_is_never_free(kind, motion, scale, resolution):
    """Balls that a shape misses, or touches, by 1e-6 to 1e-12 of its size."""
    rng, count = np.random.default_rng([kind, len(motion)]), 300
    size = rng.uniform(0.1, 1.0, 3) * scale
    if kind != ShapeKind.BOX:
        size[1] = size[0]
        size[2] += size[0]
    apart = np.stack(np.unravel_index(np.arange(count), (7, 7, 7)), axis=1) * 12.0 * scale
    starts, goals = (apart + rng.uniform(-1, 1, (count, 3)) * scale for _ in range(2))
    turns, goal_turns = random_turns(rng, count), random_turns(rng, count)
    if motion == 'turn':
        goals = starts
    if motion == 'move':
        goal_turns = turns
    balls, ways = (
        apart + rng.uniform(-1.5, 1.5, (count, 3)) * scale,
        Ways(starts, turns, goals, goal_turns),
    )
    least, when = ways.closest(kind, size, balls)
    graze = 10.0 ** rng.uniform(-12, -6, count) * scale * rng.choice([-1, 1], count)
    good = (least > 1e-3 * scale) & (when > 1e-6) & (when < 1 - 1e-6)
    assert good.sum() > count / 4
    diameters = np.where(good, 2 * (least + graze), 1e-3 * scale).astype(float)
    resolution = resolution * scale
    scene = scene_of(Shapes.spheres(balls, diameters / 2))
    shape = Shapes([kind], np.zeros((1, 3)), [UPRIGHT], size[None])
    found = scene.sweep_shape_many(shape, starts, turns, goals, goal_turns, resolution=resolution)
    free, radii = np.isinf(found.t), diameters.astype(Long) / 2
    assert not (good & free & (least < radii)).any()
    met = good & ~free
    gaps = ways.distances(kind, size, balls, np.where(met, found.t, 0.0)) - radii
    assert met.any()
    assert (gaps[met] <= resolution * 1.001).all()
    for share in np.linspace(0.0, 1.0, 33)[:-1]:
        t = np.where(free, 1.0, found.free_until) * share
        touches = ways.distances(kind, size, balls, t) <= radii
        assert not (good & touches & (found.free_until > 0.0)).any()


def random_obstacles(rng, scene, moving):
    """Shapes of all kinds, some of which are meshes."""
    meshes = [Mesh(bulging(rng)) for _ in range(10)]
    places = rng.uniform(-7.0, 7.0, (10, 3))
    solids = Shapes.of_meshes(meshes, places, random_turns(rng, 10))
    for name, shapes in (('solid', random_shapes(rng, 40, 7.0)), ('mesh', solids)):
        count = len(shapes.kind)
        given = {'velocities': rng.uniform(-1.0, 1.0, (count, 3))} if moving else {}
        names = [f'{name}/{i}' for i in range(count)]
        assert not scene.update('a', names, shapes, stamp=SECOND, **given)


def random_shape(rng, kind):
    if kind == ShapeKind.MESH:
        return Shapes.of_meshes([Mesh(np.add(bulging(rng), (0.3, 0.1, -0.2)))], [0.0, 0.0, 0.0])
    shapes = random_shapes(rng, 60)
    return shapes.take([int(np.argmax(shapes.kind == kind))])


@pytest.mark.parametrize(
    ('moving', 'planar'),
    [
        (False, False),
        (False, True),
        (True, False),
        pytest.param(True, True, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize('kind', list(ShapeKind))
def test_it_agrees_with_many_poses(kind, moving, planar):
    rng = np.random.default_rng([kind, moving, planar])
    scene = Scene(
        planar=planar,
        max_prediction=0.6 if moving else np.inf,
        uncertainty=0.05 if moving and kind % 2 else 0.0,
    )
    random_obstacles(rng, scene, moving)
    count, steps = 40, 200
    starts = rng.uniform(-7.0, 7.0, (count, 3))
    goals = starts + rng.normal(size=(count, 3))
    turns, goal_turns = random_turns(rng, count), random_turns(rng, count)
    shape = random_shape(rng, kind)
    share = np.linspace(0.0, 1.0, steps + 1)
    span = {'at': 1_100_000_000, 'until': 2_100_000_000} if moving else {}
    given = shape, starts, turns, goals, goal_turns
    found = scene.sweep_shape_many(*given, **span)
    for column, again in zip(
        found, scene.sweep_shape_many(*given, threads=3, **span), strict=True
    ):
        assert_array_equal(column, again)
    assert_array_equal(scene.sweep_shape_many(*given, want='any', **span), found.t < np.inf)
    assert 0 < np.isfinite(found.t).sum() < count
    for i in range(count):
        poses = Slerp([0, 1], Rotation.from_quat([turns[i], goal_turns[i]]))(share).as_quat()
        places, when = starts[i] + share[:, None] * (goals[i] - starts[i]), {}
        if moving:
            when = {'at': span['at'] + np.rint(share * SECOND).astype(np.int64)}
        touches = scene.overlap_shape_many(shape, places, poses, **when)
        first = share[touches.argmax()] if touches.any() else np.inf
        assert found.free_until[i] <= first + 1e-9
        if found.t[i] < np.inf:  # something is near
            row = min(int(found.t[i] * steps), steps - 1)
            near = slice(row, row + 2)
            some = {name: rows[near] for name, rows in when.items()}
            options = {'tolerance': 0.05, **some}
            assert scene.overlap_shape_many(shape, places[near], poses[near], **options).any()
        one = scene.sweep_shape(
            changed(shape, position=starts[i : i + 1], orientation=turns[i : i + 1]),
            *(goals[i], goal_turns[i]),
            **span,
        )
        if one is None:
            assert found.handles[i] == NO_NODE
            assert np.isinf(found.t[i])
        else:
            assert (one.handle, one.t) == (found.handles[i], found.t[i])
            assert_array_equal(one.point, found.points[i])
            assert_array_equal(one.normal, found.normals[i])


def test_balls_are_as_swept_balls():
    rng = np.random.default_rng(5)
    scene = Scene()
    random_obstacles(rng, scene, False)
    starts, goals = rng.uniform(-5.0, 5.0, (2, 200, 3))
    found = scene.sweep_shape_many(Shapes.spheres([0, 0, 0], 0.3), starts, None, goals)
    balls = scene.sweep_many(starts, goals, 0.3)
    both = np.isfinite(balls.t) & np.isfinite(found.t)
    # Only where it grazes they may differ.
    assert np.count_nonzero(np.isfinite(balls.t) != np.isfinite(found.t)) <= 2
    assert not (np.isfinite(balls.t) & np.isinf(found.t)).any()
    assert (found.t[both] <= balls.t[both] + 1e-12).all()
    length = np.linalg.norm(goals - starts, axis=1)
    same = both & (found.handles == balls.handles)
    normal_speed = -((goals - starts) * balls.normals).sum(axis=1)
    square = same & (normal_speed > 0.5 * length) & (balls.t > 0.0)
    assert square.sum() > 30
    assert ((balls.t[square] - found.t[square]) * normal_speed[square] <= 1.01e-4).all()
    np.testing.assert_allclose(found.normals[square], balls.normals[square], atol=2e-2)
    np.testing.assert_allclose(found.points[square], balls.points[square], atol=2e-2)


def test_boxes_that_do_not_turn_are_as_swept_boxes():
    from bvh_ros import DynamicBVH

    rng = np.random.default_rng(6)
    lo = rng.uniform(-5.0, 5.0, (80, 3))
    hi = lo + rng.uniform(0.1, 1.0, (80, 3))
    tree = DynamicBVH()
    tree.insert_many(lo, hi)
    scene = scene_of(Shapes.boxes((lo + hi) / 2, hi - lo))
    size = np.array([0.6, 0.4, 0.3])
    starts, goals = rng.uniform(-6.0, 6.0, (2, 200, 3))
    found = scene.sweep_shape_many(Shapes.boxes([0, 0, 0], size), starts, None, goals)
    for i in range(200):
        hit = tree.boxcast(starts[i] - size / 2, starts[i] + size / 2, goals[i] - starts[i])
        if hit is None:
            continue
        assert found.t[i] <= hit.t + 1e-12
        assert (hit.t - found.t[i]) * np.abs((goals[i] - starts[i]) @ hit.normal) <= 1.01e-4


def test_a_half_turn_goes_as_the_signs_say():
    scene = scene_of(Shapes.spheres([[0, 2, 0], [0, -2, 0]], 0.1), names=['left', 'right'])
    corners = [[x, y, z] for x in (0.0, 3.0) for y in (-0.1, 0.1) for z in (-0.1, 0.1)]
    rod = Shapes.of_meshes([Mesh(hull_of(corners))], [0.0, 0.0, 0.0])
    for sign, name in ((1.0, 'left'), (-1.0, 'right')):
        hit = scene.sweep_shape(rod, [0, 0, 0], [0.0, 0.0, sign, 0.0])
        assert hit.name == name
        assert hit.t == pytest.approx(0.5, abs=0.05)
    # A quaternion and its negative are the same pose, but not the same half turn.
    turned = changed(rod, orientation=np.array([[0.0, 0.0, 0.0, -1.0]]))
    assert scene.sweep_shape(turned, [0, 0, 0], [0.0, 0.0, 1.0, 0.0]).name == 'right'
    # The nearest doubles to half a turn on either side.
    tiny = 1e-300
    assert scene.sweep_shape(rod, [0, 0, 0], [0.0, 0.0, 1.0, tiny]).name == 'left'
    assert scene.sweep_shape(rod, [0, 0, 0], [0.0, 0.0, 1.0, -tiny]).name == 'right'


@pytest.mark.parametrize('resolution', [1e-2, 1e-6, 1e-12])
def test_it_ends_in_extreme_cases(resolution):
    wall = Shapes.boxes([[0, 0, -1], [0, 0, 5]], [[100, 100, 2], [2, 2, 2]])
    scene = scene_of(wall, names=['floor', 'block'])
    given = {'resolution': resolution}
    box = Shapes.boxes([-40.0, 20.0, 0.15], [0.6, 0.4, 0.3])
    # It lies on the floor, or slides along it, closer than the resolution or farther.
    assert scene.sweep_shape(box, box.position[0], **given).t == 0.0
    for height, touches in ((0.15, True), (0.15 + 3e-2, False), (0.15 - 1e-3, True)):
        moved = changed(box, position=np.array([[-40.0, 20.0, height]]))
        hit = scene.sweep_shape(moved, [40.0, 20.0, height], [0.0, 0.0, 1.0, 0.0], **given)
        assert (hit is not None) == touches
    # From there it lifts off: touching at the start is contact.
    assert scene.sweep_shape(box, [-40.0, 20.0, 9.0], **given).t == 0.0
    # Far away, and very small.
    far = Shapes.boxes([-1e6, 0.0, 5.0], [1e-6, 1e-6, 1e-6], [0.6, 0.0, 0.0, 0.8])
    hit = scene.sweep_shape(far, [1e6, 0.0, 5.0], [0.0, 0.6, 0.0, 0.8], **given)
    assert hit.name == 'block'
    assert (1e6 - 1.0) / 2e6 - 2e-2 / 2e6 <= hit.t <= (1e6 - 1.0) / 2e6 + 1e-12
    off = changed(far, position=np.array([[-1e6, 1.1, 5.0]]))
    assert scene.sweep_shape(off, [1e6, 1.1, 5.0], [0.0, 0.6, 0.0, 0.8], **given) is None


def test_where_it_starts_in_an_obstacle_the_normal_is_zero():
    scene = scene_of(Shapes.boxes([0, 0, 0], [2, 2, 2]), names=['x'])
    hit = scene.sweep_shape(Shapes.boxes([0.5, 0, 0], [1, 1, 1]), [9, 0, 0], [0, 0, 1, 0])
    assert (hit.name, hit.t, hit.normal.tolist()) == ('x', 0.0, [0.0, 0.0, 0.0])
    hit = scene.sweep_shape(Shapes.boxes([5, 0.2, 0.1], [1, 1, 1]), [0, 0.2, 0.1])
    assert hit.t == pytest.approx(0.7, abs=1e-4)
    np.testing.assert_allclose(hit.normal, [1.0, 0.0, 0.0], atol=1e-9)
    assert hit.point[0] == pytest.approx(1.0, abs=1e-9)


def test_masks_and_tolerances_count():
    crates = Shapes.boxes([[2, 0, 0], [5, 0, 0]], [1, 1, 1])
    scene = scene_of(crates, names=['near', 'far'], categories=[1, 2])
    box = Shapes.boxes([0, 0, 0], [1, 1, 1])
    assert scene.sweep_shape(box, [9, 0, 0]).name == 'near'
    assert scene.sweep_shape(box, [9, 0, 0], mask=2).name == 'far'
    assert scene.sweep_shape(box, [9, 0, 0], mask=4) is None
    assert scene.sweep_shape(box, [9, 0, 0], tolerance=0.5).t == pytest.approx(0.5 / 9, abs=2e-5)
    found = scene.sweep_shape_many(box, [[0, 0, 0]] * 2, None, [[9, 0, 0]] * 2, None, 0.0, [1, 2])
    assert found.t[0] < found.t[1] < 1.0


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'positions': [[0, 0, np.nan]] * 2}, 'positions must be finite: row 0'),
        ({'goal_positions': [[0, 0, 0], [np.inf, 0, 0]]}, 'goal_positions must be finite: row 1'),
        ({'orientations': [[0, 0, 0, 2.0]] * 2}, 'orientations must be quaternions'),
        ({'goal_orientations': [[0, 0, 0, 1.0], [0, 0, 0, 0]]}, 'goal_orientations .* row 1'),
        ({'resolution': 0.0}, 'resolution must be finite and above 0'),
        ({'resolution': np.inf}, 'resolution must be finite and above 0'),
        ({'resolution': -1.0}, 'resolution'),
        ({'tolerance': np.inf}, 'tolerance must be finite'),
        ({'want': 'all'}, "want must be first or any, not 'all'"),
        ({'threads': 0}, 'threads'),
        ({'goal_positions': [[0, 0, 0]]}, 'goal_positions'),
        ({'shape': Shapes.boxes([[0, 0, 0]] * 2, [1, 1, 1])}, 'shape must be one row'),
        ({'until': 5}, 'until needs at'),
        (
            {'positions': [[-1e308, 0, 0]] * 2, 'goal_positions': [[1e308, 0, 0]] * 2},
            'the way of row 0 is longer than a double',
        ),
    ],
)
def test_bad_arguments_are_named(change, message):
    scene = Scene()
    given = {
        'shape': Shapes.boxes([0, 0, 0], [1, 1, 1]),
        'positions': [[0, 0, 0]] * 2,
        'orientations': None,
        'goal_positions': [[1, 0, 0]] * 2,
    }
    with pytest.raises(ValueError, match=message):
        scene.sweep_shape_many(**{**given, **change})


@pytest.mark.parametrize('gap', [1e-4, 1e-8])
def test_a_tilted_plate_turns_below_a_ball_on_its_axis(gap):
    """Their distance stays the same, so no plane at rest keeps them apart for long."""
    tilt, turn = 0.3, 1.5
    height = (1.5 + gap) / np.cos(tilt)
    scene = scene_of(Shapes.spheres([[0.0, 0.0, height]], 1.0), names=['ball'])
    first = Rotation.from_rotvec([tilt, 0.0, 0.0])
    last = Rotation.from_rotvec([0.0, 0.0, turn]) * first
    plate = Shapes.boxes([0.0, 0.0, 0.0], [4.0, 4.0, 1.0], first.as_quat())
    given = [0.0, 0.0, 0.0], last.as_quat()
    assert scene.sweep_shape(plate, *given, resolution=gap / 2.0) is None
    assert scene.sweep_shape(plate, *given, resolution=gap * 2.0) is not None
    assert scene.sweep_shape(plate, *given, gap * 1.1, resolution=gap / 4.0).t == 0.0


def test_a_mesh_far_from_its_origin_and_the_worlds():
    """Where its middle is rounded, a ball that slides over its top is not free for that."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) + 11.7
    corners = corners.astype(np.float32).astype(float)
    mesh, missed = Mesh(hull_of(corners)), 0
    for k in range(60):
        z = 1e6 + k * 0.37
        top = Fraction(z) + Fraction(corners[:, 2].max())
        above = float(top) + 1.25
        gap = Fraction(above) - Fraction(0.25) - top
        tolerance = float(gap)
        if Fraction(tolerance) < gap:
            tolerance = float(np.nextafter(tolerance, 9.0))
        scene = scene_of(Shapes.of_meshes([mesh], [[0.0, 0.0, z]]), names=['mesh'])
        ball = Shapes.spheres([[8.0, 12.2, above]], 0.25)
        missed += (
            scene.sweep_shape(ball, [16.0, 12.2, above], None, tolerance, resolution=1e-9) is None
        )
    assert missed == 0


def test_ties_go_to_the_smaller_handle():
    box, rng = Shapes.boxes([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), np.random.default_rng(8)
    for singly in (False, True):
        scene = Scene()
        same = Shapes.boxes(np.tile([5.0, 0.0, 0.0], (8, 1)), [1.0, 1.0, 1.0])
        for k in range(8 if singly else 1):
            rows = [k] if singly else list(range(8))
            scene.update('a', [str(row) for row in rows], same.take(rows), stamp=1)
        assert scene.sweep_shape(box, [10.0, 0.0, 0.0]).name == '0'
        turn = random_turns(rng, 1)[0]
        assert scene.sweep_shape(box, [10.0, 0.2, 0.0], turn).name == '0'
    scene = scene_of(Shapes.boxes([[5, 0, 0], [9, 0, 0]], [1, 1, 1]), names=['1', '2'])
    assert scene.sweep_shape(box, [10.0, 0.0, 0.0], resolution=9.0).name == '1'


def test_an_arm_turns_round_a_column():
    """Its distance stays 0.12 mm; it is the obstacle that is round about the axis."""
    corners = [[x, y, z] for x in (10.0, 11.0) for y in (-20.0, 20.0) for z in (-0.5, 0.5)]
    arm = Shapes.of_meshes([Mesh(hull_of(corners))], [0.0, 0.0, 0.0])
    goal = [0.0, 0.0, 0.0], [0.0, 0.0, np.sin(1.5), np.cos(1.5)]
    for planar in (False, True):
        column = Shapes.cylinders([[0.0, 0.0, 0.0]], 10.0 - 1.2e-4, 1.0)
        scene = scene_of(column, planar=planar, names=['column'])
        assert scene.sweep_shape(arm, *goal) is None
        assert scene.sweep_shape(arm, *goal, resolution=1e-6) is None
        assert scene.sweep_shape(arm, *goal, resolution=1e-3).t == 0.0


def test_an_obstacle_far_from_where_it_was_told():
    """921.9 m/s for 64 s: where it is then is rounded, and a touch is not free for that."""
    z = 59224.33241751894
    crate = Shapes.boxes([[0.0, 0.0, 1.0021521802443287]], [1.0, 1.0, 1.0])
    scene = scene_of(crate, names=['x'], stamp=0, velocities=[[0.0, 0.0, 921.9040736673851]])
    box = Shapes.boxes([[-3.0, 0.0, z]], [0.5, 0.5, 0.5])
    given = {'tolerance': 0.7500000000018653, 'resolution': 1e-12, 'at': 64238603513}
    assert scene.sweep_shape(box, [2.0, 0.0, z], **given) is not None


@pytest.mark.timeout(300)  # in parts as short as the body it would not end
@pytest.mark.parametrize('velocity', [None, (0.0, 0.0, 1e-9)])
def test_a_body_like_a_point_goes_among_boxes_that_are_near_all_the_time(velocity):
    """The boxes around leaning sticks hold all of the way, which none of the sticks touches."""
    height = np.linspace(0.05, 0.8, 20)
    places = np.stack((0.0 * height, height, height + 0.3), axis=1)
    leaning, _ = Rotation.align_vectors([[1.0, 1.0, 1.0]], [[1.0, 0.0, 0.0]])
    turns, sizes = np.tile(leaning.as_quat(), (20, 1)), np.tile((4.0, 0.01, 0.01), (20, 1))
    scene = scene_of(Shapes.boxes(places, sizes, turns))
    wall = Shapes.boxes([0.9, 0.0, 0.0], 0.2)
    scene.update('wall', ['wall'], wall, stamp=0)
    if velocity is not None:
        sticks = Shapes.boxes(places, sizes, turns)
        names = [f'stick{k}' for k in range(20)]
        scene.update('moving', names, sticks, stamp=0, velocities=np.tile(velocity, (20, 1)))
    point = Shapes.spheres([-1.0, 0.0, 0.0], 1e-15)
    hit = scene.sweep_shape(point, (1.0, 0.0, 0.0), at=None if velocity is None else 0.0)
    assert hit.name == 'wall'
    assert hit.t == pytest.approx(0.9, abs=1e-4)
