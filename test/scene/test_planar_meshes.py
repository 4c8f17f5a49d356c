# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes in planar scenes: convex polygons, against boxes, sampling and exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene.reference import scene_of
from scipy.spatial import ConvexHull

from bvh_ros.scene import Mesh, Shapes

coordinates = st.integers(-8, 8)


@settings(max_examples=60)
@given(st.lists(st.tuples(*[coordinates] * 4), min_size=1, max_size=8), st.randoms())
def test_thin_rays_are_clipped_exactly(rays, random):
    """An octahedron on its tip is a square on its corner."""
    corners = np.array([(4, 0, 0), (0, 4, 0), (-4, 0, 0), (0, -4, 0), (0, 0, 4), (0, 0, -4)])
    mesh = Mesh(corners[ConvexHull(corners).simplices])
    scene = scene_of(Shapes.of_meshes([mesh], [(0, 0, 0)]), planar=True)
    for x, y, to_x, to_y in rays:
        entry, leave = Fraction(0), Fraction(1)
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            height, slope = 4 - a * x - b * y, a * (to_x - x) + b * (to_y - y)
            if slope > 0:
                leave = min(leave, Fraction(height, slope))
            elif slope < 0:
                entry = max(entry, Fraction(height, slope))
            elif height < 0:
                leave = Fraction(-1)
        if entry == leave:  # touched in one point: the direction's rounding decides
            continue
        hit = scene.raycast((x, y, 0), (to_x, to_y, random.random()))
        assert (hit is not None) == (entry < leave)
        if hit is not None:
            assert hit.t == pytest.approx(float(entry), rel=1e-15)
            assert abs(hit.point[:2]).sum() == pytest.approx(4, rel=1e-15) or hit.t == 0.0
