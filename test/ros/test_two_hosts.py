# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node and client on two hosts whose network loses packets, or is cut."""

import json
import os
import sys
import tempfile
import time
from pathlib import Path

import pytest
from ros import two_hosts
from ros.patience import PATIENCE

pytestmark = pytest.mark.slow

LONG = bool(os.environ.get('BVH_ROS_LONG_TESTS'))
PROFILE = Path(__file__).parents[2] / 'config' / 'fastdds_lossy_link.xml'
OBSTACLES = 50
SOON = 10.0  # seconds: of what is lost, the middleware itself tries again every three


@pytest.fixture(scope='module')
def hosts():
    if reason := two_hosts.reason_to_skip():
        pytest.skip(reason)
    with two_hosts.Hosts() as made:
        yield made


@pytest.fixture(scope='module', params=['', str(PROFILE)], ids=['default', 'profile'])
def far(hosts, request):
    """Tells the client what to do; `far.later` does not wait for what comes of it."""
    environment = {'FASTRTPS_DEFAULT_PROFILES_FILE': request.param} if request.param else {}
    client = [sys.executable, str(Path(__file__).with_name('far_client.py'))]
    node = [sys.executable, '-m', 'bvh_ros.ros.node']
    with (
        tempfile.TemporaryFile('w+') as log,
        hosts.running(0, node, log, **environment),
        hosts.running(1, client, log, **environment) as process,
    ):

        def later(what, count, argument):
            process.stdin.write(json.dumps([what, count, argument]) + '\n')
            process.stdin.flush()

        def do(what, count, argument):
            later(what, count, argument)
            line = process.stdout.readline()
            if not line:
                log.seek(0)
                raise AssertionError(f'the client ended: {log.read()[-2000:]}')
            if LONG:
                print(what, count, argument, line, flush=True)
            return json.loads(line)

        do.has_profile = bool(request.param)
        do.later, do.answer = later, lambda: json.loads(process.stdout.readline())
        assert do('ready', OBSTACLES, None)[0] == OBSTACLES
        yield do


@pytest.fixture
def lossy(hosts):
    yield hosts.lose
    hosts.lose(0)


@pytest.mark.parametrize('percent', [5, 20])
def test_each_question_is_answered_over_a_lossy_link(far, lossy, percent):
    lossy(percent)
    came = far('ask', 10_000 if LONG else 300, SOON)
    assert came['wrong'] == came['timeouts'] == came['errors'] == 0
    came = far('batch', 1000 if LONG else 50, [100, SOON])
    assert came['wrong'] == came['timeouts'] == came['errors'] == 0
    assert far('many', 200, PATIENCE) == 200


def test_large_batches_come_over_a_lossy_link(far, lossy):
    lossy(5)
    came = far('batch', 3, [20_000, PATIENCE])
    assert came['right'] == 3


def test_a_partition_is_an_error_and_is_over_when_it_ends(far, hosts):
    far.later('tell', 100, [1000, 0.01])
    hosts.cut(True)
    try:
        far.answer()
        came = far('ask', 4, 1.0)
        assert came['right'] == came['wrong'] == 0  # never free
    finally:
        hosts.cut(False)
    assert far('ask', 1, PATIENCE)['right'] == 1
    assert far('known', 100, [1000, PATIENCE])[0] == 100


def test_changes_are_all_known_after_a_lossy_link(far, lossy):
    lossy(5)
    count = 2000 if LONG else 200
    began = time.monotonic()
    far('tell', count, [3000, 0.005])
    known, seconds = far('known', count, [3000, PATIENCE])
    assert known == count, (seconds, time.monotonic() - began)
