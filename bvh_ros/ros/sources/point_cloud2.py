# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a PointCloud2 topic: many boxes a message."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.conversions import point_cloud2
from bvh_ros.ros.conversions.markers import moved
from bvh_ros.ros.conversions.times import nanoseconds
from bvh_ros.ros.sources.source import Source
from bvh_ros.scene import Numbered, Refusal


class PointCloud2Source(Source):
    """Replaces its boxes with those of each message, or updates them by id."""

    message_type = PointCloud2

    def apply(self, message: Any, now: int) -> tuple[int, Sequence[Refusal]]:
        """Replace all boxes, or update and delete by id."""
        boxes = point_cloud2.boxes(message, voxel=self.settings.options['voxel'])
        stamp = nanoseconds(message.header.stamp)
        shapes = moved(boxes.shapes, self.frames.into_node(message.header.frame_id, stamp))
        stamp = stamp or now
        prefix = f'{self.settings.prefix}{self.name}#'
        names = Numbered(prefix, boxes.numbers)
        self.skipped += boxes.skipped
        if boxes.by_id:
            self.scene.remove(self.name, Numbered(prefix, boxes.deleted))
            refusals = self.scene.update(self.name, names, shapes, stamp=stamp)
        else:
            refusals = self.scene.replace(self.name, '', names, shapes, stamp=stamp)
        refusals = [*boxes.refusals, *refusals]
        return len(boxes.numbers) + len(boxes.refusals), refusals
