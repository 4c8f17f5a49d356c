# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hits of boxes that move come in exact order, also where their distances are one double."""

import numpy as np

from bvh_ros.scene import Scene, Shapes
from bvh_ros.scene.shapes.shape import BOX, SPHERE


def test_a_scene_tells_exactly_who_is_met_first():
    """Two boxes are met within the last digit of t; the younger one, who comes, is first."""
    sizes = np.full((3, 3), 2.0)
    places = np.array([[2.0, 0, 0], [2.0, 0, 0], [0, 9.0, 0]])
    shapes = Shapes(np.array([BOX, BOX, SPHERE], np.uint8), places, np.zeros((3, 4)), sizes)
    scene = Scene()
    slow = np.array([[0, 0, 0], [-1e-20, 0, 0], [0, 0, 0]])
    scene.update('s', ['rests', 'comes', 'a ball'], shapes, stamp=0, velocities=slow)
    hits = scene.raycast_all([0, 0, 0], [4, 0, 0], at=0, until=10**9)
    assert [hit.name for hit in hits] == ['comes', 'rests']
    assert hits[0].t == hits[1].t == 0.25
