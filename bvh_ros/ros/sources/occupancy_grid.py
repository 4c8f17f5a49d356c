# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from an OccupancyGrid topic."""

from __future__ import annotations

from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid

from bvh_ros.ros.config.parameters import ConfigurationError
from bvh_ros.ros.conversions import occupancy_grid
from bvh_ros.ros.conversions.markers import moved
from bvh_ros.ros.conversions.times import nanoseconds
from bvh_ros.ros.sources.source import Applying, Source
from bvh_ros.scene import Numbered, Part


class OccupancyGridSource(Source):
    """Replaces its boxes with the occupied cells of each message, merged to rectangles."""

    message_type = OccupancyGrid
    depth = 1  # a map replaces the one before it
    follows_publisher = False

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        options = self.settings.options
        if options['z_min'] > options['z_max']:
            raise ConfigurationError(f"parameter '{self.name}.z_min' is above '{self.name}.z_max'")

    def apply(self, message: Any, now: int) -> Applying:
        """Replace all boxes."""
        self.is_whole = True
        options = self.settings.options
        shapes = yield from occupancy_grid.boxes(
            message,
            occupied_at=options['occupied_at'],
            unknown_occupied=options['unknown'] == 'occupied',
            z_min=options['z_min'],
            z_max=options['z_max'],
            most=self.scene.max_obstacles,
        )
        stamp = nanoseconds(message.header.stamp)
        shapes = moved(shapes, self.frames.into_node(message.header.frame_id, stamp))
        n = len(shapes.kind)
        names = Numbered(f'{self.settings.prefix}{self.name}#', np.arange(n))
        part = Part(names, shapes, stamp or now)
        return n, (yield from self._in_slices('', n, part.cut, whole=True))
