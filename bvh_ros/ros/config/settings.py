# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the node was told, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

SHARED = 1024  # rows: with fewer, threads take longer to begin than they save


@dataclass(frozen=True)
class SourceSettings:
    """What one source was told."""

    name: str
    type: str
    topic: str
    prefix: str
    required: bool
    max_age: float  # s, 0 = unlimited
    options: Mapping[str, Any]  # those of its type

    @property
    def predicts(self) -> bool:
        """Whether it tells velocities."""
        return bool(self.options.get('predict', 'none') != 'none')


@dataclass(frozen=True)
class ViewSettings:
    """What one view was told."""

    name: str
    include: tuple[str, ...]
    exclude: tuple[str, ...]
    skip_inside: bool


@dataclass(frozen=True)
class TransformSettings:
    """Where one frame lies in another, for ever."""

    frame_id: str
    parent: str
    xyz: tuple[float, ...]  # m
    xyzw: tuple[float, ...]  # of any length but zero


@dataclass(frozen=True)
class Settings:
    """What the node was told."""

    frame_id: str
    planar: bool
    margin: float  # m
    max_obstacles: int
    max_hits: int
    region: tuple[tuple[float, ...], tuple[float, ...]] | None  # lo, hi, m; None is everywhere
    nearest_limit: int
    max_prediction: float  # s
    uncertainty: float  # m/s
    history: float  # s
    batch: bool
    footprint: tuple[float, ...]  # m: edge lengths of a box, a ball's radius, or none
    threads: int  # that share the rows of a batch
    use_tf: bool
    sources: tuple[SourceSettings, ...]
    views: tuple[ViewSettings, ...]
    transforms: tuple[TransformSettings, ...]
    groups: Mapping[str, Mapping[str, Any]]  # options of parts: group -> option -> value

    @property
    def predicts(self) -> bool:
        """Whether a source does."""
        return any(source.predicts for source in self.sources)

    def threads_for(self, rows: int) -> int:
        """How many threads share so many rows."""
        return self.threads if rows >= SHARED else 1
