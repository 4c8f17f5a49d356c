# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The poses of a nav_msgs/Path, and a footprint at each of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.cdr import path as decoder
from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.conversions.query_clouds import Faults, Floats, take
from bvh_ros.scene import Shapes, unchecked_shapes


class Poses(NamedTuple):
    """Poses of one path; nothing is known of their values yet."""

    places: Floats  # (n, 3) m
    turns: Floats  # (n, 4) quaternions
    elsewhere: NDArray[np.bool_]  # (n,) whether the pose names another frame than the path
    stamps: NDArray[np.int64]  # (n,) ns, the time of the pose; 0: now
    before: Any = None  # Poses: those before, that itself of the first; None: not needed

    def faults(self) -> Faults:
        """Return why rows (n,) cannot be answered."""
        near = np.isfinite(self.places) & (np.abs(self.places) < 1e300)
        faults = {
            'its position is not finite, or beyond 1e300': ~near.all(axis=1),
            'its orientation is not finite': ~np.isfinite(self.turns).all(axis=1),
            rotations.OFF: rotations.are_off(self.turns),
            'its frame is not that of the path': self.elsewhere,
        }
        if self.before is not None:
            bad = np.logical_or.reduce([*self.before.faults().values()])
            faults['the pose before it cannot be used'] = bad
        return faults


class PathPoses:
    """The poses of a serialised path, to be read in parts as those of a `QueryCloud`; ValueError
    if it is none. `between`: with the poses before.
    """

    real, height, has_radii = np.dtype(np.float64), 1, False

    def __init__(self, message: bytes, between: bool = False) -> None:
        path = decoder.read(message)
        self.frame_id, self.stamp = path.frame_id, path.stamp
        self._poses = Poses(path.positions, path.orientations, path.elsewhere, path.stamps)
        self.width = len(path.stamps)
        if between:
            rows = np.maximum(np.arange(self.width) - 1, 0)
            self._poses = self._poses._replace(before=take(self._poses, rows))

    def __len__(self) -> int:
        return self.width

    @property
    def has_times(self) -> bool:
        """Whether some poses are about other times than now."""
        return bool(self._poses.stamps.any())

    def moments(self) -> Poses:
        """All poses, which have their times."""
        return self._poses

    def rows(self, begin: int, end: int) -> Poses:
        """Return some of the poses."""
        return take(self._poses, slice(begin, end))


def shapes(poses: Poses, part: Shapes) -> Shapes:
    """Return a part of the footprint at each pose."""
    count = len(poses.places)
    kinds, sizes = part.kind.repeat(count), part.size.repeat(count, axis=0)
    meshes = None if part.mesh is None else part.mesh.repeat(count)
    return unchecked_shapes(kinds, poses.places, poses.turns, sizes, meshes)
