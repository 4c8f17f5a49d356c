# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is refused, malformed or only announced costs little memory, and no life."""

import contextlib
import os
import resource
import signal
import subprocess
import sys
from array import array
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from ros.messages import LATCHED, cloud, grid, marker
from sensor_msgs.msg import PointCloud2, PointField
from visualization_msgs.msg import MarkerArray

pytestmark = pytest.mark.slow

SMALL_MULTIPLE = 12  # of the bytes; DDS, the message and the reply are some of them
ANYWAY = 30_000_000  # bytes that come and go whatever is done
MOST = 1000
PARTS = {  # of diagnostics, by topic
    'c': 'source c',
    'g': 'source g',
    'bvh/obstacles': 'source markers',
    'bvh/rays': 'rays',
}
PARAMETERS = {
    'sources': ['markers', 'c', 'g'],
    'c': {'type': 'PointCloud2', 'topic': 'c'},
    'g': {'type': 'OccupancyGrid', 'topic': 'g'},
    'max_obstacles': MOST,
    'max_hits': 5,
}


@pytest.fixture(scope='module')
def start_node(start_node):
    """Processes that did not begin as forks."""
    return partial(start_node, fresh=True)


def octets(count):
    data = array('B')
    data.frombytes(bytes(count))
    return data


def announced(width, height):
    message = grid([[0]])
    message.info.width, message.info.height, message.data = width, height, []
    return 'g', message


def junk(**given):
    return 'bvh/rays', PointCloud2(height=1, **given)


def memory(world, what):
    status = Path(f'/proc/{world.process.pid}/status').read_text()
    return 1024 * int(status.partition(f'{what}:')[2].split()[0])


def bombs():
    """Messages by what is wrong with them, each with its topic."""
    nothing, size = (0, 2**32 - 1), 8_000_000
    points = np.arange(300_000)
    empty = PointCloud2(width=2**32 - 1, height=1000, row_step=1000, data=octets(1_000_000))
    arrows = [marker(k, type=0) for k in range(10_000)]
    return {
        'rows without cells': announced(*nothing),
        'columns without cells': announced(*nothing[::-1]),
        'a point a byte': junk(width=size, point_step=1, row_step=size, data=octets(size)),
        'points without bytes': junk(width=2**32 - 1, data=octets(0)),
        'boxes of no bytes': ('c', empty),
        'rays of no bytes': ('bvh/rays', empty),
        'very many fields': junk(width=1, fields=[PointField(name='x')] * 100_000),
        'more than there is room for': ('c', cloud(dict.fromkeys('xyz', points))),
        'ids that are none': ('c', cloud({**dict.fromkeys('xyz', points), 'id': points + 0.5})),
        'markers of no use': ('bvh/obstacles', MarkerArray(markers=arrows)),
    }


def taken(world, topic):
    """What the node counts of the messages of a topic."""
    values = world.status(PARTS[topic]).values
    return [values.get(name) for name in ('messages', 'refused', 'rays refused')]


def test_what_is_refused_costs_little(start_node):
    world = start_node(PARAMETERS)
    below = ((0, 0, -5), (1, 0, -5))
    for what, (topic, message) in bombs().items():
        Path(f'/proc/{world.process.pid}/clear_refs').write_text('5')  # forget the peak so far
        before = memory(world, 'VmHWM')
        counted = taken(world, topic)
        world.publish(topic, message, qos=LATCHED if topic == 'g' else 10)
        world.until(lambda: taken(world, topic) != counted)  # noqa: B023
        assert world.names('raycast', *below) == [], what
        grown = memory(world, 'VmHWM') - before
        size = len(serialize_message(message))
        assert grown <= SMALL_MULTIPLE * size + ANYWAY, f'{what}: {grown} for {size} bytes'
    assert 'fields' in world.said()
    refused = world.status('source c').values['refused']
    assert int(refused) == 1 + (300_000 - MOST) + 300_000  # no bytes, no room, no ids
    reply = world.names('raycast', (0, 0, 0), (1, 0, 0), frame='x' * 1_000_000)
    assert reply[0].startswith('error: ')
    assert world.trigger('validate').success
    assert world.end(signal.SIGTERM) == 0


def test_too_little_memory_is_a_reason_not_an_end(start_node):
    world = start_node({**PARAMETERS, 'max_obstacles': 5_000_000})
    # Less than the cloud takes, but enough for threads of the middleware that allocate for the
    # first time: each may reserve 128 MB.
    room = memory(world, 'VmSize') + 500_000_000
    resource.prlimit(world.process.pid, resource.RLIMIT_AS, (room, room))
    points = np.random.default_rng(0).uniform(0, 100, (2_000_000, 3)).T
    points = cloud(dict(zip('xyz', points, strict=True)), kind='f4')
    for _ in range(10):  # the middleware may have no memory for it, either, and then loses it
        world.publish('c', points)
        with contextlib.suppress(AssertionError):
            world.until(lambda: 'not enough memory' in world.said(), timeout=100)
            break
    assert 'not enough memory' in world.said()
    assert world.status('source c').values['refused'] != '0'
    world.publish('c', cloud({'x': [5], 'y': [0], 'z': [0]}))
    world.until(lambda: world.names('raycast', (0, 0, 0), (9, 0, 0)) == ['c#0'])
    assert world.trigger('validate').success


def test_an_answer_beyond_max_hits_is_an_error_and_none_is_cut_short(start_node):
    world = start_node({**PARAMETERS, 'views': ['all'], 'all': {'include': ['*']}})
    turned = (0, 0, 0.1, 1)
    everywhere = ((-50, -50, -50), (50, 50, 50))
    along, ball = ((-1, 0, 0), (99, 0, 0)), {'tolerance': 0.1}
    for turn in ((0, 0, 0, 1), turned):
        for count in (5, 6):
            cubes = [marker(k, (2 * k, 0, 0), turn=turn) for k in range(count)]
            world.markers(*cubes)
            world.until(lambda: len(world.names('raycast_all', *along)) == (5, 1)[count - 5])  # noqa: B023
            for view in ('', 'all/'):
                for ask, where, given in (
                    ('raycast_all', along, {}),
                    ('raycast_all', along, ball),
                    ('overlap', everywhere, {}),
                    ('overlap', everywhere, {'turn': turned}),
                    ('overlap', everywhere, ball),
                ):
                    names = world.names(view + ask, *where, **given)
                    if count == 5:
                        assert sorted(names) == [f'a/{k}' for k in range(5)]
                    else:
                        (name,) = names
                        assert name.startswith('error: ')
                        assert 'max_hits' in name
                assert world.names(f'{view}raycast', *along) == ['a/0']
        world.trigger('clear')


def of_many_steps(kind, count):
    """A message that used to be as many changes as it has markers."""
    if kind == 'DELETEALL and ADD in turns':
        array = [marker(k, ns=f'n{k // 2}', action=3 * (1 - k % 2)) for k in range(count)]
    elif kind == 'lists and single ones in turns':
        array = [marker(k, type=(6, 1)[k % 2], points=[(k, 0, 0)]) for k in range(count)]
    else:
        array = [marker(k // 3, action=2 * (k % 2)) for k in range(count)]
    return MarkerArray(markers=array)


@pytest.mark.parametrize(
    'kind', ['DELETEALL and ADD in turns', 'lists and single ones in turns', 'ADD and DELETE']
)
def test_time_grows_with_the_length_of_a_message_whatever_its_order(world, kind):
    def seconds():
        fields = Path(f'/proc/{world.process.pid}/stat').read_text().rpartition(')')[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf('SC_CLK_TCK')

    took = []
    for count in (4_000, 16_000):
        last = marker(0, (0, 0, count), ns='end')
        message = of_many_steps(kind, count)
        before = seconds()
        world.publish('bvh/obstacles', message)
        world.markers(last)
        above, below = (0, 0, count + 2), (0, 0, count - 2)
        world.until(lambda: world.names('raycast', above, below) == ['end/0'])  # noqa: B023
        took.append(seconds() - before)
    assert took[1] <= 8 * took[0] + 0.5
    assert world.trigger('validate').success


def test_a_busy_node_heeds_sigterm(start_node, seconds_to_end):
    world = start_node({**PARAMETERS, 'max_obstacles': 2_000_000})
    checkerboard = grid(np.indices((2500, 2500)).sum(0) % 2 * 100)
    points = np.random.default_rng(0).uniform(0, 100, (3, 500_000))
    names = 'x', 'y', 'z', 'dx', 'dy', 'dz'
    rays = cloud(dict(zip(names, (*points, *points), strict=True)), kind='f4')
    points = cloud(dict(zip('xyz', points, strict=True)), kind='f4')
    # Each of them keeps it busy for a second or more.
    for topic, message in (('g', checkerboard), ('c', points), ('bvh/rays', rays)):
        world.publish(topic, message, qos=LATCHED if topic == 'g' else 10)
    world.until(lambda: world.names('raycast', (-1, -1, -1), (99, 99, 99)))
    assert seconds_to_end(world.process) < 1.0


@pytest.mark.parametrize('service', ['rebuild', 'validate'])
def test_a_node_that_works_for_a_service_heeds_sigterm(start_node, seconds_to_end, service):
    from std_srvs.srv import Trigger

    world = start_node({**PARAMETERS, 'max_obstacles': 1_000_000})
    points = np.random.default_rng(0).uniform(0, 100, (3, 100_000))
    world.publish('c', cloud(dict(zip(('x', 'y', 'z'), points, strict=True))))
    everywhere = (0, 0, 0), (99, 99, 99)  # more hits than a reply may have: that is an error
    world.until(lambda: 'max_hits' in ''.join(world.names('overlap', *everywhere)))
    client = world.node.create_client(Trigger, f'{world.name}/{service}')
    world.until(client.service_is_ready)
    asked = [client.call_async(Trigger.Request()) for _ in range(100)]  # 5 s of work
    world.until(lambda: any(one.done() for one in asked))
    assert seconds_to_end(world.process) < 1.0
    assert not all(one.done() for one in asked)
    world.node.destroy_client(client)


BUSY = """
import hashlib
from bvh_ros.ros.node import Interrupts
interrupts = Interrupts()
print('busy', flush=True)
hashlib.pbkdf2_hmac('sha256', b'', b'', 500_000_000)  # minutes in C, where Python hears nothing
"""


@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_heeded_whatever_runs(how, seconds_to_end):
    with subprocess.Popen([sys.executable, '-c', BUSY], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b'busy\n'
        assert seconds_to_end(process, how) < 1.0
