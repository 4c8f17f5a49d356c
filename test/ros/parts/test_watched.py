# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Who subscribes late hears the last message, whether it asks for what is latched or not."""

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


@pytest.fixture
def listen(world):
    """Subscribe to ~/names in some way; return what is heard."""
    opened = []

    def start(reliability, durability):
        heard = []
        qos = QoSProfile(depth=9, reliability=reliability, durability=durability)
        opened.append(
            world.node.create_subscription(
                DiagnosticStatus, f'{world.name}/names', heard.append, qos
            )
        )
        return heard

    yield start
    for subscription in opened:
        world.node.destroy_subscription(subscription)


def test_late_subscribers_of_every_kind_hear_the_names(world, messages, listen):
    """Nothing changes while they come, one beside the others, and after all had gone."""
    world.markers(messages.marker(1))
    world.until(lambda: world.everything() == {'a/1'})
    kinds = [
        (reliability, durability)
        for reliability in (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE)
        for durability in (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL)
    ]
    for reliability, durability in [*kinds, *kinds]:
        heard = listen(reliability, durability)
        world.until(lambda heard=heard: heard)
        assert [pair.value for pair in heard[0].values] == ['a/1']
