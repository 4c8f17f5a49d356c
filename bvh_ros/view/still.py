# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A picture of a recording, or of the warehouse, without browser and node."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bvh_ros import replay, scenarios
from bvh_ros.extent import Extent
from bvh_ros.questions import Question
from bvh_ros.scene import NodeScene
from bvh_ros.view.recorded import Tracks, open_recording
from bvh_ros.view.worlds import Recording


class Answering:
    """Answers a demo's questions from a scene, as a client would, and keeps rays and hits."""

    def __init__(self, scene: NodeScene) -> None:
        self._scene = scene
        self.rays: list[tuple[Sequence[float], Sequence[float]]] = []
        self.hits: list[Sequence[float]] = []

    def raycast(self, start: Sequence[float], end: Sequence[float], radius: float = 0.0) -> Any:
        """Ask as `BvhClient.raycast` does."""
        hit = self._scene.raycast(start, end, radius)
        if hit is not None and radius:  # the ball's middle goes so far
            self.hits.append(hit.point.tolist())
            end = (start + hit.t * np.subtract(end, start)).tolist()
        self.rays.append((start, end))
        return hit

    def overlap(
        self, lo: Sequence[float], hi: Sequence[float], *, tolerance: float = 0.0
    ) -> list[Any]:
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
    if path is None:
        recording: Recording = Tracks('warehouse', list(scenarios.warehouse()))
    else:
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
