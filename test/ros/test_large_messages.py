# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Fast DDS profile is found, is used unless the user has another, and lets clouds arrive."""

import json
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from bvh_ros.ros import large_messages

SENT = 10
NO_HEARTBEAT = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <profiles>
    <data_writer profile_name="no_heartbeat" is_default_profile="true">
      <times><heartbeatPeriod><sec>3600</sec></heartbeatPeriod></times>
    </data_writer>
  </profiles>
</dds>
"""
LISTEN = """
import time, rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node('listener')
heard = []
node.create_subscription(PointCloud2, '/large', heard.append, qos_profile_sensor_data)
end = time.monotonic() + 20
while len(heard) < {sent} and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
print(sum(len(cloud.data) == 3_200_000 for cloud in heard))
"""
TALK = """
import time, rclpy
from array import array
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node('talker')
publisher = node.create_publisher(PointCloud2, '/large', qos_profile_sensor_data)
while publisher.get_subscription_count() == 0:
    time.sleep(0.01)
time.sleep(0.5)
cloud = PointCloud2(data=array('B', bytes(3_200_000)))
for _ in range({sent}):
    publisher.publish(cloud)
    time.sleep(0.1)
time.sleep(1)
"""


def test_large_best_effort_messages_arrive():
    environment = {**os.environ, large_messages.VARIABLES[0]: str(large_messages.profile())}
    listener, talker = (
        subprocess.Popen(
            [sys.executable, '-c', code.format(sent=SENT)], env=environment, stdout=subprocess.PIPE
        )
        for code in (LISTEN, TALK)
    )
    talker.wait(60)
    heard, _ = listener.communicate(timeout=60)
    # Without the profile one or none arrive. With it, a machine that has no time may miss one.
    assert int(heard) > SENT // 2


@pytest.mark.parametrize('variable', large_messages.VARIABLES)
def test_the_users_own_profile_is_kept(monkeypatch, variable):
    for name in large_messages.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, '/mine.xml')
    large_messages.enable()
    assert [os.environ.get(name) for name in large_messages.VARIABLES].count(None) == 1
    assert os.environ[variable] == '/mine.xml'


def test_the_profile_is_used_otherwise(monkeypatch):
    for name in large_messages.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    large_messages.enable()
    ElementTree.parse(os.environ.pop(large_messages.VARIABLES[0]))


def test_requests_before_a_large_message_wait_for_no_heartbeat(tmp_path):
    """The message pushes requests out of the shared memory. `BvhClient` repeats them."""
    profile = tmp_path / 'no_heartbeat.xml'
    profile.write_text(NO_HEARTBEAT)
    domain = {'ROS_DOMAIN_ID': str(102 + os.getpid() % 100)}
    environment = {**os.environ, **domain, large_messages.VARIABLES[0]: str(profile)}
    client = [sys.executable, str(Path(__file__).with_name('far_client.py'))]
    with subprocess.Popen([sys.executable, '-m', 'bvh_ros.ros.node'], env=environment) as node:
        lines = [['ready', 1, None], ['before_large', 200, [node.pid, 60.0]]]
        done = subprocess.run(
            client,
            input='\n'.join(map(json.dumps, lines)),
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        node.terminate()
    assert [json.loads(line) for line in done.stdout.splitlines()][1] == 201
