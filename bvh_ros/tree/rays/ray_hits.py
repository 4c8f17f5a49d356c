# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays in, and out what the caller reads: handles, points and normals."""

import numpy as np

from ..compiler import lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import EXACT_RAYS, NONE, RAYS, leaf_box
from ..results import RayHits
from ..store.turns import ANY_VERSION, NOT_FINITE, REFUSED, begin_query, count_rays, end_query
from .raycasting import CLOSEST, NO_RAYS, Asked, Found, of_row, raycast
from .slab import EXACT, INSIDE, RAY_ROWS, is_finite, set_ray


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


@lean_kernel
def locate_hit(tree, origin, direction, slot, t, axis, place):
    """`locate`, as Python calls it."""
    locate(tree.nodes, tree.tight, origin, direction, slot, t, axis, place)


@lean_kernel
def raycast_one(tree, origin, direction, t_max, mask, skip_inside, mode, place):
    """One ray in one call: (handle, t), and for CLOSEST its point and normal in `place`; instead
    of a handle NONE if there is none, NOT_FINITE if the input is not, REFUSED if the tree is being
    changed.
    """
    state = tree.state
    if not is_finite(origin, direction):
        return NOT_FINITE, np.inf
    if not begin_query(state, ANY_VERSION):
        return REFUSED, np.inf
    ray = stack_array((RAY_ROWS, 3), np.float64)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    ts = stack_array(1, np.float64)
    set_ray(ray, origin, direction)
    asked, found = Asked(t_max, mask, skip_inside, mode), Found(slots, ts, axes)
    hits = raycast(tree, ray, asked, found, 0)
    state[RAYS] += 1
    state[EXACT_RAYS] += np.int64(ray[EXACT, 0])
    handle = np.int64(NONE)
    if hits > 0:
        handle = tree.handles[slots[0]]
        if mode == CLOSEST:
            locate(tree.nodes, tree.tight, origin, direction, slots[0], ts[0], axes[0], place)
    end_query(state)
    return handle, (ts[0] if hits > 0 else np.inf)


@lean_kernel
def raycast_row(tree, ray, rays, row, found, hits):
    """The first hit (CLOSEST) of one ray of a batch, or of any (ANY) no more than an id; NONE
    where there is none. `ray` and `found` are scratch. Returns 1 if it took exact arithmetic, else
    0; NOT_FINITE if the ray is not.
    """
    origin, direction = rays.origins[row], rays.directions[row]
    if not is_finite(origin, direction):
        return np.int64(NOT_FINITE)
    set_ray(ray, origin, direction)
    asked = Asked(of_row(rays.t_max, row), of_row(rays.masks, row), rays.skip_inside, rays.mode)
    slot, axis, t = np.int64(NONE), np.int64(INSIDE), np.inf
    if raycast(tree, ray, asked, found, 0) > 0:
        slot, axis, t = found.slots[0], found.axes[0], found.ts[0]
    hits.ids[row] = tree.handles[slot] if slot != NONE else NONE
    if rays.mode == CLOSEST:
        hits.t[row] = t
        for k in range(origin.shape[0]):
            hits.normals[row, k] = 0.0
        if axis != INSIDE:
            hits.normals[row, axis] = -1.0 if direction[axis] > 0.0 else 1.0
    return np.int64(ray[EXACT, 0])


@lean_kernel
def raycast_rows(tree, version, rays, hits):
    """`raycast_row` for all rays. Returns how many took exact arithmetic; NOT_FINITE if a ray is
    not, REFUSED if the tree is changed meanwhile.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    ray = stack_array((RAY_ROWS, 3), np.float64)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    found = Found(slots, stack_array(1, np.float64), axes)
    exact = np.int64(0)
    for row in range(rays.origins.shape[0]):
        done = raycast_row(tree, ray, rays, row, found, hits)
        if done < 0:
            exact = done
            break
        exact += done
    if rays.counted and exact >= 0:
        count_rays(tree.state, rays.origins.shape[0], exact)
    end_query(tree.state)
    return exact


@lean_kernel
def count(tree, rays, exact):
    """Count rays, and those of them that took exact arithmetic."""
    count_rays(tree.state, rays, exact)


_POINT, _ROWS = np.empty(0), np.empty((0, 3))
NO_HITS = RayHits(np.empty(0, np.int64), np.empty(0), _ROWS)
locate_entry = entry_points(locate_hit, _POINT, _POINT, 0, 0.0, 0, _ROWS)
one_entry = entry_points(raycast_one, _POINT, _POINT, 0.0, np.uint32(0), False, CLOSEST, _ROWS)
count_entry = entry_points(count, 0, 0)
rows_entry = entry_points(raycast_rows, 0, NO_RAYS, NO_HITS)
