# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Refusals, bad arguments, masks, churn, and what a plain scene leaves out."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest
from scene.inside import store_of
from scene.reference import changed, scene_of

from bvh_ros.scene import NodeScene, Numbered, Shapes

BOX = Shapes.boxes([[0, 0, 0]], [1, 1, 1])


def test_a_refusal_names_the_owner_and_good_rows_are_applied():
    scene = scene_of(BOX, names=['x'], source='lidar', of=NodeScene)
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
    flat = Shapes.boxes([[1, 0, 0], [2, 0, 0]], [0, 1, 1], [[0, 0, 0, 1], [0, 0, 0.1, 1]])
    scene = scene_of(flat, names=['wall', 'turned'], of=NodeScene)
    assert [hit.name for hit in scene.raycast_all([0, 0, 0], [3, 0, 0])] == ['wall', 'turned']
    assert {hit.name for hit in scene.overlap([0, 0, 0], [3, 0, 0])} == {'wall', 'turned'}


def test_a_scene_is_copied_but_neither_pickled_nor_shared():
    scene = scene_of(BOX, names=['x'], of=NodeScene)
    other = copy.deepcopy(scene)
    scene.clear()
    assert len(scene) == 0
    assert [hit.name for hit in other.raycast_all((0, 0, 0), (1, 0, 0))] == ['x']
    for share in (copy.copy, pickle.dumps):
        with pytest.raises(TypeError, match=r'copy\(\)'):
            share(scene)


def test_node_handles_end_with_a_clear_error():
    scene = NodeScene()
    store_of(scene).next_node_handle = 2**31 - 1
    assert scene.update('test', ['last'], BOX, stamp=1) == []
    assert scene.get('last').handle == 2**31 - 1
    with pytest.raises(OverflowError, match='node handles of this run are used up'):
        scene.update('test', ['more'], BOX, stamp=2)
    assert scene.names() == [(2**31 - 1, 'last')]
    assert scene.update('test', ['last'], BOX, stamp=3) == []


def test_a_scene_of_aligned_boxes_compiles_and_imports_nothing_narrow():
    program = """
import sys, numpy as np
from bvh_ros.scene import NodeScene, Shapes
half = np.pi / 4
root = 0.5**0.5
turns = [[0, 0, 0, 1], [0, 0, root, root], [0.5, -0.5, 0.5, 0.5]]
turns += [[0, 0, np.sin(half), np.cos(half)]]
scene = NodeScene()
crates = Shapes.boxes(np.eye(4, 3) * 9, [1, 2, 3], turns)
assert scene.update('a', list('abcd'), crates, stamp=1) == []
assert scene.raycast([-5, 0, 0], [9, 0, 0]) and scene.raycast_all([-5, 0, 0], [9, 0, 0])
assert scene.overlap([0, 0, 0], [9, 9, 9], turns[1], 0.1)
assert scene.overlap([0, 0, 0], [0, 0, 0], tolerance=1)
assert (scene.raycast_many(np.zeros((2, 3)), np.eye(3)[:2])[0] == 4).all()
assert not {'fcl', 'rclpy'} & set(sys.modules)
assert not scene.stats()['narrow_phase'] and scene.stats()['shaped'] == 0
from bvh_ros.scene.cast import batch
from bvh_ros.scene.distance.query import overlap_kernel
assert not batch.cast_segment.signatures and len(overlap_kernel.signatures) == 1
scene.update('a', ['e'], Shapes.boxes([[0, 0, 9]], [1, 2, 3], [[0, 0, 0.1, 0.995]]), stamp=1)
assert scene.overlap([0, 0, 8], [1, 1, 9]) and len(overlap_kernel.signatures) == 2
assert 'fcl' not in sys.modules
"""
    subprocess.run([sys.executable, '-c', program], check=True)


def test_validation_in_turns_sees_what_there_was_and_finds_as_much():
    shapes = Shapes.boxes(np.random.default_rng(1).uniform(0, 9, (60, 3)), [1, 1, 1])
    scene = scene_of(shapes, names=Numbered('c#', np.arange(60)), source='s', of=NodeScene)
    for turn, _ in enumerate(scene.validate_in_turns()):
        scene.update('s', [f'new {turn}'], shapes.take([0]), stamp=2)
    assert len(scene) > 60
    store_of(scene).tree.view().tree.heights[:] += 1
    with pytest.raises(RuntimeError, match='height'):
        list(scene.validate_in_turns())


def test_memory_for_new_obstacles_is_asked_for_before_anything_changes(monkeypatch):
    box = Shapes.boxes([[0, 0, 0]], [1, 1, 1])
    scene = scene_of(box, names=['a'], source='s', of=NodeScene)

    def refuse(updates, rows):
        raise MemoryError

    monkeypatch.setattr('bvh_ros.scene.updates.Updates.require_memory', refuse)
    assert not scene.update('s', ['a'], changed(box, position=np.ones((1, 3))), stamp=2)
    with pytest.raises(MemoryError):
        scene.update('s', ['b'], box, stamp=3)
    assert (scene.interrupted, scene.newest, len(scene)) == (False, 2, 1)
    assert scene.get('a').position.tolist() == [1, 1, 1]


def test_an_aligned_box_in_the_place_of_a_turned_one():
    turned = Shapes.boxes([[0, 0, 0], [9, 0, 0]], [4, 1, 1], [[0.0, 0.0, 0.3, 0.95]] * 2)
    scene = scene_of(turned, planar=True, names=['gone', 'stays'], source='a', of=NodeScene)
    scene.remove('a', ['gone'])
    scene.update('a', ['new'], Shapes.boxes([[0, 0, 0]], [4, 1, 1]), stamp=2)
    assert scene.any_shaped
    for radius in (0.0, 0.25):
        hit = scene.raycast([-5, 0.5, 0], [5, 0.5, 0], radius)
        assert (hit.name, hit.t) == ('new', (3 - radius) / 10)
    assert [hit.name for hit in scene.overlap([1.5, 0.4, 0], [2, 0.5, 0])] == ['new']


def test_names_of_handles_of_any_shape():
    scene = scene_of(Shapes.boxes([[0, 0, 0], [5, 0, 0]], [1, 1, 1]), names=['a', 'b'])
    hits = scene.raycast_many(
        [[-9, 0, 0], [-9, 9, 0], [9, 0, 0]], [[1, 0, 0], [1, 0, 0], [-1, 0, 0]]
    )
    assert scene.names_of(hits.handles).tolist() == ['a', None, 'b']
    near = scene.nearest_many([[0, 0, 0], [9, 0, 0]], 3)
    assert scene.names_of(near.handles).tolist() == [['a', 'b', None], ['b', 'a', None]]
    assert near.distances[1, 0] == 3.5
    assert scene.clearance_many(Shapes.boxes([[0, 3, 0]], [1, 1, 1])).distances.tolist() == [2.0]
    assert scene.names_of([]).shape == (0,)
    assert scene.names_of(hits.handles[0]).item() == 'a'
    scene.remove('test', ['a'])
    with pytest.raises(KeyError, match=str(hits.handles[0])):
        scene.names_of(hits.handles)
