# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nothing that is told or asked is lost, or it is seen, over real processes."""

import time
from functools import partial

import numpy as np
import pytest
from nav_msgs.srv import GetPlan
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros.messages import cloud, get_plan, marker
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from bvh_ros.ros.access import DEPTH, REQUESTS

DEEP = QoSProfile(depth=DEPTH)
LAST_FIVE = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
BURST = 1000
OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'
DELETE_ALL = 3


def everything_of(*numbers):
    whole = marker(0, ns='', action=DELETE_ALL)
    return MarkerArray(markers=[whole, *(marker(n, (2 * n, 0, 0)) for n in numbers)])


def test_a_burst_of_changes(world):
    """A thousand markers, and as many boxes with ids, one a message, as fast as can be."""
    for i in range(BURST):
        change = MarkerArray(markers=[marker(i, (2 * i, 0, 0), ns='burst')])
        world.publish('bvh/obstacles', change, qos=DEEP)
    world.until(lambda: len(world.everything()) == BURST)
    status = world.status('source markers')
    assert (status.level, status.values['messages lost']) == (OK, '0')
    assert world.trigger('clear').success


@pytest.mark.slow
@pytest.mark.parametrize(('clients', 'each'), [(1, 1000), (20, 50)])
def test_a_burst_of_requests(world, clients, each):
    asking = [
        world.node.create_client(GetPlan, f'{world.name}/raycast', qos_profile=REQUESTS)
        for _ in range(clients)
    ]
    for client in asking:
        world.until(client.service_is_ready)
    world.until_found()  # that a client has found the node does not say it
    request = get_plan((0, 0, 0), (1, 0, 0))
    replies = [client.call_async(request) for _ in range(each) for client in asking]
    world.until(lambda: all(reply.done() for reply in replies))
    for client in asking:
        world.node.destroy_client(client)


@pytest.mark.slow
def test_a_gap_is_seen(start_node):
    """With room for one message only, most of a burst is lost."""
    namespace = '/shallow'
    depth = {f'qos_overrides.{namespace}/bvh/obstacles.subscription.depth': 1}
    world = start_node({'markers.required': True, **depth}, namespace=namespace)

    def answer():
        return world.names('raycast', (-1, 0, 0), (1, 0, 0))

    tell = partial(world.publish, 'bvh/obstacles', qos=DEEP)
    tell(MarkerArray(markers=[marker(0)]))
    world.until(lambda: answer() == ['a/0'])  # heard from its first message on
    for i in range(300):
        tell(MarkerArray(markers=[marker(i, (2 * i, 0, 0))]))
    world.until(lambda: 'of its messages were lost' in answer()[0])
    assert answer()[0].startswith("error: required source 'markers' has to tell all again")
    lost = int(world.status('source markers').values['messages lost'])
    assert lost > 0
    for part in ('world', 'queries', 'rays', 'source markers'):
        assert world.status(part).level == ERROR
    assert 'messages were lost' in world.said()
    tell(everything_of(0, 1))
    world.until(lambda: answer() == ['a/0'])
    assert world.status('source markers').level == OK
    assert world.trigger('clear').success
    tell(MarkerArray(markers=[marker(0)]))
    world.until(lambda: 'what it had told was cleared' in answer()[0])


def test_who_spoke_before_has_to_tell_all(start_node, ros):
    """After a restart: a change is not enough, what is latched is, and so is a whole message."""
    namespace = '/restarted'
    publishers = {
        name: ros[0].create_publisher(MarkerArray, f'{namespace}/{name}', qos)
        for name, qos in (('old', DEEP), ('kept', LAST_FIVE))
    }
    old = publishers['old']
    for publisher in publishers.values():
        for i in range(7):
            publisher.publish(MarkerArray(markers=[marker(i, (2 * i, 0, 0))]))
    sources = {
        name: {'type': 'MarkerArray', 'topic': name, 'required': True, 'prefix': f'{name}.'}
        for name in publishers
    }
    world = start_node({'sources': [*publishers], **sources}, namespace=namespace)

    def answer():
        return world.names('raycast_all', (-1, 0, 0), (99, 0, 0))

    assert 'has not spoken' in answer()[0]
    world.until(lambda: old.get_subscription_count() > 0)
    old.publish(MarkerArray(markers=[marker(6, (12, 0, 0))]))
    world.until(lambda: 'it had spoken before it was heard' in answer()[0])
    time.sleep(0.5)
    assert "'old'" in answer()[0]
    old.publish(everything_of(0))
    kept = [f'kept.a/{i}' for i in range(2, 7)]  # the last five messages
    world.until(lambda: sorted(answer()) == [*kept, 'old.a/0'])
    for publisher in publishers.values():
        ros[0].destroy_publisher(publisher)


@pytest.mark.slow
def test_clouds_with_ids_tell_all_by_one_without(start_node, ros):
    namespace = '/tracked'
    source = {'type': 'PointCloud2', 'topic': 'tracks', 'required': True}
    publisher = ros[0].create_publisher(PointCloud2, f'{namespace}/tracks', DEEP)

    def tracks(*ids):
        columns = {axis: [3 * i for i in ids] for axis in 'xyz'}
        return cloud({**columns, 'id': ids})

    publisher.publish(tracks(1, 2))
    world = start_node({'sources': ['c'], 'c': source}, namespace=namespace)
    world.until(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(tracks(2))
    world.until(lambda: 'spoken before' in next(iter(world.everything())))
    publisher.publish(cloud({axis: [] for axis in 'xyz'}))  # all of them: none
    for number in range(BURST):
        publisher.publish(tracks(number))
    world.until(lambda: len(world.everything()) == BURST)
    assert world.status('source c').values['messages lost'] == '0'
    ros[0].destroy_publisher(publisher)


@pytest.mark.slow
def test_best_effort_beside_reliable_beside_latched(start_node, ros):
    """All three are heard, each message once, and each publisher's in order."""
    world = start_node()
    kinds = {'latched': LAST_FIVE, 'reliable': DEEP, 'best': BEST_EFFORT}
    topic = f'{world.name}/obstacles'
    publishers = {n: ros[0].create_publisher(MarkerArray, topic, qos) for n, qos in kinds.items()}
    world.until(lambda: all(one.get_subscription_count() for one in publishers.values()))
    world.until(lambda: 'best effort, too' in world.said())
    time.sleep(0.5)
    for i in range(50):
        for name, publisher in publishers.items():
            publisher.publish(MarkerArray(markers=[marker(1, (i, 0, 0), ns=name)]))
        world.executor.spin_once(0.002)
    wanted = {f'{name}/1' for name in kinds}
    world.until(lambda: set(world.names('overlap', (49, 0, 0), (49, 0, 0))) == wanted)
    status = world.status('source markers')
    assert status.values['messages'] == '150'
    assert status.values['messages lost'] == '0'
    for publisher in publishers.values():
        ros[0].destroy_publisher(publisher)


@pytest.mark.slow
def test_large_clouds_that_come_too_fast_make_the_node_neither_late_nor_large(start_node):
    world = start_node({'sources': ['c'], 'c': {'type': 'PointCloud2', 'topic': 'c'}})
    rows = np.arange(20_000)
    columns = {'x': rows % 100, 'y': rows // 100, 'z': rows * 0}
    for _ in range(60):
        world.publish('c', cloud(columns, kind='f4'), qos=DEEP)
    world.publish('c', cloud({'x': [0], 'y': [0], 'z': [0]}))
    world.holds('c#0')
    values = world.status('source c').values
    assert int(values['messages']) + int(values['messages that newer ones replaced']) == 61
