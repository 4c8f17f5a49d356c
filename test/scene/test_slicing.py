# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A large update in slices ends as at once, and on the way nothing looks free that is not."""

import itertools

import numpy as np
import pytest
from scene.reference import changed, scene_of

from bvh_ros.scene import NodeScene, Numbered, Part, ShapeKind, Shapes, unchecked_shapes

SLICE = 7  # rows
PLACES = 120  # where boxes may stand, on a line


@pytest.fixture(autouse=True)
def small_slices(set_slices):
    set_slices(20, SLICE)


def random_part(random, stamp, shaped):
    """Some numbers, each at a place of its own; some rows are bad, some of the shapes round."""
    count = random.integers(20, 90)
    position = np.zeros((count, 3))
    position[:, 0] = random.permutation(PLACES)[:count]
    size = np.full((count, 3), 0.9)
    size[random.random(count) < 0.05] = np.nan
    kind = random.choice([ShapeKind.BOX, ShapeKind.SPHERE], count) if shaped else [0] * count
    shapes = unchecked_shapes(np.array(kind, np.uint8), position, np.zeros((count, 4)), size)
    return Part(Numbered('c#', np.sort(random.permutation(100)[:count])), shapes, stamp)


def occupied(scene):
    """At which places something stands; no question names an obstacle twice."""
    ways = [
        scene.raycast_all([-1, 0, 0], [PLACES, 0, 0]),
        scene.raycast_all([-1, 0, 0], [PLACES, 0, 0], 0.1),
        scene.overlap([-1, -1, -1], [PLACES, 1, 1]),
        scene.overlap_shape(Shapes.boxes([[0, 0, 0]], [2 * PLACES, 1, 1])),
        scene.nearest([40.3, 0, 0], PLACES),
    ]
    for hits in ways:
        names = [hit.name for hit in hits]
        assert len(set(names)) == len(names) == len(scene)
        assert [hit.t for hit in hits] == sorted(hit.t for hit in hits)
    every = [hit.name for hit in ways[-1]]
    for few in range(1, 6):
        assert [hit.name for hit in scene.nearest([40.3, 0, 0], few)] == every[:few]
    pairs = [tuple(sorted(pair)) for pair in scene.overlap_pairs()]
    assert all(one != two for one, two in pairs)
    assert len(set(pairs)) == len(pairs)
    places = [(x, scene.overlap([x, 0, 0], [x, 0, 0])) for x in range(PLACES)]
    gaps: dict[str, float] = {}
    for (x, here), (y, there) in itertools.combinations([p for p in places if p[1]], 2):
        if y - x <= 2:
            for one, two in itertools.product(here, there):
                if one.name != two.name:
                    for name in (one.name, two.name):
                        gaps[name] = min(gaps.get(name, 9.0), y - x - 0.9)
    for name, gap in list(gaps.items())[::7]:
        found = scene.clearance(name)
        assert found.name != name
        assert found.distance <= gap + 1e-9
    return {x for x, hits in places if hits}


def state(scene):
    return [
        (o.name, o.kind, o.position.tolist(), o.size.tolist(), o.stamp, o.handle)
        for o in (scene.get(name) for _, name in scene.names())
    ]


def pausing(work):
    """None at every pause, then the refusals."""
    yield (yield from work)


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('shaped', [False, True])
@pytest.mark.parametrize('whole', [False, True])
def test_slices_end_as_at_once_and_never_look_freer(whole, shaped, planar):
    random = np.random.default_rng([whole, shaped, planar])
    sliced, at_once = NodeScene(planar=planar), NodeScene(planar=planar)
    pauses = 0
    for stamp in range(1, 5):
        part = random_part(random, stamp, shaped)
        before, newest = occupied(sliced), sliced.newest
        update = at_once.replace if whole else at_once.update
        group = [''] if whole else []
        expected = update('s', *group, *part[:2], stamp=stamp)
        after = occupied(at_once)
        work = sliced.in_slices('s', '', len(part.shapes.kind), part.cut, whole=whole)
        for refusals in pausing(work):
            if refusals is not None:
                assert refusals == expected
                break
            pauses += 1
            assert before & after <= occupied(sliced) <= before | after
            assert sliced.newest == newest  # as new as the message when all of it is in
            sliced.validate()
            assert len({handle for handle, _ in sliced.names()}) == len(sliced)
        assert state(sliced) == state(at_once)
        assert sliced.newest == at_once.newest == stamp
        assert occupied(sliced) == after
        sliced.validate()
        assert len(sliced) == len(at_once)
    assert pauses > 15


def test_too_many_are_refused_as_at_once():
    """Whatever is known, new, bad or too much, and however few rows replace how many."""
    random = np.random.default_rng(7)
    pauses = 0
    for old, new, most in ((50, 70, 60), (60, 60, 60), (60, 5, 60), (30, 0, 40), (5, 90, 7)) * 3:
        sliced, at_once = NodeScene(max_obstacles=most), NodeScene(max_obstacles=most)
        shapes = Shapes.boxes(random.uniform(0, 9, (100, 3)), [1, 1, 1])
        shapes = changed(shapes, size=shapes.size.copy())
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
    shapes = Shapes.boxes(np.random.default_rng(1).uniform(0, 9, (60, 3)), [1, 1, 1])
    scene = scene_of(shapes, names=Numbered('c#', np.arange(60)), source='s', of=NodeScene)
    part = Part(Numbered('d#', np.arange(2)), shapes.take(slice(2)), 2)
    left = [len(scene) for _ in scene.in_slices('s', '', 2, part.cut, whole=True)]
    assert max(np.abs(np.diff(left))) <= SLICE
    assert sorted(name for _, name in scene.names()) == ['d#0', 'd#1']


def test_rows_with_meshes_take_turns_earlier(set_slices):
    set_slices(6, 2, 'COSTLY_')
    scene = NodeScene()
    shapes = Shapes.boxes(np.zeros((7, 3)), [1, 1, 1])
    part = Part(Numbered('c#', np.arange(7)), shapes, 1)
    sizes = [
        len(scene)
        for _ in scene.in_slices('s', '', 7, part.cut, whole=False, costly=True)
        if len(scene)
    ]
    assert sizes == [2, 4, 6, 7]
    assert list(NodeScene().in_slices('s', '', 7, part.cut, whole=False)) == []


def test_whoever_is_late_does_not_pause():
    scene = NodeScene()
    shapes = Shapes.boxes(np.random.default_rng(1).uniform(0, 9, (60, 3)), [1, 1, 1])
    part = Part(Numbered('c#', np.arange(60)), shapes, 2)
    scene.update('s', *part[:2], stamp=1)
    assert len(list(scene.in_slices('s', '', 60, part.cut, whole=True))) > 5
    assert list(scene.in_slices('s', '', 60, part.cut, whole=True, at_once=True)) == []
