# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from an Octomap topic."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from octomap_msgs.msg import Octomap

from bvh_ros.ros.compile_jobs import Job
from bvh_ros.ros.conversions import octomap
from bvh_ros.ros.sources.source import Applying, ColumnsSource


def to_compile() -> Job:
    """Return what goes through octrees."""
    return Job('decode octrees', 'decode octrees', 1.0, octomap.exercise, early=True)


class OctomapSource(ColumnsSource):
    """Replaces its boxes with the occupied leaves of each message."""

    message_type = Octomap
    depth = 1  # a map replaces the one before it
    fields = octomap.FIELDS

    def to_compile(self) -> Iterable[Job]:
        """Return the readers of the message and of the octree."""
        return [*super().to_compile(), to_compile()]

    def apply(self, message: Any, now: int) -> Applying:
        """Replace all boxes."""
        self.is_whole = True
        columns = self._columns(message)
        shapes = yield from octomap.boxes(
            octomap.Octree.read(columns),
            occupied_at=self.settings.options['occupied_at'],
            most=self.scene.max_obstacles,
        )
        (frame_id,) = columns.texts('header.frame_id')
        stamp = columns.stamps('header.stamp').item()
        return (yield from self._replace_all(shapes, frame_id, stamp, now))
