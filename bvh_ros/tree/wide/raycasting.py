# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays through the wide snapshot: filtered in float32 by `filtering`, in lists as in
`ray_streams`; what passes is decided by `best_hit`.
"""

import numpy as np

from ..compiler import WIDTH, inlined, lean_kernel, prefetch, stack_array
from ..entries import entry_points
from ..nodes import ALL, NONE, leaf_box
from ..rays.ray_hits import NO_HITS
from ..rays.raycasting import ANY, NO_RAYS, of_row
from ..rays.slab import (
    DIRECTION,
    EXACT,
    INSIDE,
    INVERSE,
    ORIGIN,
    near_plane,
    plane_distance,
    set_ray,
)
from ..simd.float32x16 import seen16, stream16
from ..simd.int32x8 import AT_ONCE, list_met8
from ..store.turns import REFUSED, count_rays, end_query
from .best_hit import exact_entry_axis, is_better
from .filtering import NOWHERE, limit32
from .ray_piles import pile_size, start_rays
from .ray_streams import (
    BAD,
    COUNT,
    DECIDED_EXACTLY,
    FOUND,
    NODE,
    OCTANTS,
    START,
    TALLY,
    farthest_first,
    make_scratch,
)
from .snapshot import begin_batch, no_snapshot

ALL32 = np.uint32(ALL)
MIXED = -1  # for an octant: that of each ray
LINES_OF_PLANES = 6  # of a wide node of three dimensions


@lean_kernel
def cast_rows(tree, version, snapshot, rays, scratch, hits):
    """First hits of `rays`, or of any hit no more than an id. Returns how many took exact
    arithmetic; NOT_FINITE if a ray is not, REFUSED if the tree is changed meanwhile.
    """
    if not begin_batch(tree, version, snapshot):
        return np.int64(REFUSED)
    tally, piled = stack_array(TALLY, np.int64), stack_array(OCTANTS, np.int64)
    tally[DECIDED_EXACTLY], tally[BAD], piled[:] = 0, 0, 0
    count, row, pile = rays.origins.shape[0], np.int64(0), np.int64(0)
    together, mixed = pile_size(snapshot, rays.origins)
    while row < count or pile < OCTANTS:
        full = pile
        if row < count:
            piles = scratch.records, scratch.rows, piled, together, mixed
            row, full = start_rays(snapshot, tree, rays, row, piles, scratch.ray, tally, hits)
        else:
            pile += 1
        if piled[full] > 0:
            group = MIXED if mixed else full, full * together, piled[full]
            cast_pile(snapshot, tree, group, rays, scratch, tally, hits)
            piled[full] = 0
    if rays.counted and tally[BAD] == 0:
        count_rays(tree.state, count, tally[DECIDED_EXACTLY])
    end_query(tree.state)
    return tally[DECIDED_EXACTLY] if tally[BAD] == 0 else tally[BAD]


@inlined
def is_first(tree, ray, rays, row, slot, best):
    """`best_hit.is_better` of a ray that is still to be set."""
    set_inverse(ray, rays.origins[row], rays.directions[row])
    return is_better(tree, ray, of_row(rays.t_max, row), rays.skip_inside, slot, best)


@inlined
def cast_pile(snapshot, tree, group, rays, scratch, tally, hits):
    """Answer rays that go together: (octant, the first place, how many)."""
    octant, begin, count = group
    for i in range(count):
        scratch.lists[i] = begin + i
    tally[FOUND] = 0
    group = octant, scratch.rows, count
    traverse(snapshot, tree, group, rays, scratch, tally, fetch_leaf, is_first)
    for place in scratch.found[: tally[FOUND]]:
        best, row = scratch.records[place], scratch.rows[place]
        set_inverse(scratch.ray, rays.origins[row], rays.directions[row])
        hit = np.int64(best.slot), best.best_t, np.int64(best.axis)
        exact = write_hit(tree, scratch.ray, rays, row, hit, hits)
        tally[DECIDED_EXACTLY] += exact and not best.exact


@inlined
def traverse(snapshot, tree, group, rays, scratch, tally, put_off, better):
    """Find the best hits of the rays of a group, (octant, rows of places, how many are listed),
    and note them in their records. `put_off` asks for the memory of a leaf, and says whether it
    keeps the rays that visit it for later.
    """
    octant, rows, alive = group
    lists, stack, masks = scratch.lists, scratch.stack, rays.masks
    all_seen = masks.shape[0] == 1 and masks[0] == ALL32
    nearest, keys = stack_array(WIDTH, np.int32), stack_array(WIDTH, np.int64)
    top = 1 + snapshot.loose
    for row in range(top):
        stack[row, NODE] = 0 if row == 0 else snapshot.size + row - 1
        stack[row, START], stack[row, COUNT] = 0, alive
    patched = snapshot.loose > 0
    while top > 0:
        top -= 1
        node, start = np.int64(stack[top, NODE]), np.int64(stack[top, START])
        count = np.int64(stack[top, COUNT])
        if node < 0:
            listed = rows, lists[start : start + count]
            visit_leaf(tree, ~node, patched, listed, rays, scratch, tally, better)
            continue
        here = lists[start : start + count]
        met = stream16(snapshot.planes, node, octant, scratch.records, here, scratch.met, nearest)
        if not all_seen:
            met = apply_masks(snapshot.masks, node, masks, rows, here, scratch.met)
        if met == np.uint32(0):
            continue
        begin, end = start, start + count  # the list of a single ray serves all children
        scratch.met[count : count + AT_ONCE] = np.uint32(0)
        for i in range(farthest_first(met, nearest, keys)):
            lane = keys[i] & (WIDTH - 1)
            child = snapshot.children[node * WIDTH + lane]
            if count > 1:
                begin = end
                end = list_met8(lists, start, count, scratch.met, lane, begin)
            if child >= 0:
                fetch_node(snapshot, np.int64(child))
            else:
                listed = rows, lists[begin:end]
                if put_off(tree, rays, ~np.int64(child), listed, scratch, tally):
                    continue
            stack[top, NODE], stack[top, START], stack[top, COUNT] = child, begin, end - begin
            top += 1


@inlined
def visit_leaf(tree, slot, patched, group, rays, scratch, tally, better):
    """See for each ray of a group whether the leaf is its best hit."""
    (rows, places), ray = group, scratch.ray
    for place in places:
        best, row = scratch.records[place], rows[place]
        if rays.mode == ANY and best.slot != NONE:
            continue
        if patched and is_stale(tree, slot, of_row(rays.masks, row), best.slot):
            continue
        before = np.int64(best.slot), best.best_t, np.int64(best.axis)
        first, t, axis = better(tree, ray, rays, row, slot, before)
        if ray[EXACT, 0] != 0.0 and not best.exact:
            best.exact = True
            tally[DECIDED_EXACTLY] += 1
        if first:
            if best.slot == NONE:
                scratch.found[tally[FOUND]] = place
                tally[FOUND] += 1
            best.slot, best.best_t, best.axis = slot, t, axis
            best.limit = NOWHERE if rays.mode == ANY else limit32(t, best.unit)


@inlined
def set_inverse(ray, origin, direction):
    """Write all rows of a ray that is suited."""
    set_ray(ray, origin, direction)
    for axis in range(origin.shape[0]):
        ray[INVERSE, axis] = 1.0 / direction[axis]


@inlined
def apply_masks(wide_masks, node, masks, rows, places, met):
    """Take from `met` what a ray's mask does not see; return what any ray still meets."""
    any_met = np.uint32(0)
    for i in range(places.shape[0]):
        mask = of_row(masks, rows[places[i]])
        met[i] &= seen16(wide_masks, node * WIDTH, mask)
        any_met |= met[i]
    return any_met


@inlined
def fetch_node(snapshot, child):
    """Ask for the memory of a wide node that will be visited soon."""
    prefetch(snapshot.planes, child * (2 * snapshot.center.shape[0] * WIDTH), LINES_OF_PLANES)
    prefetch(snapshot.children, child * WIDTH, 1)


@inlined
def fetch_leaf(tree, rays, slot, listed, scratch, tally):
    """Ask for the memory of a leaf."""
    fetch_box(tree, slot)
    return False


@inlined
def fetch_box(tree, slot):
    """Ask for the memory of the box of a slot."""
    if tree.tight.shape[0] > 0:
        prefetch(tree.tight, slot, 1)
    else:
        prefetch(tree.nodes, 2 * slot, 1)


@inlined
def is_stale(tree, slot, mask, best):
    """Whether a leaf of a snapshot that was patched is to be left out: what it was is removed or
    has another mask now, or it is met twice.
    """
    return tree.nodes[2 * slot].mask & mask == 0 or slot == best


@inlined
def write_hit(tree, ray, rays, row, hit, hits):
    """Write the answer of a ray that hits, (slot, about t, axis); whether that took exact
    arithmetic. `ray` has its inverses.
    """
    slot, t, axis = hit
    hits.ids[row] = tree.handles[slot]
    if rays.mode == ANY:
        return False
    hits.t[row] = 0.0
    if axis != INSIDE:
        lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
        axis = exact_entry_axis(lo, hi, ray, of_row(rays.t_max, row), t, axis)
        plane = near_plane(lo, hi, ray, axis)
        hits.t[row] = plane_distance(plane, ray[ORIGIN, axis], ray[DIRECTION, axis])
        hits.normals[row, axis] = -1.0 if ray[DIRECTION, axis] > 0.0 else 1.0
    return ray[EXACT, 0] != 0.0


cast_entry = entry_points(
    *(cast_rows, 0, no_snapshot, NO_RAYS, lambda ndim: make_scratch(0, ndim, 0), NO_HITS)
)
