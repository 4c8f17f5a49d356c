# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The directions of a virtual scanner, and what it measured as messages."""

from __future__ import annotations

from array import array
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan

from bvh_ros.ros.config.parameters import ScanSettings
from bvh_ros.ros.conversions.query_clouds import FREE, UNANSWERED, Floats

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
