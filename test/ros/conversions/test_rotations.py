# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quaternions, checked against rotation matrices."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bvh_ros.ros.conversions import rotations

RNG = np.random.default_rng(1)


def matrix(q):
    return Rotation.from_quat(q).as_matrix()


@pytest.mark.parametrize(
    'normal',
    [
        (1, 0, 0),
        (0, 1, 0),
        (0, 0, -1),
        (-1, 1e-9, 0),
        (-1, 0, 1e-300),
        (-math.sqrt(0.5), math.sqrt(0.5), 0),
        *(v / np.linalg.norm(v) for v in RNG.normal(size=(50, 3))),
    ],
)
def test_from_normal_turns_x_onto_it(normal):
    q = rotations.from_normal(*normal)
    assert math.isclose(math.hypot(*q), 1.0, rel_tol=1e-15)
    assert np.allclose(matrix(q)[:, 0], normal, atol=1e-14, rtol=0)


def test_from_normal_special_cases():
    assert rotations.from_normal(0, 0, 0) == (0, 0, 0, 1)
    assert rotations.from_normal(-1, 0, 0) == (0, 0, 1, 0)  # half a turn about z
    assert rotations.from_normal(-1, -0.0, 0.0) == (0, 0, 1, 0)


def test_rotate_and_multiply_agree_with_matrices():
    first, second = rotations.normalised(RNG.normal(size=(2, 20, 4)))
    points = RNG.normal(size=(20, 3))
    turned_points = rotations.rotate(rotations.multiply(first, second), points)
    for f, s, p, turned in zip(first, second, points, turned_points, strict=True):
        assert np.allclose(matrix(f) @ matrix(s) @ p, turned, atol=1e-14)


def test_normalised():
    q = rotations.normalised(
        [[0, 0, 0, 0], [0, 0, 2, 0], [1e-200, 0, 0, 1e-200], [3e200, 0, 0, 0]]
    )
    root = math.sqrt(0.5)
    assert np.allclose(q, [[0, 0, 0, 1], [0, 0, 1, 0], [root, 0, 0, root], [1, 0, 0, 0]])
    assert np.isnan(rotations.normalised([math.nan, 0, 0, 1])).any()


def test_only_what_is_near_length_1_is_normalised_where_others_are_refused():
    given = [[0, 0, 0, 0], [0, 0, 0.7, 0.71], [0, 0, 90, 0], [0, 0, 0, 0.98], [math.nan, 0, 0, 1]]
    assert rotations.are_off(given).tolist() == [False, False, True, True, True]
    assert rotations.set_ones(given)[0].tolist() == [0, 0, 0, 1]
    tidy = rotations.normalised_if_near(given)
    assert np.allclose(np.linalg.norm(tidy[:2], axis=1), 1.0, atol=1e-15)
    assert np.array_equal(tidy[2:], given[2:], equal_nan=True)
