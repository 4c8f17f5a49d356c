# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls while obstacles move: as each obstacle, alone, sees them from its place."""

import math
from fractions import Fraction

import numpy as np
import pytest
from scene.reference import changed, scene_of
from scene.shapes.test_convexity import prism
from scene.test_then import some_shapes

from bvh_ros.scene import NO_NODE, Mesh, NodeScene, Numbered, Part, ShapeKind, Shapes

BOX, SPHERE, CYLINDER, *_ = ShapeKind

SECOND = 1_000_000_000
NOW = 1_790_000_000 * SECOND
Random = np.random.Generator


def alone(shapes: Shapes, row: int, planar: bool) -> NodeScene:
    return scene_of(shapes.take(np.array([row])), planar=planar, names=['one'], stamp=0)


@pytest.mark.slow
@pytest.mark.parametrize('planar', [False, True])
def test_each_obstacle_is_met_as_it_sees_the_ray(planar: bool):
    rng, count = np.random.default_rng(7), 16
    shapes = some_shapes(rng, count)
    names = [f'o{i}' for i in range(count)]
    velocities = rng.normal(size=(count, 3)) * (rng.random((count, 1)) < 0.8) * [3, 3, 0.5]
    stamps = NOW + rng.integers(0, SECOND, count)
    scene = scene_of(shapes, planar=planar, names=names, stamp=stamps, velocities=velocities)
    each = [alone(shapes, row, planar) for row in range(count)]
    for number in range(40):
        start, goal = rng.uniform(-9, 9, (2, 3))
        radius = float(number % 2) * 0.3
        at = NOW + int(rng.integers(-SECOND, 2 * SECOND))
        until = None if number % 5 == 0 else at + int(rng.integers(0, 3 * SECOND))
        wanted = []
        for row, one in enumerate(each):
            begin = (at - int(stamps[row])) * 1e-9
            end = begin if until is None else (until - int(stamps[row])) * 1e-9
            seen = start - velocities[row] * begin, goal - velocities[row] * end
            hit = one.raycast(*seen, radius)
            if hit is not None:
                when = begin + hit.t * (end - begin)
                wanted.append((hit.t, names[row], hit.point + velocities[row] * when, hit.normal))
        wanted.sort(key=lambda hit: hit[0])
        hits = scene.raycast_all(start, goal, radius, at=at, until=until)
        assert [hit.name for hit in hits] == [hit[1] for hit in wanted]
        for hit, (t, _, point, normal) in zip(hits, wanted, strict=True):
            assert hit.t == pytest.approx(t, abs=1e-9)
            axes = slice(2 if planar else 3)
            np.testing.assert_allclose(hit.point[axes], point[axes], atol=1e-6)
            np.testing.assert_allclose(hit.normal, normal, atol=1e-6)
        first = scene.raycast(start, goal, radius, at=at, until=until)
        assert (first is None) == (not hits)
        many = scene.sweep_many([start] * 3, [goal] * 3, radius, at=at, until=until, threads=2)
        outside = [hit for hit in hits if hit.t > 0.0 or hit.normal.any()]
        skipped = scene.raycast_all(start, goal, radius, skip_inside=True, at=at, until=until)
        assert [hit.name for hit in skipped][:1] in ([hit.name for hit in outside][:1], [])
        if first is not None:
            assert (first.handle, first.t) == (hits[0].handle, hits[0].t)
            assert many.handles.tolist() == [first.handle] * 3
            assert many.t.tolist() == [first.t] * 3
            assert many.points[2].tolist() == first.point.tolist()


def test_the_world_as_last_told_and_at_rest():
    scene = NodeScene()
    boxes = Shapes.boxes([[10, 0, 0], [0, 10, 0]], [1, 1, 1])
    still = scene.raycast([0, 0, 0], [20, 0, 0], at=NOW)
    assert still is None
    scene.update('s', ['car', 'cart'], boxes, stamp=NOW, velocities=[[-5, 0, 0], [0, 0, 0]])
    way = [[0, 0, 0]] * 2, [[20, 0, 0]] * 2
    assert scene.raycast([0, 0, 0], [20, 0, 0]).t == 0.475
    assert scene.raycast_many(*way).t.tolist() == [0.475] * 2
    assert scene.sweep_many(*way).t.tolist() == [0.475] * 2
    times = [NOW, NOW + SECOND]
    assert scene.sweep_many(*way, at=times).t.tolist() == [0.475, 0.225]
    assert scene.raycast([0, 0, 0], [20, 0, 0], at=NOW, until=NOW + 4 * SECOND).t == 0.2375
    # Who is told again without a velocity is at rest.
    scene.update('s', ['car'], boxes.take([0]), stamp=NOW + SECOND)
    assert scene.raycast([0, 0, 0], [20, 0, 0], at=NOW + 9 * SECOND).t == 0.475
    scene.replace('s', '', ['car'], boxes.take([0]), stamp=NOW, velocities=[[5, 0, 0]])
    assert scene.raycast([0, 0, 0], [20, 0, 0], at=NOW + SECOND).t == 0.725
    assert len(scene) == 1


def test_updates_in_slices_keep_velocities(set_slices):
    set_slices(20, 7)
    count = 50
    boxes = Shapes.boxes(10.0 * np.arange(3.0 * count).reshape(count, 3), [1, 1, 1])
    names, speeds = Numbered('b#', np.arange(count)), np.full((count, 3), 2.0)
    scene = scene_of(boxes, names=names, source='s', of=NodeScene, stamp=NOW, velocities=speeds)
    moved = changed(boxes, position=boxes.position + 5.0)
    part, seen = Part(names, moved, NOW + SECOND, velocities=-speeds), []
    for _ in scene.in_slices('s', '', count, part.cut, whole=True):
        # Where the first one was told to go before, and where it is now.
        places = boxes.position[0] + 4.0, moved.position[0] - 2.0
        hits = [scene.raycast(place, place, at=NOW + 2 * SECOND) for place in places]
        seen.append([hit and hit.name for hit in hits])
    assert seen[0] == ['b#0', 'b#0']
    for row in (0, 17, 49):
        place = moved.position[row] - 2.0
        assert scene.raycast(place, place, at=NOW + 2 * SECOND).name == f'b#{row}'
    assert scene.raycast(places[0], places[0], at=NOW + 2 * SECOND) is None


def test_what_is_refused():
    scene = NodeScene()
    boxes = Shapes.boxes([[10, 0, 0]], [1, 1, 1])
    for wrong in ([[1, 2]], [1, 2, 3], [[0, 0, 0]] * 2, 'x'):
        with pytest.raises(ValueError, match='velocities'):
            scene.update('s', ['car'], boxes, stamp=NOW, velocities=wrong)
    assert len(scene) == 0
    scene.update('s', ['car'], boxes, stamp=NOW, velocities=[[1, 0, 0]])
    ends = [0, 0, 0], [20, 0, 0]
    for times in (
        {'until': 5},
        {'at': 6, 'until': 5},
        {'at': math.nan},
        {'at': 1, 'until': [1, 2]},
    ):
        with pytest.raises(ValueError, match=r'at|until'):
            scene.raycast(*ends, **times)
        with pytest.raises(ValueError, match=r'at|until'):
            scene.raycast_all(*ends, **times)
    for beyond in (1 << 63, [10**30], -(10**30)):
        with pytest.raises(ValueError, match='at must be from -9223372036854775808 to'):
            scene.raycast_many(ends[:1], ends[1:], at=beyond)
    with pytest.raises(ValueError, match='t_max must end the path of a ball: row 0'):
        scene.raycast_many(ends[:1], ends[1:], radius=1.0, at=NOW)
    with pytest.raises(ValueError, match='1 hits, more than 0'):
        scene.raycast_all(*ends, at=NOW, most=0)


@pytest.mark.parametrize('radius', [0.0, 0.3])
def test_nobody_is_met_where_all_that_moved_have_gone(radius: float):
    box = Shapes.boxes([[5, 0, 0]], [1, 1, 1])
    scene = scene_of(box, names=['car'], source='s', stamp=NOW, velocities=[[1, 0, 0]])
    assert scene.remove('s', ['car']) == 1
    ways, later = ([[0, 0, 0]] * 3, [[9, 0, 0]] * 3), NOW + SECOND
    for until in (None, later):
        hits = scene.sweep_many(*ways, radius, at=NOW, until=until)
        assert hits.handles.tolist() == [NO_NODE] * 3
        assert np.isinf(hits.t).all()
        assert np.isnan(hits.points).all()
        assert not hits.normals.any()
        assert scene.raycast([0, 0, 0], [9, 0, 0], radius, at=NOW, until=until) is None
        assert scene.raycast_all([0, 0, 0], [9, 0, 0], radius, at=NOW, until=until) == []


def near_zero_and_now(scene: NodeScene) -> list[float]:
    """How far a car has come that is told now, where somebody was told when the clock said 0."""
    old, car = Shapes.boxes([[0, 500, 0]], [1, 1, 1]), Shapes.boxes([[5, 0, 0]], [1, 1, 1])
    scene.update('s', ['old'], old, stamp=1, velocities=[[0, 0, 1]])
    scene.update('s', ['car'], car, stamp=NOW + 1, velocities=[[-1e4, 0, 0]])
    times = range(NOW + 1, NOW + 3000, 7)
    hits = [scene.raycast([0, 0, 0], [8, 0, 0], at=at) for at in times]
    return [
        abs(hit.t * 8 - (4.5 - 1e-5 * (at - NOW - 1)))
        for hit, at in zip(hits, times, strict=True)
        if hit is not None and hit.name == 'car'
    ]


def test_nanoseconds_count_wherever_the_clock_began():
    scene = NodeScene()
    errors = near_zero_and_now(scene)
    assert len(errors) == 429
    assert max(errors) < 1e-13  # 1.2 mm with times of 1e9 s in doubles
    (old,) = scene.nearest([0, 500, NOW / 1e9], at=NOW)
    assert (old.name, old.t) == ('old', 0.0)
    scene.update('s', ['car'], Shapes.boxes([[5, 0, 0]], [1, 1, 1]), stamp=NOW + 2 * SECOND)
    assert scene.raycast([0, 0, 0], [8, 0, 0], at=NOW + 1).t * 8 == 4.5  # at rest


def test_time_begins_anew_when_all_are_forgotten_or_at_rest():
    scene, box = NodeScene(), Shapes.boxes([[5, 0, 0]], [1, 1, 1])
    for forget in (scene.clear, scene.rest, lambda: scene.remove('s', ['car'])):
        scene.update('s', ['car'], box, stamp=NOW, velocities=[[1, 0, 0]])
        forget()
        scene.update('s', ['car'], box, stamp=1, velocities=[[-1e4, 0, 0]])
        hit = scene.raycast([0, 0, 0], [8, 0, 0], at=8)  # as the clock was set back
        assert hit is not None
        assert abs(hit.t * 8 - (4.5 - 7e-5)) < 1e-13
        scene.update('s', ['car'], box, stamp=1)
        scene.clear()


def test_a_scene_tells_exactly_who_is_met_first():
    """Two boxes are met within the last digit of t; the younger one, who comes, is first."""
    sizes = np.full((3, 3), 2.0)
    places = np.array([[2.0, 0, 0], [2.0, 0, 0], [0, 9.0, 0]])
    shapes = Shapes(np.array([BOX, BOX, SPHERE], np.uint8), places, [0, 0, 0, 1], sizes)
    slow = np.array([[0, 0, 0], [-1e-20, 0, 0], [0, 0, 0]])
    scene = scene_of(shapes, names=['rests', 'comes', 'a ball'], stamp=0, velocities=slow)
    hits = scene.raycast_all([0, 0, 0], [4, 0, 0], at=0, until=10**9)
    assert [hit.name for hit in hits] == ['comes', 'rests']
    assert hits[0].t == hits[1].t == 0.25


SOLIDS = {
    'sphere': lambda place, size: Shapes.spheres([place], size),
    'capsule': lambda place, size: Shapes.capsules([place], size, 2 * size + 2),
    'cylinder': lambda place, size: Shapes.cylinders([place], size, 2.0),
    'turned box': lambda place, size: Shapes.boxes([place], [2 * size] * 3, [(0, 0, 0.6, 0.8)]),
    'box': lambda place, size: Shapes.boxes([place], [2 * size] * 3),
}
OUTWARDS = {  # the normal of a side, in rational numbers
    'turned box': (Fraction(7, 25), Fraction(24, 25)),
    'box': (Fraction(1), Fraction(0)),
}


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('kind', list(SOLIDS))
def test_a_ray_hits_what_its_end_touches_however_far_it_went(kind: str, planar: bool):
    """Rays that end on the surface to the last digit, at shapes that have gone up to 10,000 km."""
    rng, asked = np.random.default_rng(5), 0
    outwards = OUTWARDS.get(kind, (Fraction(3, 5), Fraction(4, 5)))
    for _ in range(150):
        size, radius = rng.choice([0.1, 0.5, 1.0]), rng.choice([0.0, 0.25, 1.0])
        place, velocity = rng.uniform(-5, 5, 3), rng.uniform(-1, 1, 3) * 10 ** rng.uniform(0, 3)
        at = int(rng.choice([SECOND, 333_333_333, 123_456_789_012, 10_000 * SECOND]))
        gone = [Fraction(place[k]) + Fraction(velocity[k]) * at / SECOND for k in range(3)]
        if kind == 'box' and radius == 0.0:
            radius = 0.25  # thin rays at boxes are exact
        ends = np.array([gone, gone], dtype=float)
        for axis in range(2):
            for row, more in enumerate((2, 0)):
                off = Fraction(size) + Fraction(radius) + more
                ends[row, axis] = float(gone[axis] + outwards[axis] * off)
        start, goal = ends
        if any(
            Fraction(goal[k] - start[k]) != Fraction(goal[k]) - Fraction(start[k])
            for k in range(3)
        ):
            continue  # its direction would be rounded
        scene = scene_of(
            SOLIDS[kind](place, size), planar=planar, names=['it'], stamp=0, velocities=[velocity]
        )
        if not scene.overlap(goal, goal, tolerance=radius, at=at):
            continue
        asked += 1
        for times in ({'at': at}, {'at': at - SECOND, 'until': at}):
            assert scene.raycast(start, goal, radius, **times) is not None
            assert len(scene.raycast_all(start, goal, radius, **times)) == 1
            for rows in (1, 64):
                many = scene.sweep_many([start] * rows, [goal] * rows, radius, **times)
                assert np.isfinite(many.t).all()
    assert asked > 20


@pytest.mark.parametrize('radius', [0.0, 0.5])
@pytest.mark.parametrize('kind', list(SOLIDS))
def test_what_goes_farther_than_all_doubles_is_not_passed(kind: str, radius: float):
    for velocity in (1e307, 1e308):
        scene = scene_of(
            SOLIDS[kind](np.zeros(3), 1.0), names=['it'], stamp=0, velocities=[[velocity, 0, 0]]
        )
        for start, goal in (([0, 0, 0], [10, 0, 0]), ([5, 0, 0], [6, 0, 0])):
            hit = scene.raycast(start, goal, radius, at=0, until=10 * SECOND)
            assert hit is not None
            assert hit.t < 1e-306
            many = scene.sweep_many([start], [goal], radius, at=0, until=10 * SECOND)
            assert many.t[0] == hit.t


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('radius', [0.0, 2.0**-20])
def test_what_stops_is_hit_where_the_ray_enters_it_again(planar: bool, radius: float):
    """A ray in the notch of a mesh goes with it until that stops, then through its arms."""
    outline = np.array([[0, 0], [0, 2], [-2, 2], [-2, -2], [2, -2], [2, 0]], float)
    rng, free, mesh = np.random.default_rng(4), 0, Mesh(prism(outline))
    assert not mesh.convex
    rest = scene_of(Shapes.of_meshes(mesh), planar=planar, names=['it'], stamp=0)
    for number in range(60):
        velocity = np.append(rng.integers(-16, 17, 2) / 2.0, 0.0)
        scene = NodeScene(max_prediction=1.0, planar=planar)
        scene.update('s', ['it'], Shapes.of_meshes(mesh), stamp=0, velocities=[velocity])
        # As the obstacle sees them: for a second in the notch, and one beyond.
        starts = np.append(rng.uniform(0.25, 1.75, (20, 2)), np.zeros((20, 1)), axis=1)
        slow = rng.normal(size=(20, 3)) * [1e-9, 1e-3, 0.1, 0.0][number % 4] * [1, 1, 0]
        goals = starts + 2 * (velocity + slow)
        stop = starts + slow
        before = rest.sweep_many(starts, stop, radius).t * 0.5
        wanted = 0.5 + rest.sweep_many(stop, goals - velocity, radius).t * 0.5
        wanted[np.isfinite(before)] = before[np.isfinite(before)]
        hits = scene.sweep_many(starts, goals, radius, at=0, until=2 * SECOND)
        np.testing.assert_allclose(hits.t, wanted, rtol=0, atol=1e-9)
        points = np.isfinite(wanted)
        free += points.size - np.count_nonzero(points)
        for row in np.flatnonzero(points)[:3]:
            one = scene.raycast(starts[row], goals[row], radius, at=0, until=2 * SECOND)
            assert one.t == hits.t[row]
            assert one.point.tolist() == hits.points[row].tolist()
            (every,) = scene.raycast_all(starts[row], goals[row], radius, at=0, until=2 * SECOND)
            assert every.t == one.t
    assert 100 < free < 1100


@pytest.mark.parametrize('kind', list(SOLIDS))
def test_an_endless_ray_beside_what_goes_with_it_is_free(kind: str):
    velocity = np.array([242.9388530987352, 1801.4208584493329, -764.4641157203993])
    direction = np.array([0.24293885309873522, 1.8014208584493332, -0.7644641157203994])
    scene = scene_of(SOLIDS[kind](np.zeros(3), 1.0), names=['it'], stamp=0, velocities=[velocity])
    for away in (1e-3, 1.0, 1e6):
        for limit in (1.0, 1e9, np.inf):
            start = [[3.0 + away, 0, 0]]
            hits = scene.raycast_many(start, [direction], limit, at=0, until=1_000_000)
            assert np.isinf(hits.t).all() or hits.t[0] > 1e9
