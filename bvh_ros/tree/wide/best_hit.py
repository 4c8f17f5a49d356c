# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a box is hit before the best so far: in float64 where rounding cannot matter, else as
`slab.intersect_exact` decides.

The order in which boxes are looked at has no part in the answer.
"""

import numpy as np

from ..compiler import inlined, lean_kernel
from ..nodes import NONE, leaf_box
from ..rays.raycasting import is_before
from ..rays.slab import (
    DIRECTION,
    INSIDE,
    INVERSE,
    ORIGIN,
    PAD,
    TINY,
    intersect_exact,
    near_plane,
    rounded_slabs,
)

MISSES, MEETS, ASK = range(3)


@inlined
def quick_decision(lo, hi, ray, best_t):
    """Decide where rounding cannot matter: (verdict, t, axis).

    MISSES: surely not met, or surely after best_t. MEETS: surely met, and before best_t. ASK:
    `intersect_exact` must tell. t has an error of three roundings, and `axis` is one entered then:
    of two that are entered at almost the same time it may be the other, which `exact_entry_axis`
    finds out where it matters. Distances neither overflow nor have an infinite inverse here.
    """
    entry, leave, entered = rounded_slabs(lo, hi, ray, best_t)
    if entry > leave * PAD + TINY:
        return MISSES, entry, entered
    if entered != INSIDE and entry * PAD + TINY < leave:
        return MEETS, entry, entered
    return ASK, entry, entered


@lean_kernel
def exact_entry_axis(lo, hi, ray, t_max, t, entered):
    """The axis on which a ray that meets the box enters it last, exactly; likely `entered`."""
    for axis in range(lo.shape[0]):
        if axis != entered and ray[DIRECTION, axis] != 0.0:
            near = (near_plane(lo, hi, ray, axis) - ray[ORIGIN, axis]) * ray[INVERSE, axis]
            if near * PAD + TINY >= t:
                return np.int64(intersect_exact(lo, hi, ray, t_max)[2])
    return np.int64(entered)


@inlined
def is_better(tree, ray, t_max, skip_inside, slot, best):
    """Whether a leaf is hit before the best hit, (slot, t, axis): (better, about t, axis)."""
    best_slot, best_t, best_axis = best
    lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
    verdict, t, axis = quick_decision(lo, hi, ray, best_t)
    if verdict != ASK:
        return verdict == MEETS, t, axis
    met, t, axis = intersect_exact(lo, hi, ray, t_max)
    if not met or (skip_inside and axis == INSIDE):
        return False, t, axis
    if best_slot == NONE:
        return True, t, axis
    best_lo, best_hi = leaf_box(tree.nodes, tree.tight, 2 * best_slot)
    best_axis = exact_entry_axis(best_lo, best_hi, ray, t_max, best_t, best_axis)
    better = is_before(tree, ray, (slot, t, axis), (best_slot, best_t, best_axis))
    return better, t, axis
