# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishes one moving box until it is killed.

Run: python steady_publisher.py TOPIC ID
"""

import sys
import time

import rclpy
from visualization_msgs.msg import Marker, MarkerArray


def main(topic: str, number: str) -> None:
    """Publish 50 times a second, with 200 markers a message: a kill falls into one."""
    rclpy.init()
    node = rclpy.create_node(f'steady_publisher_{number}')
    publisher = node.create_publisher(MarkerArray, topic, 10)
    step = 0
    while True:
        step += 1
        array = MarkerArray()
        for y in range(200):
            marker = Marker(ns=f'publisher{number}', id=y, type=Marker.CUBE)
            marker.pose.position.x, marker.pose.position.y = float(step % 50), 2.0 * y
            marker.scale.x = marker.scale.y = marker.scale.z = 1.0
            array.markers.append(marker)
        publisher.publish(array)
        time.sleep(0.02)


if __name__ == '__main__':
    main(*sys.argv[1:])
