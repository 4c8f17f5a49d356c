# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches and names through the Python client, on a node in its own process."""

import math
import threading

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

import rclpy
from rclpy.executors import SingleThreadedExecutor
from ros.patience import PATIENCE

from bvh_ros.client import FREE, UNANSWERED, BvhClient, BvhError, BvhTimeoutError

FIVE = np.arange(5.0)
ORIGINS = np.column_stack((FIVE * 10, FIVE * 0, FIVE * 0))
UPWARDS = np.tile((0.0, 0.0, 2.0), (5, 1))


@pytest.fixture
def client(world):
    node = rclpy.create_node('asker')
    yield BvhClient(node, world.name, timeout=PATIENCE)
    node.destroy_node()


@pytest.fixture
def filled(world, messages):
    """Boxes above the rays 0, 1 and 3."""
    assert world.trigger('clear').success
    world.markers(*(messages.marker(i, (10 * i, 0, 5), ns='crate') for i in (0, 1, 3)))
    world.until(lambda: len(world.everything()) == 3)
    return world


def test_hits_and_their_names(filled, client):
    hits = client.raycast_many(ORIGINS, UPWARDS)
    assert hits.t.tolist() == [2.25, 2.25, math.inf, 2.25, math.inf]
    hit = hits.obstacles != FREE
    assert hit.tolist() == [True, True, False, True, False]
    assert hits.points[hit].tolist() == [[0, 0, 4.5], [10, 0, 4.5], [30, 0, 4.5]]
    assert hits.normals[hit].tolist() == [[0, 0, -1]] * 3
    names = client.names(hits.obstacles)
    assert [names.get(handle) for handle in hits.obstacles.tolist()] == [
        'crate/0',
        'crate/1',
        None,
        'crate/3',
        None,
    ]


def test_float32_limits_and_masks(filled, client):
    rays = ORIGINS.astype(np.float32), UPWARDS.astype(np.float32)
    limits = np.array((2.25, 2.24, 9, 9, 9))
    seen = [1, 1, 1, 0, 1]
    hits = client.raycast_many(*rays, limits, seen)
    assert (hits.obstacles != FREE).tolist() == [True, False, False, False, False]
    assert client.raycast_many(*rays, 2.0).obstacles.tolist() == [FREE] * 5


@pytest.mark.usefixtures('patient_client')
def test_rows_without_an_answer(filled, client):
    origins = ORIGINS.copy()
    origins[1, 0] = math.nan
    hits = client.raycast_many(origins, UPWARDS)
    assert hits.obstacles[1] == UNANSWERED
    assert math.isnan(hits.t[1])
    assert hits.t[[0, 3]].tolist() == [2.25, 2.25]
    with pytest.raises(BvhError, match='cannot answer'):
        client.raycast_many(origins[1:2], UPWARDS[1:2])
    with pytest.raises(BvhError) as plain:
        client.raycast((0, 0, 0), (1, 0, 0), frame_id='mars')
    with pytest.raises(BvhError) as batch:
        client.raycast_many(ORIGINS, UPWARDS, frame_id='mars')
    assert str(batch.value) == str(plain.value)  # the node's reason
    assert 'mars' in str(plain.value)


def test_arrays_that_do_not_fit(client):
    with pytest.raises(ValueError, match='shape'):
        client.raycast_many(ORIGINS, UPWARDS[1:])
    with pytest.raises(ValueError, match='t_max'):
        client.raycast_many(ORIGINS, UPWARDS, np.ones(4))


def test_no_node(client):
    nobody = BvhClient(client.node, '/nobody/bvh', timeout=0.1)
    with pytest.raises(BvhTimeoutError):
        nobody.raycast_many(ORIGINS, UPWARDS)


def test_ten_batches_on_the_way(filled, client):
    executor = SingleThreadedExecutor()
    executor.add_node(client.node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        client.wait_until_batches_are_ready(PATIENCE)
        asked = [client.raycast_many_async(ORIGINS[:i], UPWARDS[:i]) for i in range(10)]
        filled.until(lambda: all(answer.done() for answer in asked))
        assert [len(answer.result().t) for answer in asked] == [0, 1, 2, 3, 4, 5, 5, 5, 5, 5]
        assert client.raycast_many(ORIGINS, UPWARDS).t[0] == 2.25  # as another thread spins
    finally:
        executor.shutdown()
        thread.join()


def test_names_follow_who_comes_and_goes(filled, client, messages):
    before = client.raycast_many(ORIGINS, UPWARDS).obstacles
    assert set(client.names(before).values()) == {'crate/0', 'crate/1', 'crate/3'}
    filled.markers(
        messages.marker(2, (20, 0, 5), ns='späť'), messages.marker(0, action=2, ns='crate')
    )
    filled.until(lambda: 'späť/2' in filled.everything())
    after = client.raycast_many(ORIGINS, UPWARDS).obstacles
    assert set(client.names(after).values()) == {'crate/1', 'späť/2', 'crate/3'}
    assert client.names(before[:1], timeout=0.1) == {}


def test_names_are_a_latched_diagnostic_status(filled):
    from diagnostic_msgs.msg import DiagnosticStatus
    from rclpy.qos import DurabilityPolicy, QoSProfile

    received = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    subscription = filled.node.create_subscription(
        DiagnosticStatus, f'{filled.name}/names', received.append, latched
    )
    crates = ['crate/0', 'crate/1', 'crate/3']
    # What was latched comes first, and what is true now after that.
    filled.until(lambda: received and [pair.value for pair in received[-1].values] == crates)
    filled.node.destroy_subscription(subscription)
    handles = [int(pair.key) for pair in received[-1].values]
    assert handles == sorted(handles)
    assert received[-1].message == '3 obstacles'


def test_requests_before_a_large_message(filled, client):
    """The message pushes some of them out of the shared memory; they are asked again."""
    executor = SingleThreadedExecutor()
    executor.add_node(client.node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        client.wait_until_ready(PATIENCE)
        client.wait_until_batches_are_ready(PATIENCE)
        asked = [client.raycast_async((0, 0, 0), (0, 0, 9)) for _ in range(200)]
        origins = np.zeros((40_000, 3), np.float32)  # 0.96 MB
        hits = client.raycast_many(origins, origins + np.float32((0, 0, 1)))
        assert (hits.t == 4.5).all()
        filled.until(lambda: all(answer.done() for answer in asked))
        assert {answer.result().name for answer in asked} == {'crate/0'}
    finally:
        executor.shutdown()
        thread.join()
