# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the node starts and ends."""

import shlex
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from ros.messages import marker
from ros.patience import PATIENCE


@pytest.fixture(scope='module')
def start_node(start_node):
    """Processes that did not begin as forks."""
    return partial(start_node, fresh=True)


def test_a_node_starts_where_standard_error_is_closed():
    command = [sys.executable, '-m', 'bvh_ros.ros.node', '--ros-args', '-p', 'sources:=1']
    ended = subprocess.run(['sh', '-c', f'exec {shlex.join(command)} 2>&-'], timeout=PATIENCE)
    assert ended.returncode == 2  # it has come as far as its parameters


@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM])
def test_clean_exit(start_node, how):
    world = start_node()
    world.show(marker(1))
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
@pytest.mark.parametrize('sources', [[], ['']])
def test_no_source_at_all(start_node, sources):
    world = start_node({'sources': sources})
    assert world.names('raycast', (0, 0, 0), (1, 0, 0)) == []
    assert world.end() == 0
