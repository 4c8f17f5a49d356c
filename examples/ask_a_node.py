# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node's client: publish obstacles as markers, ask the node about them.

bvh_node &
python examples/ask_a_node.py
"""

import time

from needs import ROS, command_line, end_with

try:
    import rclpy
    from rclpy.qos import QoSProfile
    from visualization_msgs.msg import Marker, MarkerArray

    from bvh_ros.client import BvhClient, BvhTimeoutError
except ImportError:
    end_with(ROS)

PATIENCE = 10.0  # s


def crate(number: int, x: float) -> Marker:
    """Return a cube of 1 m on the floor."""
    marker = Marker(ns='crate', id=number, type=Marker.CUBE, action=Marker.ADD)
    marker.pose.position.x, marker.pose.position.z = x, 0.5
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker


def wait_for(client: BvhClient, name: str) -> None:
    """Wait while the node compiles, and say so; end if there is none."""
    while True:
        try:
            return client.wait_until_ready(PATIENCE)
        except BvhTimeoutError as error:
            if 'compiling' not in str(error):
                end_with(f'there is no node {name}: start one with `bvh_node`, or name yours')
            print(error, flush=True)


def main(name: str) -> None:
    """Publish three crates, wait until the node knows them, ask."""
    print(f'Three crates are shown to the node {name}, and it is asked about them.', flush=True)
    rclpy.init()
    node = rclpy.create_node('ask_a_node')
    client = BvhClient(node, name)
    wait_for(client, name)
    publisher = node.create_publisher(MarkerArray, f'{name}/obstacles', QoSProfile(depth=1000))
    deadline = time.monotonic() + PATIENCE
    while len(client.raycast_all((0.0, 0.0, 0.5), (20.0, 0.0, 0.5))) < 3:
        if time.monotonic() > deadline:
            end_with(f'{name} does not hear markers on {name}/obstacles: see its sources')
        publisher.publish(MarkerArray(markers=[crate(k, 5.0 * k) for k in (1, 2, 3)]))
        time.sleep(0.1)  # the message is on its way

    hit = client.raycast((0.0, 0.0, 0.5), (20.0, 0.0, 0.5))
    print('first on the segment:', hit.name, 'at', tuple(round(x, 3) for x in hit.point))
    hit = client.raycast((0.0, 0.8, 0.5), (20.0, 0.8, 0.5), radius=0.4)
    print('a robot of 0.4 m, 0.8 m to the side, meets', hit.name)
    free = client.raycast((0.0, 2.0, 0.5), (20.0, 2.0, 0.5), radius=0.4) is None
    print('2 m to the side the way is', 'free' if free else 'blocked')
    print('within 2 m of (9, 0):', [h.name for h in client.overlap((9, 0), (9, 0), tolerance=2.0)])
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    parser = command_line(__doc__)
    parser.add_argument('name', nargs='?', default='/bvh', help='of the node')
    main(parser.parse_args().name)
