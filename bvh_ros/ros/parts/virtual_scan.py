# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`~/virtual_scan`: what a laser scanner would measure in this world, at a pose from a topic."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header

from bvh_ros.ros.config.parameters import LASER_SCAN
from bvh_ros.ros.conversions import rotations, scans
from bvh_ros.ros.conversions.query_clouds import Hits, answers_cloud, unanswered
from bvh_ros.ros.conversions.times import nanoseconds
from bvh_ros.ros.parts.part import NodePart, Timings
from bvh_ros.ros.qos import Delivery
from bvh_ros.ros.sources.subscribing import FollowingSubscription
from bvh_ros.ros.texts import Refused, explain
from bvh_ros.ros.world.frames import Transform

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.config.parameters import ScanSettings
    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import NodeScene

DEPTH = 5
QOS_PERIOD = 1.0  # seconds


class VirtualScan(NodePart):
    """Publishes a LaserScan or a PointCloud2 for each pose, or at a rate from the newest pose.

    The pose is a PoseStamped: it says in which frame it is, needs no velocity or covariance as
    Odometry does, and `ros2 topic pub` can write one. A PointCloud2 has the fields of
    `~/ray_hits`, with t the range, so that each point carries its obstacle. Ranges follow REP 117;
    where nothing can be measured (an incomplete world, an unknown frame) all are NaN.

    Parameters
    ----------
    view : View
        What the scanner sees; one that skips inside does not see the robot that carries it.
    """

    def __init__(self, node: Node, world: World, settings: ScanSettings, view: View) -> None:
        super().__init__(node)
        self.what = 'virtual scan'
        self.refused = Refused(node.get_logger(), self.what)
        self.answered = 0  # rays
        self.timings = Timings()
        self._world = world
        self._settings = settings
        self._view = view
        self._pattern = scans.pattern(settings)
        self._pose: PoseStamped | None = None
        kind = LaserScan if settings.type == LASER_SCAN else PointCloud2
        self._publisher = self.publisher(kind, '~/virtual_scan', DEPTH)
        subscription = FollowingSubscription(
            node, PoseStamped, settings.pose_topic, self.receive, Delivery(DEPTH)
        )
        self._close.append(subscription.destroy)
        self.every(QOS_PERIOD, subscription.check)
        if settings.rate:
            timer = node.create_timer(1.0 / settings.rate, self._scan_again)
            self._close.append(lambda: node.destroy_timer(timer))

    def receive(self, poses: list[PoseStamped]) -> None:
        """Take a pose, and scan from there unless a timer does."""
        (pose,) = poses
        self._pose = pose
        if not self._settings.rate:
            self._scan(pose, nanoseconds(pose.header.stamp))

    def _scan_again(self) -> None:
        if self._pose is not None:
            self._scan(self._pose, 0)

    def _scan(self, pose: PoseStamped, stamp: int) -> None:
        if not self._publisher.get_subscription_count():
            return
        began = time.perf_counter_ns()
        now = self.node.get_clock().now()
        place = Transform(np.zeros(3), np.array(rotations.IDENTITY))
        hits, reason = unanswered(Hits, len(self._pattern.directions)), ''
        try:
            place = self._place(pose)
            hits = self._measure(self._world.at(now.nanoseconds), place)
            self.answered += len(hits.t)
        except ValueError as error:
            reason = str(error)
        except Exception as error:  # whatever went wrong, the way must not look free
            reason = explain(error)
        if reason:
            self.refused.add(reason, len(hits.t))
        scan = self._message(hits, place)
        frame = self._settings.frame_id or self._world.frames.frame_id
        scan.header = Header(frame_id=frame, stamp=pose.header.stamp if stamp else now.to_msg())
        self._publisher.publish(scan)
        self.timings.add(began)

    def _place(self, stamped: PoseStamped) -> Transform:
        """Return the way from the scanner's frame into the node's."""
        at, turn = stamped.pose.position, stamped.pose.orientation
        position = np.array((at.x, at.y, at.z))
        given = turn.x, turn.y, turn.z, turn.w
        if rotations.are_off(given):
            raise ValueError('the length of the orientation is neither 1 nor 0')
        orientation = rotations.normalised(given)
        header = stamped.header
        transform = self._world.frames.into_node(header.frame_id, nanoseconds(header.stamp))
        if transform is not None:
            position, orientation = transform.points(position), transform.orientations(orientation)
        if not (np.isfinite(position).all() and np.isfinite(orientation).all()):
            raise ValueError('the pose is not finite')
        return Transform(position, orientation)

    def _measure(self, scene: NodeScene, place: Transform) -> Hits:
        directions = place.vectors(self._pattern.directions)
        origins = np.tile(place.translation, (len(directions), 1))
        view, settings = self._view, self._settings
        return Hits(
            *scene.raycast_many(
                *(origins, directions, settings.range_max, view.mask, view.skip_inside),
                threads=self._world.settings.threads_for(len(origins)),
            )
        )

    def _message(self, hits: Hits, place: Transform) -> Any:
        settings, given = self._settings, self._pattern
        measured = scans.ranges(hits.obstacles, hits.t, settings.range_min)
        if settings.type == LASER_SCAN:
            return scans.laser_scan(measured, given, settings)
        points, normals = hits.points, hits.normals
        if settings.frame_id:
            points = hits.t[:, None] * given.directions
            normals = place.inverse().vectors(normals)
        points = np.where(np.isfinite(measured)[:, None], points, np.nan)
        found = Hits(hits.obstacles, measured, points, normals)
        return answers_cloud(found, settings.channels, len(given.angles), np.float32)
