# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replies whose client is found late, or never."""

import time
import warnings

import pytest
from nav_msgs.srv import GetPlan
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros.patience import spin_until
from std_srvs.srv import Trigger

from bvh_ros.ros.parts import part
from bvh_ros.ros.parts.part import NodePart

SOON = 0.2, 0.1, 0.3  # seconds
LOST = 'failed to send response (timeout): client will not receive response'


@pytest.mark.parametrize('failures', [0, 1, len(SOON), len(SOON) + 1])
def test_a_reply_is_sent_again_until_its_client_is_found(ros, monkeypatch, failures):
    """The middleware fails as it does where the reader of a client is not found in time."""
    monkeypatch.setattr(part, 'AGAIN_AFTER', SOON)
    node, executor = ros
    opened = NodePart(node)
    attempts = []

    def answer(request, response):
        response.message = 'here'
        return response

    create = node.create_service

    def create_failing(*arguments, **given):
        service = create(*arguments, **given)
        send = service.send_response

        def send_or_fail(response, header):
            attempts.append(time.monotonic())
            if len(attempts) <= failures:
                warnings.warn(LOST, RuntimeWarning, stacklevel=1)
            else:
                send(response, header)

        service.send_response = send_or_fail
        return service

    monkeypatch.setattr(node, 'create_service', create_failing)
    name = f'late_{failures}'
    opened.service(Trigger, name, answer)
    client = node.create_client(Trigger, name)
    timers = len(list(node.timers))
    try:
        spin_until(executor, client.service_is_ready)
        reply = client.call_async(Trigger.Request())
        tried = min(failures, len(SOON)) + 1
        spin_until(
            executor, lambda: len(attempts) >= tried and (reply.done() or tried <= failures)
        )
        for _ in range(5):
            executor.spin_once(0.05)
    finally:
        opened.destroy()
        node.destroy_client(client)
    assert len(attempts) == tried
    assert reply.done() == (tried > failures)
    assert not reply.done() or reply.result().message == 'here'
    assert len(list(node.timers)) == timers  # who has nothing to send does not look


@pytest.mark.slow
def test_a_client_that_cannot_be_reached_is_named_and_hinders_nobody(start_node):
    world = start_node()
    assert world.names('raycast', (0, 0, 0), (1, 0, 0)) == []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    name = f'{world.name}/raycast'
    client = world.node.create_client(GetPlan, name, qos_profile=latched)  # no reply can match
    try:
        world.until(lambda: world.node.count_clients(name) == 2)
        until = time.monotonic() + 1.0
        world.until(lambda: time.monotonic() > until)
        client.call_async(GetPlan.Request())
        world.until(lambda: 'a reply of ~/raycast is lost' in world.said())
    finally:
        world.node.destroy_client(client)
    assert world.names('raycast', (0, 0, 0), (1, 0, 0)) == []
