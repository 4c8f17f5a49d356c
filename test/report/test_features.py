# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report's builds without a part really lack it."""

import pytest

from bvh_ros.report.features.parts import WITHOUT, random_world
from bvh_ros.report.features.running import Job, run_in_turns
from bvh_ros.scene import ShapeKind

SHAPES = tuple(f'bvh_ros.{module}' for module in WITHOUT['other shapes and the narrow phase'])


def test_a_build_without_a_part_answers_until_it_needs_it(tmp_path):
    boxes = random_world(50, ShapeKind.BOX, False, 5).save(tmp_path, 'boxes')
    took = run_in_turns({'lean': Job(boxes, without=SHAPES)}, 1, lambda: None)
    assert set(took['lean'][0]) == {'start', 'update', 'raycast', 'overlap', 'memory'}
    spheres = random_world(50, ShapeKind.SPHERE, True, 5).save(tmp_path, 'spheres')
    with pytest.raises(RuntimeError, match='object'):
        run_in_turns({'lean': Job(spheres, without=SHAPES)}, 1, lambda: None)
