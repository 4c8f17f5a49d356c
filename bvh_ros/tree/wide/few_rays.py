# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Few rays through the wide snapshot, one after the other.

What lists of rays save is the processor's wrong guesses, see `ray_streams`; of some tens of rays,
or some hundreds far apart, no list is long enough for that, and to make them takes longer.
"""

import numpy as np

from ..entries import entry_points
from ..jit.compiling import inlined, lean_kernel
from ..jit.float32x16 import seen16, stream16
from ..jit.float64x4 import look_ahead
from ..jit.intrinsics import WIDTH, stack_array, trailing_zeros
from ..nodes import NONE, WRITTEN
from ..rays.ray_hits import NO_HITS, raycast_row
from ..rays.raycasting import ANY, NO_RAYS, Found, of_row
from ..rays.slab import EXACT, INSIDE, RAY_ROWS
from ..store.turns import REFUSED, begin_query, count_rays, end_query
from .best_hit import is_better
from .collapse_plan import DEEPEST_WIDE
from .filtering import CORNERS, fill_whole, limit32, start_ray
from .ray_piles import write_miss
from .ray_streams import without_lowest
from .raycasting import ALL32, is_stale, set_inverse, write_hit
from .snapshot import LOOSE_NODES, no_snapshot

_STACK = DEEPEST_WIDE + LOOSE_NODES
_CHILD = np.int64(0xFFFFFFFF)


@lean_kernel
def cast_few(tree, version, snapshot, rays, hits):
    """As `raycasting.cast_rows`; REFUSED, too, where a snapshot that nothing was added to is not
    of the tree as it is.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    if snapshot.loose == 0 and tree.state[WRITTEN] != snapshot.written:
        end_query(tree.state)
        return np.int64(REFUSED)
    ray = stack_array((RAY_ROWS, 3), np.float64)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    one = Found(slots, stack_array(1, np.float64), axes)
    records, stack = stack_array(1, snapshot.record), stack_array(_STACK, np.int64)
    exact, record, whole = np.int64(0), records[0], stack_array(CORNERS, np.float64)
    fill_whole(tree, whole)
    for row in range(rays.origins.shape[0]):
        origin, direction, t_max = rays.origins[row], rays.directions[row], of_row(rays.t_max, row)
        away, _ = look_ahead(record, origin, direction, whole)
        if away:
            write_miss(rays, row, hits)
            continue
        if not start_ray(record, origin, direction, snapshot.center, snapshot.per_length, t_max):
            done = raycast_row(tree, ray, rays, row, one, hits)
            if done < 0:
                end_query(tree.state)
                return done
            exact += done
            continue
        ray[EXACT, 0] = 0.0
        hit = cast_one(snapshot, tree, rays, row, ray, records, stack)
        write_miss(rays, row, hits)
        if hit[0] != NONE:
            write_hit(tree, ray, rays, row, hit, hits)
        exact += np.int64(ray[EXACT, 0])
    if rays.counted:
        count_rays(tree.state, rays.origins.shape[0], exact)
    end_query(tree.state)
    return exact


@inlined
def cast_one(snapshot, tree, rays, row, ray, records, stack):
    """Best hit of a ray, or any: (slot, about t, axis). An entry of the stack is a node or ~slot
    of a leaf, and above that the bits of a float32: where the ray enters.
    """
    record, mask, t_max = records[0], of_row(rays.masks, row), of_row(rays.t_max, row)
    octant, patched = np.uint64(record.octant), snapshot.loose > 0
    best, best_t, best_axis = np.int64(NONE), t_max, np.int64(INSIDE)
    nearest, met, first = (
        stack_array(WIDTH, np.int32),
        stack_array(1, np.uint32),
        stack_array(1, np.int32),
    )
    limits = stack_array(1, np.float32)
    first[0], limits[0], ready = 0, record.limit, False
    stack[0], top = 0, 1
    for loose in range(snapshot.loose):
        stack[top] = snapshot.size + loose
        top += 1
    while top > 0:
        top -= 1
        if stack[top] >> 32 > limits.view(np.int32)[0]:
            continue
        node = np.int64(np.int32(stack[top] & _CHILD))
        if node >= 0:
            lanes = stream16(snapshot.planes, node, octant, records, first, met, nearest)
            if mask != ALL32:
                lanes = np.uint32(lanes & seen16(snapshot.masks, node * WIDTH, mask))
            top = push_children(snapshot, node, lanes, nearest, stack, top)
            continue
        slot = ~node
        if patched and is_stale(tree, slot, mask, best):
            continue
        if not ready:  # many rays meet no leaf
            set_inverse(ray, rays.origins[row], rays.directions[row])
            ready = True
        before = best, best_t, best_axis
        better, t, axis = is_better(tree, ray, t_max, rays.skip_inside, slot, before)
        if better:
            best, best_t, best_axis = slot, t, np.int64(axis)
            record.limit = limits[0] = limit32(t, record.unit)
            if rays.mode == ANY:
                break
    return best, best_t, best_axis


@inlined
def push_children(snapshot, node, lanes, nearest, stack, top):
    """Put the children in `lanes` on the stack, the nearest on top; return the new top."""
    bottom = top
    while lanes != np.uint32(0):
        lane = np.int64(trailing_zeros(lanes))
        lanes = without_lowest(lanes)
        child = np.int64(snapshot.children[node * WIDTH + lane])
        entry = np.int64(nearest[lane]) << 32 | (child & _CHILD)
        place = top
        while place > bottom and stack[place - 1] < entry:
            stack[place] = stack[place - 1]
            place -= 1
        stack[place] = entry
        top += 1
    return top


few_entry = entry_points(cast_few, 0, no_snapshot, NO_RAYS, NO_HITS)
