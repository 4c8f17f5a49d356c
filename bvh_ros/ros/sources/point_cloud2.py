# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a PointCloud2 topic: many boxes a message."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.cdr import point_cloud2 as decoder
from bvh_ros.ros.conversions import point_cloud2
from bvh_ros.ros.conversions.markers import TOO_FAR_AHEAD, moved
from bvh_ros.ros.sources.source import Applying, Source
from bvh_ros.scene import Numbered, Part
from bvh_ros.scene.store import run_in_thread

MANY = 30_000  # rows, whose ids take some 5 ms to compare


def says_everything(serialised: bytes) -> bool:
    """Whether a cloud replaces all boxes: it has no ids."""
    try:
        names = [field.name for field in decoder.read(serialised).fields]
    except ValueError:
        return False
    return bool(names) and 'id' not in names


class PointCloud2Source(Source):
    """Replaces its boxes with those of each message, or updates them by id."""

    message_type = PointCloud2

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.says_everything = says_everything
        self.raw = True

    def apply(self, message: Any, now: int) -> Applying:
        """Replace all boxes, or update and delete by id."""
        given = decoder.read(*message)
        options = self.settings.options
        moving = options['predict'] == 'given'
        read = partial(point_cloud2.BoxCloud, given, voxel=options['voxel'], moving=moving)
        large = given.width * given.height >= MANY
        cloud = (yield from run_in_thread(read)) if large else read()
        self.is_whole = not cloud.by_id
        stamp = given.stamp
        transform = self.frames.into_node(given.frame_id, stamp)
        prefix = f'{self.settings.prefix}{self.name}#'
        items = skipped = 0
        if (latest := self._latest(now)) is not None and stamp > latest:
            raise ValueError(f'{TOO_FAR_AHEAD}; what it replaces or deletes stays')

        def parts(length: int) -> Iterator[Part]:
            nonlocal items, skipped
            items = skipped = 0  # a late update begins again
            for boxes in cloud.parts(length):
                skipped += boxes.skipped
                items += len(boxes.numbers)
                if len(boxes.deleted):
                    self.scene.remove(self.name, Numbered(prefix, boxes.deleted))
                names = Numbered(prefix, boxes.numbers)
                speeds: Any = boxes.velocities if moving else self.follow
                if moving and transform is not None:
                    speeds = transform.vectors(speeds)
                part = Part(names, moved(boxes.shapes, transform), stamp or now)
                yield part._replace(velocities=speeds)

        whole = not cloud.by_id
        refusals = yield from self._in_slices('', cloud.total, parts, whole=whole)
        self.skipped += skipped
        refusals.extend(cloud.refusals)
        return items + len(cloud.refusals), refusals
