# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The poses of a nav_msgs/Path, and a footprint at each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.cdr import path as decoder
from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.conversions.ray_clouds import Floats, first_fault
from bvh_ros.ros.world.frames import Transform
from bvh_ros.scene import ShapeKind, Shapes


class Poses(NamedTuple):
    """Poses of one path; nothing is known of their values yet."""

    frame_id: str
    stamp: int  # ns
    places: Floats  # (n, 3) m
    turns: Floats  # (n, 4) quaternions
    elsewhere: NDArray[np.bool_]  # (n,) whether the pose names another frame than the path
    stamps: NDArray[np.int64]  # (n,) ns, when somebody is there; 0: nobody says

    def rows(self, rows: Any) -> Poses:
        """Return some of the rows."""
        columns: Any = (column[rows] for column in self[2:])
        return Poses(self.frame_id, self.stamp, *columns)

    def moved(self, transform: Transform) -> Poses:
        """Return the same in the node's frame."""
        with np.errstate(over='ignore', invalid='ignore'):  # what leaves the doubles is bad
            return self._replace(
                places=transform.points(self.places),
                turns=transform.orientations(rotations.normalised(self.turns)),
            )

    def fault(self, number: int) -> tuple[NDArray[np.bool_], str]:
        """Return which rows (n,) cannot be answered, and of the first of them why."""
        far = np.isfinite(self.places) & (np.abs(self.places) < 1e300)
        faults: dict[str, NDArray[np.bool_]] = {
            'its position is not finite, or beyond 1e300': np.logical_not(far.all(axis=1)),
            'its orientation is not finite': np.logical_not(np.isfinite(self.turns).all(axis=1)),
            'its frame is not that of the path': self.elsewhere,
        }
        return first_fault(faults, number)


def read(message: bytes) -> Poses:
    """Read a serialised path; ValueError if it is none."""
    path = decoder.read(message)
    return Poses(
        path.frame_id, path.stamp, path.positions, path.orientations, path.elsewhere, path.stamps
    )


def shapes(poses: Poses, footprint: Sequence[float]) -> Shapes:
    """Return the footprint, a box or a ball, at each pose."""
    size = footprint if len(footprint) == 3 else (2.0 * footprint[0],) * 3
    boxes = Shapes.boxes(poses.places, size, poses.turns)
    if len(footprint) == 3:
        return boxes
    return boxes._replace(kind=np.full(len(poses.places), ShapeKind.SPHERE, np.uint8))
