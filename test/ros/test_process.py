# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the node starts and ends."""

import re
import shlex
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from ros.patience import COMPILING, PATIENCE

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from bvh_ros.ros.access import ConfigurationError

OVERRIDES = 'qos_overrides./configured/obstacles.subscription'
GRID = {'sources': ['g'], 'g.type': 'OccupancyGrid', 'g.topic': 'g'}


@pytest.fixture(scope='module')
def start_node(start_node):
    """Processes that did not begin as forks."""
    return partial(start_node, fresh=True)


def end_of(world):
    """Return the exit code and what was said."""
    return world.process.wait(PATIENCE), world.said()


def test_a_node_starts_where_standard_error_is_closed():
    command = [sys.executable, '-m', 'bvh_ros.ros.node', '--ros-args', '-p', 'sources:=1']
    ended = subprocess.run(['sh', '-c', f'exec {shlex.join(command)} 2>&-'], timeout=PATIENCE)
    assert ended.returncode == 2  # it has come as far as its parameters


@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM])
def test_clean_exit(start_node, messages, how):
    world = start_node()
    world.markers(messages.marker(1))
    world.until(lambda: world.everything() == {'a/1'})
    assert world.end(how) == 0
    assert 'Traceback' not in world.said()
    assert 'rror' not in world.said()


def handles(process, number):
    """Whether a process has a handler for this signal: Python itself has none for SIGTERM."""
    status = Path(f'/proc/{process.pid}/status').read_text()
    return int(status.partition('SigCgt:')[2].split()[0], 16) >> (number - 1) & 1


@pytest.mark.slow
@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('after', [0.0, 0.1, 0.3])
def test_clean_exit_while_starting(start_node, how, after):
    """From when it has been imported; before that, the signal ends it in Python's way."""
    world = start_node(wait=False)
    world.until(lambda: handles(world.process, signal.SIGTERM))
    time.sleep(after)
    assert world.end(how) == 0, world.said()
    assert 'Traceback' not in world.said()


@pytest.mark.slow
@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM])
def test_clean_exit_while_compiling(start_node, monkeypatch, tmp_path, seconds_to_end, how):
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    world = start_node(wait=False)
    world.until(lambda: any(tmp_path.rglob('*.nbc')), COMPILING)  # of some minutes
    assert seconds_to_end(world.process, how) < 1.0
    assert 'Traceback' not in world.said()


@pytest.mark.slow
def test_a_second_start_compiles_nothing(start_node, monkeypatch):
    start_node().end()  # compiles, if nobody has
    monkeypatch.setenv('NUMBA_DEBUG_CACHE', '1')
    said = start_node().said()
    assert '[cache] data loaded from' in said
    assert '[cache] data saved to' not in said


@pytest.mark.slow
def test_start_up_line_says_what_is_on(start_node):
    world = start_node({'planar': True, 'margin': 0.5, 'frame_id': 'odom'})
    line = next(line for line in world.said().splitlines() if 'ready' in line)
    for word in ("'odom'", '2D', 'margin of 0.5', 'MarkerArray', 'obstacles', 'narrow phase'):
        assert word in line


@pytest.mark.slow
@pytest.mark.parametrize(
    ('parameters', 'reason'),
    [
        ({'margin': -1.0}, "'margin' must be at least 0"),
        ({'margin': float('nan')}, "'margin' must be"),
        ({'sources': ['g'], 'g': {'type': 'OccupancyGrid'}}, "needs a parameter 'g.topic'"),
        ({'markers': {'topic': 'a//b'}}, "source 'markers'"),
    ],
)
def test_wrong_parameters_end_the_node(start_node, parameters, reason):
    code, said = end_of(start_node(parameters, wait=False))
    assert code == 2
    assert reason in said
    assert 'Traceback' not in said


@pytest.mark.parametrize(
    ('parameters', 'reason'),
    [
        ({'margin': 'wide'}, "'margin' must be a number"),
        ({'planar': 1}, "'planar' must be true or false"),
        ({'frame_id': ''}, "'frame_id' is empty"),
        ({'frame_id': 5}, "'frame_id' must be a string"),
        ({'max_obstacles': 0}, "'max_obstacles' must be at least 1"),
        ({'max_obstacles': 10.5}, "'max_obstacles' must be a whole number"),
        ({'sources': 'markers'}, 'must be a list'),
        ({'sources': ['a', 'a']}, 'there twice'),
        ({'sources': ['margin']}, 'name of another parameter'),
        ({'sources': ['views']}, 'name of another parameter'),
        ({'sources': ['a b']}, 'is not a name'),
        ({'sources': ['a']}, "'a.type' must be one of MarkerArray, PointCloud2, OccupancyGrid"),
        ({'sources': ['a'], 'a.type': 'LaserScan'}, "'a.type' must be one of"),
        ({'sources': ['a'], 'a.type': 'PointCloud2'}, "needs a parameter 'a.topic'"),
        ({'markers.max_age': -1.0}, "'markers.max_age' must be at least 0"),
        ({'markers.requierd': True}, "did you mean 'markers.required'"),
        ({f'{OVERRIDES}.relability': 'reliable'}, f"did you mean '{OVERRIDES}.reliability'"),
        ({'qos_overrides./obstacle.subscription.depth': 5}, 'is for nothing here'),
        ({f'{OVERRIDES}.reliability': 'relaible'}, 'must be one of reliable, best_effort'),
        ({f'{OVERRIDES}.depth': 0}, 'must be a whole number from 1'),
        ({f'{OVERRIDES}.depth': 'deep'}, 'must be a whole number from 1'),
        ({**GRID, 'g.unknown': 'maybe'}, "'g.unknown' must be one of free, occupied"),
        ({**GRID, 'g.z_min': 9.0}, "'g.z_min' is above 'g.z_max'"),
    ],
)
def test_wrong_parameters(configure, parameters, reason):
    with pytest.raises(ConfigurationError, match=re.escape(reason)):
        configure(parameters)


@pytest.mark.slow
@pytest.mark.parametrize('sources', [[], ['']])
def test_no_source_at_all(start_node, sources):
    world = start_node({'sources': sources})
    assert world.names('raycast', (0, 0, 0), (1, 0, 0)) == []
    assert world.end() == 0


def test_diagnostics(world, messages):
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

    seen = {}

    def keep(message):
        seen.update({status.name: status for status in message.status})

    subscription = world.node.create_subscription(DiagnosticArray, '/diagnostics', keep, 10)
    name = world.name.lstrip('/')
    world.markers(messages.marker(1), messages.marker(2, size=(1, -1, 1)))
    world.until(lambda: world.everything() == {'a/1'})
    world.until(lambda: f'{name}: world' in seen and '1 obst' in seen[f'{name}: world'].message)
    source = seen[f'{name}: source markers']
    values = {pair.key: pair.value for pair in source.values}
    assert values['refused'] == '1'
    assert 'negative' in values['last reason']
    assert values['reliability'] == 'reliable'
    assert seen[f'{name}: queries'].level in (DiagnosticStatus.OK, DiagnosticStatus.WARN)
    world.node.destroy_subscription(subscription)
