# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Hits of boxes that move come in exact order, also where their distances are one double."""

import numpy as np

from bvh_ros.scene import Scene, Shapes
from bvh_ros.scene.cast.motion_batch import _keep_exact_order
from bvh_ros.scene.geometry.shapes import BOX, SPHERE


def test_equal_doubles_stay_in_exact_order():
    """Against sorting by what the doubles do not tell."""
    rng = np.random.default_rng(1)
    for _ in range(300):
        count = int(rng.integers(1, 30))
        first = int(rng.integers(0, count + 1))
        rows, ts = rng.integers(0, 3, count), rng.integers(0, 3, count).astype(float)
        told = np.lexsort((ts[:first], rows[:first]))  # the first come by ray, nearest first
        rows[:first], ts[:first] = rows[told], ts[told]
        handles = rng.permutation(count)
        order = np.lexsort((handles, ts, rows))
        _keep_exact_order(order, first)
        assert sorted(order) == list(range(count))
        keys = list(zip(rows[order], ts[order], strict=True))
        assert keys == sorted(keys)
        exact = order[order < first]
        assert (exact == np.arange(first)).all()


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
