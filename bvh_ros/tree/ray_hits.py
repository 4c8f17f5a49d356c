# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From slots and axes to what the caller reads: handles, points and normals."""

import numpy as np

from .compiling import lean_kernel
from .machine import stack_array
from .nodes import EXACT_RAYS, NONE, RAYS, ROOT, leaf_box
from .raycasting import raycast
from .slab import EXACT, INSIDE, aim


@lean_kernel
def locate(nodes, tight, origin, direction, slot, t, axis, place):
    """Write a hit's point and normal as the first two rows of `place`.

    The point is in the closed box, and on the face entered; it is the origin where the ray starts
    inside.
    """
    lo, hi = leaf_box(nodes, tight, 2 * slot)
    for k in range(origin.shape[0]):
        place[0, k] = origin[k]
        place[1, k] = 0.0
        if axis == INSIDE:
            continue
        if k == axis:
            place[0, k] = lo[k] if direction[k] > 0.0 else hi[k]
            place[1, k] = -1.0 if direction[k] > 0.0 else 1.0
        elif direction[k] != 0.0:
            place[0, k] = min(max(origin[k] + t * direction[k], lo[k]), hi[k])


NOT_FINITE = -2


@lean_kernel
def raycast_one(
    nodes, tight, handles, state, origin, direction, t_max, mask, skip_inside, mode, place
):
    """One ray in one call: (slot, t), and its point and normal in `place`, whose other rows are
    scratch; slot NONE if there is none, NOT_FINITE if the input is not.
    """
    for k in range(origin.shape[0]):
        if not (np.isfinite(origin[k]) and np.isfinite(direction[k])):
            return NOT_FINITE, np.inf
    aim(place[2:], origin, direction)
    slots, ts, axes = (
        stack_array(1, np.int64),
        stack_array(1, np.float64),
        stack_array(1, np.int64),
    )
    found = raycast(
        nodes,
        tight,
        handles,
        state[ROOT],
        place[2:],
        t_max,
        mask,
        skip_inside,
        mode,
        slots,
        ts,
        axes,
        0,
    )
    state[RAYS] += 1
    state[EXACT_RAYS] += np.int64(place[2 + EXACT, 0])
    if found == 0:
        return NONE, np.inf
    locate(nodes, tight, origin, direction, slots[0], ts[0], axes[0], place)
    return slots[0], ts[0]


@lean_kernel
def describe(handles, slots, axes, directions, normals):
    """Turn slots into handles in place, and write the normals of the faces entered."""
    for i in range(slots.shape[0]):
        for k in range(directions.shape[1]):
            normals[i, k] = 0.0
        if slots[i] >= 0:
            slots[i] = handles[slots[i]]
            if axes[i] != INSIDE:
                normals[i, axes[i]] = -1.0 if directions[i, axes[i]] > 0.0 else 1.0
