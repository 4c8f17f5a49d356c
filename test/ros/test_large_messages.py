# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Fast DDS profile is found, is used unless the user has another, and lets clouds arrive."""

import json
import os
import select
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from ros.patience import PATIENCE

from bvh_ros.ros import large_messages

SENT = 10
LOST = 20.0  # seconds after which a message counts as lost
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
def hear(cloud):
    print(len(cloud.data), flush=True)
rclpy.init()
node = rclpy.create_node('listener')
large = node.create_subscription(PointCloud2, '/large', hear, qos_profile_sensor_data)
while large.get_publisher_count() == 0:
    time.sleep(0.01)
print('found', flush=True)
rclpy.spin(node)
"""
TALK = """
import sys, time, rclpy
from array import array
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node('talker')
publisher = node.create_publisher(PointCloud2, '/large', qos_profile_sensor_data)
while publisher.get_subscription_count() == 0:
    time.sleep(0.01)
print('found', flush=True)
cloud = PointCloud2(data=array('B', bytes(3_200_000)))
for line in sys.stdin:
    publisher.publish(cloud)
"""


def test_large_best_effort_messages_arrive():
    environment = {**os.environ, large_messages.VARIABLES[0]: str(large_messages.profile())}
    pipes = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE, 'bufsize': 0}
    given = {'env': environment, **pipes}
    with (
        subprocess.Popen([sys.executable, '-c', LISTEN], **given) as listener,
        subprocess.Popen([sys.executable, '-c', TALK], **given) as talker,
    ):
        try:
            for one in (listener, talker):
                assert one.stdout.readline() == b'found\n'
            heard = 0
            for _ in range(SENT):  # each once the one before was heard: none has to wait
                talker.stdin.write(b'go\n')
                talker.stdin.flush()
                if select.select([listener.stdout], [], [], LOST)[0]:
                    heard += listener.stdout.readline() == b'3200000\n'
        finally:
            listener.kill()
            talker.kill()
    # Without the profile every second one is lost, or more.
    assert heard >= SENT - 1


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
    domain = {'ROS_DOMAIN_ID': str(101 + int(os.environ['ROS_DOMAIN_ID']))}
    environment = {**os.environ, **domain, large_messages.VARIABLES[0]: str(profile)}
    client = [sys.executable, str(Path(__file__).with_name('far_client.py'))]
    with subprocess.Popen([sys.executable, '-m', 'bvh_ros.ros.node'], env=environment) as node:
        lines = [['ready', 1, None], ['before_large', 200, [node.pid, PATIENCE]]]
        done = subprocess.run(
            client,
            input='\n'.join(map(json.dumps, lines)),
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        node.terminate()
    assert [json.loads(line) for line in done.stdout.splitlines()][1] == 201
