# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Play a recording to a node that is configured for it, and query a scene of unknown content."""

from __future__ import annotations

import re
import time
from typing import NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from bvh_ros.bags import BagError, Recording, Track
from bvh_ros.client import BvhClient
from bvh_ros.ros.parts.diagnostics import HIGHEST, LOWEST
from bvh_ros.scenarios import Question, Table

# ---- How many obstacles a node has, and between which corners, as its diagnostics tell


Vector = tuple[float, float, float]


class Extent(NamedTuple):
    """Where the obstacles are."""

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


class Watch:
    """Listens to the diagnostics of one node, on a node of its own.

    Parameters
    ----------
    node : rclpy.node.Node
        Gives the context and the namespace.
    name : str
        Of the bvh node, in that namespace or with its own.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.extent: Extent | None = None  # as last reported; None while there are no obstacles
        self._node = rclpy.create_node('watch', namespace=node.get_namespace())
        self._status = f'{self._node.resolve_service_name(name).lstrip("/")}: world'
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._same = 0  # times in a row that nothing had changed
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._receive, 10)

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()

    def wait(self, until: float) -> None:
        """Listen until then (time.monotonic), and at least to what waits."""
        self._executor.spin_once(0.0)
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(left)

    def until_quiet(self, timeout: float) -> None:
        """Listen until there are obstacles and they do not change any more."""
        deadline = time.monotonic() + timeout
        self._same = 0
        while self._same < 2 and time.monotonic() < deadline:
            self._executor.spin_once(0.1)

    def _receive(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._status:
                values = {pair.key: pair.value for pair in status.values}
                extent = _extent(values)
                self._same = self._same + 1 if extent is not None and extent == self.extent else 0
                self.extent = extent


def _extent(values: dict[str, str]) -> Extent | None:
    if LOWEST not in values:
        return None
    low, high = ([float(text) for text in values[key].split(',')] for key in (LOWEST, HIGHEST))
    return Extent(int(values['obstacles']), _vector(low), _vector(high))


def _vector(corner: list[float]) -> Vector:
    x, y, *rest = corner
    return x, y, rest[0] if rest else 0.0


# ---- Playing a recording to a node


MESSAGES = {'MarkerArray': MarkerArray, 'PointCloud2': PointCloud2, 'OccupancyGrid': OccupancyGrid}
SOURCE = 'replay'  # begins the names of the node's sources, and of obstacles that have none
PRINT_EVERY = 1.0  # seconds
ARRIVES_WITHIN = 30.0  # seconds, for the last message


def parameters(recording: Recording, namespace: str) -> dict[str, object]:
    """Parameters of a node that listens to this recording, in the recording's frame."""
    sources = {}
    markers = [track for track in recording.tracks if track.source_type == 'MarkerArray']
    for track, name in zip(recording.tracks, source_names(recording), strict=True):
        sources[name] = {'type': track.source_type, 'topic': namespace + track.topic}
        if len(markers) > 1 and track in markers:  # two may use one name
            sources[name]['prefix'] = f'{track.topic}/'
    return {'sources': [*sources], **sources, 'frame_id': frame_of(recording) or 'map'}


def source_names(recording: Recording) -> list[str]:
    """One for each topic, after it: where there is one only, obstacles are just `replay#...`."""
    if len(recording.tracks) == 1:
        return [SOURCE]
    return [
        f'{SOURCE}_{number}_{re.sub("[^A-Za-z0-9]", "_", track.topic.strip("/"))[:40]}'
        for number, track in enumerate(recording.tracks, 1)
    ]


def frame_of(recording: Recording) -> str:
    """The frame of the first obstacles in the recording; empty if none has one."""
    for _, track, serialised in recording.messages():
        try:
            message = deserialize_message(serialised, MESSAGES[track.source_type])
        except Exception as error:  # of several classes, none of which rclpy names
            raise BagError(f'a message on {track.topic} cannot be read: {error}') from error
        parts = message.markers if track.source_type == 'MarkerArray' else [message]
        for part in parts:
            if part.header.frame_id:
                return str(part.header.frame_id)
    return ''


def play(recording: Recording, speed: float, node: Node, client: BvhClient) -> Table:
    """Publish the messages of all topics when they are due, and ask after each."""
    for track in recording.tracks:
        print(f'{track.topic} ({track.source_type}): {track.total} messages')
    print(f'{recording.total} messages in {recording.seconds:.1f} s')
    if recording.others:
        print(f'not played: {", ".join(recording.others)}')
    publishers = {track.topic: _publisher(node, track) for track in recording.tracks}
    table = Table()
    with Watch(node, client.name) as watch:
        began, printed, extent = time.monotonic(), -1, None
        t = 0.0
        for t, track, serialised in recording.messages():
            watch.wait(began + t / speed)
            publishers[track.topic].publish(serialised)
            if watch.extent is None:
                continue
            if extent is None:
                print(watch.extent.in_words())
                table.head()
            extent = watch.extent
            second = int(t / speed / PRINT_EVERY)
            for question in questions(extent):
                table.ask(client, question, t, show=second > printed)
            printed = second
        ask_at_the_end(client, table, watch, t)
    print(f'\n{recording.total} messages in {time.monotonic() - began:.1f} s; {table.summary()}')
    return table


def _publisher(node: Node, track: Track) -> Publisher:
    # The node asks for a map that was published before it came.
    latched = track.transient_local or track.source_type == 'OccupancyGrid'
    qos = QoSProfile(
        depth=10,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    topic = node.get_namespace() + track.topic
    publisher = node.create_publisher(MESSAGES[track.source_type], topic, qos)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    return publisher


def ask_at_the_end(client: BvhClient, table: Table, watch: Watch, t: float) -> None:
    """The last message takes a moment to arrive, and a recording may have one only."""
    watch.until_quiet(ARRIVES_WITHIN)
    if watch.extent is None:
        raise BagError('the recording brought no obstacle; what the node refused stands above')
    print(watch.extent.in_words())
    if not table.times:
        table.head()
    for question in questions(watch.extent):
        table.ask(client, question, t, show=True)


def questions(extent: Extent) -> list[Question]:
    """Questions that fit any scene."""
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
            'what is within 1 m of the middle', lambda c: c.overlap(middle, middle, tolerance=1.0)
        ),
    ]
