# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report intake`: how soon what is published can be asked about, over real ROS 2."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from ..page import Page
from ..tables import Cell, Table
from ..timing import seconds

if TYPE_CHECKING:
    from bvh_ros.client import BvhClient

REPEATS = 7
MARKERS, BOXES = 10_000, 100_000
BRIEF = 50  # times fewer in brief
CASES = (
    ('MarkerArray', MARKERS, 'obstacles', False),
    ('PointCloud2', BOXES, 'boxes', False),
    ('PointCloud2 with id', BOXES, 'boxes_by_id', True),
)


INTRODUCTION = '## Intake'


def over_ros(page: Page, brief: bool) -> None:
    """Measure over ROS 2 with the profile for large messages."""
    from bvh_ros.ros import large_messages, running

    large_messages.enable()
    parameters = {
        'sources': ['markers', 'boxes', 'by_id'],
        'boxes': {'type': 'PointCloud2', 'topic': '~/boxes'},
        'by_id': {'type': 'PointCloud2', 'topic': '~/boxes_by_id'},
        'max_obstacles': 10 * BOXES,
    }
    with (
        (page.folder / 'intake_node.log').open('wb') as log,
        running.served('intake', parameters, log=log) as (client, _),
    ):
        page.table(_usable(client, brief))


SECTIONS = {'over ROS 2': over_ros}


def _usable(client: 'BvhClient', brief: bool) -> Table:
    rows: list[list[Cell]] = []
    for name, count, topic, by_id in CASES:
        count = count // BRIEF if brief else count
        raws, message_type, peer, peer_name = _work(count, name, by_id)
        first, later = _until_usable(client, topic, message_type, raws, brief)
        peer()
        alone = statistics.median(seconds(peer) for _ in range(1 if brief else REPEATS))
        rows.append([name, count, first * 1e3, later * 1e3, peer_name, alone * 1e3, later / alone])
    header = ('message', 'boxes', 'ms, first message', 'ms, a later one', 'beside')
    return Table('intake', (*header, 'ms', 'ratio'), rows)


def _work(count: int, name: str, by_id: bool) -> tuple[list[bytes], Any, Callable[[], Any], str]:
    """Two messages, their type, and the work that they are compared with."""
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import PointCloud2
    from visualization_msgs.msg import MarkerArray

    from bvh_ros import DynamicBVH

    from . import messages

    if name == 'MarkerArray':
        raws = [messages.marker_array(count, side) for side in (0, 1)]
        return raws, MarkerArray, lambda: deserialize_message(raws[0], MarkerArray), 'rclpy alone'
    raws = [serialize_message(messages.cloud(count, side, by_id=by_id)) for side in (0, 1)]
    lo = messages.centres(count, 0) - messages.EDGE / 2
    hi = lo + messages.EDGE
    return raws, PointCloud2, lambda: DynamicBVH.from_boxes(lo, hi), 'from_boxes'


def _until_usable(
    client: 'BvhClient', topic: str, message_type: Any, raws: Sequence[bytes], brief: bool
) -> tuple[float, float]:
    """Seconds from publishing to the first answer that shows it: the first time, and later."""
    from . import messages

    node = client.node
    publisher = node.create_publisher(message_type, f'bvh/{topic}', 2)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    time.sleep(1.0)  # until the node has matched it, too
    took = []
    for turn in range(2 if brief else REPEATS + 1):
        side = turn % 2
        x, y = messages.BEACON_X, messages.SIDES[side]
        began = time.perf_counter()
        publisher.publish(raws[side])
        while client.raycast((x, y, -2.0), (x, y, 2.0)) is None:
            pass
        took.append(time.perf_counter() - began)
        time.sleep(0.2)
    node.destroy_publisher(publisher)
    _clear(client)
    return took[0], statistics.median(took[1:])


def _clear(client: 'BvhClient') -> None:
    """Empty the world."""
    import rclpy
    from std_srvs.srv import Trigger

    node = rclpy.create_node('intake_clear')  # the client spins its own
    trigger = node.create_client(Trigger, f'{client.node.get_namespace()}/bvh/clear')
    trigger.wait_for_service()
    rclpy.spin_until_future_complete(node, trigger.call_async(Trigger.Request()))
    node.destroy_node()
