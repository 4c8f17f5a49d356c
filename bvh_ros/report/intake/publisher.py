# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishes boxes at a rate, in a process of its own: `publisher TOPIC KIND COUNT RATE`."""

import itertools
import sys
import time

import rclpy
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from . import messages


def main() -> None:
    """Publish until told to end."""
    topic, kind, count, rate = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    if kind == 'markers':
        message_type, raws = MarkerArray, [messages.marker_array(count, side) for side in (0, 1)]
    else:
        message_type = PointCloud2
        raws = [serialize_message(messages.cloud(count, side)) for side in (0, 1)]
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # SIGTERM ends it
    node = rclpy.create_node('intake_publisher')
    publisher = node.create_publisher(message_type, topic, 2)
    due = time.monotonic()
    for raw in itertools.cycle(raws):
        publisher.publish(raw)
        due = max(due + 1.0 / rate, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == '__main__':
    main()
