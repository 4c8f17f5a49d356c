# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The nearest other obstacle: a plane between the two proves the distance, python-fcl agrees on
boxes.
"""

import numpy as np
import pytest
from scene.reference import hull_of, scene_of

from bvh_ros.scene import Mesh, Shapes


def test_axis_aligned_boxes_exactly():
    shapes = Shapes.boxes([[0, 0, 0], [4, 1, 9], [3, 4, 0]], [[2, 2, 2], [2, 2, 2], [2, 2, 2]])
    scene = scene_of(shapes, names=['a', 'b', 'c'])
    found = scene.clearance('a')
    assert (found.distance, found.name) == (np.sqrt(5.0), 'c')
    assert (found.point.tolist(), found.other_point.tolist()) == ([1, 1, 0], [2, 3, 0])
    scene.update('test', ['b'], Shapes.boxes([[2, 0.5, 0.5]], [2, 2, 2]), stamp=2)
    found = scene.clearance('a')
    assert (found.distance, found.name) == (0.0, 'b')
    assert found.point.tolist() == found.other_point.tolist() == [1, 0.25, 0.25]


@pytest.mark.parametrize('nudge', [0.0, 2.0**-50])
def test_the_first_of_many_as_near_at_a_time(nudge):
    """On whole numbers of metres many touch, or are as near as others: more than there is room
    for at first. So they are where some are farther by a last digit.
    """
    rng = np.random.default_rng(3)
    corners = rng.integers(-4, 5, (400, 3)) + np.where(rng.random((400, 1)) < 0.5, 0.0, nudge)
    speeds = rng.integers(-2, 3, (400, 3)).astype(float)
    scene = scene_of(Shapes.boxes(corners, (1, 1, 1)), stamp=0, velocities=speeds)
    places = rng.integers(-9, 10, (300, 3)).astype(float)
    handles, distances, points, others = scene.clearance_many(
        Shapes.boxes(places, (1, 1, 1)), at=1_000_000_000
    )
    low, high = corners + speeds - 0.5, corners + speeds + 0.5
    places = places[:, None]
    apart = np.maximum(np.maximum(low - (places + 0.5), (places - 0.5) - high), 0.0)
    gaps = np.sqrt((apart**2).sum(axis=2))
    nearest = gaps.min(axis=1)
    equally = np.count_nonzero(gaps == nearest[:, None], axis=1)
    assert (equally > 8).any()
    assert (equally[nearest > 0.0] > 2).any()
    assert (distances == nearest).all()
    assert (handles == scene.handles()[np.argmax(gaps == nearest[:, None], axis=1)]).all()
    assert np.allclose(np.linalg.norm(points - others, axis=1), nearest, rtol=0.0, atol=1e-14)


def test_meshes_apart_in_one_box():
    """Two corners cut off a cube: the middle of their boxes is the same, and lies in neither."""
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = corner[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]
    meshes = [Mesh(faces), Mesh(1.0 - faces)]
    scene = scene_of(Shapes.of_meshes(meshes, np.zeros((2, 3))), names=['a', 'b'])
    assert scene.overlap_pairs() == []
    found = scene.clearance('a')
    assert found.distance == pytest.approx(1 / np.sqrt(3))
    assert found.point.sum() == pytest.approx(1)
    assert found.other_point.sum() == pytest.approx(2)


def test_a_corner_next_to_the_foot_of_an_edge_is_not_lost():
    """Corners of two solids, 8.089e-11 m apart: true value in rationals, to the rounding of the
    turns. The foot was within 2**-53 of the edge's end, and the edge was passed over.
    """
    angle = np.arange(4) * np.pi / 2
    rim = np.column_stack((np.cos(angle), np.sin(angle), np.full(4, -1.0)))
    mesh = Mesh(hull_of(np.vstack((rim, rim * [1, 1, -1]))))
    place = [2.0276924442535242, -0.16799615471023405, -1.8961507196848433]
    other = [2.730285123749456, -1.7345266680773037, -3.154270107781881]
    turn = [0.39079225778914123, -0.7677200925595162, -0.3950377768121889, 0.3191119327504951]
    nearly = [0.3907922576480083, -0.7677200926380268, -0.3950377768610538, 0.3191119326739578]
    size = [1.5240712412707102, 1.8409593686503811, 0.9771056534053408]
    scene = scene_of(Shapes.boxes([place], size, [turn]), names=['box'])
    scene.update('test', ['mesh'], Shapes.of_meshes([mesh], [other], [nearly]), stamp=1)
    for name in ('box', 'mesh'):
        assert abs(scene.clearance(name).distance - 8.0890292e-11) < 1e-13


def test_alone_or_unknown():
    scene = scene_of(Shapes.boxes([[0, 0, 0]], [1, 1, 1]), names=['a'])
    assert scene.clearance('a') is None
    with pytest.raises(KeyError):
        scene.clearance('b')
