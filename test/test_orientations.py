# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quaternions from angles, and what is refused for none."""

import numpy as np
import pytest
from odd_values import VALUES
from scipy.spatial.transform import Rotation

from bvh_ros import Scene, Shapes, quaternions


def test_angles_are_those_of_scipy() -> None:
    rng = np.random.default_rng(3)
    rpy = rng.uniform(-7, 7, (200, 3))
    right = Rotation.from_euler('xyz', rpy)
    for turns in (quaternions(rpy=rpy), np.array([quaternions(rpy=row) for row in rpy])):
        assert turns.shape == (200, 4)
        assert (Rotation.from_quat(turns) * right.inv()).magnitude().max() < 1e-14
    yaw = rpy[:, 2]
    right = Rotation.from_euler('z', yaw[:, None])
    for turns in (quaternions(yaw=yaw), np.array([quaternions(yaw=angle) for angle in yaw])):
        assert (Rotation.from_quat(turns) * right.inv()).magnitude().max() < 1e-14


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('name', ['yaw', 'rpy'])
def test_what_are_no_angles(name: str) -> None:
    for value in VALUES:
        if isinstance(value, np.ndarray) and value.size > 2**40:
            continue
        said = name
        try:
            turns = quaternions(**{name: value})
        except ValueError as error:
            said = str(error)
        else:
            assert np.allclose(np.linalg.norm(turns, axis=-1), 1.0)
        assert name in said
        assert '\n' not in said
    with pytest.raises(ValueError, match='not both'):
        quaternions(yaw=0.0, rpy=[0, 0, 0])


NONE = [[0, 0, 90, 0], [0, 0, 0, 0], [0, 0, 0, 0.98], [0, 0, 0.8, 0.8], [1e200, 0, 0, 0]]
NEAR = [[0, 0, 0.7, 0.71], [0, 0, 0, -1.009], [0.5, 0.5, 0.5, 0.5]]
ONE, TWO = [1.0, 1.0, 1.0], [[0.0, 0, 0], [3, 0, 0]]


@pytest.mark.parametrize('turn', NONE + NEAR, ids=str)
def test_lengths_are_1_to_within_a_hundredth(turn: list[float]) -> None:
    scene, good = Scene(), [0.0, 0, 0, 1]
    calls = {
        'orientation': [
            lambda: Shapes.boxes(TWO, ONE, [good, turn]),
            lambda: Shapes.cylinders(TWO, 1, 1, turn),
            lambda: Shapes.capsules(TWO, 1, 3, [good, turn]),
            lambda: Shapes([0, 1], TWO, [good, turn], ONE),
            lambda: scene.overlap(*TWO, turn),
        ],
        'orientations': [
            lambda: scene.overlap_many(TWO, ONE, [good, turn]),
            lambda: scene.overlap_many(TWO, ONE, turn),
            lambda: scene.overlap_many(TWO, ONE, np.array(turn)),
            lambda: scene.overlap_shape_many(Shapes.boxes([[0, 0, 0]], 1), TWO, [good, turn]),
        ],
    }
    for name, several in calls.items():
        for call in several:
            if turn in NEAR:
                call()
                continue
            with pytest.raises(ValueError, match=rf'{name} must be quaternions x, y, z, w .* row'):
                call()


def test_one_orientation_serves_for_all_rows() -> None:
    scene = Scene()
    scene.update('s', ['a', 'b'], Shapes.boxes(TWO, [1, 1, 4], quaternions(rpy=[0.4, 0, 0.3])))
    rng = np.random.default_rng(4)
    places, turn = rng.uniform(-3, 5, (60, 3)), quaternions(rpy=[0.1, 0.2, 0.3])
    every = np.tile(turn, (60, 1))
    right = scene.overlap_many(places, [1, 2, 0.2], every, want='count')
    assert 0 < right.sum() < 120
    for one in (turn, turn.tolist(), tuple(turn)):
        told = scene.overlap_many(places, [1, 2, 0.2], one, want='count')
        assert np.array_equal(told, right)
    shape = Shapes.capsules([[0, 0, 0]], 0.2, 2)
    right = scene.overlap_shape_many(shape, places, every, want='count')
    assert np.array_equal(scene.overlap_shape_many(shape, places, turn, want='count'), right)


def test_a_rotation_of_scipy_is_told_how_to_come_in() -> None:
    turn = Rotation.from_rotvec([0.0, 0.0, 0.5])
    with pytest.raises(ValueError, match='as_quat'):
        Shapes.boxes([0, 0, 0], [1, 1, 1], turn)
    assert len(Shapes.boxes([0, 0, 0], [1, 1, 1], turn.as_quat()).kind) == 1
