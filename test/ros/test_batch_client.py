# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches and names through the Python client, on a node in its own process."""

import itertools
import math
import threading

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros.messages import marker
from ros.patience import PATIENCE

from bvh_ros.client import FREE, UNANSWERED, BvhError, BvhTimeoutError

RELIABILITY = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
DURABILITY = DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL
FIVE = np.arange(5.0)
ORIGINS = np.column_stack((FIVE * 10, FIVE * 0, FIVE * 0))
UPWARDS = np.tile((0.0, 0.0, 2.0), (5, 1))


@pytest.fixture
def client(world, client_of):
    return client_of(world)


@pytest.fixture
def filled(world):
    """Boxes above the rays 0, 1 and 3."""
    assert world.trigger('clear').success
    world.show(*(marker(i, (10 * i, 0, 5), ns='crate') for i in (0, 1, 3)))
    return world


@pytest.fixture
def spun(client):
    """The same client, whose node a thread spins."""
    executor = SingleThreadedExecutor()
    executor.add_node(client.node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    yield client
    executor.shutdown()
    thread.join()


def test_hits_and_their_names(filled, client):
    hits = client.raycast_many(ORIGINS, UPWARDS)
    assert hits.t.tolist() == [2.25, 2.25, math.inf, 2.25, math.inf]
    hit = hits.obstacles != FREE
    assert hit.tolist() == [True, True, False, True, False]
    assert hits.points[hit].tolist() == [[0, 0, 4.5], [10, 0, 4.5], [30, 0, 4.5]]
    assert hits.normals[hit].tolist() == [[0, 0, -1]] * 3
    names = client.names(hits.obstacles)
    named = [names.get(handle) for handle in hits.obstacles.tolist()]
    assert named == ['crate/0', 'crate/1', None, 'crate/3', None]


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


def test_no_node(client_of):
    with pytest.raises(BvhTimeoutError):
        client_of('/nobody/bvh', timeout=0.1).raycast_many(ORIGINS, UPWARDS)


def test_ten_batches_on_the_way(filled, spun):
    spun.wait_until_batches_are_ready(PATIENCE)
    asked = [spun.raycast_many_async(ORIGINS[:i], UPWARDS[:i]) for i in range(10)]
    filled.until(lambda: all(answer.done() for answer in asked))
    assert [len(answer.result().t) for answer in asked] == [0, 1, 2, 3, 4, 5, 5, 5, 5, 5]
    assert spun.raycast_many(ORIGINS, UPWARDS).t[0] == 2.25  # as another thread spins


def test_names_follow_who_comes_and_goes(filled, client):
    before = client.raycast_many(ORIGINS, UPWARDS).obstacles
    assert set(client.names(before).values()) == {'crate/0', 'crate/1', 'crate/3'}
    filled.markers(marker(2, (20, 0, 5), ns='späť'), marker(0, action=2, ns='crate'))
    filled.until(lambda: 'späť/2' in filled.everything())
    after = client.raycast_many(ORIGINS, UPWARDS).obstacles
    assert set(client.names(after).values()) == {'crate/1', 'späť/2', 'crate/3'}
    assert client.names(before[:1], timeout=0.1) == {}


def test_late_subscribers_of_every_kind_hear_the_names(filled):
    """Nothing changes while they come, one beside the others."""
    crates, kinds = ['crate/0', 'crate/1', 'crate/3'], itertools.product(RELIABILITY, DURABILITY)
    first, *others = (
        QoSProfile(depth=9, reliability=reliability, durability=durability)
        for reliability, durability in kinds
    )
    for some in ([first], others, [first, *others]):
        heard = [filled.heard(DiagnosticStatus, 'names', qos) for qos in some]

        def told():
            # What was latched may come first, and what is true now after that.
            return all(
                one and [pair.value for pair in one[-1].values] == crates
                for one in heard  # noqa: B023
            )

        filled.until(told)
        for one in heard:
            handles = [int(pair.key) for pair in one[-1].values]
            assert handles == sorted(handles)
            assert one[-1].message == '3 obstacles'
