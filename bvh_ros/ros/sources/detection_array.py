# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a Detection3DArray topic: turned boxes with names."""

from __future__ import annotations

from typing import Any

import numpy as np
from vision_msgs.msg import Detection3DArray

from bvh_ros.ros.conversions.placing import Placing, alike
from bvh_ros.ros.sources.source import TOO_FAR_AHEAD, Applying, ColumnsSource
from bvh_ros.scene import Part, ShapeKind


class Detection3DArraySource(ColumnsSource):
    """Replaces its boxes with those of the detections of each message."""

    message_type = Detection3DArray
    fields = 'header', 'detections.header', 'detections.bbox', 'detections.id'

    @staticmethod
    def says_everything(_serialised: bytes) -> bool:
        """Whether a message replaces the one before."""
        return True

    def apply(self, message: Any, now: int) -> Applying:
        """Replace all boxes. Where all frames are unknown, the message is refused."""
        self.is_whole = True
        columns, latest = self._columns(message), self._latest(now)
        (frame_id,), own = (
            columns.texts('header.frame_id'),
            columns.texts('detections.header.frame_id'),
        )
        stamps = columns.stamps('detections.header.stamp')
        stamps = np.where(stamps == 0, columns.stamps('header.stamp'), stamps)
        numbers: dict[str, int] = {}
        frame = np.array([numbers.setdefault(each or frame_id, len(numbers)) for each in own], int)
        boxes = columns.numbers('detections.bbox')  # position, orientation, size
        total, rows = len(boxes), np.arange(len(boxes))
        shapes = alike(ShapeKind.BOX, boxes[:, :3], boxes[:, 3:7], boxes[:, 7:])
        placing = Placing(list(numbers), frame, stamps, self.frames.into_node)
        nowhere = yield from placing.find(rows)
        if nowhere and len(nowhere) == total:
            raise ValueError(next(iter(nowhere.values())))
        yield from placing.move(shapes, rows)
        shapes.position[list(nowhere)] = np.nan
        if latest is not None and (stamps > latest).any():
            raise ValueError(f'{TOO_FAR_AHEAD}; what it replaces stays')
        names = self._names(columns.texts('detections.id'))
        part = Part(names, shapes, np.where(stamps == 0, now, stamps), velocities=self.follow)
        refusals = yield from self._in_slices('', total, part.cut, whole=True)
        why = nowhere.get
        return total, [each._replace(reason=why(each.row, each.reason)) for each in refusals]

    def _names(self, ids: list[str]) -> list[str]:
        """The ids; where one is empty, or an earlier detection has it, the row instead."""
        prefix, taken, names = self.settings.prefix, {''}, []
        for row, name in enumerate(ids):
            names.append(f'{prefix}{self.name}#{row}' if name in taken else f'{prefix}{name}')
            taken.add(name)
        return names
