# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tree for the other rooms of the package: its callers need none of this."""

from typing import TYPE_CHECKING, Optional

from .dynamic_bvh import DynamicBVH

if TYPE_CHECKING:
    from .motion.queries import MotionQueries


class OpenTree(DynamicBVH):
    """A tree whose arrays, slots and steps other rooms use."""

    arrays = DynamicBVH._arrays
    slots = DynamicBVH._slots
    view = DynamicBVH._view
    latest = DynamicBVH._latest
    check_unchanged = DynamicBVH._check_unchanged
    snapshot_for = DynamicBVH._snapshot_for
    ready_snapshot = DynamicBVH._ready_snapshot
    few_rays = DynamicBVH._few_rays
    first_hits = DynamicBVH._first_hits
    move_sound = DynamicBVH._move_sound
    count_nanoseconds = DynamicBVH._count_nanoseconds
    room_for = DynamicBVH._room_for
    move_into = DynamicBVH._move_into
    room_for_copy = DynamicBVH._room_for_copy
    copied = DynamicBVH._copied
    validate_copy = DynamicBVH._validate_copy
    figures = DynamicBVH._figures

    @property
    def motion(self) -> Optional['MotionQueries']:
        """What is asked of moving boxes; None where no box ever had a velocity."""
        return self._motion
