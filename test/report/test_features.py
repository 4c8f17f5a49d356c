# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report's builds without a part really lack it, and are compared with the whole."""

import subprocess
import sys

import pytest

from bvh_ros.report.features import builds, off
from bvh_ros.report.features.on import random_world
from bvh_ros.report.features.running import Job, side_by_side
from bvh_ros.scene import ShapeKind

WITHOUT_SHAPES = 'other shapes and the narrow phase'


@pytest.mark.parametrize('name', builds.WITHOUT)
def test_every_cut_meets_the_source(tmp_path, name):
    builds.make(builds.WITHOUT[name], tmp_path, 'lean')
    for file in (tmp_path / 'lean').rglob('*.py'):
        compile(file.read_text(encoding='utf-8'), file, 'exec')


def test_a_cut_that_meets_nothing_is_an_error(tmp_path):
    build = builds.Build((), (builds.Cut('scene/*.py', 'no such line', ''),))
    with pytest.raises(RuntimeError, match="no 'no such line' in scene"):
        builds.make(build, tmp_path, 'lean')


def test_a_build_without_a_part_answers_until_it_needs_it(tmp_path):
    builds.make(builds.WITHOUT[WITHOUT_SHAPES], tmp_path, 'bvh_ros')
    boxes = random_world(50, ShapeKind.BOX, False, 5).save(tmp_path, 'boxes')
    took = side_by_side({'lean': Job(boxes, path=tmp_path)}, 1)
    assert set(took['lean']) == {'start', 'update', 'raycast', 'overlap', 'memory'}
    program = 'from bvh_ros.scene import Scene; Scene().raycast([0, 0, 0], [1, 0, 0], 0.1)'
    swept = subprocess.run(
        [sys.executable, '-c', program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert "'object' object is not callable" in swept.stderr


def turns(*times):
    return {kind: list(times) for kind in off.TIMES}


def test_the_whole_over_a_build_without_a_part():
    """Turn by turn with both copies of the whole, then the median of the turns and processes."""
    first = {off.WHOLE: turns(2, 6, 9), off.AGAIN: turns(4, 6, 1), 'lean': turns(1, 4, 50)}
    second = {off.WHOLE: turns(3), off.AGAIN: turns(5), 'lean': turns(2)}
    alone = {off.WHOLE: [{'start': 6, 'memory': 8}], 'lean': [{'start': 3, 'memory': 4}]}
    found = off.ratios('lean', [first, second], alone)
    for kind in off.TIMES:  # of (3, 1.5, 0.1), and of 2
        assert found[kind] == pytest.approx((1.75, 1.25 * 0.125**0.5 / 2**0.5))
    assert found['start'] == found['memory'] == (2.0, 0.0)
    alone[off.AGAIN] = [{'start': 5, 'memory': 2}]
    again = off.ratios(off.AGAIN, [first, second], alone)
    assert again['update'][0] == pytest.approx((1.0 + 0.6) / 2)
    assert (again['start'], again['memory']) == ((1.2, 0.0), (4.0, 0.0))
