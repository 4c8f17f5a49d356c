# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a box meets on its way: the traversal of rays, with a box that moves instead of a point."""

import numpy as np

from ..compiler import lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import EXACT_RAYS, NONE, RAYS, leaf_box
from ..store.turns import ANY_VERSION, NOT_FINITE, REFUSED, begin_query, end_query
from .ray_hits import locate
from .raycasting import CLOSEST, Asked, Found, raycast
from .slab import EXACT, INSIDE, ORIGIN, RAY_ROWS, set_swept_box


@lean_kernel
def boxcast(tree, lo, hi, translation, mask, place):
    """First box met: (handle, t); point and normal go to `place`. Instead of a handle NONE if
    there is none, NOT_FINITE if the input is not, or lo exceeds hi, REFUSED if the tree is being
    changed.
    """
    nodes, tight, state = tree.nodes, tree.tight, tree.state
    for axis in range(lo.shape[0]):
        finite = np.isfinite(lo[axis]) and np.isfinite(hi[axis])
        if not (finite and np.isfinite(translation[axis]) and lo[axis] <= hi[axis]):
            return NOT_FINITE, np.inf
    if not begin_query(state, ANY_VERSION):
        return REFUSED, np.inf
    ray = stack_array((RAY_ROWS, 3), np.float64)
    set_swept_box(ray, lo, hi, translation)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    ts = stack_array(1, np.float64)
    found = Found(slots, ts, axes)
    hits = raycast(tree, ray, Asked(1.0, mask, False, CLOSEST), found, 0)
    state[RAYS] += 1
    state[EXACT_RAYS] += np.int64(ray[EXACT, 0])
    if hits == 0:
        end_query(state)
        return NONE, np.inf
    # Of all points that touch, the closest to the swept box's centre: where that would be, brought
    # into the box that is met. On the axes along which it does not move, now; `locate` does the
    # others.
    met_lo, met_hi = leaf_box(nodes, tight, 2 * slots[0])
    centre = ray[ORIGIN]
    for axis in range(lo.shape[0]):
        centre[axis] = lo[axis] * 0.5 + hi[axis] * 0.5
        if axes[0] == INSIDE or translation[axis] == 0.0:
            centre[axis] = min(max(centre[axis], met_lo[axis]), met_hi[axis])
    locate(nodes, tight, centre, translation, slots[0], ts[0], axes[0], place)
    handle = tree.handles[slots[0]]
    end_query(state)
    return handle, ts[0]


_POINT = np.empty(0)
entry = entry_points(boxcast, *(_POINT,) * 3, np.uint32(0), np.empty((0, 3)))
