# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first kernel of a batch takes the tree as it is; what goes on from there, only that tree."""

import numpy as np
import pytest
from scene.inside import store_of
from scene.reference import scene_of

from bvh_ros.scene import NO_NODE, Shapes
from bvh_ros.scene.cast import batch
from bvh_ros.scene.distance.distances import Distances

NOWHERE = 1e3
TURNED = 0.0, 0.0, 0.6, 0.8


def row_of_boxes(turn=None):
    """Boxes every 3 m along x, and a snapshot of them."""
    x = 3.0 * np.arange(1.0, 21.0)
    places = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
    shapes = Shapes.boxes(places, [1.0, 1.0, 1.0], None if turn is None else [turn] * 20)
    scene = scene_of(shapes)
    scene.raycast_many(np.zeros((99, 3)), np.ones((99, 3)), radius=0.1, t_max=1.0)
    assert store_of(scene).tree.ready_snapshot() is not None
    return scene


def put(scene, name, x):
    scene.update('test', [name], Shapes.boxes([[x, 0.0, 0.0]], [1.0, 1.0, 1.0]), stamp=2)


@pytest.mark.parametrize('turn', [None, TURNED], ids=['boxes', 'turned'])
@pytest.mark.parametrize('radius', [0.0, 0.25])
def test_a_snapshot_from_before_a_change_is_not_asked(turn, radius):
    scene, start, goal = row_of_boxes(turn), np.zeros((1, 3)), np.array([[6.0, 0.0, 0.0]])
    for x, first in ((1.5, '19'), (NOWHERE, '0'), (1.75, '19')):
        put(scene, '19', x)
        ways = (
            scene.sweep_many(start, goal, radius),
            scene.raycast_many(start, goal, 1.0, radius=radius),
        )
        for found in ways:
            assert scene.name_of(int(found.handles[0])) == first
            assert found.t[0] == scene.raycast(start[0], goal[0], radius).t


def test_a_batch_of_balls_goes_on_with_the_tree_that_it_began_with(monkeypatch):
    scene, start, goal = row_of_boxes(), np.zeros((3, 3)), np.array([[9.0, 0.0, 0.0]] * 3)
    start[:, 1] = goal[:, 1] = -1.25  # they pass by so closely that only exact arithmetic decides
    expected, answer_exactly = scene.sweep_many(start, goal, 0.75), batch._answer_exactly
    assert (expected.handles != NO_NODE).all()

    def moving_on(*given):
        answer_exactly(*given)
        put(scene, '19', 70.0 + given[-2])

    monkeypatch.setattr(batch, '_answer_exactly', moving_on)
    with pytest.raises(RuntimeError, match='changed'):
        scene.sweep_many(start, goal, 0.75)


def test_a_batch_of_boxes_goes_on_with_the_tree_that_it_began_with(monkeypatch):
    scene = row_of_boxes()
    asked = np.zeros((3, 3)), np.zeros(3), None, 2.5  # as far away as the tolerance
    assert scene.overlap_many(*asked, want='count').tolist() == [1, 1, 1]
    answer_exactly = Distances._answer_exactly

    def moving_on(distances, *given):
        put(scene, '19', 70.0 + given[-1])
        return answer_exactly(distances, *given)

    monkeypatch.setattr(Distances, '_answer_exactly', moving_on)
    with pytest.raises(RuntimeError, match='changed'):
        scene.overlap_many(*asked, want='count')
