# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the rest of the package uses of moving boxes: imported with the first velocity."""

from ..simd.moving_sides import FRONTS
from .bounds import LONGEST, OUTSIDE, begin_asking, covers, moments_of, no_motion, set_fronts
from .entries import cast_one, enter_bounds, locate, path_at, sort_hits_at
from .exact_contact import (
    box_of,
    course_of,
    elapsed,
    face_met,
    fetch_box,
    is_before,
    may_meet,
    meet_box,
    moves,
)
from .nearest import Bounded, at_least, near_at, nearest_bounds
from .overlap import overlap_at, overlap_swept_at
from .state import span_of, times_of
from .sweep import (
    AHEAD,
    AS_ARRAYS,
    FEW,
    MOST_WAITING,
    NO_FEW,
    NO_RAYS,
    PLACES,
    UNSUITED,
    WAITING,
    WAITING_SHARE,
    Sweep,
    TimedRays,
    cast_few,
    cast_rows,
    no_sweep,
    split_times,
    start_in_drift_frame,
)
