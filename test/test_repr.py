# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What objects say of themselves where a person prints them."""

from pathlib import Path

import numpy as np
import pytest
from scene.reference import box_of_triangles

from bvh_ros import DynamicBVH, Mesh, Scene, Shapes
from bvh_ros.forest import Forest


def test_trees_tell_size_and_height() -> None:
    lo = np.arange(3000.0).reshape(1000, 3)
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    assert repr(tree) == f'DynamicBVH(3D, 1,000 boxes, height {tree.height})'
    tree = DynamicBVH(2)
    assert repr(tree) == 'DynamicBVH(2D, 0 boxes, height 0)'
    crate = tree.insert([0, 0], [1, 1])
    assert repr(tree) == 'DynamicBVH(2D, 1 box, height 0)'
    assert repr(tree.raycast([-1, 0.5], [3, 0])) == (
        f'RayHit(id={crate}, t=0.333333, point=[0, 0.5], normal=[-1, 0])'
    )


def test_scenes_tell_how_many_obstacles_there_are() -> None:
    scene, planar = Scene(), Scene(planar=True)
    assert repr(planar) == 'Scene(planar, 0 obstacles of 0 sources)'
    scene.update('camera', ['crate'], Shapes.boxes([[2, 0, 0]], 1))
    assert repr(scene) == 'Scene(3D, 1 obstacle of 1 source)'
    assert repr(scene.raycast([0, 0, 0], [9, 0, 0])) == (
        "SceneHit('crate', t=0.166667, point=[1.5, 0, 0], normal=[-1, 0, 0], handle=1, stamp=0)"
    )


def test_batches_tell_how_many_rows_found_something() -> None:
    boxes = [[2.0, 0, 0], [6, 0, 0]]
    tree = DynamicBVH.from_boxes(np.subtract(boxes, 0.5), np.add(boxes, 0.5))
    rays = [0.0, 0, 0], [[1.0, 0, 0], [2, 0, 0], [0, 1, 0]]
    assert repr(tree.raycast_many(*rays)) == 'RayHits(2 of 3 rays hit, t from 0.75 to 1.5)'
    assert repr(tree.raycast_many(rays[0], -np.array(rays[1]))) == 'RayHits(0 of 3 rays hit)'
    scene = Scene()
    scene.update('camera', ['crate', 'box'], Shapes.boxes(boxes, 1))
    assert repr(scene.raycast_many(*rays)) == 'CastHits(2 of 3 rays hit, t from 0.75 to 1.5)'
    ball = Shapes.spheres([[0.0, 0, 0]], 0.5)
    sweeps = scene.sweep_shape_many(ball, [0.0, 0, 0], None, [[4.0, 0, 0], [0, 4, 0]])
    assert repr(sweeps).startswith('ShapeSweeps(1 of 2 sweeps hit, t from 0.2')
    assert repr(scene.overlap_many([[2.0, 0, 0], [0, 0, 0]], 1, want='hits')) == (
        'BoxHits(1 of 2 boxes touched, distances from 0 to 0)'
    )
    assert repr(scene.clearance('crate')) == (
        "Clearance('box', distance=3, point=[2.5, 0, 0], other_point=[5.5, 0, 0], handle=2)"
    )


def test_batches_of_a_node_tell_what_it_did_not_answer() -> None:
    pytest.importorskip('sensor_msgs', reason='ROS is not installed')
    from bvh_ros.client import FREE, UNANSWERED, Hits, Near

    handles, rows = np.array([7, FREE, UNANSWERED], np.uint32), np.zeros((3, 3))
    far = np.array([1.5, np.inf, np.nan])
    assert repr(Hits(handles, far, rows, rows)) == (
        'Hits(1 of 3 rays hit, t from 1.5 to 1.5, 1 unanswered)'
    )
    assert repr(Near(rows[:2], far[:2], rows[:2], handles[:2])) == (
        'Near(1 of 2 near an obstacle, distances from 1.5 to 1.5)'
    )


def test_obstacles_tell_where_they_are() -> None:
    scene, turn = Scene(), [0.0, 0.0, 0.6, 0.8]
    scene.update('camera', ['crate', 'box'], Shapes.boxes([[2, 0, 0], [4, 0, 0]], 1, [turn] * 2))
    scene.update('camera', ['box'], Shapes.boxes([[4, 0, 0]], [1, 2, 1]), stamp=3)
    assert repr(scene.get('box')) == (
        "Obstacle('box', BOX, position=[4, 0, 0], size=[1, 2, 1], source='camera', handle=2, "
        'stamp=3)'
    )
    assert 'orientation=[0, 0, 0.6, 0.8], size' in repr(scene.get('crate'))


def test_shapes_and_meshes_tell_what_they_are() -> None:
    rows = [[0.0, 0, 0]] * 4
    assert repr(Shapes([0, 1, 0, 2], rows, [0, 0, 0, 1], 1)) == (
        'Shapes(2 boxes, 1 sphere, 1 cylinder)'
    )
    assert repr(Shapes.spheres([], 1)) == 'Shapes(none)'
    assert (
        repr(Mesh(box_of_triangles((1, 2, 0.5))))
        == 'Mesh(convex solid of 12 triangles, 1 x 2 x 0.5 m)'
    )


def test_forests_tell_where_they_are(tmp_path: Path) -> None:
    lo = np.arange(30.0).reshape(10, 3)
    forest = Forest.build(tmp_path / 'world', [(lo, lo + 1)], 5)
    assert repr(forest) == f"Forest('{tmp_path / 'world'}', 3D, 10 boxes in 2 parts)"
