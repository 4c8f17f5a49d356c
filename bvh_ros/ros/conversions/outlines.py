# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles as lines and triangles, many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions import rotations
from bvh_ros.scene import Shapes, inspection
from bvh_ros.tree.access import CORNERS, SIDES, plotting

Floats = NDArray[np.float64]

# The two triangles of each side.
TRIANGLES = SIDES[:, (0, 1, 2, 0, 2, 3)].ravel()


def edges(lo: Floats, hi: Floats) -> Floats:
    """Return the edges (n * 12, 2, 3) of boxes (n, 3), or (n * 4, 2, 3) of flat ones (n, 2)."""
    return np.pad(plotting.edges(lo, hi), ((0, 0), (0, 0), (0, 3 - lo.shape[1])))


def triangles(shapes: Shapes) -> Floats:
    """Return the corners (n * 36, 3) of the twelve triangles around each shape's own box."""
    local = (CORNERS - 0.5) * shapes.size[:, None]
    turned = rotations.rotate(rotations.normalised(shapes.orientation)[:, None], local)
    middles = inspection.middles(shapes)
    corners: Floats = (middles[:, None] + turned)[:, TRIANGLES].reshape(-1, 3)
    return corners
