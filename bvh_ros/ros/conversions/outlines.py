# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes as lines and triangles, many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions import rotations
from bvh_ros.scene import Shapes

Floats = NDArray[np.float64]

# Corner k of a box has the upper coordinate on axis a where bit a of k is set.
CORNERS = np.array([[k >> axis & 1 for axis in range(3)] for k in range(8)], np.float64)
EDGES = np.array([(k, k | 1 << axis) for axis in range(3) for k in range(8) if not k >> axis & 1])
FLAT_EDGES = EDGES[(EDGES < 4).all(axis=1)]
# Four corners of each side, counter-clockwise seen from outside, as two triangles.
SIDES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
TRIANGLES = np.array([(a, b, c, a, c, d) for a, b, c, d in SIDES]).ravel()


def edges(lo: Floats, hi: Floats) -> Floats:
    """Return the ends (n * 24, 3) of the twelve edges of boxes (n, 3); of flat ones (n, 2) the
    ends (n * 8, 3) of the four at z = 0.
    """
    if lo.shape[1] == 2:
        flat = np.zeros((len(lo), 1))
        lo, hi = np.hstack((lo, flat)), np.hstack((hi, flat))
        around = FLAT_EDGES
    else:
        around = EDGES
    corners = lo[:, None] + CORNERS * (hi - lo)[:, None]
    ends: Floats = corners[:, around.ravel()].reshape(-1, 3)
    return ends


def triangles(shapes: Shapes) -> Floats:
    """Return the corners (n * 36, 3) of the twelve triangles around each shape's own box."""
    local = (CORNERS - 0.5) * shapes.size[:, None]
    turned = rotations.rotate(rotations.normalised(shapes.orientation)[:, None], local)
    corners: Floats = (shapes.position[:, None] + turned)[:, TRIANGLES].reshape(-1, 3)
    return corners
