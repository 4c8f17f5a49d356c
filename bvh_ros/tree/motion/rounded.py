# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Decisions of a ray and a box that moves where rounding cannot matter, by `leaves.leaf_dtype`;
`stopping` decides the others.
"""

import numpy as np

from ..compiler import inlined, lean_kernel, stack_array, trailing_zeros
from ..rays.slab import INSIDE, PAD, TINY
from ..simd.moving_leaf import moving_slabs
from ..wide.best_hit import ASK, MEETS, MISSES
from .meeting import box_of
from .stopping import STOPPED

# Slower than this boxes and rays have no common ways in numbers; and how far t of a hit may be
# from that of the same box's record.
SLOWEST, NEAR = 1e-290, 2.0**-16
FASTEST, LEAST_32 = 1e30, np.float32(1e-37)
LOST = 2.0**-44  # of lengths: more than a ray and a box that are written here lose by rounding


@inlined
def quick_decision(leaves, slot, origin, direction, since, pace, limit):
    """Decide where rounding cannot matter: (verdict, t, face), as `wide.best_hit.quick_decision`.
    `since` the start of the span.

    MEETS: surely met, and before `limit`, at `face`; t is not before that, nor later by more than
    NEAR of it.
    """
    missed, doubt, entry, leave, entered_by, others_by, surely, lanes, negative, within = (
        moving_slabs(leaves, slot, origin, direction, since, pace, 0.0, SLOWEST)
    )
    if within and limit > 0.0:
        return MEETS, 0.0, INSIDE
    if missed or entry > min(leave, limit) * PAD + TINY:
        return MISSES, limit, INSIDE
    surely = min(surely, limit * (1.0 - NEAR))
    clear = others_by * PAD < entry and entered_by * PAD < surely and not doubt
    if clear and lanes & (lanes - 1) == 0 and entered_by < entry * (1.0 + 0.5 * NEAR):
        axis = np.int64(trailing_zeros(np.uint32(lanes)))
        return MEETS, entered_by, 2 * axis + (negative >> axis & 1)
    return ASK, limit, INSIDE


@inlined
def may_meet(leaves, slot, origin, direction, since, pace, limit, more):
    """Whether a course may meet a leaf before `limit` whose box is larger by `more` on all sides;
    as `quick_decision`, where it does not say MISSES.
    """
    missed, _, entry, leave, _, _, _, _, _, _ = moving_slabs(
        *(leaves, slot, origin, direction, since, pace, more, SLOWEST)
    )
    return not (missed | (entry > min(leave, limit) * PAD + TINY))


@lean_kernel
def quick_decision_of_both(tree, moving, leaves, slot, way, limit):
    """`quick_decision` of a box that goes for a part of the way = (origin, direction, at, pace),
    and then stands: by a record of each part. `leaves` tells the type of these.
    """
    (origin, direction, at, pace), box = way, box_of(tree, moving, slot)
    part, end, until = stack_array(1, leaves), box[3] + moving.left, np.inf
    if end < at:
        until = -1.0
    elif pace > 0.0:
        until = (end - at) / pace
    if until >= 0.0:
        first = min(limit, until)
        span = at, (end if pace > 0.0 else at)
        _write_part(part[0], box, box[2], span, origin)
        verdict, t, face = quick_decision(part, 0, origin, direction, 0.0, pace, first)
        if verdict == MEETS and t < until * (1.0 - 2.0 * NEAR):
            return verdict, t, np.int64(face)
        if verdict != MISSES or until > limit * (1.0 + NEAR):
            return (ASK if verdict == MEETS else verdict), limit, np.int64(INSIDE)
    still = stack_array(3, np.float64)
    still[:] = 0.0
    _write_part(part[0], box, still, (end, end), origin)
    verdict, t, face = quick_decision(part, 0, origin, direction, 0.0, 0.0, limit)
    if verdict == MEETS and until >= 0.0:
        if face == INSIDE or t <= until * (1.0 + 2.0 * NEAR):
            return ASK, limit, np.int64(INSIDE)
        face += STOPPED
    return verdict, t, np.int64(face)


@inlined
def _write_part(leaf, box, velocity, span, origin):
    """Write the record of a box that goes at a velocity from the first time of a span to its last,
    for a ray from an origin. Where they meet on an axis, the ray has gone no further than the sum
    of all that `more` is a share of.
    """
    (lo, hi, told, reference), (start, stop) = box, span
    leaf.loose = np.float32(0.0)
    for axis in range(lo.shape[0]):
        speed = np.float32(velocity[axis] if abs(velocity[axis]) < FASTEST else 0.0)
        gone, rest = told[axis] * (start - reference), velocity[axis] - np.float64(speed)
        rest *= stop - start
        more = abs(lo[axis]) + abs(hi[axis]) + abs(origin[axis])
        more += abs(told[axis]) * (abs(start) + abs(stop) + abs(reference))
        more = more * LOST + SLOWEST
        leaf.velocity[axis] = speed
        leaf.lo[axis] = lo[axis] + gone + min(rest, 0.0) - more
        leaf.hi[axis] = hi[axis] + gone + max(rest, 0.0) + more
        # By half more, as it is a float32.
        loose = np.float32((abs(rest) + 3.0 * more) * 1.5) + LEAST_32
        leaf.loose = max(leaf.loose, loose)
