# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that die and come back, come late, or do not fit together."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import OccupancyGrid
from ros.messages import LATCHED, cloud, grid, marker
from ros.patience import PATIENCE

from bvh_ros.client import BvhTimeoutError

pytestmark = pytest.mark.slow

UP, DOWN = (0, 0, 9), (0, 0, -9)
MANY = 1_000_000 if os.environ.get('BVH_ROS_LONG_TESTS') else 100_000  # boxes in one message


@contextmanager
def publisher_process(world, number):
    script = Path(__file__).with_name('steady_publisher.py')
    command = [sys.executable, str(script), f'{world.name}/obstacles', str(number)]
    process = subprocess.Popen(command)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_publisher_is_killed_and_another_comes(start_node):
    world = start_node()
    first = {f'publisher1/{i}' for i in range(200)}
    second = {f'publisher2/{i}' for i in range(200)}
    with publisher_process(world, 1) as process:
        world.until(lambda: world.everything() == first)
        process.send_signal(signal.SIGKILL)
    assert world.everything() == first  # nothing good is lost
    with publisher_process(world, 2):
        world.until(lambda: world.everything() == first | second)
        before = world.plan('overlap', (-1e3,) * 3, (1e3,) * 3).header.stamp
        world.until(lambda: world.plan('overlap', (-1e3,) * 3, (1e3,) * 3).header.stamp != before)
    assert world.trigger('validate').success
    assert world.status('source markers').values['refused'] == '0'


def test_the_node_is_killed_while_clients_wait_and_comes_back(start_node, client_of):
    world = start_node()
    world.show(marker(1))
    client = client_of(world)
    assert client.raycast(UP, DOWN).name == 'a/1'

    world.process.send_signal(signal.SIGSTOP)  # it takes the request, and will never answer
    raised = []
    waiting = threading.Thread(target=lambda: raised.append(timeout_of(client)))
    waiting.start()
    time.sleep(0.3)
    world.process.kill()
    world.process.wait()
    waiting.join()
    assert 'did not answer within 1 s' in str(raised[0])

    back = start_node(namespace=world.namespace)
    deadline = time.monotonic() + PATIENCE
    while True:  # the same client; a timeout as long as the dead node is still announced
        back.markers(marker(2))  # again: the first may be heard by the dead one only
        try:
            hit = client.raycast(UP, DOWN, timeout=5.0)
        except BvhTimeoutError:
            hit = None
        if hit is not None:
            break
        assert time.monotonic() < deadline, f'the node says:\n{back.said()}'
    assert hit.name == 'a/2'


def timeout_of(client):
    with pytest.raises(BvhTimeoutError) as caught:
        client.raycast(UP, DOWN, timeout=1.0)
    return caught.value


FLOOR = {'sources': ['floor'], 'floor': {'type': 'OccupancyGrid', 'topic': 'map'}}


def test_a_publisher_whose_qos_does_not_fit_is_said_in_diagnostics(start_node):
    world = start_node(FLOOR)
    volatile = world.node.create_publisher(OccupancyGrid, f'{world.namespace}/map', 1)
    world.until(lambda: 'not heard' in world.status('source floor').message)
    assert world.status('source floor').level == DiagnosticStatus.WARN
    said = world.status('source floor').message
    assert 'durability transient_local that is asked for' in said
    assert said in world.said()
    volatile.publish(grid([[100, 100]]))
    world.publish('map', grid([[0, 100]]), qos=LATCHED)  # another one is
    world.holds('floor#0')
    # The remedy that it names is one.
    parameter, value = re.search("'(qos_overrides[^']*)' to '([a-z_]*)'", said).groups()
    namespace = f'{world.namespace}_mended'
    mended = start_node(
        {**FLOOR, parameter.replace(world.namespace, namespace): value}, namespace=namespace
    )
    mended.publish('map', grid([[0, 100]]), qos=1)
    mended.holds('floor#0')
    world.node.destroy_publisher(volatile)


def place(row):
    """Centres of a lattice's boxes, 1 m apart."""
    return row % 100, row // 100 % 100, row // 10_000


def test_a_very_large_cloud_and_then_more_than_there_is_room_for(start_node):
    world = start_node(
        {'sources': ['c'], 'c': {'type': 'PointCloud2', 'topic': 'c'}, 'max_obstacles': MANY}
    )
    rows, more = np.arange(MANY + 50), 50
    columns = dict(zip('xyz', place(rows), strict=True))
    first, last, beyond = (list(map(float, place(row))) for row in (0, MANY - 1, MANY))
    world.publish('c', cloud({axis: column[:MANY] for axis, column in columns.items()}))
    world.until(lambda: world.names('overlap', last, last) == [f'c#{MANY - 1}'])
    assert world.names('raycast_all', first, (99, 0, 0)) == [f'c#{row}' for row in range(100)]

    world.publish('c', cloud(columns))
    world.until(lambda: world.status('source c').values['refused'] == str(more))
    assert 'max_obstacles' in world.status('source c').values['last reason']
    assert world.names('overlap', last, last) == [f'c#{MANY - 1}']
    assert world.names('overlap', beyond, beyond) == []
    assert world.names('raycast_all', first, (99, 0, 0)) == [f'c#{row}' for row in range(100)]
    assert world.trigger('validate').success
