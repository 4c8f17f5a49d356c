# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A large update in slices ends as at once, and on the way nothing looks free that is not."""

import numpy as np
import pytest

from bvh_ros.scene import Numbered, Part, Scene, Shapes, slicing


@pytest.fixture(autouse=True)
def small_slices(set_slices):
    set_slices(20, 7)


def state(scene):
    return [
        (o.name, o.kind, o.position.tolist(), o.size.tolist(), o.stamp, o.handle)
        for o in (scene.get(name) for _, name in scene.names())
    ]


def pausing(work):
    """None at every pause, then the refusals."""
    yield (yield from work)


def test_too_many_are_refused_as_at_once():
    """Whatever is known, new, bad or too much, and however few rows replace how many."""
    random = np.random.default_rng(7)
    pauses = 0
    for old, new, most in ((50, 70, 60), (60, 60, 60), (60, 5, 60), (30, 0, 40), (5, 90, 7)) * 3:
        sliced, at_once = Scene(max_obstacles=most), Scene(max_obstacles=most)
        shapes = Shapes.boxes(random.uniform(0, 9, (100, 3)), [1, 1, 1])
        shapes = shapes._replace(size=shapes.size.copy())
        shapes.size[random.random(100) < 0.1] = np.nan
        names = Numbered('c#', np.sort(random.permutation(100)[:new]))
        part = Part(names, shapes.take(slice(new)), random.integers(5, 9, new))
        for scene in (sliced, at_once):
            scene.update('t', ['other'], Shapes.boxes([[0, 0, 5]], [1, 1, 1]), stamp=1)
            given = Shapes.boxes(np.zeros((old, 3)), [1, 1, 1])
            scene.replace('s', '', Numbered('c#', np.arange(old)), given, stamp=1)
        expected = at_once.replace('s', '', *part[:2], stamp=part.stamp)
        assert at_once.newest == int(np.max(part.stamp, initial=1))
        for refusals in pausing(sliced.in_slices('s', '', new, part.cut, whole=True)):
            if refusals is None:
                pauses += 1
                assert len(sliced) <= 2 * most
                sliced.validate()
            else:
                assert refusals == expected
        assert state(sliced) == state(at_once)
        assert sliced.newest == at_once.newest
        sliced.validate()
    assert pauses > 100


def test_few_rows_in_place_of_very_many_take_many_turns():
    scene = Scene()
    shapes = Shapes.boxes(np.random.default_rng(1).uniform(0, 9, (60, 3)), [1, 1, 1])
    scene.update('s', Numbered('c#', np.arange(60)), shapes, stamp=1)
    part = Part(Numbered('d#', np.arange(2)), shapes.take(slice(2)), 2)
    left = [len(scene) for _ in scene.in_slices('s', '', 2, part.cut, whole=True)]
    assert max(np.abs(np.diff(left))) <= slicing.SLICE
    assert sorted(name for _, name in scene.names()) == ['d#0', 'd#1']


def test_rows_with_meshes_take_turns_earlier(set_slices):
    set_slices(6, 2, 'COSTLY_')
    scene = Scene()
    shapes = Shapes.boxes(np.zeros((7, 3)), [1, 1, 1])
    part = Part(Numbered('c#', np.arange(7)), shapes, 1)
    sizes = [
        len(scene)
        for _ in scene.in_slices('s', '', 7, part.cut, whole=False, costly=True)
        if len(scene)
    ]
    assert sizes == [2, 4, 6, 7]
    assert list(Scene().in_slices('s', '', 7, part.cut, whole=False)) == []


def test_whoever_is_late_does_not_pause():
    scene = Scene()
    shapes = Shapes.boxes(np.random.default_rng(1).uniform(0, 9, (60, 3)), [1, 1, 1])
    part = Part(Numbered('c#', np.arange(60)), shapes, 2)
    scene.update('s', *part[:2], stamp=1)
    assert len(list(scene.in_slices('s', '', 60, part.cut, whole=True))) > 5
    assert list(scene.in_slices('s', '', 60, part.cut, whole=True, at_once=True)) == []
