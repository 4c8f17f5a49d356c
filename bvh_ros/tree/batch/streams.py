# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays through the wide snapshot: filtered in float32, decided as `slab` decides.

A ray alone spends most of its time on branches that the processor guesses wrong: whether a child
is met, how many are, whether the stack is empty. So a node's boxes are tested for a list of rays
without a branch, each ray is put on the lists of the children that it meets, and the guesses are
one a list instead of one a ray (Barringer and Akenine-Möller 2014, "Dynamic Ray Stream
Traversal").

The lists of a node's children lie behind each other in one array, the nearest child's last and
behind it those of its own children: the traversal is depth first, so what lies behind the list of
a node that is visited is done with.
"""

import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import WIDTH, inlined, lean_kernel, prefetch, stack_array, trailing_zeros
from ..nodes import ALL, NONE, aligned_empty, entry_points, leaf_box
from ..query.ray import ANY, NO_HITS, NO_RAYS, Found, Hit, is_before, of_row, raycast_row
from ..query.slab import (
    DIRECTION,
    EXACT,
    INSIDE,
    INVERSE,
    ORIGIN,
    PAD,
    RAY_ROWS,
    TINY,
    intersect_exact,
    near_plane,
    plane_distance,
    rounded_slabs,
    set_ray,
)
from ..simd.float32x16 import at_most16, seen16, stream16
from ..simd.float64x4 import look_ahead
from ..simd.int32x8 import AT_ONCE, list_met8
from ..store.turns import REFUSED, count_rays, end_query
from .snapshot import (
    CORNERS,
    LOOSE_NODES,
    NOWHERE,
    begin_batch,
    fill_whole,
    limit32,
    no_snapshot,
    ray_dtype,
    start_ray,
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
    hit, t, axis = intersect_exact(lo, hi, ray, t_max)
    if not hit or (skip_inside and axis == INSIDE):
        return False, t, axis
    if best_slot == NONE:
        return True, t, axis
    best_lo, best_hi = leaf_box(tree.nodes, tree.tight, 2 * best_slot)
    best_axis = exact_entry_axis(best_lo, best_hi, ray, t_max, best_t, best_axis)
    better = is_before(tree, ray, Hit(slot, t, axis), Hit(best_slot, best_t, best_axis))
    return better, t, axis


# How many rays go together at most.
RAYS_AT_ONCE = 4096
RAYS_SORTED = 8 * RAYS_AT_ONCE

OCTANTS = 8  # of two dimensions, four are empty

# A thread reuses scratch for so many rays, 0.5 MB among 10,000 boxes: to make it takes 5 us, a
# sixth of 400 short rays, and less than 3 % of more rays.
KEPT_RAYS = 1024

# The columns of the stack: a node or ~slot of a leaf, and its list.
NODE, START, COUNT = range(3)
FOUND, DECIDED_EXACTLY, BAD = range(3)  # what is counted
TALLY = 3


class Scratch(NamedTuple):
    """Memory for the rays of one thread."""

    ray: NDArray[np.float64]
    """One ray, as of `slab`."""
    octants: NDArray[np.uint8]
    """Of rays that are sorted, see `motion.starting`."""
    rows: NDArray[np.int64]
    """Of rays, octant by octant."""
    records: NDArray[Any]
    """Of `filtering.ray_dtype`, as many."""
    lists: NDArray[np.int32]
    """Places in `records`."""
    found: NDArray[np.int32]
    """Places in `records` of those that hit anything."""
    hit_lanes: NDArray[np.uint32]
    """Bit masks of the children that the rays of a list meet."""
    stack: NDArray[np.int32]
    """A node a row."""


def make_scratch(count: int, ndim: int, depth: int) -> Scratch:
    """For `count` rays through a snapshot of so many levels of wide nodes."""
    together, piled = min(count, RAYS_AT_ONCE), min(OCTANTS * count, RAYS_SORTED)
    return Scratch(
        np.empty((RAY_ROWS, ndim)),
        np.empty(min(count, RAYS_SORTED), np.uint8),
        np.empty(piled, np.int64),
        aligned_empty(piled, ray_dtype(ndim)),
        np.empty(together * (1 + WIDTH * depth) + AT_ONCE, np.int32),
        np.empty(together, np.int32),
        np.empty(together + AT_ONCE, np.uint32),
        np.empty((WIDTH * depth + LOOSE_NODES, 3), np.int32),
    )


class ScratchPool(threading.local):
    """Scratch of a thread, by number of dimensions. Kernels write it before they read it."""

    def __init__(self) -> None:
        self.rooms: dict[int, Scratch] = {}


_pool = ScratchPool()


def scratch_for(count: int, ndim: int, depth: int) -> Scratch:
    """`make_scratch`, or scratch of the thread that is as large."""
    if count > KEPT_RAYS:
        return make_scratch(count, ndim, depth)
    scratch = _pool.rooms.get(ndim)
    if scratch is None or len(scratch.stack) < WIDTH * depth + LOOSE_NODES:
        scratch = _pool.rooms[ndim] = make_scratch(KEPT_RAYS, ndim, depth)
    return scratch


@inlined
def without_lowest(bits):
    """Without the lowest bit that is set, if any is."""
    return np.uint32(bits & np.uint32(bits - np.uint32(bits != np.uint32(0))))


@inlined
def farthest_first(hit_lanes, nearest, keys):
    """Sort the children of `met`; return how many. The lane is in the last four bits of a key."""
    count = 0
    while hit_lanes != np.uint32(0):
        lane = np.int64(trailing_zeros(hit_lanes))
        hit_lanes = without_lowest(hit_lanes)
        key = np.int64(nearest[lane]) << 32 | lane
        place = count
        while place > 0 and keys[place - 1] < key:
            keys[place] = keys[place - 1]
            place -= 1
        keys[place] = key
        count += 1
    return count


# How many rays of an octant go together, and one more for so many nodes: of few rays the records
# stay in the nearest cache, among many nodes many rays share what comes from memory. A scan's fly
# side by side.
RAYS_PILED, NODES_A_RAY = 512, 2
# Up to so many rays, and so many more a node, go together whatever their octants: lists that are
# eight times as long make up for planes that are loaded for each ray; but not of rays of a scan.
MIXED_RAYS, MIXED_A_NODE = 2 * RAYS_AT_ONCE, 4


@inlined
def pile_size(snapshot, origins):
    """How many rays a pile is, and whether they are of all octants."""
    count, size = origins.shape[0], snapshot.size
    if count == 0 or is_scan(origins):
        return min(count, RAYS_PILED), False
    if count <= min(MIXED_RAYS, RAYS_PILED + MIXED_A_NODE * size):
        return min(count, RAYS_AT_ONCE), True
    return min(count, RAYS_PILED + size // NODES_A_RAY, RAYS_AT_ONCE), False


@inlined
def is_scan(origins):
    """Whether rays seem to come from one place."""
    same, last = True, origins.shape[0] - 1
    for axis in range(origins.shape[1]):
        first = origins[0, axis]
        same &= first == origins[last // 2, axis] and first == origins[last, axis]
    return same


@inlined
def start_rays(snapshot, tree, rays, row, piles, ray, tally, hits):
    """Put the rays from `row` on that may meet anything on the pile of their octant, or all on one
    pile, and answer those that are not suited, until a pile is full; return the row behind them,
    and which pile. A pile is `together` records, and as many `rows`.
    """
    records, rows, piled, together, mixed = piles
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    found = Found(slots, stack_array(1, np.float64), axes)
    whole = stack_array(CORNERS, np.float64)
    fill_whole(tree, whole)
    while row < rays.origins.shape[0]:
        origin, direction = rays.origins[row], rays.directions[row]
        write_miss(rays, row, hits)
        away, octant = look_ahead(records[0], origin, direction, whole)
        row += 1
        if away:
            continue
        pile = np.int64(0) if mixed else octant
        place, t_max = pile * together + piled[pile], of_row(rays.t_max, row - 1)
        center, per_length = snapshot.center, snapshot.per_length
        if start_ray(records[place], origin, direction, center, per_length, t_max):
            rows[place] = row - 1
            piled[pile] += 1
            if piled[pile] == together:
                return row, pile
        else:
            done = raycast_row(tree, ray, rays, row - 1, found, hits)
            tally[BAD] = min(tally[BAD], done)
            tally[DECIDED_EXACTLY] += done
    return row, np.int64(0)


@inlined
def write_miss(rays, row, hits):
    """Write that a ray hits nothing."""
    hits.ids[row] = NONE
    if rays.mode != ANY:
        hits.t[row] = np.inf
        for axis in range(hits.normals.shape[1]):
            hits.normals[row, axis] = 0.0


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
    traverse(snapshot, tree, group, rays, scratch, tally, take_no_leaves, fetch_leaf, visit_box)
    for place in scratch.found[: tally[FOUND]]:
        best, row = scratch.records[place], scratch.rows[place]
        set_inverse(scratch.ray, rays.origins[row], rays.directions[row])
        hit = np.int64(best.slot), best.best_t, np.int64(best.axis)
        exact = write_hit(tree, scratch.ray, rays, row, hit, hits)
        tally[DECIDED_EXACTLY] += exact and not best.exact


@inlined
def traverse(snapshot, tree, group, rays, scratch, tally, take, fetch, visit):
    """Find the best hits of the rays of a group, (octant, rows of places, how many are listed),
    and note them in their records.

    `take` may look at all leaves of a node at once; it returns the children that are left. Of
    other leaves `fetch` prefetches the memory, and `visit` decides.
    """
    octant, rows, alive = group
    lists, stack, masks = scratch.lists, scratch.stack, rays.masks
    sees_all = masks.shape[0] == 1 and masks[0] == ALL32
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
            visit(tree, ~node, patched, listed, rays, scratch, tally)
            continue
        here = lists[start : start + count]
        hit_lanes = stream16(
            snapshot.planes, node, octant, scratch.records, here, scratch.hit_lanes, nearest
        )
        if not sees_all:
            hit_lanes = apply_masks(snapshot.masks, node, masks, rows, here, scratch.hit_lanes)
        listed = rows, here
        hit_lanes = take(snapshot, tree, node, listed, rays, scratch, tally, hit_lanes)
        if hit_lanes == np.uint32(0):
            continue
        begin, end = start, start + count  # the list of a single ray serves all children
        scratch.hit_lanes[count : count + AT_ONCE] = np.uint32(0)
        for i in range(farthest_first(hit_lanes, nearest, keys)):
            lane = keys[i] & (WIDTH - 1)
            child = snapshot.children[node * WIDTH + lane]
            if count > 1:
                begin = end
                end = list_met8(lists, start, count, scratch.hit_lanes, lane, begin)
            if child >= 0:
                fetch_node(snapshot, np.int64(child))
            else:
                fetch(tree, ~np.int64(child))
            stack[top, NODE], stack[top, START], stack[top, COUNT] = child, begin, end - begin
            top += 1


@inlined
def leaves_of(snapshot, node):
    """Bit mask of the children of a wide node that are leaves, or no nodes."""
    return at_most16(snapshot.children, node * WIDTH, np.int32(-1))


@inlined
def take_no_leaves(snapshot, tree, node, listed, rays, scratch, tally, hit_lanes):
    """For `traverse`: `visit_box` decides of each leaf."""
    return hit_lanes


@inlined
def fetch_leaf(tree, slot):
    """Prefetch the memory of a leaf."""
    if tree.tight.shape[0] > 0:
        prefetch(tree.tight, slot, 1)
    else:
        prefetch(tree.nodes, 2 * slot, 1)


@inlined
def visit_box(tree, slot, patched, listed, rays, scratch, tally):
    """`visit_leaf` of boxes at rest."""
    visit_leaf(tree, slot, patched, listed, rays, scratch, tally, is_first)


@inlined
def visit_leaf(tree, slot, patched, listed, rays, scratch, tally, better):
    """See for each ray that is listed whether the leaf is its best hit."""
    (rows, places), ray = listed, scratch.ray
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


# ---- leaves that are decided later


@inlined
def defer_leaves(snapshot, tree, node, listed, rays, scratch, tally, hit_lanes, keep):
    """For `traverse`: hand each ray that is listed and each leaf of a wide node that it meets to
    keep(tree, rays, slot, rows, place, scratch, tally).
    """
    leaves, (rows, places) = leaves_of(snapshot, node), listed
    if np.uint32(hit_lanes & leaves) != np.uint32(0):
        for i in range(places.shape[0]):
            lanes = np.uint32(scratch.hit_lanes[i] & leaves)
            scratch.hit_lanes[i] = np.uint32(scratch.hit_lanes[i] & ~leaves)
            while lanes != np.uint32(0):
                child = snapshot.children[node * WIDTH + trailing_zeros(lanes)]
                lanes = without_lowest(lanes)
                keep(tree, rays, ~np.int64(child), rows, places[i], scratch, tally)
    return np.uint32(hit_lanes & ~leaves)


@inlined
def fetch_nothing(tree, slot):
    """For `traverse`, where all leaves are deferred."""


@inlined
def visit_nothing(tree, slot, patched, listed, rays, scratch, tally):
    """For `traverse`, where all leaves are deferred."""


@inlined
def set_inverse(ray, origin, direction):
    """Write all rows of a ray that is suited."""
    set_ray(ray, origin, direction)
    for axis in range(origin.shape[0]):
        ray[INVERSE, axis] = 1.0 / direction[axis]


@inlined
def apply_masks(wide_masks, node, masks, rows, places, hit_lanes):
    """Take from `met` what a ray's mask does not see; return what any ray still meets."""
    any_met = np.uint32(0)
    for i in range(places.shape[0]):
        mask = of_row(masks, rows[places[i]])
        hit_lanes[i] &= seen16(wide_masks, node * WIDTH, mask)
        any_met |= hit_lanes[i]
    return any_met


@inlined
def fetch_node(snapshot, child):
    """Ask for the memory of a wide node that will be visited soon."""
    prefetch(snapshot.planes, child * (2 * snapshot.center.shape[0] * WIDTH), LINES_OF_PLANES)
    prefetch(snapshot.children, child * WIDTH, 1)


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
