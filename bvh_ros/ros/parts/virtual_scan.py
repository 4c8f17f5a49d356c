# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`~/virtual_scan`: what a laser scanner would measure in this world, at a pose from a topic."""

from __future__ import annotations

import time
from array import array
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header

from bvh_ros.ros.conversions import nanoseconds, rotations
from bvh_ros.ros.conversions.query_clouds import (
    FREE,
    UNANSWERED,
    Floats,
    Hits,
    answers_cloud,
    unanswered,
)
from bvh_ros.ros.parameters import LASER_SCAN, ScanSettings
from bvh_ros.ros.parts.part import Answerer
from bvh_ros.ros.qos import Delivery
from bvh_ros.ros.texts import why
from bvh_ros.ros.world.frames import Transform

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import NodeScene

# ---- The directions of a virtual scanner, and what it measured as messages


ROUNDING = 1e-6  # steps: angle_max is a direction too where it should be one


class Pattern(NamedTuple):
    """The directions of a scanner in its own frame: x forward, z up."""

    angles: Floats  # (beams,) rad
    directions: Floats  # (channels * beams, 3) unit vectors, ring by ring from below


def pattern(settings: ScanSettings) -> Pattern:
    """Return what the settings describe."""
    # As a reader of a LaserScan computes them: from float32.
    first, step = np.float64(np.float32(settings.angle_min)), np.float32(settings.angle_increment)
    span = (settings.angle_max - settings.angle_min) / settings.angle_increment
    angles = first + np.arange(int(span + ROUNDING) + 1) * np.float64(step)
    rings = np.linspace(settings.elevation_min, settings.elevation_max, settings.channels)
    rise, turn = np.meshgrid(rings, angles, indexing='ij')
    across = np.cos(rise)
    directions = (across * np.cos(turn), across * np.sin(turn), np.sin(rise))
    return Pattern(angles, np.stack(directions, axis=-1).reshape(-1, 3))


def ranges(obstacles: NDArray[np.uint32], t: Floats, range_min: float) -> Floats:
    """Return ranges as REP 117 wants them, from hits on rays of unit length.

    +Inf: nothing within range; -Inf: too near to measure; NaN: not measurable.
    """
    measured = np.where(obstacles == FREE, np.inf, t)
    measured[(obstacles != FREE) & (t < range_min)] = -np.inf
    measured[obstacles == UNANSWERED] = np.nan
    return measured


def laser_scan(measured: Floats, given: Pattern, settings: ScanSettings) -> LaserScan:
    """Write ranges of one ring into a LaserScan, its header left to the caller."""
    scan = LaserScan(
        angle_min=float(np.float32(settings.angle_min)),
        angle_max=float(np.float32(given.angles[-1])),
        angle_increment=float(np.float32(settings.angle_increment)),
        scan_time=1.0 / settings.rate if settings.rate else 0.0,
        range_min=settings.range_min,
        range_max=settings.range_max,
    )
    scan.ranges = array('f', measured.astype(np.float32).tobytes())
    return scan


# ---- The part of the node that scans


DEPTH = 5


class VirtualScan(Answerer):
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
        super().__init__(node, world, view, 'virtual scan', of_view=False)
        self._settings = settings
        self._pattern = pattern(settings)
        self._pose: PoseStamped | None = None
        kind = LaserScan if settings.type == LASER_SCAN else PointCloud2
        self._publisher = self.publisher(kind, '~/virtual_scan', DEPTH)
        self.listen(PoseStamped, settings.pose_topic, self.receive, Delivery(DEPTH))
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
        except Exception as error:  # whatever went wrong, the way must not look free
            reason = why(error)
        if reason:
            self.refused.add(reason, len(hits.t))
        scan = self._message(hits, place)
        frame = self._settings.frame_id or self._world.frames.frame_id
        scan.header = Header(frame_id=frame, stamp=pose.header.stamp if stamp else now.to_msg())
        self._publisher.publish(scan)
        self.timings.add(began)

    def _place(self, stamped: PoseStamped) -> Transform:
        """Return the way from the scanner's frame into the node's."""
        header, turn = stamped.header, stamped.pose.orientation
        if rotations.are_off((turn.x, turn.y, turn.z, turn.w)):
            raise ValueError('the length of the orientation is neither 1 nor 0')
        place = Transform.of(stamped.pose.position, turn)
        into_node = self._world.frames.into_node(header.frame_id, nanoseconds(header.stamp))
        place = place if into_node is None else into_node.after(place)
        if not np.isfinite(np.hstack(place)).all():
            raise ValueError('the pose is not finite')
        return place

    def _measure(self, scene: NodeScene, place: Transform) -> Hits:
        directions = place.vectors(self._pattern.directions)
        origins = np.tile(place.translation, (len(directions), 1))
        view, settings = self.view, self._settings
        return Hits(
            *scene.raycast_many(
                *(origins, directions, settings.range_max, view.mask, view.skip_inside),
                threads=self._world.settings.threads_for(len(origins)),
            )
        )

    def _message(self, hits: Hits, place: Transform) -> Any:
        settings, given = self._settings, self._pattern
        measured = ranges(hits.obstacles, hits.t, settings.range_min)
        if settings.type == LASER_SCAN:
            return laser_scan(measured, given, settings)
        points, normals = hits.points, hits.normals
        if settings.frame_id:
            points = hits.t[:, None] * given.directions
            normals = place.inverse().vectors(normals)
        points = np.where(np.isfinite(measured)[:, None], points, np.nan)
        found = Hits(hits.obstacles, measured, points, normals)
        return answers_cloud(found, settings.channels, len(given.angles), np.float32)
