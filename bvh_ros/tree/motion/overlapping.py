# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a box touches at some time: what it meets where it goes nowhere."""

import numpy as np

from ..entries import entry_points
from ..jit.compiling import lean_kernel
from ..jit.intrinsics import stack_array
from ..rays.raycasting import EVERY, Asked, Found
from ..rays.slab import RAY_FLOATS, RAY_ROWS, set_swept_box
from ..store.turns import NOT_FINITE, REFUSED, begin_query, end_query
from .bounds import covers
from .casting import OUTSIDE, cast, is_sound, no_motion
from .meeting import Course


@lean_kernel
def overlap_one(tree, moving, box, mask, at, found):
    """Handles, in no order, of what the box = (lo, hi, nowhere) touches, to found.slots: how many,
    of which as many are written as there is room for; NOT_FINITE if it is no box, OUTSIDE, or
    REFUSED. The rest of `found` is scratch.
    """
    lo, hi, nowhere = box
    if not is_sound(lo, hi, nowhere, (at, 0.0)):
        return np.int64(NOT_FINITE)
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    if covers(moving, at, 0.0, 0.0) == 0:
        end_query(tree.state)
        return np.int64(OUTSIDE)
    course = Course(stack_array(RAY_FLOATS, np.float64).reshape(RAY_ROWS, 3), at, 0.0)
    set_swept_box(course.ray, lo, hi, nowhere)
    count = np.int64(cast(tree, moving, course, Asked(0.0, mask, False, EVERY), found, 0))
    for i in range(min(count, found.slots.shape[0])):
        found.slots[i] = tree.handles[found.slots[i]]
    end_query(tree.state)
    return count


_ROW, _IDS = np.empty(0), np.empty(0, np.int64)
one_entry = entry_points(
    *(overlap_one, no_motion, (_ROW,) * 3, np.uint32(0), 0.0, Found(_IDS, _ROW, _IDS))
)
