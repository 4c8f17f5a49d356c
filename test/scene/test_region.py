# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A scene of a region holds those of all obstacles whose bounds touch it, whatever happens."""

import numpy as np
import pytest
from scene.inside import store_of

from bvh_ros.scene import NodeScene, Part, ShapeKind, Shapes
from bvh_ros.scene.tracking import Tracks

NAMES = [f'thing/{i}' for i in range(40)]


def shapes_at(rng, count):
    """Half boxes, half balls, some that touch the region's faces exactly."""
    places = rng.integers(-8, 9, (count, 3)).astype(float)
    places[::3] += rng.uniform(-1, 1, places[::3].shape)
    kinds = ShapeKind.BOX, ShapeKind.SPHERE
    return Shapes(rng.choice(kinds, count), places, [0, 0, 0, 1], 2.0)


def expected(everything, lo, hi):
    """Names and handles-free facts of the obstacles of a scene that touch a box."""
    held = store_of(everything)
    names = [name for _, name in everything.names()]
    slots = np.array([held.registry.slot(name) for name in names], np.int64)
    low, high = held.tree.boxes(held.columns.tree_handle[slots])
    touch = ((low <= hi) & (high >= lo)).all(axis=1)
    return {
        name: everything.get(name).position.tolist()
        for name, here in zip(names, touch, strict=True)
        if here
    }


def held_by(scene):
    return {name: scene.get(name).position.tolist() for _, name in scene.names()}


@pytest.mark.parametrize('planar', [False, True])
def test_what_leaves_goes_and_what_enters_comes(planar):
    rng, ndim = np.random.default_rng(3), 2 if planar else 3
    lo, hi = np.full(3, -3.0), np.array([4.0, 3.0, np.inf])
    region = lo[:ndim], hi[:ndim]
    part, whole = NodeScene(planar=planar, region=region), NodeScene(planar=planar)
    seen = set()
    for step in range(300):
        count = int(rng.integers(1, 8))
        names, shapes = rng.choice(NAMES, count).tolist(), shapes_at(rng, count)
        for scene in (part, whole):
            if step % 5 == 4:
                refused = scene.replace('one', '', names, shapes, stamp=step)
            elif step % 7 == 6:
                scene.remove('one', names[:1])
            else:
                refused = scene.update('one', names, shapes, stamp=step)
            assert not refused
        assert held_by(part) == expected(whole, *region)
        part.validate()
        seen.add(len(part) < len(whole))
        query = rng.uniform(-4, 4, (2, 3))
        box = np.minimum(*query), np.maximum(*query)
        mine = [hit.name for hit in part.overlap(*box)]
        assert mine == [hit.name for hit in whole.overlap(*box) if hit.name in held_by(part)]
    assert seen == {True, False}


def test_between_slices_nothing_that_was_or_will_be_is_missing(set_slices):
    set_slices(1, 7)
    rng = np.random.default_rng(4)
    scene = NodeScene(region=([-3] * 3, [3] * 3))
    old = Shapes.boxes(rng.uniform(-5, 5, (60, 3)), [1, 1, 1])
    new = Shapes.boxes(rng.uniform(-5, 5, (60, 3)), [1, 1, 1])
    names = [f'thing/{i}' for i in range(60)]
    scene.replace('one', '', names, old, stamp=0)
    before = held_by(scene)
    slices = scene.in_slices('one', '', 60, Part(names, new, 1).cut, whole=True)
    for pause, _ in enumerate(slices):
        if pause < 60 // 7:  # then all is in, and what was goes
            for name, place in before.items():
                assert name in [hit.name for hit in scene.overlap(place, place)], pause
        scene.validate()
    after = NodeScene(region=([-3] * 3, [3] * 3))
    after.replace('one', '', names, new, stamp=1)
    assert held_by(scene) == held_by(after) != before
    scene.validate()


@pytest.mark.parametrize('planar', [False, True])
def test_who_will_be_in_the_region_is_kept(planar):
    rng, ndim, step = np.random.default_rng(5), 2 if planar else 3, 100_000_000
    region, names = ([-3.0] * ndim, [3.0] * ndim), [f'thing/{i}' for i in range(60)]
    places, speeds = rng.uniform(-9, 9, (60, 3)), rng.uniform(-8, 8, (60, 3))
    speeds[::4] = 0.0
    for follow, uncertainty in ((False, 0.0), (True, 0.0), (False, 3.0)):
        scenes = [
            NodeScene(planar=planar, region=one, max_prediction=1.0, uncertainty=uncertainty)
            for one in (region, None)
        ]
        tracks = {scene: Tracks(0.0, 15.0) for scene in scenes}
        for time in (0, step):
            for scene in scenes:
                now = places + speeds * (time / 1e9) * follow
                told = tracks[scene] if follow else speeds
                boxes = Shapes.boxes(now, [1, 1, 1])
                assert not scene.update('one', names, boxes, stamp=time, velocities=told)
        part, whole = scenes
        assert follow or len(part) < len(whole)
        for at in (step, 2 * step, 11 * step, (11 if uncertainty else 99) * step):
            for corner in rng.uniform(-3, 3, (20, 3)):
                seen = [hit.name for hit in part.overlap(corner, -corner, at=at)]
                assert seen == [hit.name for hit in whole.overlap(corner, -corner, at=at)]
        # Who stands is forgotten as ever, and so is who is told to stand.
        for scene in scenes:
            scene.update('one', names, Shapes.boxes(places, [1, 1, 1]), stamp=2 * step)
        assert held_by(part) == expected(whole, *map(np.array, region))


def test_room_is_for_what_is_kept():
    scene = NodeScene(region=([0] * 3, [1] * 3), max_obstacles=2)
    places = [[0.5] * 3, [9.0] * 3, [9.0] * 3, [0.2] * 3, [0.1] * 3]
    refused = scene.update('one', list('abcde'), Shapes.boxes(places, [1, 1, 1]), stamp=0)
    assert [row.name for row in refused] == ['e']


@pytest.mark.parametrize(
    'region', [1, (1, 2), ([0, 0], [1, 1]), ([0] * 3, [-1] * 3), ([np.nan] * 3, [1] * 3), 'ab']
)
def test_what_is_no_region_is_refused(region):
    with pytest.raises(ValueError, match='region'):
        NodeScene(region=region)
