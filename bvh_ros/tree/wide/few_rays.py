# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Few rays through the wide snapshot, one after the other.

What lists of rays save is the processor's wrong guesses, see `ray_streams`; of some tens of rays,
or some hundreds far apart, no list is long enough for that, and to make them takes longer.
"""

import numpy as np

from ..compiler import WIDTH, bits_of, inlined, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import NONE
from ..rays.ray_hits import NO_HITS, raycast_row
from ..rays.raycasting import ANY, NO_RAYS, Found, Rays, of_row
from ..rays.slab import EXACT, INSIDE, RAY_ROWS
from ..simd.float32x16 import seen16, stream16
from ..simd.float64x4 import look_ahead
from ..store.turns import REFUSED, count_rays, end_query
from .best_hit import is_better
from .filtering import CORNERS, fill_whole, limit32, start_ray
from .ray_piles import write_miss
from .ray_stacks import ABREAST, STACK, child_of, push_children, push_root
from .raycasting import ALL32, MIXED, is_stale, set_inverse, write_hit
from .rays_in_turns import cast_in_turns, take_turns
from .snapshot import begin_batch, no_snapshot


@lean_kernel
def cast_few(tree, version, snapshot, asked, hits):
    """As `raycasting.cast_rows`, asked = what a `Rays` holds, which Python makes slowly. REFUSED,
    too, where a snapshot that nothing was added to is not of the tree as it is.
    """
    if not begin_batch(tree, version, snapshot):
        return np.int64(REFUSED)
    ray, stack = stack_array((RAY_ROWS, 3), np.float64), stack_array(STACK, np.int64)
    records, rows = stack_array(ABREAST, snapshot.record), stack_array(ABREAST, np.int64)
    places, met = stack_array(ABREAST, np.int32), stack_array(ABREAST, np.uint32)
    rays = Rays(*asked)
    nearest, whole = stack_array((ABREAST, WIDTH), np.int32), stack_array(CORNERS, np.float64)
    count, row, exact = rays.origins.shape[0], np.int64(0), np.int64(0)
    fill_whole(tree, whole)
    while row < count:
        row, alive, done = start_abreast(snapshot, tree, rays, row, whole, (records, rows), hits)
        if done < 0:
            end_query(tree.state)
            return done
        exact += done
        if alive == 0:
            continue
        for i in range(alive):
            places[i] = i
        stream16(snapshot.planes, 0, MIXED, records, places[:alive], met, nearest)
        if take_turns(snapshot):
            group, seen = (rows, places, alive), (records, met, nearest)
            exact += cast_in_turns(snapshot, tree, rays, group, seen, stack, hits)
            continue
        for i in range(alive):
            ray[EXACT, 0] = 0.0
            seen = places[i : i + 1], met[i], nearest[i : i + 1]
            room = ray, records, stack
            hit = cast_one(snapshot, tree, rays, rows[i], seen, room, set_inverse, better_of_row)
            if hit[0] != NONE:
                write_hit(tree, ray, rays, rows[i], hit, hits)
            exact += np.int64(ray[EXACT, 0])
    if rays.counted:
        count_rays(tree.state, count, exact)
    end_query(tree.state)
    return exact


@inlined
def start_abreast(snapshot, tree, rays, row, whole, room, hits):
    """Fill records and rows of the next rays that may meet anything, ABREAST at most, and answer
    those that are not suited: (the row behind them, how many are filled, how many took exact
    arithmetic or NOT_FINITE).
    """
    (records, rows), ray = room, stack_array((RAY_ROWS, 3), np.float64)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    found = Found(slots, stack_array(1, np.float64), axes)
    alive, exact, center = np.int64(0), np.int64(0), snapshot.center
    while row < rays.origins.shape[0] and alive < ABREAST and exact >= 0:
        origin, direction, t_max = rays.origins[row], rays.directions[row], of_row(rays.t_max, row)
        write_miss(rays, row, hits)
        away, _ = look_ahead(records[alive], origin, direction, whole)
        rows[alive] = row
        if away:
            pass
        elif start_ray(records[alive], origin, direction, center, snapshot.per_length, t_max):
            alive += 1
        else:
            done = raycast_row(tree, ray, rays, row, found, hits)
            exact = done if done < 0 else exact + done
        row += 1
    return row, alive, exact


@inlined
def better_of_row(tree, ray, rays, row, slot, best):
    """`best_hit.is_better` of a row."""
    return is_better(tree, ray, of_row(rays.t_max, row), rays.skip_inside, slot, best)


@inlined
def cast_one(snapshot, tree, rays, row, seen, room, prepare, better):
    """Best hit of a ray, or any: (slot, about t, axis); `seen`: its place, and what it meets of
    the root, see `stream16`; room = (ray, records, stack), and `prepare` is called to write the
    ray before `better` may read it.
    """
    (place, lanes, nearest), (ray, records, stack) = seen, room
    record, mask, t_max = records[place[0]], of_row(rays.masks, row), of_row(rays.t_max, row)
    octant, patched = np.uint64(record.octant), snapshot.loose > 0
    best, best_t, best_axis = np.int64(NONE), t_max, np.int64(INSIDE)
    met, limit, ready = stack_array(1, np.uint32), bits_of(record.limit), False
    top = push_root(snapshot, mask, lanes, nearest[0], stack)
    while top > 0:
        top -= 1
        if stack[top] >> 32 > limit:
            continue
        node = child_of(stack[top])
        if node >= 0:
            lanes = stream16(snapshot.planes, node, octant, records, place, met, nearest)
            if mask != ALL32:
                lanes = np.uint32(lanes & seen16(snapshot.masks, node * WIDTH, mask))
            top = push_children(snapshot, node, lanes, nearest[0], stack, top)
            continue
        slot = ~node
        if patched and is_stale(tree, slot, mask, best):
            continue
        if not ready:  # many rays meet no leaf
            prepare(ray, rays.origins[row], rays.directions[row])
            ready = True
        before = best, best_t, best_axis
        first, t, axis = better(tree, ray, rays, row, slot, before)
        if first:
            best, best_t, best_axis = slot, t, np.int64(axis)
            record.limit = limit32(t, record.unit)
            limit = bits_of(record.limit)
            if rays.mode == ANY:
                break
    return best, best_t, best_axis


few_entry = entry_points(cast_few, 0, no_snapshot, tuple(NO_RAYS), NO_HITS)
