# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Track files and ROS 2 bags, read into a scene."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from bvh_ros import bags, replay, scenarios
from bvh_ros.ros.server import BvhServer
from bvh_ros.scene import NodeScene
from bvh_ros.view.worlds import Moment, Recording


class Tracks(Recording):
    """A track file, or any other list of frames.

    Parameters
    ----------
    frames : sequence of scenarios.Frame
        Each tells all there is.
    """

    def __init__(self, title: str, frames: Sequence[scenarios.Frame]) -> None:
        super().__init__(title, NodeScene(), frames[-1].t - frames[0].t)
        self._frames = frames
        self.restart()

    @property
    def frame(self) -> scenarios.Frame:
        """The one that is shown."""
        times = [frame.t for frame in self._frames]
        return self._frames[bisect_right(times, times[0] + self.t) - 1]

    def clear(self) -> None:
        """Forget the frame; an obstacle that returns keeps its handle."""

    def moments(self) -> Iterator[Moment]:
        """Yield the frames."""
        begin = self._frames[0].t
        for frame in self._frames:
            yield frame.t - begin, partial(scenarios.show, frame, self.scene)


class Bag(Recording):
    """The obstacles of a ROS 2 bag, read by the node's own sources; nothing is published."""

    frame_id = ''

    def __init__(self, recording: bags.Recording) -> None:
        self._recording = recording
        parameters = {'use_tf': False, **replay.parameters(recording, '')}
        self._node = Node('bvh_view_recording', parameter_overrides=as_parameters(parameters))
        self._server = BvhServer(self._node)
        world = self._server.world
        super().__init__(recording.path.name, world.scene, recording.seconds)
        self.frame_id = world.frames.frame_id
        self._sources = {source.settings.topic: source for source in world.sources}
        self.restart()

    def clear(self) -> None:
        """Begin with an empty world."""
        self.scene.clear()
        for source in self._sources.values():
            source.forget()

    def moments(self) -> Iterator[Moment]:
        """Yield the messages."""
        for t, track, serialised in self._recording.messages():
            yield t, partial(self._sources[track.topic].apply_now, serialised)

    def figures(self) -> dict[str, str]:
        """Tell what was refused, too."""
        refused = sum(source.refused.count for source in self._sources.values())
        return {**super().figures(), **({'refused': str(refused)} if refused else {})}

    def close(self) -> None:
        """Destroy the node."""
        self._server.destroy()
        self._node.destroy_node()


def open_recording(path: Path, topic: str = '') -> Recording:
    """Open a track file (.csv) or a bag.

    Raises
    ------
    RuntimeError
        If it cannot be read.
    """
    if path.suffix == '.csv':
        return Tracks(path.name, list(scenarios.tracks(path)))
    if not rclpy.ok():
        rclpy.init(args=[])
    return Bag(bags.find(path, topic))


def as_parameters(values: object, prefix: str = '') -> list[Parameter]:
    """A node's parameters from mappings of mappings."""
    if not isinstance(values, dict):
        return [Parameter(prefix, value=values)]
    dot = f'{prefix}.' if prefix else ''
    return [one for key, value in values.items() for one in as_parameters(value, f'{dot}{key}')]
