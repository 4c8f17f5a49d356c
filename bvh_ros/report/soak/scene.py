# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A thousand boxes that move, turn, come and go, and who meets what, by brute force.

Everything follows from the number of the frame, so that two processes know the same world.
"""

from typing import NamedTuple

import numpy as np

from ..scenes import Floats

BOXES = 1000
SIDE = 40.0  # m, of the cube that holds the centres
ABSENT, CYCLE = 20, 200  # frames: each box is away for 20 of 200
UNDECIDED = 1e-7  # m: closer to touching than this, rounding may decide either way

_RNG = np.random.default_rng(5)
_BASE = _RNG.uniform(0.0, SIDE, (BOXES, 3))
_REACH = _RNG.uniform(-4.0, 4.0, (BOXES, 3))  # m, of the swing
_PACE = _RNG.uniform(0.005, 0.03, (BOXES, 1))  # radians a frame
_TURN = np.where(np.arange(BOXES) % 2 == 0, 0.0, _RNG.uniform(-0.05, 0.05, BOXES))
HALF = _RNG.uniform(0.2, 1.2, (BOXES, 3))
"""Half edge lengths, m."""


class Scene(NamedTuple):
    """The boxes of one frame; those that are away have a place, too."""

    present: np.ndarray  # (n,) bool
    centre: Floats  # (n, 3) m
    yaw: Floats  # (n,) radians; every second box is never turned

    def local(self, points: Floats) -> Floats:
        """Points or directions (n, 3), one a box, in the boxes' own axes."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        x, y, z = points.T
        return np.column_stack((c * x + s * y, c * y - s * x, z))

    def entries(self, start: Floats, way: Floats, grown: float) -> Floats:
        """Where on start + t * way, 0 to 1, each box is entered; inf where it is not met."""
        half = HALF + grown
        origin, along = self.local(start - self.centre), self.local(np.tile(way, (BOXES, 1)))
        with np.errstate(divide='ignore'):
            one, other = (-half - origin) / along, (half - origin) / along
        enter = np.maximum(np.minimum(one, other).max(axis=1), 0.0)
        leave = np.minimum(np.maximum(one, other).min(axis=1), 1.0)
        return np.where(self.present & (enter <= leave), enter, np.inf)

    def closest(self, point: Floats) -> Floats:
        """The point (n, 3) of each box that is closest to a point (3,)."""
        x, y, z = np.clip(self.local(point - self.centre), -HALF, HALF).T
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return self.centre + np.column_stack((c * x - s * y, s * x + c * y, z))

    def distances(self, point: Floats) -> Floats:
        """Distance of each box from a point: 0 inside, inf for those that are away."""
        distance = np.linalg.norm(self.closest(point) - point, axis=1)
        return np.where(self.present, distance, np.inf)

    def gaps(self, centre: Floats, half: Floats) -> Floats:
        """How far an aligned box and each box are apart along the axis that parts them most.

        Negative where they overlap. The boxes are upright prisms, so x, y, z and the boxes' own
        two horizontal axes are enough (separating axes).
        """
        offset = centre - self.centre
        c, s = np.abs(np.cos(self.yaw)), np.abs(np.sin(self.yaw))
        own = np.abs(self.local(offset))
        along = np.abs(offset)
        gaps = [
            along[:, 0] - half[0] - c * HALF[:, 0] - s * HALF[:, 1],
            along[:, 1] - half[1] - s * HALF[:, 0] - c * HALF[:, 1],
            along[:, 2] - half[2] - HALF[:, 2],
            own[:, 0] - HALF[:, 0] - c * half[0] - s * half[1],
            own[:, 1] - HALF[:, 1] - s * half[0] - c * half[1],
        ]
        return np.where(self.present, np.max(gaps, axis=0), np.inf)


def scene_at(frame: int) -> Scene:
    """The world of one frame; there is nothing before frame 0."""
    phase = (frame + 13 * np.arange(BOXES)) % CYCLE
    return Scene(
        (phase >= ABSENT) & (frame >= 0), _BASE + _REACH * np.sin(_PACE * frame), _TURN * frame
    )
