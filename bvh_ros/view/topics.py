# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a node tells everybody: its diagnostics, and the pictures that RViz shows, too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import LaserScan, PointCloud2
from visualization_msgs.msg import MarkerArray

from bvh_ros.ros.config.part_settings import LASER_SCAN, ScanSettings
from bvh_ros.ros.conversions import ray_clouds, rotations
from bvh_ros.ros.conversions.times import nanoseconds
from bvh_ros.ros.world.frames import FrameError, Frames, Transform
from bvh_ros.scene import Shapes
from bvh_ros.view import pictures
from bvh_ros.view.worlds import NO_POINTS, Floats, Integers, Overlay, Wanted

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
POSES_KEPT = 100
WORLD_FIGURES = {'height': 'height of the tree', 'cost': 'cost', 'expired': 'expired'}
RATES = {
    'updates a second': 'updates a second',
    'answers a second': 'answers a second',
    'p50 [ms]': 'median [ms]',
    'p99 [ms]': 'p99 [ms]',
}


class Topics:
    """Listens to a node's topics; to pictures only while somebody wants them.

    Parameters
    ----------
    node : rclpy.node.Node
        Ours.
    name : str
        Of the other node, with its namespace.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self.figures: dict[str, str] = {}
        self.drawn: dict[str, Shapes] = {}  # what `~/scene` shows of each source
        self.scenes = 0  # how often it was told
        self.boxes: tuple[Floats, Floats, Integers] = pictures.NO_BOXES
        self.overlay = Overlay()
        self._source_topics: dict[str, str] = {}
        self._wanted: dict[str, Subscription] = {}
        self._poses: dict[int, PoseStamped] = {}
        self._frames = Frames('')
        self._scan: ScanSettings | None = None
        self._pose_subscription: Subscription | None = None
        node.create_subscription(DiagnosticArray, '/diagnostics', self._note, 10)
        self._listen('scene', MarkerArray, self._draw, raw=True)

    def sources(self) -> dict[str, str]:
        """The node's sources, and the topics that they listen to; empty until it told."""
        return self._source_topics

    def place_scans_with(self, frames: Frames, settings: ScanSettings) -> None:
        """Tell where the node's scanner is."""
        self._frames, self._scan = frames, settings

    def want(self, wanted: Wanted) -> None:
        """Listen to these topics, and to no other picture."""
        self._switch('tree', wanted.tree, MarkerArray, self._draw_tree, raw=True)
        self._switch('queries', wanted.queries, MarkerArray, self._draw_queries, raw=True)
        if not wanted.queries:
            self.overlay = Overlay(scan=self.overlay.scan)
        if self._scan is not None and self._scan.pose_topic:
            kind = LaserScan if self._scan.type == LASER_SCAN else PointCloud2
            if wanted.scan and self._pose_subscription is None:
                topic = self._scan.pose_topic.replace('~', self._name, 1)
                self._pose_subscription = self._node.create_subscription(
                    PoseStamped, topic, self._keep_pose, 10
                )
            self._switch('virtual_scan', wanted.scan, kind, self._draw_scan)
            if not wanted.scan:
                self.overlay = self.overlay._replace(scan=NO_POINTS)

    def _switch(
        self, topic: str, on: bool, kind: type, callback: Callable[[Any], None], raw: bool = False
    ) -> None:
        if on and topic not in self._wanted:
            self._listen(topic, kind, callback, raw)
        elif not on and topic in self._wanted:
            self._node.destroy_subscription(self._wanted.pop(topic))

    def _listen(
        self, topic: str, kind: type, callback: Callable[[Any], None], raw: bool = False
    ) -> None:
        qos = 5 if topic == 'virtual_scan' else LATCHED
        self._wanted[topic] = self._node.create_subscription(
            kind, f'{self._name}/{topic}', callback, qos, raw=raw
        )

    def _note(self, message: DiagnosticArray) -> None:
        """Take the figures of our node out of everybody's."""
        beginning = f'{self._name.lstrip("/")}: '
        mine = {
            status.name.removeprefix(beginning): {pair.key: pair.value for pair in status.values}
            for status in message.status
            if status.name.startswith(beginning)
        }
        if not mine:
            return
        figures: dict[str, str] = {}
        for part, values in mine.items():
            if part.startswith('source ') and 'topic' in values:
                self._source_topics[part.removeprefix('source ')] = values['topic']
            wanted = WORLD_FIGURES if part == 'world' else RATES
            shown = {new: values[old] for old, new in wanted.items() if old in values}
            where = '' if part == 'world' else f'{part}: '
            figures |= {f'{where}{key}': value for key, value in shown.items()}
        self.figures = figures

    def _draw(self, message: bytes) -> None:
        self.drawn = pictures.obstacles(message)
        self.scenes += 1

    def _draw_tree(self, message: bytes) -> None:
        first, planar = (
            self._node.get_parameter(name).value for name in ('draw.first_depth', 'planar')
        )
        self.boxes = pictures.tree(message, first, planar)

    def _draw_queries(self, message: bytes) -> None:
        lines, colours, spots = pictures.queries(message)
        self.overlay = Overlay(lines, colours, spots, self.overlay.scan)

    def _keep_pose(self, pose: PoseStamped) -> None:
        self._poses[nanoseconds(pose.header.stamp)] = pose
        if len(self._poses) > POSES_KEPT:
            del self._poses[next(iter(self._poses))]

    def _draw_scan(self, scan: Any) -> None:
        if not self._poses:
            return
        stamp = nanoseconds(scan.header.stamp)
        pose = self._poses.get(stamp, self._poses[next(reversed(self._poses))])
        try:
            place = self._place_of(pose)
        except FrameError:
            return  # the node says so itself
        if isinstance(scan, LaserScan):
            points = place.points(_points_of(scan))
        elif scan.header.frame_id == self._frames.frame_id:
            points = ray_clouds.hits(scan).points
        else:
            points = place.points(ray_clouds.hits(scan).points)
        self.overlay = self.overlay._replace(scan=points[np.isfinite(points).all(axis=1)])

    def _place_of(self, stamped: PoseStamped) -> Transform:
        at, turn = stamped.pose.position, stamped.pose.orientation
        place = Transform(
            np.array((at.x, at.y, at.z)), rotations.normalised((turn.x, turn.y, turn.z, turn.w))
        )
        header = stamped.header
        into = self._frames.into_node(header.frame_id, nanoseconds(header.stamp))
        return place if into is None else into.after(place)


def _points_of(scan: LaserScan) -> Floats:
    """Where the beams end, in the scanner's frame."""
    ranges = np.array(scan.ranges, np.float64)
    ranges[~np.isfinite(ranges)] = np.nan
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    return np.stack((ranges * np.cos(angles), ranges * np.sin(angles), 0.0 * ranges), axis=1)
