# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What objects say of themselves where a person prints them."""

from pathlib import Path

import numpy as np
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
