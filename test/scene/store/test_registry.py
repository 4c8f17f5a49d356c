# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbered names cost no Python step a row, and are the same names as strings."""

import sys

import numpy as np
import pytest
from scene.reference import changed

from bvh_ros.scene import Families, Numbered, Part, Scene, Shapes


def calls_of(work):
    count = 0

    def note(frame, event, argument):
        nonlocal count
        count += event in ('call', 'c_call')

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.parametrize('planar', [False, True])
def test_a_frame_of_points_takes_as_many_steps_however_many_points(planar):
    counts = []
    for rows in (100, 100, 10_000):  # the first time compiles
        scene = Scene(planar=planar)
        names = Numbered('cloud#', np.arange(rows))
        shapes = Shapes.boxes(np.random.default_rng(0).uniform(-9, 9, (rows, 3)), [0.1, 0.1, 0.1])

        def frame(scene=scene, names=names, shapes=shapes):
            assert scene.replace('cloud', '', names, shapes, stamp=1) == []

        def fewer(scene=scene, names=names, shapes=shapes, rows=rows):
            kept = Numbered('cloud#', names.numbers[: rows // 2])
            assert scene.replace('cloud', '', kept, shapes.take(slice(rows // 2)), stamp=1) == []

        if not counts:
            frame(), fewer(), frame(), scene.clear()
        steps = [
            calls_of(frame),
            calls_of(frame),
            calls_of(fewer),
            calls_of(frame),
            calls_of(scene.clear),
        ]
        counts.append(steps)
    _, few, many = np.array(counts)
    assert (many <= few + 50).all(), counts


@pytest.mark.parametrize('stride', [1, 7, 16, 2**12, 2**40 + 1])
def test_names_come_and_go_as_in_a_dictionary(stride):
    """Numbers of every stride, several prefixes, and names without a number; as the table grows
    and clusters break up."""
    random = np.random.default_rng(stride)
    scene, known = Scene(), {}
    pool = [f'{prefix}{stride * k}' for prefix in ('a#', 'b/', 'b/-') for k in range(700)]
    pool += [f'wall {k:04}' for k in range(300)]
    for _ in range(30):
        chosen = random.choice(pool, 500, replace=False).tolist()
        places = random.integers(0, 99, (500, 3)) * 1.0
        assert not scene.update('s', chosen, Shapes.boxes(places, [1, 1, 1]), stamp=1)
        known.update(zip(chosen, places.tolist(), strict=True))
        gone = random.choice(sorted(known), len(known) // 3, replace=False).tolist()
        assert scene.remove('s', gone) == len(gone)
        for name in gone:
            del known[name]
        assert [name in scene for name in pool] == [name in known for name in pool]
    assert {name: scene.get(name).position.tolist() for _, name in scene.names()} == known
    assert scene.remove_namespace('s', 'b') == sum(name.startswith('b/') for name in known)


def test_a_number_and_a_string_are_one_name():
    one = Shapes.boxes([[0, 0, 0]], [1, 1, 1])
    scene = Scene()
    scene.update('a', ['p5', 'p05', 'p'], Shapes.boxes(np.zeros((3, 3)), [1, 1, 1]), stamp=1)
    (refusal,) = scene.update('b', Numbered('p', np.array([5])), one, stamp=2)
    assert refusal == (0, 'p5', "its name belongs to the source 'a'")
    assert scene.update('b', Numbered('p', np.array([6])), one, stamp=2) == []
    (refusal,) = scene.update('a', ['p6'], one, stamp=3)
    assert "source 'b'" in refusal.reason
    assert scene.update('a', Numbered('p0', np.array([5])), one, stamp=4) == []
    assert scene.get('p05').stamp == 4
    assert scene.get('p5').stamp == 1
    assert sorted(name for _, name in scene.names()) == ['p', 'p05', 'p5', 'p6']
    scene.validate()


def test_the_last_row_of_a_name_holds():
    scene = Scene()
    places = np.array([[1.0, 0, 0], [2, 0, 0], [3, 0, 0], [np.nan, 0, 0]])
    shapes = changed(Shapes.boxes(np.zeros((4, 3)), [1, 1, 1]), position=places)
    refusals = scene.update('a', ['x', 'y', 'x', 'x'], shapes, stamp=1)
    assert [refusal.row for refusal in refusals] == [3]
    assert scene.get('x').position.tolist() == [3, 0, 0]
    refusals = scene.update('b', Numbered('n', np.array([4, 4, 2, 4])), shapes, stamp=1)
    assert [refusal.row for refusal in refusals] == [3]
    assert scene.get('n4').position.tolist() == [2, 0, 0]
    assert len(scene) == 4


def test_names_of_several_prefixes_are_the_same_names_as_strings():
    scene = Scene()
    shapes = Shapes.boxes(np.arange(15.0).reshape(5, 3), [1, 1, 1])
    names = Families(['a/', 'a/-', 'b1'], np.array([0, 1, 2, 0, 2]), np.array([4, 4, 2, 4, 2]))
    assert scene.update('a', names, shapes, stamp=np.arange(5)) == []
    assert {name for _, name in scene.names()} == {'a/4', 'a/-4', 'b12'}
    assert [scene.get(name).stamp for name in ('a/4', 'a/-4', 'b12')] == [3, 1, 4]
    assert scene.newest == 4
    assert scene.remove('a', Families(['b', 'a/'], np.array([0, 1]), np.array([12, 5]))) == 1
    (refusal,) = scene.update('b', Numbered('a/', np.array([4])), shapes.take([0]), stamp=9)
    assert "source 'a'" in refusal.reason
    scene.validate()


def test_names_that_were_split_stay_the_same_names() -> None:
    """An update that is cut into parts splits its names before each part does."""
    names = ['a', 'b7', 'c-1', '-1', '', 'd01', 'e1', 'f123456789012345678901']
    scene, kept = Scene(), [name for name in names if name]
    count = len(kept)
    kinds, ones = np.ones(count, np.uint8), np.ones((count, 3))
    shapes = Shapes(kinds, ones, np.tile((0.0, 0.0, 0.0, 1.0), (count, 1)), ones)
    for part in Part(kept, shapes, 0).cut(4):
        assert not scene.update('s', part.names, part.shapes, stamp=part.stamp)
    assert all(name in scene for name in kept)
    assert len(scene) == count
