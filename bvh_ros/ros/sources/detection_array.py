# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a Detection3DArray topic."""

from __future__ import annotations

from typing import Any

import numpy as np
from vision_msgs.msg import Detection3DArray

from bvh_ros.ros.conversions import detections
from bvh_ros.ros.conversions.markers import TOO_FAR_AHEAD
from bvh_ros.ros.sources.columns import ColumnsSource
from bvh_ros.ros.sources.source import Applying
from bvh_ros.scene import Part


class Detection3DArraySource(ColumnsSource):
    """Replaces its boxes with those of the detections of each message."""

    message_type = Detection3DArray
    fields = detections.FIELDS

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.says_everything = lambda _message: True

    def apply(self, message: Any, now: int) -> Applying:
        """Replace all boxes."""
        self.is_whole = True
        found = yield from detections.read(
            self._columns(message),
            into_node=self.frames.into_node,
            prefix=self.settings.prefix,
            source=self.name,
        )
        latest, total = self._latest(now), len(found.names)
        if latest is not None and (found.stamps > latest).any():
            raise ValueError(f'{TOO_FAR_AHEAD}; what it replaces stays')
        stamps = np.where(found.stamps == 0, now, found.stamps)
        part = Part(found.names, found.shapes, stamps, velocities=self.follow)
        refusals = yield from self._in_slices('', total, part.cut, whole=True)
        given = found.reasons
        return total, [each._replace(reason=given.get(each.row, each.reason)) for each in refusals]
