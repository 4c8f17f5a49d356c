# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The demo ends by itself, and its table tells who was in the way."""

import re
import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from bvh_ros import demo

ROW = re.compile(r'^ *\d+\.\d  .+ +(free|\S+/\d+.* \(.+, .+, .+\)) +\d+\.\d+$')


def run(*arguments):
    return subprocess.run(
        [sys.executable, '-m', 'bvh_ros.demo', *arguments],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )


def test_replay_of_recorded_traffic(shared_data):
    file = shared_data / 'commonroad_ngsim' / 'USA_Peach-4_8_T-1.csv'
    result = run('--replay', str(file), '--speed', '3')
    assert result.returncode == 0, result.stderr
    rows = [line for line in result.stdout.splitlines() if ROW.match(line)]
    assert len(rows) >= 6, result.stdout
    assert any('car/' in row.split('  ')[-3] or 'car/' in row for row in rows)
    assert '0 errors' in result.stdout
    assert 'Traceback' not in result.stderr


def test_every_frame_of_the_warehouse():
    frames = list(demo.warehouse())
    assert len(frames) == demo.DURATION * demo.RATE
    for frame in frames:
        names = [(thing.namespace, thing.number) for thing in frame.things]
        assert len(set(names)) == len(names)


def test_markers_of_things_that_are_gone():
    thing = demo.Thing('box', 'a', 1, (1.0, 2.0, 3.0), (1.0, 1.0, 1.0), 0.0)
    add, delete = demo.markers([thing], [('a', 2)]).markers
    assert (add.ns, add.id, add.action) == ('a', 1, 0)
    assert (delete.ns, delete.id, delete.action) == ('a', 2, 2)


@pytest.mark.parametrize(
    'arguments', [('--replay', '/nowhere.csv'), ('--speed', '0'), ('--speed', 'nan')]
)
def test_wrong_arguments(arguments):
    result = run(*arguments)
    assert result.returncode == 2
    assert 'Traceback' not in result.stderr
