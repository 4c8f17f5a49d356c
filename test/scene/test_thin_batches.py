# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Few thin rays among boxes are one kernel: each is what the single question says, whether there
is a snapshot, one that was patched, or none.
"""

import numpy as np
import pytest

from bvh_ros.scene import NO_NODE, Scene, Shapes

SIZES = 1, 7, 150, 924, 1074


def boxes(rng, count):
    """Boxes on whole numbers, so that hits tie."""
    return Shapes.boxes(rng.integers(-20, 21, (count, 3)), rng.integers(0, 5, (count, 3)) * 1.0)


def world(count, planar=False):
    rng = np.random.default_rng(count)
    scene = Scene(planar=planar)
    masks = rng.integers(1, 4, count)
    names = [str(i) for i in range(count)]
    scene.update('test', names, boxes(rng, count), stamp=1, categories=masks)
    return scene, rng


def check(scene, rng, count):
    starts = rng.integers(-26, 27, (count, 3)) * 1.0
    ways = rng.integers(-9, 10, (count, 3)) * 1.0
    ways[::31] = 0.0
    starts[::13] *= 1e6
    mask = int(rng.integers(1, 4))
    found = scene.raycast_many(starts, ways, 1.0, mask)
    for one, other in zip(found, scene.sweep_many(starts, starts + ways, mask=mask), strict=True):
        np.testing.assert_array_equal(one, other)
    for row in range(0, count, 1 + count // 50):
        hit = scene.raycast(starts[row], starts[row] + ways[row], mask=mask)
        if hit is None:
            assert (found.handles[row], found.t[row]) == (NO_NODE, np.inf)
            assert np.isnan(found.points[row]).all()
            assert not found.normals[row].any()
        else:
            assert (found.handles[row], found.t[row]) == (hit.handle, hit.t)
            assert found.points[row].tolist() == hit.point.tolist()
            assert found.normals[row].tolist() == hit.normal.tolist()


@pytest.mark.parametrize('planar', [False, True], ids=['solid', 'planar'])
@pytest.mark.parametrize('many', [0, 1, 300, 15_000])
def test_each_is_the_single_question(many, planar):
    scene, rng = world(many, planar)
    check(scene, rng, 20)  # there is no snapshot yet
    scene.raycast_many(*rng.normal(size=(2, 8000, 3)))
    for count in SIZES:
        check(scene, rng, count)
    if many > 1:
        moved = rng.choice(many, 5, replace=False)
        scene.update('test', [str(i) for i in moved], boxes(rng, 5), stamp=2)
        check(scene, rng, 60)
        scene.remove('test', [str(i) for i in moved[:2]])
        check(scene, rng, 60)


@pytest.mark.parametrize('asked', [0, 8000], ids=['no snapshot', 'a snapshot'])
@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(asked, bad):
    scene, rng = world(300)
    scene.raycast_many(*rng.normal(size=(2, asked, 3)))
    rows, other = rng.uniform(30, 40, (5, 3)), np.ones((5, 3))  # they fly away from all
    rows[3, 1] = bad
    for ask, first, second in (
        (scene.raycast_many, 'origins', 'directions'),
        (scene.sweep_many, 'starts', 'goals'),
    ):
        with pytest.raises(ValueError, match=f'{first} must be finite: row 3'):
            ask(rows, other)
        with pytest.raises(ValueError, match=f'{second} must be finite: row 3'):
            ask(other, rows)
    with pytest.raises(ValueError, match='the segment of row 1 is longer'):
        scene.sweep_many([[0, 0, 0], [1e308] * 3], [[1, 0, 0], [-1e308] * 3])


@pytest.mark.parametrize('radius', [None, 0.0, 0.5, [0.0, 0.5, 0.0, 0.5, 0.5]])
@pytest.mark.parametrize('planar', [False, True], ids=['solid', 'planar'])
@pytest.mark.parametrize('turned', [False, True], ids=['boxes', 'turned'])
def test_no_kernel_answers_what_is_not_finite(planar, turned, radius):
    scene, turn = Scene(planar=planar), [[0.0, 0.0, 0.3, 1.0]] if turned else None
    scene.update('test', ['one'], Shapes.boxes([[0.0] * 3], [1.0] * 3, turn), stamp=1)
    good, rows = np.ones((5, 3)), np.full((5, 3), 30.0)
    for axis in range(3):
        for bad in np.nan, np.inf, -np.inf:
            rows[3] = 30.0
            rows[3, axis] = bad
            with pytest.raises(ValueError, match='origins must be finite: row 3'):
                scene.raycast_many(rows, good, 1.0, radius=radius)
            with pytest.raises(ValueError, match='directions must be finite: row 3'):
                scene.raycast_many(good, rows, 0.0, radius=radius)
    if radius:
        with pytest.raises(ValueError, match='end the way of a ball: row 3 has none'):
            scene.raycast_many(good, good, [1, 1, 1, np.inf, 1], radius=radius)
