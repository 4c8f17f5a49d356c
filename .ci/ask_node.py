# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start the given bvh_node, show it one box over ROS 2, ask what a segment meets, end the node.

Run: python ask_node.py PATH_OF_BVH_NODE
"""

import signal
import subprocess
import sys
import time

import rclpy
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.client import BvhClient, BvhTimeoutError, Hit

COMPILING = 1000.0  # seconds: the first start ever compiles the kernels
PATIENCE = 200.0  # seconds: a loaded machine is slow


def box() -> Marker:
    """A cube of 1 m around (2, 0, 0)."""
    marker = Marker(ns='crate', id=7, type=Marker.CUBE)
    marker.header.frame_id = 'map'
    marker.pose.position.x = 2.0
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker


def wait_until_ready(client: BvhClient, process: subprocess.Popen[bytes]) -> None:
    """Wait for the services, but not for a node that has ended."""
    deadline = time.monotonic() + COMPILING
    while process.poll() is None and time.monotonic() < deadline:
        try:
            return client.wait_until_ready(1.0)
        except BvhTimeoutError:
            continue
    raise RuntimeError(f'no services; the node ended with {process.poll()}')


def first_hit(node: Node, client: BvhClient) -> Hit:
    """What the segment from (0, 0, 0) to (4, 0, 0) meets, as soon as the box has arrived."""
    publisher = node.create_publisher(MarkerArray, '/bvh/obstacles', 10)
    for _ in range(100):
        publisher.publish(MarkerArray(markers=[box()]))
        hit = client.raycast((0.0, 0.0, 0.0), (4.0, 0.0, 0.0))
        if hit is not None:
            return hit
        time.sleep(0.1)
    raise TimeoutError('the box has not arrived')


def main() -> None:
    """Ask; fail if the answer or the node's ending is not right."""
    process = subprocess.Popen([sys.argv[1]])
    rclpy.init()
    node = rclpy.create_node('ask_node')
    try:
        client = BvhClient(node, timeout=PATIENCE)
        wait_until_ready(client, process)
        hit = first_hit(node, client)
        print('the installed node answers:', hit)
        assert hit.name == 'crate/7', hit
        assert abs(hit.point[0] - 1.5) < 1e-12, hit
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
        process.send_signal(signal.SIGINT)
        status = process.wait(PATIENCE)
    assert status == 0, f'the node ended with {status} on Ctrl-C'


if __name__ == '__main__':
    main()
