# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Velocities from successive updates: jitter, jumps, late stamps, and who vanishes."""

import math

import numpy as np
import pytest
from scene.inside import store_of
from scene.reference import changed

from bvh_ros.scene import NodeScene, Numbered, Part, Shapes
from bvh_ros.scene.tracking import Tracks

SECOND = 1_000_000_000
NOW = 1_790_000_000 * SECOND


def told(tracks, places, stamps):
    """Tell one obstacle again and again; its velocity after each time but the first."""
    scene, found = NodeScene(), []
    for place, stamp in zip(places, stamps, strict=True):
        box = Shapes.boxes([place], [1, 1, 1])
        assert not scene.update('s', ['one'], box, stamp=stamp, velocities=tracks)
        found.append(velocity(scene, 'one'))
    return found[1:]


def velocity(scene, name):
    held = store_of(scene)
    (rows, _) = held.tree.velocities([held.columns.tree_handle[held.slot(name)]])
    return rows[0].tolist()


def plain(places, stamps, smoothing):
    """The definition, in plain sums: ways and times of all steps, older ones faded."""
    last = stamps[-1]
    way, time = np.zeros(3), 0.0
    for k in range(1, len(stamps)):
        weight = math.exp(-((last - stamps[k]) / SECOND) / smoothing)
        way += weight * (np.array(places[k]) - places[k - 1])
        time += weight * (stamps[k] - stamps[k - 1]) / SECOND
    return way / time


def test_it_is_the_faded_way_over_the_faded_time():
    rng = np.random.default_rng(1)
    stamps = NOW + np.cumsum(rng.integers(SECOND // 50, SECOND // 5, 12))
    places = np.cumsum(rng.uniform(-0.1, 0.1, (12, 3)), axis=0)
    found = told(Tracks(0.4, 100.0), places.tolist(), stamps.tolist())
    for k, one in enumerate(found, 2):
        np.testing.assert_allclose(one, plain(places[:k], stamps[:k], 0.4), rtol=1e-9)
    found = told(Tracks(0.0, 100.0), places.tolist(), stamps.tolist())
    steps = np.diff(places, axis=0) / (np.diff(stamps) / SECOND)[:, None]
    np.testing.assert_allclose(found, steps, rtol=1e-9)


def test_jitter_of_stamps():
    rng, errors = np.random.default_rng(2), {0.0: [], 0.3: []}
    for smoothing, kept in errors.items():
        for _ in range(20):
            true = 0.1 * np.arange(30)
            stamps = NOW + ((true + rng.uniform(-0.02, 0.02, 30)) * SECOND).astype(np.int64)
            places = [[5.0 * t, 0, 0] for t in true]
            found = told(Tracks(smoothing, 50.0), places, stamps.tolist())
            kept += [abs(one[0] - 5.0) for one in found[10:]]
    assert max(errors[0.3]) < 0.75 < np.max(errors[0.0])
    assert np.mean(errors[0.3]) < np.mean(errors[0.0]) / 3.0


def test_jumps_late_and_equal_stamps():
    ms = SECOND // 1000
    steps = [
        # (place, ms): the velocity then
        (0.0, 0, None),
        (0.2, 100, 2.0),
        (0.2, 100, 2.0),  # told twice
        (0.4, 200, 2.0),
        (0.3, 150, 2.0),  # late: as if it had not been told
        (0.6, 300, 2.0),
        (90.0, 400, 0.0),  # a jump
        (90.1, 500, 1.0),
        (90.2, 600, 1.0),
        (50.0, 600, 0.0),  # a jump at the same time
        (50.2, 700, 2.0),
        (50.4, -60_000, 0.0),  # the clock was set back
        (50.7, -59_900, 3.0),
        (50.7, -59_900 + 1e-6, 3.0),
        (60.0, 10_000, (60.0 - 50.7) / 69.9),  # after a long time
    ]
    places = [[x, 0, 0] for x, _, _ in steps]
    found = told(Tracks(0.3, 50.0), places, [NOW + round(t * ms) for _, t, _ in steps])
    wanted = [v for *_, v in steps[1:]]
    np.testing.assert_allclose([one[0] for one in found], wanted, rtol=1e-3)


@pytest.mark.parametrize('smoothing', [0.0, 0.3])
def test_whatever_is_told_velocities_are_finite_and_at_most_the_largest(smoothing):
    rng = np.random.default_rng(3)
    places = np.array([0.0, 1e-300, 1e-9, 1.0, 1e9, 1e150, -1e300, 1.7e308, -1.7e308])
    stamps = [0, 1, 2, SECOND, NOW, -(1 << 63), (1 << 63) - 1, NOW + 1]
    tracks = Tracks(smoothing, 50.0)
    chosen = rng.choice(places, (300, 3)), rng.choice(np.array(stamps), 300)
    found = told(tracks, chosen[0].tolist(), chosen[1].tolist())
    assert np.isfinite(found).all()
    assert np.linalg.norm(found, axis=1).max() <= 50.0 * (1 + 1e-12)
    assert np.any(found)


def test_who_vanishes_begins_anew_and_many_are_followed_at_once(set_slices):
    scene, tracks, rng = NodeScene(), Tracks(), np.random.default_rng(4)
    places, speeds = rng.uniform(-50, 50, (500, 3)), rng.uniform(-9, 9, (500, 3))
    for tick in range(5):
        if tick == 3:
            scene.remove('s', ['b#7'])
        if tick == 4:  # in slices
            set_slices(100, 256)
        rows = rng.permutation(500)
        boxes = Shapes.boxes((places + 0.1 * tick * speeds)[rows], [1, 1, 1])
        part = Part(Numbered('b#', rows), boxes, NOW + tick * SECOND // 10, velocities=tracks)
        for _ in scene.in_slices('s', '', 500, part.cut, whole=True):
            pass
        wanted = np.zeros(3) if tick in (0, 3) else speeds[7]
        np.testing.assert_allclose(velocity(scene, 'b#7'), wanted, atol=1e-6)
        if tick:
            np.testing.assert_allclose(velocity(scene, 'b#8'), speeds[8], atol=1e-6)


def test_a_slot_that_another_one_has_now():
    scene, tracks = NodeScene(), Tracks()
    for name, speed in (('first', 5.0), ('second', -2.0)):
        for tick in range(4):
            box = Shapes.boxes([[speed * 0.1 * tick, 0, 0]], [1, 1, 1])
            stamp = NOW + tick * SECOND // 10
            scene.replace('s', '', [name], box, stamp=stamp, velocities=tracks)
        np.testing.assert_allclose(velocity(scene, name), [speed, 0, 0], rtol=1e-9)
        scene.remove('s', [name])


def test_rows_whose_velocity_is_not_finite_are_refused():
    scene, boxes = NodeScene(), Shapes.boxes([[10, 0, 0], [20, 0, 0]], [1, 1, 1])
    scene.replace('s', '', ['a', 'b'], boxes, stamp=NOW, velocities=[[1, 0, 0]] * 2)
    moved, speeds = changed(boxes, position=boxes.position + 1), [[np.nan, 0, 0], [2, 0, 0]]
    refused = scene.replace('s', '', ['a', 'b'], moved, stamp=NOW + 1, velocities=speeds)
    assert refused == [(0, 'a', 'its velocity is not finite')]
    assert velocity(scene, 'a') == [1, 0, 0]
    assert velocity(scene, 'b') == [2, 0, 0]
    assert scene.get('a').position[0] == 10
    assert scene.get('b').position[0] == 21
    speeds[0] = [0, 0, np.inf]
    assert scene.update('s', ['c', 'd'], boxes, stamp=NOW, velocities=speeds)[0].name == 'c'
    assert 'c' not in scene
    assert 'd' in scene
