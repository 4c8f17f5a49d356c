# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the parts that draw and scan: `draw.*` and `virtual_scan.*`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from bvh_ros.ros.config.option import FARTHEST, ConfigurationError, Option

LASER_SCAN, POINT_CLOUD = 'LaserScan', 'PointCloud2'
MOST_RAYS = 1_000_000  # of one scan

DRAW_OPTIONS = (
    Option(
        'limit',
        10_000,
        'So many obstacles on ~/scene, boxes on ~/tree and rays on ~/queries are drawn at most.',
        minimum=1,
        maximum=1_000_000,
    ),
    Option('first_depth', 0, 'Upper end of the levels on ~/tree; the root has depth 0.', 0, 127),
    Option('last_depth', 6, 'Lower end of the levels on ~/tree.', 0, 127),
)
TURNS = (-100.0, 100.0)  # rad
SCAN_OPTIONS = (
    Option('pose_topic', '', 'PoseStamped of the scanner. Empty: there is no virtual scan.'),
    Option('type', LASER_SCAN, 'What ~/virtual_scan carries.', choices=(LASER_SCAN, POINT_CLOUD)),
    Option('frame_id', 'laser', "The scanner's own frame. Empty: points in the node's frame."),
    Option('view', '', 'The view that the scanner has; empty: it sees everything.'),
    Option(
        'angle_min', -math.pi, 'First direction (rad) about the z axis of the scanner.', *TURNS
    ),
    Option('angle_max', math.pi, 'Last direction (rad).', *TURNS),
    Option('angle_increment', math.pi / 180, 'Step between directions (rad).', 1e-6, math.tau),
    Option('channels', 1, 'Rings of a PointCloud2.', 1, 1024),
    Option('elevation_min', 0.0, 'Lowest ring (rad).', -math.pi / 2, math.pi / 2),
    Option('elevation_max', 0.0, 'Highest ring (rad).', -math.pi / 2, math.pi / 2),
    Option('range_min', 0.0, 'What is nearer (m) is -Inf.', 0.0, FARTHEST),
    Option('range_max', 100.0, 'What is farther (m) is +Inf.', 0.0, FARTHEST),
    Option('rate', 0.0, 'Scans a second from the newest pose; 0: one scan a pose.', 0.0, 1000.0),
)
GROUPS = {'draw': DRAW_OPTIONS, 'virtual_scan': SCAN_OPTIONS}


class DrawSettings(NamedTuple):
    """`draw.*`."""

    limit: int
    first_depth: int
    last_depth: int


class ScanSettings(NamedTuple):
    """`virtual_scan.*`, angles in rad, ranges in m."""

    pose_topic: str
    type: str
    frame_id: str
    view: str
    angle_min: float
    angle_max: float
    angle_increment: float
    channels: int
    elevation_min: float
    elevation_max: float
    range_min: float
    range_max: float
    rate: float


def draw_settings(values: Mapping[str, Any]) -> DrawSettings:
    """Return `draw.*`; ConfigurationError if the levels are upside down."""
    settings = DrawSettings(**values)
    if settings.first_depth > settings.last_depth:
        raise ConfigurationError("parameter 'draw.first_depth' exceeds 'draw.last_depth'")
    return settings


def scan_settings(values: Mapping[str, Any]) -> ScanSettings:
    """Return `virtual_scan.*`; ConfigurationError where one contradicts another."""
    settings = ScanSettings(**values)
    for what in ('angle', 'elevation', 'range'):
        if values[f'{what}_min'] > values[f'{what}_max']:
            raise ConfigurationError(
                f"parameter 'virtual_scan.{what}_min' exceeds 'virtual_scan.{what}_max'"
            )
    if settings.type == LASER_SCAN and (settings.channels > 1 or not settings.frame_id):
        raise ConfigurationError(
            "a LaserScan has one channel and a frame of its own: set 'virtual_scan.type' to "
            "PointCloud2 or change 'virtual_scan.channels' or 'virtual_scan.frame_id'"
        )
    beams = (settings.angle_max - settings.angle_min) / settings.angle_increment
    if beams * settings.channels > MOST_RAYS:
        raise ConfigurationError(
            "parameters 'virtual_scan.angle_min', 'virtual_scan.angle_max', "
            "'virtual_scan.angle_increment' and 'virtual_scan.channels' make more than "
            f'{MOST_RAYS} rays a scan'
        )
    return settings
