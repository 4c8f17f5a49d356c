# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Orientations for tests."""

import numpy as np


def unit_quaternions(quaternions):
    """Quaternions (n, 4), none of them zero, at length 1."""
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
