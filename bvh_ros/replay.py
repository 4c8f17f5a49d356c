# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Play a recording to a node that is configured for it, and ask about a scene nobody knows yet."""

from __future__ import annotations

import time
from typing import NamedTuple

from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from bvh_ros.bags import BagError, Recording
from bvh_ros.client import BvhClient
from bvh_ros.questions import Question, Table

MESSAGES = {'MarkerArray': MarkerArray, 'PointCloud2': PointCloud2, 'OccupancyGrid': OccupancyGrid}
SOURCE = 'replay'  # name of the node's source, and beginning of the names of what has none
PRINT_EVERY = 1.0  # seconds
ARRIVES_WITHIN = 30.0  # seconds, for the last message
EVERYWHERE = ((-1e6, -1e6, -1e6), (1e6, 1e6, 1e6))  # m
Vector = tuple[float, float, float]


class Extent(NamedTuple):
    """Where the obstacles are, roughly: one point of each was looked at."""

    number: int
    low: Vector
    high: Vector

    def middle(self) -> Vector:
        """The point halfway."""
        x, y, z = (0.5 * (low + high) for low, high in zip(self.low, self.high, strict=True))
        return x, y, z

    def in_words(self) -> str:
        """Say how many there are, and where."""
        low, high = (
            '({:.1f}, {:.1f}, {:.1f})'.format(*corner) for corner in (self.low, self.high)
        )
        return f'{self.number} obstacles between {low} and {high}'


def parameters(recording: Recording, namespace: str) -> dict[str, object]:
    """Parameters of a node that listens to this recording, in the recording's frame."""
    source = {'type': recording.source_type, 'topic': namespace + recording.topic}
    return {'sources': [SOURCE], SOURCE: source, 'frame_id': frame_of(recording) or 'map'}


def frame_of(recording: Recording) -> str:
    """The frame of the first obstacles in the recording; empty if none has one."""
    for _, serialised in recording.messages():
        try:
            message = deserialize_message(serialised, MESSAGES[recording.source_type])
        except Exception as error:  # of several classes, none of which rclpy names
            raise BagError(f'a message on {recording.topic} cannot be read: {error}') from error
        parts = message.markers if recording.source_type == 'MarkerArray' else [message]
        for part in parts:
            if part.header.frame_id:
                return str(part.header.frame_id)
    return ''


def play(recording: Recording, speed: float, node: Node, client: BvhClient) -> Table:
    """Publish the messages when they are due, and ask after each."""
    print(
        f'{recording.topic} ({recording.source_type}): {recording.total} messages in '
        f'{recording.seconds:.1f} s'
    )
    if recording.others:
        print(f'not played: {", ".join(recording.others)} (choose with --topic)')
    publisher = _publisher(node, recording)
    table = Table()
    extent: Extent | None = None
    began, printed = time.monotonic(), -1
    t = 0.0
    for t, serialised in recording.messages():
        time.sleep(max(0.0, began + t / speed - time.monotonic()))
        publisher.publish(serialised)
        if extent is None:
            extent = _first_look(client, table)
            continue
        second = int(t / speed / PRINT_EVERY)
        for question in questions(extent):
            table.ask(client, question, t, show=second > printed)
        printed = second
    _ask_at_the_end(client, table, extent, t)
    print(f'\n{recording.total} messages in {time.monotonic() - began:.1f} s; {table.summary()}')
    return table


def _publisher(node: Node, recording: Recording) -> Publisher:
    # The node asks for a map that was published before it came.
    latched = recording.transient_local or recording.source_type == 'OccupancyGrid'
    qos = QoSProfile(
        depth=10,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    topic = node.get_namespace() + recording.topic
    publisher = node.create_publisher(MESSAGES[recording.source_type], topic, qos)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    return publisher


def _first_look(client: BvhClient, table: Table) -> Extent | None:
    """Where the obstacles are; None while there are none."""
    points = [hit.point for hit in client.overlap(*EVERYWHERE, timeout=ARRIVES_WITHIN)]
    if not points:
        return None
    x, y, z = zip(*points, strict=True)
    extent = Extent(len(points), (min(x), min(y), min(z)), (max(x), max(y), max(z)))
    print(extent.in_words())
    table.head()
    return extent


def _ask_at_the_end(client: BvhClient, table: Table, extent: Extent | None, t: float) -> None:
    """The last message takes a moment to arrive, and a recording may have one only."""
    deadline = time.monotonic() + ARRIVES_WITHIN
    while extent is None and time.monotonic() < deadline:
        time.sleep(0.1)
        extent = _first_look(client, table)
    if extent is None:
        raise BagError('the recording brought no obstacle; what the node refused stands above')
    for question in questions(extent):
        table.ask(client, question, t, show=True)


def questions(extent: Extent) -> list[Question]:
    """What can be asked about any scene."""
    x, y, z = middle = extent.middle()
    reach_x, reach_y = extent.high[0] - x + 1.0, extent.high[1] - y + 1.0
    return [
        Question(
            f'ray from the middle along x, {reach_x:.0f} m',
            lambda c: c.raycast(middle, (x + reach_x, y, z)),
        ),
        Question(
            f'ball, radius 0.3 m, along y, {reach_y:.0f} m',
            lambda c: c.raycast(middle, (x, y + reach_y, z), 0.3),
        ),
        Question(
            'who is within 1 m of the middle', lambda c: c.overlap(middle, middle, tolerance=1.0)
        ),
    ]
