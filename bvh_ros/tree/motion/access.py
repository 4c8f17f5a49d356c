# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the rest of the package uses of moving boxes: imported with the first velocity."""

from ..simd.moving_sides import FRONTS
from .asked_then import AS_ARRAYS, NO_RAYS, RaysThen, told_once
from .bounds import LONGEST, OUTSIDE, begin_asking, covers, moments_of, set_fronts
from .casting import Casts, cast_one, descend, locate, no_motion
from .few_casting import FEW, NO_FEW, cast_few
from .meeting import box_of, course_of, fetch_box, moves
from .nearest import Near, at_least, nearest_bounds
from .nearest_packets import Bounded
from .overlapping import overlap_then
from .rounded import may_meet
from .spans import span_of, times_of
from .starting import start_seen
from .stopping import face_met, is_before, meet_box
from .sums import elapsed
from .sweeping import Sweep, no_sweep
from .wide_casting import (
    AHEAD,
    MOST_WAITING,
    PLACES,
    UNSUITED,
    WAITING,
    WAITING_SHARE,
    cast_rows,
    not_yet,
)
