# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings as worlds that can be shown, and a picture of one without browser and node."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from bvh_ros import bags, replay, scenarios
from bvh_ros.replay import Extent
from bvh_ros.ros.access import BvhServer
from bvh_ros.scenarios import Question
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


def open_recording(path: Path | None, topic: str = '') -> Recording:
    """Open a track file (.csv) or a bag; None is the warehouse.

    Raises
    ------
    RuntimeError
        If it cannot be read.
    """
    if path is None:
        return Tracks('warehouse', list(scenarios.warehouse()))
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


# ---- A picture of a recording, or of the warehouse, without browser and node

Point = Sequence[float]  # m


class Answering:
    """Answers a demo's questions from a scene, as a client would, and keeps rays and hits."""

    def __init__(self, scene: NodeScene) -> None:
        self._scene = scene
        self.rays: list[tuple[Point, Point]] = []
        self.hits: list[Point] = []

    def raycast(self, start: Point, end: Point, radius: float = 0.0) -> Any:
        """Ask as `BvhClient.raycast` does."""
        hit = self._scene.raycast(start, end, radius)
        if hit is not None and radius:  # the ball's middle goes so far
            self.hits.append(hit.point.tolist())
            end = (start + hit.t * np.subtract(end, start)).tolist()
        self.rays.append((start, end))
        return hit

    def overlap(self, lo: Point, hi: Point, *, tolerance: float = 0.0) -> list[Any]:
        """Ask as `BvhClient.overlap` does."""
        return list(self._scene.overlap(lo, hi, tolerance=tolerance))


def draw(file: Path, path: Path | None, topic: str = '') -> None:
    """Draw the middle of a recording, or of the warehouse, into a file.

    Raises
    ------
    RuntimeError
        If the recording cannot be read, or matplotlib is not installed; ValueError if it knows no
        such kind of file.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise RuntimeError("pictures need matplotlib: pip install 'bvh_ros[report]'") from error
    matplotlib.use('agg')
    recording = open_recording(path, topic)
    try:
        recording.seek(0.5 * recording.seconds)
        answers = Answering(recording.scene)
        for question in _questions(recording):
            question.ask(answers)  # type: ignore[arg-type]
        ndim = 2 if recording.scene.planar else 3
        rays = np.array(answers.rays).reshape(-1, 2, 3)[..., :ndim]
        hits = np.array(answers.hits).reshape(-1, 3)[:, :ndim]
        axes = recording.scene.plot(rays=rays, hits=hits)
        axes.set_title(f'{recording.title}: {len(recording.scene)} obstacles, {recording.t:.1f} s')
        axes.figure.savefig(file, dpi=150)
    finally:
        recording.close()


def _questions(recording: Recording) -> list[Question]:
    if isinstance(recording, Tracks):
        return recording.frame.questions
    bounds = recording.scene.bounds
    if bounds is None:
        return []
    lo, hi = (tuple(np.append(corner, 0.0)[:3].tolist()) for corner in bounds)
    return replay.questions(Extent(len(recording.scene), lo, hi))
