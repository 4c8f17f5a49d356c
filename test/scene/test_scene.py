# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Updates, replacements, lifetimes and refusals, step by step against a dictionary."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from scene.reference import random_shapes

from bvh_ros.scene import Numbered, Scene, Shapes

SOURCES = ['camera', 'lidar']
# Given as strings or as prefix and number; 'a1' + 5 and 'a' + 15 are one name, 'a05' is another.
texts = st.sampled_from(
    ['a0', 'a1', 'a15', 'a05', 'a1/2', 'a1/3', 'b', 'a', '', 'error: x', 'a-1', '7']
)
numbered = st.tuples(
    st.sampled_from(['a', 'a1', 'a1/', '', 'a-', 'error: ', 'c']),
    st.lists(st.integers(-1, 20), max_size=8),
)
coordinates = st.sampled_from([0.0, 1.0, 2.5, float('nan'), 1e308])


def spelled(names):
    if isinstance(names, Numbered):
        return [f'{names.prefix}{number}' for number in names.numbers]
    return names


class Model(RuleBasedStateMachine):
    """The scene, and a dictionary: name -> (source, group, x, expires, node handle)."""

    def __init__(self):
        super().__init__()
        self.scene = Scene(max_obstacles=25)
        self.known = {}
        self.last_handle = 0
        self.newest = 0

    def apply(self, source, group, names, x, expires, whole):
        written = spelled(names)
        x = (x * len(written))[: len(written)]
        shapes = Shapes.boxes(
            np.stack([x, np.zeros(len(x)), np.zeros(len(x))], axis=1), [1.0, 1.0, 1.0]
        )
        arguments = (names, shapes)
        if whole:
            refusals = self.scene.replace(
                source, group, *arguments, stamp=self.newest + 1, expires=expires
            )
        else:
            refusals = self.scene.update(
                source, *arguments, stamp=self.newest + 1, expires=expires
            )
        refused = {row for row, name in enumerate(written) if self.is_bad(source, name, x[row])}
        if whole:
            gone = [
                n
                for n, o in self.known.items()
                if o[0] == source and group in ('', o[1]) and n not in written
            ]
            for name in gone:
                del self.known[name]
        last = {name: row for row, name in enumerate(written) if row not in refused}
        for row in sorted(last.values()):
            name = written[row]
            if name not in self.known and len(self.known) >= 25:
                refused.add(row)
                continue
            handle = self.known[name][4] if name in self.known else None
            self.known[name] = (source, group if whole else '', x[row], expires, handle)
        for name in (written[row] for row in sorted(last.values())):
            if name in self.known and self.known[name][4] is None:
                self.last_handle += 1
                self.known[name] = (*self.known[name][:4], self.last_handle)
        assert [refusal.row for refusal in refusals] == sorted(refused)
        assert all(refusal.name == written[refusal.row] and refusal.reason for refusal in refusals)
        if whole or last:
            self.newest += 1

    def is_bad(self, source, name, x):
        return (
            np.isnan(x)
            or not name
            or name.startswith('error: ')
            or (name in self.known and self.known[name][0] != source)
        )

    sources = st.sampled_from(SOURCES)
    groups = st.sampled_from(['', 'g', 'h'])
    places = st.lists(coordinates, min_size=1, max_size=4)
    lives = st.sampled_from([0, 5, 9])

    @rule(source=sources, names=st.lists(texts, max_size=6), x=places, expires=lives)
    def update_texts(self, source, names, x, expires):
        self.apply(source, '', names, x, expires, False)

    @rule(
        source=sources, names=numbered, x=places, expires=lives, whole=st.booleans(), group=groups
    )
    def numbered_names(self, source, names, x, expires, whole, group):
        prefix, numbers = names
        self.apply(
            source,
            group if whole else '',
            Numbered(prefix, np.array(numbers, int)),
            x,
            expires,
            whole,
        )

    @rule(source=sources, names=st.lists(texts, max_size=6), x=places, group=groups)
    def replace_texts(self, source, names, x, group):
        self.apply(source, group, names, x, 0, True)

    @rule(source=sources, names=st.lists(texts, max_size=4))
    def remove(self, source, names):
        gone = {n for n in names if n in self.known and self.known[n][0] == source}
        assert self.scene.remove(source, names) == len(gone)
        self.forget(gone)

    @rule(source=sources, group=groups)
    def remove_group(self, source, group):
        gone = {n for n, o in self.known.items() if o[0] == source and group in ('', o[1])}
        assert self.scene.remove_group(source, group) == len(gone)
        self.forget(gone)

    @rule(source=sources, namespace=st.sampled_from([None, 'a1', 'a', 'b']))
    def remove_namespace(self, source, namespace):
        gone = {
            n
            for n, o in self.known.items()
            if o[0] == source and (namespace is None or n.startswith(namespace + '/'))
        }
        assert self.scene.remove_namespace(source, namespace) == len(gone)
        self.forget(gone)

    @rule(now=st.integers(0, 10))
    def expire(self, now):
        gone = {n for n, o in self.known.items() if 0 < o[3] <= now}
        assert self.scene.expire(now) == len(gone)
        self.forget(gone)

    @rule()
    def clear(self):
        assert self.scene.clear() == len(self.known)
        self.known.clear()
        self.newest = 0

    def forget(self, names):
        for name in names:
            del self.known[name]

    @invariant()
    def same(self):
        scene = self.scene
        scene.validate()
        assert len(scene) == len(self.known)
        assert dict(scene.names()) == {o[4]: n for n, o in self.known.items()}
        assert scene.newest == self.newest
        for name, (source, group, x, expires, handle) in self.known.items():
            obstacle = scene.get(name)
            assert (obstacle.source, obstacle.group, obstacle.expires, obstacle.handle) == (
                source,
                group,
                expires,
                handle,
            )
            assert obstacle.position.tolist() == [x, 0, 0]
            assert scene.name_of(handle) == name
            assert name in scene
        counts = scene.stats()['sources']
        assert all(
            counts.get(s, 0) == sum(o[0] == s for o in self.known.values()) for s in SOURCES
        )
        near = scene.overlap([2.4, 0, 0], [2.6, 0, 0])
        assert [hit.name for hit in near] == [
            n for n, o in sorted(self.known.items(), key=lambda item: item[1][4]) if o[2] == 2.5
        ]


Model.TestCase.settings = settings(max_examples=30, stateful_step_count=25, deadline=None)
TestModel = Model.TestCase


BOX = Shapes.boxes([[0, 0, 0]], [1, 1, 1])


def shape(kind=0, position=(0, 0, 0), orientation=(0, 0, 0, 0), size=(1, 1, 1)):
    return Shapes(
        np.array([kind]), *(np.array([part], float) for part in (position, orientation, size))
    )


@pytest.mark.parametrize(
    ('bad', 'words'),
    [
        (shape(position=(0, np.nan, 0)), 'position is not finite'),
        (shape(position=(0, 0, -np.inf)), 'position is not finite'),
        (shape(orientation=(0, 0, np.nan, 1)), 'orientation is not finite'),
        (shape(size=(1, np.inf, 1)), 'size is not finite'),
        (shape(size=(1, -1e-9, 1)), 'size is negative'),
        (shape(kind=3), 'none of BOX, SPHERE and CYLINDER'),
        (shape(kind=1, size=(1, 1, 1.5)), 'sphere must be equal'),
        (shape(kind=2, size=(1, 1.5, 1)), 'cylinder along x and y must be equal'),
        (shape(kind=1, size=(0, 0, 0)), 'above zero'),
        (shape(kind=2, size=(1, 1, 0)), 'above zero'),
        (shape(position=(1.7e308, 0, 0), size=(1e308, 1, 1)), 'exceed the largest double'),
    ],
)
def test_a_bad_row_is_refused_and_keeps_the_old_obstacle(bad, words):
    scene = Scene()
    assert scene.update('test', ['x'], BOX, stamp=1) == []
    (refusal,) = scene.update('test', ['x'], bad, stamp=2)
    assert (refusal.row, refusal.name) == (0, 'x')
    assert words in refusal.reason
    assert scene.get('x').stamp == 1
    assert scene.newest == 1
    (refusal,) = scene.replace('test', '', ['x'], bad, stamp=3)
    assert scene.get('x').stamp == 1
    assert scene.newest == 3


def test_a_refusal_names_the_owner_and_good_rows_are_applied():
    scene = Scene()
    scene.update('lidar', ['x'], BOX, stamp=1)
    two = Shapes.boxes([[5, 0, 0], [6, 0, 0]], [1, 1, 1])
    (refusal,) = scene.update('camera', ['x', 'y'], two, stamp=2)
    assert refusal == (0, 'x', "its name belongs to the source 'lidar'")
    assert scene.get('x').position.tolist() == [0, 0, 0]
    assert scene.get('y').position.tolist() == [6, 0, 0]
    assert (
        scene.replace('camera', '', [], Shapes.boxes(np.zeros((0, 3)), [1, 1, 1]), stamp=3) == []
    )
    assert scene.names() == [(1, 'x')]


def test_flat_boxes_are_obstacles():
    scene = Scene()
    flat = Shapes.boxes([[1, 0, 0], [2, 0, 0]], [0, 1, 1], [[0, 0, 0, 1], [0, 0, 0.1, 1]])
    assert scene.update('test', ['wall', 'turned'], flat, stamp=1) == []
    assert [hit.name for hit in scene.raycast_all([0, 0, 0], [3, 0, 0])] == ['wall', 'turned']
    assert {hit.name for hit in scene.overlap([0, 0, 0], [3, 0, 0])} == {'wall', 'turned'}


@pytest.mark.parametrize(
    'change',
    [
        lambda s: s.update('test', ['a', 'b'], BOX, stamp=1),
        lambda s: s.update('test', 'a', BOX, stamp=1),
        lambda s: s.update('test', [5], BOX, stamp=1),
        lambda s: s.update('test', Numbered('a', np.array([0.5])), BOX, stamp=1),
        lambda s: s.update('test', ['a'], BOX._replace(size=np.ones((2, 3))), stamp=1),
        lambda s: s.update('test', ['a'], BOX._replace(kind=np.array([0.0])), stamp=1),
        lambda s: s.update('test', ['a'], BOX, stamp=1, categories=-1),
        lambda s: s.update('test', ['a'], BOX, stamp=1, categories=2**32),
        lambda s: s.update('test', ['a'], BOX, stamp=1, expires=-1),
        lambda s: s.update('test', ['a'], BOX, stamp=1, expires=[1, 2]),
        lambda s: s.raycast([0, 0], [1, 1]),
        lambda s: s.raycast([0, 0, 0], [1, 1, np.nan]),
        lambda s: s.raycast([0, 0, 0], [1, 1, 1], radius=-1),
        lambda s: s.raycast([0, 0, 0], [1, 1, 1], radius=np.inf),
        lambda s: s.raycast([-1.7e308, 0, 0], [1.7e308, 1, 1]),
        lambda s: s.raycast([0, 0, 0], [1, 1, 1], mask=-1),
        lambda s: s.overlap([0, 0, 0], [1, 1, 1], tolerance=-1),
        lambda s: s.overlap([0, 0, 0], [1, 1, 1], tolerance=np.nan),
        lambda s: s.overlap([0, 0, 0], [1, 1, 1], orientation=[0, 0, 0, np.inf]),
        lambda s: s.raycast_many([[0, 0, 0]], [[0, 0, np.nan]]),
        lambda s: s.raycast_many([[0, 0, 0]], [[0, 0, 1], [0, 1, 0]]),
        lambda s: Scene(max_obstacles=0),
        lambda s: Scene(margin=-1),
    ],
)
def test_bad_arguments_are_a_value_error_and_change_nothing(change):
    scene = Scene()
    scene.update('test', ['old'], BOX, stamp=1)
    with pytest.raises(ValueError):
        change(scene)
    assert scene.names() == [(1, 'old')]
    assert scene.newest == 1


def test_node_handles_end_with_a_clear_error():
    scene = Scene()
    scene._next_node_handle = 2**31 - 1
    assert scene.update('test', ['last'], BOX, stamp=1) == []
    assert scene.get('last').handle == 2**31 - 1
    with pytest.raises(OverflowError, match='node handles of this run are used up'):
        scene.update('test', ['more'], BOX, stamp=2)
    assert scene.names() == [(2**31 - 1, 'last')]
    assert scene.update('test', ['last'], BOX, stamp=3) == []


def test_categories_follow_updates():
    scene = Scene()
    scene.update('test', ['x'], BOX, stamp=1, categories=1)
    assert scene.raycast([-2, 0, 0], [2, 0, 0], mask=2) is None
    scene.update('test', ['x'], BOX, stamp=1, categories=6)
    assert scene.raycast([-2, 0, 0], [2, 0, 0], mask=2).name == 'x'
    assert scene.raycast([-2, 0, 0], [2, 0, 0], mask=1) is None
    assert [hit.name for hit in scene.overlap([0, 0, 0], [1, 1, 1], mask=4)] == ['x']
    assert scene.overlap([0, 0, 0], [1, 1, 1], mask=1) == []


@pytest.mark.parametrize('planar', [False, True])
def test_churn_of_a_large_numbered_group(planar):
    """Clouds whose rows come and go, between other obstacles."""
    rng = np.random.default_rng(3)
    scene = Scene(planar=planar, margin=0.05)
    scene.update('markers', ['wall'], Shapes.boxes([[9, 9, 9]], [1, 1, 1]), stamp=1)
    for frame in range(12):
        rows = np.flatnonzero(rng.random(3000) < rng.choice([0.2, 0.9, 1.0]))
        shapes = (
            random_shapes(rng, len(rows))
            if frame % 3 == 2
            else Shapes.boxes(rng.uniform(-5, 5, (len(rows), 3)), [0.1, 0.1, 0.1])
        )
        assert scene.replace('cloud', '', Numbered('cloud#', rows), shapes, stamp=frame) == []
        scene.validate()
        assert len(scene) == len(rows) + 1
        for i in rng.integers(0, len(rows), 20):
            assert scene.get(f'cloud#{rows[i]}').position.tolist() == shapes.position[i].tolist()


def test_a_scene_of_aligned_boxes_compiles_and_imports_nothing_narrow():
    program = """
import sys, numpy as np
from bvh_ros.scene import Scene, Shapes
half = np.pi / 4
turns = [[0] * 4, [0, 0, 1, 1], [0.5, -0.5, 0.5, 0.5], [0, 0, np.sin(half), np.cos(half)]]
scene = Scene()
crates = Shapes.boxes(np.eye(4, 3) * 9, [1, 2, 3], turns)
assert scene.update('a', list('abcd'), crates, stamp=1) == []
assert scene.raycast([-5, 0, 0], [9, 0, 0]) and scene.raycast_all([-5, 0, 0], [9, 0, 0])
assert scene.overlap([0, 0, 0], [9, 9, 9], [0, 0, 1, 1], 0.1)
assert scene.overlap([0, 0, 0], [0, 0, 0], tolerance=1)
assert (scene.raycast_many(np.zeros((2, 3)), np.eye(3)[:2])[0] == 4).all()
assert not {'fcl', 'rclpy'} & set(sys.modules)
assert not scene.stats()['narrow_phase'] and scene.stats()['shaped'] == 0
from bvh_ros.scene import casting
assert not casting.cast_rays.signatures
scene.update('a', ['e'], Shapes.boxes([[0, 0, 9]], [1, 2, 3], [[0, 0, 0.1, 1]]), stamp=1)
assert scene.overlap([0, 0, 8], [1, 1, 9]) and 'fcl' in sys.modules
"""
    subprocess.run([sys.executable, '-c', program], check=True)
