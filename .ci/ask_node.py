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

from bvh_ros.client import BvhClient

COMPILING = 300.0  # seconds: the first start ever compiles the kernels


def box() -> Marker:
    """A cube of 1 m around (2, 0, 0)."""
    marker = Marker(ns='crate', id=7, type=Marker.CUBE)
    marker.header.frame_id = 'map'
    marker.pose.position.x = 2.0
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker


def first_hit(node: Node, deadline: float):
    """What the segment from (0, 0, 0) to (4, 0, 0) meets, as soon as the box has arrived."""
    publisher = node.create_publisher(MarkerArray, '/bvh/obstacles', 10)
    client = BvhClient(node)
    while time.monotonic() < deadline:
        publisher.publish(MarkerArray(markers=[box()]))
        if client.wait_for_service(1.0):
            hit = client.raycast((0.0, 0.0, 0.0), (4.0, 0.0, 0.0))
            if hit is not None:
                return hit
        time.sleep(0.1)
    raise TimeoutError('the node has not answered in time')


def main() -> None:
    """Ask; fail if the answer or the node's ending is not right."""
    process = subprocess.Popen([sys.argv[1]])
    rclpy.init()
    node = rclpy.create_node('ask_node')
    try:
        hit = first_hit(node, time.monotonic() + COMPILING)
        print('the installed node answers:', hit)
        assert hit.name == 'crate/7', hit
        assert abs(hit.point[0] - 1.5) < 1e-12, hit
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
        process.send_signal(signal.SIGINT)
        status = process.wait(20)
    assert status == 0, f'the node ended with {status} on Ctrl-C'


if __name__ == '__main__':
    main()
