# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded tables and shelves: all rays against exact arithmetic, all pairs against python-fcl.

10^4 rays a scene with BVH_ROS_LONG_TESTS=1. The truth of rays is brute force in whole numbers of
the shapes as recorded; of pairs that the two libraries see differently, the widest gap between
two parallel planes.
"""

import os

import fcl
import numpy as np
import pytest
from scene.distance.widest_gap import widest_gap

from bvh_ros.report.error import worlds
from bvh_ros.report.error.pairs import fcl_objects
from bvh_ros.report.error.truth import NOTHING, score, shapes_truth
from bvh_ros.report.error.worlds import rays_round, scene_answer, scene_of

RAYS = 10_000 if os.environ.get('BVH_ROS_LONG_TESTS') == '1' else 200
GRAZED = 1e-11  # m: rounding over the slope of the surface that a ray enters
FLUSH = 1e-9  # m: boards that are to share a face, in numbers of few digits


@pytest.fixture(scope='module')
def recorded(shared_data):
    scenes = worlds.shapes_by_scene(shared_data / 'manipulation_scenes' / 'scenes.csv')
    assert len(scenes) == 17
    return scenes


def test_first_hits_are_those_of_exact_arithmetic(recorded):
    met = 0
    for number, shapes in enumerate(recorded.values()):
        rays = rays_round(shapes, RAYS, np.random.default_rng(number))
        truth = shapes_truth(shapes, rays)
        found = score(scene_answer(scene_of(shapes), rays), truth)
        assert (found.wrong_hits, found.wrong_misses) == (0, 0)
        assert found.wrong_by < 1e-14  # flush boards: decided in float64
        assert found.distances.max(initial=0.0) < GRAZED
        met += int(np.count_nonzero(truth.rows != NOTHING))
    assert 0.3 < met / (RAYS * len(recorded)) < 0.99


def test_pairs_touch_as_python_fcl_says(recorded):
    rng = np.random.default_rng(1)
    pairs = together = 0
    for name, shapes in recorded.items():
        objects, count = fcl_objects(shapes), len(shapes.kind)
        mine = {
            tuple(sorted((int(one), int(other))))
            for one, other in scene_of(shapes).overlap_pairs()
        }
        for i in range(count):
            for j in range(i + 1, count):
                pairs += 1
                together += (i, j) in mine
                if ((i, j) in mine) != (fcl.collide(objects[i], objects[j]) > 0):
                    gap = widest_gap(shapes.take([i, j]), rng)
                    assert abs(gap) < FLUSH, (name, i, j, gap)
    assert pairs > 400
    assert together > 40
