# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Orientations for tests."""

import numpy as np


def unit_quaternions(quaternions):
    """Quaternions (n, 4) at length 1; of zeros the identity."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    found = quaternions / np.where(lengths > 0.0, lengths, 1.0)
    return np.where(lengths > 0.0, found, [0.0, 0.0, 0.0, 1.0])
