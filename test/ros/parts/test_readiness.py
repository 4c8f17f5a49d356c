# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""While kernels are compiled the node answers what it can, and says of the rest how far it is."""

import contextlib
import re
import signal
import time
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from ros import patience
from ros.messages import marker

from bvh_ros import demo
from bvh_ros.client import BvhError, BvhTimeoutError
from bvh_ros.ros import running

SCRIPT = Path(__file__).parents[1] / 'slow_node.py'
COMPILING = re.compile(r'compiling: \d+ %, about \d+ s left \(what waits\)$')


@pytest.fixture
def start(start_node, tmp_path):
    """Start a node that goes on compiling until `go` is there."""

    def begin():
        world = start_node(wait=False, script=(SCRIPT, tmp_path))
        world.until((tmp_path / 'compiles').exists, patience.COMPILING)
        return world

    return begin


def asked(world, name, **given):
    """A reply's first name. Not too often: others compile."""
    time.sleep(0.1)
    return world.names(name, (-5, 0, 0), (5, 0, 0), **given)[0]


@pytest.mark.usefixtures('patient_client')
def test_what_is_ready_is_answered_and_the_rest_soon(start, tmp_path, client_of):
    world = start()
    world.until(lambda: COMPILING.search(asked(world, 'overlap')), patience.COMPILING)
    world.markers(marker(1))
    world.until(lambda: world.names('raycast', (-5, 0, 0), (5, 0, 0)) == ['a/1'])
    for name, tolerance in (('raycast', 0.5), ('raycast_all', 0.0), ('overlap', 0.0)):
        assert COMPILING.match(asked(world, name, tolerance=tolerance).removeprefix('error: '))
    status = world.status('world')
    assert status.level == DiagnosticStatus.ERROR
    assert COMPILING.match(status.message)
    assert not world.trigger('validate').success

    world.markers(marker(2, (3, 0, 0), type=2))  # a ball: rays at true shapes are not ready
    world.until(lambda: COMPILING.search(asked(world, 'raycast')))

    client = client_of(world)
    with pytest.raises(BvhError, match='compiling: '):
        client.overlap((0, 0, 0), (1, 1, 1))
    with pytest.raises(BvhError, match=COMPILING):
        client.raycast_many([[-5.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]])
    with pytest.raises(BvhTimeoutError, match='is still compiling'):
        client.wait_until_ready(1.0)
    (tmp_path / 'go').touch()
    client.wait_until_ready(patience.COMPILING)
    assert world.everything() == {'a/1', 'a/2'}
    assert asked(world, 'raycast', tolerance=0.5) == 'a/1'
    assert world.status('world').level == DiagnosticStatus.OK
    assert world.trigger('validate').success
    said = world.said()
    assert said.index('first start here: compiling, about') < said.index('ready in frame')
    told = re.findall(r'bvh\]: (first start|compiled in)', said)
    assert told == ['first start', 'compiled in']  # and a line a minute in between


def test_the_demo_asks_first_what_is_ready(start, tmp_path, capsys, client_of):
    world = start()
    client = client_of(world)

    def ask_and_go_on():
        demo.ask_first(client.node, client, time.monotonic())
        (tmp_path / 'go').touch()

    running.wait_until_ready(client, world.process, ask_and_go_on)
    hit = r'first answer after \d+\.\d s: .+: forklift/0 \(2\.80, 0\.00, 1\.00\)\n'
    assert re.fullmatch(hit, capsys.readouterr().out)
    assert world.everything() == set()
    assert 'refused' not in world.said()


def is_running(pid):
    with contextlib.suppress(OSError):
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    return False


@pytest.mark.slow
@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_whoever_ends_the_node_ends_the_compiling(start, tmp_path, seconds_to_end, how):
    world, compiles = start(), tmp_path / 'compiles'
    world.until(lambda: compiles.read_text() != '')  # it is there before anything stands in it
    pid = int(compiles.read_text())
    assert is_running(pid)
    if how == signal.SIGKILL:
        world.end(how)
    else:
        assert seconds_to_end(world.process, how) < 1.0
    world.until(lambda: not is_running(pid))
    assert 'Traceback' not in world.said()
