# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Floats are seconds and integers are nanoseconds, for the tree, the scene and the client."""

from fractions import Fraction

import numpy as np
import pytest

from bvh_ros import DynamicBVH, Scene, Shapes

SECONDS = [0.0, 1.0, 2.5, -1.25]
SAME = [lambda s: round(s * 1e9), lambda s: np.int64(s * 1e9), lambda s: np.float32(s)]


def moving_tree(reference: object) -> DynamicBVH:
    tree = DynamicBVH(2)
    car = tree.insert([10, -1], [14, 1])
    tree.set_velocities([car], [[-3, 0]], reference)
    return tree


@pytest.mark.parametrize('same', SAME, ids=['int', 'int64', 'float32'])
@pytest.mark.parametrize('second', SECONDS)
def test_a_tree_takes_both(second: float, same: object) -> None:
    tree, time = moving_tree(0.5), same(second)  # type: ignore[operator]
    rows = [[0.0, 0.0]] * 2, [[1.0, 0.0]] * 2
    right = tree.raycast([0, 0], [1, 0], at=second)
    assert right.t == 10 - 3 * (second - 0.5)
    assert tree.raycast([0, 0], [1, 0], at=time).t == right.t
    assert tree.raycast_all([0, 0], [1, 0], at=time)[0].t == right.t
    assert tree.raycast_many(*rows, at=[time] * 2).t.tolist() == [right.t] * 2
    assert tree.raycast_many(*rows, at=np.array([time] * 2)).t.tolist() == [right.t] * 2
    assert tree.overlap(right.point, right.point, at=time).tolist() == [right.id]
    assert tree.nearest([0, 0], at=time)[1].tolist() == [right.t]
    assert tree.nearest_many(rows[0], at=time)[1].ravel().tolist() == [right.t] * 2
    assert moving_tree(same(0.5)).raycast([0, 0], [1, 0], at=time).t == right.t  # type: ignore[operator]


def test_a_pace_is_in_seconds() -> None:
    tree = moving_tree(0)
    assert (
        tree.raycast([0, 0], [2, 0], pace=1).t == tree.raycast([0, 0], [2, 0], pace=1.0).t == 2.0
    )


def moving_scene(stamp: object) -> Scene:
    scene = Scene()
    box = Shapes.boxes([[10, 0, 0]], 1)
    assert not scene.update('s', ['car'], box, stamp=stamp, velocities=[[-3, 0, 0]])
    return scene


@pytest.mark.parametrize('same', SAME, ids=['int', 'int64', 'float32'])
@pytest.mark.parametrize('second', SECONDS)
def test_a_scene_takes_both(second: float, same: object) -> None:
    time, later = same(second), same(second + 1)  # type: ignore[operator]
    ways, point = ([[0, 0, 0]] * 2, [[20, 0, 0]] * 2), [0, 0, 0]
    scenes = [(moving_scene(0.5), time, later), (moving_scene(500_000_000), second, second + 1)]
    for scene, at, until in scenes:
        assert scene.newest == 500_000_000
        t = (9.5 - 3 * (second - 0.5)) / 20
        assert scene.raycast(*np.array(ways)[:, 0], at=at).t == t
        assert scene.sweep_many(*ways, at=at).t.tolist() == [t] * 2
        assert scene.sweep_many(*ways, at=[at] * 2).t.tolist() == [t] * 2
        assert scene.raycast_many(*ways, at=at).t.tolist() == [t] * 2
        assert scene.nearest(point, at=at)[0].t == 20 * t
        assert scene.nearest_many([point], at=[at])[1].tolist() == [[20 * t]]
        met = scene.raycast(*np.array(ways)[:, 0], at=at, until=until).t
        assert met == pytest.approx(20 * t / 23, rel=1e-15)
        assert scene.sweep_many(*ways, at=at, until=until).t.tolist() == [met] * 2


def test_obstacles_expire_at_floats_too() -> None:
    scene = Scene()
    boxes = Shapes.boxes(np.eye(3) * 9, 1)
    scene.update('s', ['a', 'b', 'c'], boxes, stamp=[0.5, 1.5, 2.5], expires=[1.0, 2.0, 3.0])
    assert [scene.get(name).stamp for name in 'abc'] == [5 * 10**8, 15 * 10**8, 25 * 10**8]
    assert (scene.newest, scene.expire(2.0), len(scene)) == (2_500_000_000, 2, 1)
    assert scene.expire(3_000_000_000) == 1


@pytest.mark.parametrize(
    'bad', [float('nan'), float('inf'), np.float16(np.inf), 1e300, '1', None, 1j]
)
def test_what_is_no_time(bad: object) -> None:
    scene = moving_scene(0.0)
    for call in (scene.expire, lambda time: scene.update('s', ['car'], BOX, expires=time)):
        with pytest.raises(ValueError, match=r'(now|expires) must be'):
            call(bad)


BOX = Shapes.boxes([[0, 0, 0]], 1)


@pytest.mark.parametrize('mixed', [[1, 2.0], (0.5, 2), [np.int64(1), np.float64(2)]])
def test_times_of_both_kinds(mixed: object) -> None:
    """numpy makes seconds of the integers among them."""
    tree, scene, rows = moving_tree(0.5), moving_scene(0.5), ([[0, 0, 0]] * 2, [[20, 0, 0]] * 2)
    for call in (
        lambda: tree.nearest_many([[0, 0]] * 2, at=mixed),
        lambda: scene.sweep_many(*rows, at=mixed),
        lambda: scene.sweep_many(*rows, at=0.5, until=mixed),
        lambda: scene.nearest_many(rows[0], at=mixed),
        lambda: scene.update('s', ['a', 'b'], Shapes.boxes(rows[0], 1), stamp=mixed),
        lambda: scene.update('s', ['a', 'b'], Shapes.boxes(rows[0], 1), stamp=0, expires=mixed),
    ):
        with pytest.raises(ValueError, match='all integers'):
            call()
    assert len(scene) == 1


def test_seconds_are_the_nearest_nanosecond() -> None:
    """Also of times that have no digits left for their nanoseconds."""
    from bvh_ros.tree.access import whole_ns

    times = np.random.default_rng(2).uniform(-2e9, 2e9, 20_000)
    for seconds in times, (times * 1e-9).astype(np.float32):
        exact = [round(Fraction(second) * 10**9) for second in seconds.tolist()]
        assert whole_ns('at', seconds, seconds).tolist() == exact
