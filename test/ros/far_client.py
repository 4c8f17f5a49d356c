# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A client in a process of its own, perhaps on another host than the node. It reads lines of JSON
from its standard input, `[what, count, argument]`, and writes each result as a line of JSON.
"""

import json
import os
import signal
import sys
import time

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.client import FREE, BvhClient, BvhError, BvhTimeoutError

PATIENCE = 600.0  # seconds, against hanging
START, END = (-2.0, 0.0, 0.0), (10.0, 0.0, 0.0)


def marker(number):
    """A cube of half a metre at x = number; number 0 is met by the rays."""
    made = Marker(ns='b', id=number, type=Marker.CUBE)
    made.header.frame_id = 'map'
    made.pose.position.x, made.pose.orientation.w = float(number), 1.0
    made.scale.x = made.scale.y = made.scale.z = 0.5
    return made


class Far:
    """What can be asked for."""

    def __init__(self):
        self.node = rclpy.create_node('far')
        self.obstacles = self.node.create_publisher(
            MarkerArray, '/bvh/obstacles', QoSProfile(depth=5000)
        )
        self.client = BvhClient(self.node, timeout=PATIENCE)

    def ready(self, count, _):
        """Wait for the node, and tell it the first obstacles."""
        self.client.wait_until_ready(PATIENCE)
        self.client.wait_until_batches_are_ready(PATIENCE)
        while self.obstacles.get_subscription_count() == 0:
            time.sleep(0.02)
        self.tell(count, [0, 0.0])
        return self.known(count, [0, PATIENCE])

    def tell(self, count, argument):
        """Publish obstacles from a number on, `period` seconds apart."""
        first, period = argument
        for number in range(first, first + count):
            self.obstacles.publish(MarkerArray(markers=[marker(number)]))
            time.sleep(period)

    def known(self, count, argument):
        """How many obstacles are known at most, within some seconds, and after how many."""
        first, patience = argument
        began, most = time.monotonic(), 0
        corners = (first - 0.2, -0.2, -0.2), (first + count - 0.8, 0.2, 0.2)
        while time.monotonic() < began + patience and most < count:
            most = max(most, len(self.client.overlap(*corners, timeout=patience)))
        return most, time.monotonic() - began

    def ask(self, count, timeout):
        """Ask for single rays one after the other."""
        return self.times(count, lambda: self.is_right(timeout))

    def is_right(self, timeout):
        hit = self.client.raycast(START, END, timeout=timeout)
        return hit is not None and hit.name == 'b/0'

    def batch(self, count, argument):
        """Ask for batches of rays."""
        rows, timeout = argument
        starts, ways = np.tile(START, (rows, 1)), np.tile((1.0, 0.0, 0.0), (rows, 1))

        def is_right():
            hits = self.client.raycast_many(starts, ways, timeout=timeout)
            return bool((hits.obstacles != FREE).all() and (hits.t == 1.75).all())

        return self.times(count, is_right)

    def many(self, count, timeout):
        """Ask for single rays all at once."""
        futures = [self.client.raycast_async(START, END) for _ in range(count)]
        end = time.monotonic() + timeout
        while not all(one.done() for one in futures) and time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.1)
        return sum(one.done() and one.result().name == 'b/0' for one in futures)

    def before_large(self, count, argument):
        """Ask for single rays, then at once for a batch of 0.96 MB, of a node that is stopped
        meanwhile. How many are answered within some seconds.
        """
        process, patience = argument
        rows = np.zeros((40_000, 3), np.float32)
        os.kill(process, signal.SIGSTOP)
        futures = [self.client.raycast_async(START, END) for _ in range(count)]
        futures.append(self.client.raycast_many_async(rows, rows + np.float32((1, 0, 0))))
        os.kill(process, signal.SIGCONT)
        deadline = time.monotonic() + patience
        while not all(one.done() for one in futures) and time.monotonic() < deadline:
            rclpy.spin_once(self.node, timeout_sec=0.1)
        return sum(one.done() for one in futures)

    def times(self, count, ask):
        """Counts of what came, and percentiles of the seconds that it took."""
        came, seconds = {'right': 0, 'wrong': 0, 'timeouts': 0, 'errors': 0}, []
        for _ in range(count):
            began = time.perf_counter()
            try:
                came['right' if ask() else 'wrong'] += 1
            except BvhTimeoutError:
                came['timeouts'] += 1
            except BvhError:
                came['errors'] += 1
            seconds.append(time.perf_counter() - began)
        p50, p99 = np.percentile(seconds, (50, 99)).tolist()
        return {**came, 'p50': p50, 'p99': p99, 'most': max(seconds)}


if __name__ == '__main__':
    rclpy.init()
    far = Far()
    for line in sys.stdin:
        what, count, argument = json.loads(line)
        print(json.dumps(getattr(far, what)(count, argument)), flush=True)
    os._exit(0)
