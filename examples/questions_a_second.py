# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How many questions a second a node answers in large messages while a thousand boxes move at
30 Hz: thin rays and balls on ~/rays, turned boxes on ~/boxes, points on ~/points.

python examples/questions_a_second.py [--rows 100000] [--seconds 5] [--threads 1]

The node, the publisher of the boxes, and this program, which asks and reads the answers, are
processes of their own. Two messages are on the way at any time.
"""

import time
from array import array
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
from needs import ROS, command_line, end_with

try:
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import PointCloud2, PointField

    from bvh_ros.client import UNANSWERED, BvhError
    from bvh_ros.ros import large_messages, running
except ImportError:
    end_with(ROS)

SIDE, RADIUS, LONG, SIZE = 40.0, 0.2, 5.0, [0.9, 0.6, 0.5]  # m, of the world and the questions
ON_THE_WAY, PATIENCE = 2, 300.0  # messages; s


def publish(namespace):
    """Publish a thousand boxes that swing at 30 Hz, until this process is ended."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # ends without a word
    node = rclpy.create_node('swing', namespace=namespace)
    publisher = node.create_publisher(PointCloud2, 'bvh/points_in', 10)
    names = 'x', 'y', 'z', 'sx', 'sy', 'sz'
    cloud = PointCloud2(height=1, width=1000, point_step=24, row_step=24_000)
    cloud.header.frame_id = 'map'
    cloud.fields = [
        PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
        for k, name in enumerate(names)
    ]
    rng = np.random.default_rng(5)
    centre, reach = rng.uniform(0.0, SIDE, (1000, 3)), rng.uniform(-4.0, 4.0, (1000, 3))
    size = rng.uniform(0.4, 2.4, (1000, 3))
    while True:
        place = centre + reach * np.sin(time.time())
        cloud.data = array('B', np.hstack((place, size)).astype(np.float32).tobytes())
        cloud.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(cloud)
        time.sleep(1.0 / 30.0)


def questions(client, rows):
    """By name: a call of the client that asks them."""
    rng = np.random.default_rng(0)
    places, ways = rng.uniform(0.0, SIDE, (rows, 3)), rng.normal(size=(rows, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    turns = rng.normal(size=(rows, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    rays = places.astype(np.float32), ways.astype(np.float32), LONG
    return {
        'thin rays of 5 m': lambda: client.raycast_many(*rays, timeout=PATIENCE),
        'balls along them': lambda: client.raycast_many(*rays, radius=RADIUS, timeout=PATIENCE),
        'turned boxes': lambda: client.overlap_many(places, SIZE, turns, 0.1, timeout=PATIENCE),
        'points': lambda: client.nearest_many(places, LONG, timeout=PATIENCE),
    }


def rate(ask, seconds):
    """Rows a second, and how many were not answered."""
    began = time.monotonic()

    def ask_for_a_while(_):
        answers = []
        while time.monotonic() - began < seconds or not answers:
            answers.append(ask().obstacles)
        return np.concatenate(answers)

    with ThreadPoolExecutor(ON_THE_WAY) as threads:
        answers = np.concatenate([*threads.map(ask_for_a_while, range(ON_THE_WAY))])
    return len(answers) / (time.monotonic() - began), int(np.sum(answers == UNANSWERED))


def until_answered(ask):
    """Wait while what this takes is compiled; a few rows are enough to see it."""
    while True:
        try:
            if not (ask().obstacles == UNANSWERED).all():
                return
        except BvhError:
            pass
        time.sleep(0.2)


def main():
    parser = command_line(__doc__)
    parser.add_argument('--rows', type=int, default=100_000)
    parser.add_argument('--seconds', type=float, default=5.0)
    parser.add_argument('--threads', type=int, default=1)
    given = parser.parse_args()
    print(
        f'Questions in messages of {given.rows:,} rows to a node, while 1,000 boxes move.',
        flush=True,
    )
    large_messages.enable()
    source = {'type': 'PointCloud2', 'topic': 'bvh/points_in'}
    parameters = {'sources': ['swing'], 'swing': source, 'threads': given.threads}
    with running.served('questions', parameters) as (client, _):
        arguments = (client.node.get_namespace(),)
        get_context('spawn').Process(target=publish, args=arguments, daemon=True).start()
        few, rates = questions(client, 10), {}
        for name, ask in questions(client, given.rows).items():
            until_answered(few[name])
            found, unanswered = rate(ask, given.seconds)
            rates[name] = found
            print(f'{name}: {found:,.0f} rows a second, {unanswered} not answered', flush=True)
    best = max(rates, key=rates.get)
    print(f'The node answers up to {rates[best]:,.0f} questions a second ({best}).')


if __name__ == '__main__':
    main()
