# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Short ways to a length change no digit of it."""

import math

import numpy as np

from bvh_ros.scene.distance import narrow_phase
from bvh_ros.scene.shapes import shape


def scaled_length(vector, exponent):
    square = 0.0
    for axis in range(vector.shape[0]):
        scaled = math.ldexp(vector[axis], -exponent)
        square += scaled * scaled
    return math.ldexp(math.sqrt(square), exponent)


def test_a_length_is_that_of_the_scaled_vector():
    rng = np.random.default_rng(2)
    vectors = rng.normal(size=(2000, 3)) * 10.0 ** rng.integers(-170, 171, (2000, 1))
    vectors *= 10.0 ** rng.integers(-20, 1, (2000, 3)) * rng.integers(0, 2, (2000, 3))
    for vector in vectors:
        exponent = math.frexp(np.abs(vector).max())[1]
        assert narrow_phase.length(vector) == scaled_length(vector, exponent)


def test_hypot_is_that_of_the_library():
    values = [0.0, -0.0, 5e-324, -1.5, 1e300, -math.inf, math.nan]
    for one in values:
        for other in values:
            told, expected = shape.hypot.py_func(one, other), math.hypot(one, other)
            assert told == expected or (math.isnan(told) and math.isnan(expected))
