# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays in, and out what the caller reads: handles, points and normals."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ..jit.compiling import entry_point, inlined, lean_kernel
from ..jit.intrinsics import stack_array
from ..nodes import EXACT_RAYS, NONE, RAYS, ROOT, box_dtype, leaf_box, node_dtype
from ..store.turns import ANY_VERSION, begin_query, end_query
from .raycasting import ANY, CLOSEST, raycast
from .slab import DIRECTION, EXACT, INSIDE, set_ray


@lean_kernel
def locate(nodes, tight, origin, direction, slot, t, axis, place):
    """Write a hit's point and normal as the first two rows of `place`.

    The point is in the closed box, and on the face entered; it is the origin where the ray starts
    inside. Coordinates beyond the tree's axes are neither read nor written.
    """
    lo, hi = leaf_box(nodes, tight, 2 * slot)
    for k in range(lo.shape[0]):
        place[0, k] = origin[k]
        place[1, k] = 0.0
        if axis == INSIDE:
            continue
        if k == axis:
            place[0, k] = lo[k] if direction[k] > 0.0 else hi[k]
            place[1, k] = -1.0 if direction[k] > 0.0 else 1.0
        elif direction[k] != 0.0:
            place[0, k] = min(max(origin[k] + t * direction[k], lo[k]), hi[k])


NOT_FINITE, REFUSED = -2, -3


@lean_kernel
def raycast_one(
    nodes, tight, handles, state, origin, direction, t_max, mask, skip_inside, mode, place
):
    """One ray in one call: (handle, t), and its point and normal in `place`, whose other rows are
    scratch; instead of a handle NONE if there is none, NOT_FINITE if the input is not, REFUSED if
    the tree is being changed.
    """
    for k in range(origin.shape[0]):
        if not (np.isfinite(origin[k]) and np.isfinite(direction[k])):
            return NOT_FINITE, np.inf
    if not begin_query(state, ANY_VERSION):
        return REFUSED, np.inf
    set_ray(place[2:], origin, direction)
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
    handle = np.int64(NONE)
    if found > 0:
        handle = handles[slots[0]]
        locate(nodes, tight, origin, direction, slots[0], ts[0], axes[0], place)
    end_query(state)
    return handle, (ts[0] if found > 0 else np.inf)


@functools.cache
def raycast_entry(ndim: int) -> Callable[..., Any]:
    """`raycast_one` for a tree of so many dimensions, without numba's look at the arguments: they
    must be exactly of these types, the arrays C-ordered.
    """
    numbers, doubles = np.empty(0, np.int64), np.empty(0)
    tree = np.empty(0, node_dtype(ndim)), np.empty(0, box_dtype(ndim)), numbers, numbers
    place = np.empty((0, ndim))
    return entry_point(
        raycast_one, *tree, doubles, doubles, 0.0, np.uint32(0), False, CLOSEST, place
    )


@inlined
def of_row(values, i):
    """The value of row i; where there is but one, it is for all."""
    return values[i if values.shape[0] > 1 else 0]


@inlined
def write_hit(handles, ray, slot, t, axis, i, ids, ts, normals):
    """Row i of a batch's answer; axis INSIDE where slot is NONE."""
    ids[i], ts[i] = NONE, t
    if slot != NONE:
        ids[i] = handles[slot]
    for k in range(normals.shape[1]):
        normals[i, k] = 0.0
    if axis != INSIDE:
        normals[i, axis] = -1.0 if ray[DIRECTION, axis] > 0.0 else 1.0


@lean_kernel
def raycast_rows(
    nodes,
    tight,
    handles,
    state,
    version,
    ray,
    origins,
    directions,
    t_max,
    masks,
    skip_inside,
    mode,
    rows,
    ids,
    ts,
    normals,
):
    """First hits (CLOSEST) of the rays of `rows`, or to any (ANY) no more than an id; NONE where
    there is none. `ray` is scratch. Returns how many took exact arithmetic, negative if the tree
    is changed meanwhile.
    """
    if not begin_query(state, version):
        return np.int64(-1)
    root, exact = state[ROOT], np.int64(0)
    slots, distances, axes = (
        stack_array(1, np.int64),
        stack_array(1, np.float64),
        stack_array(1, np.int64),
    )
    for i in rows:
        set_ray(ray, origins[i], directions[i])
        reach, seen = of_row(t_max, i), of_row(masks, i)
        slots[0], distances[0], axes[0] = NONE, np.inf, INSIDE
        raycast(
            nodes,
            tight,
            handles,
            root,
            ray,
            reach,
            seen,
            skip_inside,
            mode,
            slots,
            distances,
            axes,
            0,
        )
        exact += np.int64(ray[EXACT, 0])
        if mode == ANY:
            ids[i] = slots[0]
        else:
            write_hit(handles, ray, slots[0], distances[0], axes[0], i, ids, ts, normals)
    end_query(state)
    return exact
