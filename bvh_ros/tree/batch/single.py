# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Few rays through the wide snapshot, one after the other.

What lists of rays save is the processor's wrong guesses, see `ray_streams`; of some tens of rays,
or some hundreds far apart, no list is long enough for that, and to make them takes longer.
"""

import numpy as np

from ..compiler import WIDTH, bits_of, inlined, lean_kernel, stack_array, trailing_zeros
from ..entries import entry_points
from ..nodes import NONE
from ..query.ray import ANY, NO_HITS, NO_RAYS, Found, Rays, of_row, raycast_row
from ..query.slab import EXACT, INSIDE, RAY_ROWS
from ..simd.float32x16 import seen16, stream16
from ..simd.float64x4 import look_ahead
from ..store.turns import REFUSED, count_rays, end_query
from .snapshot import (
    CORNERS,
    DEEPEST_WIDE,
    LOOSE_NODES,
    begin_batch,
    fill_whole,
    limit32,
    no_snapshot,
    start_ray,
)
from .streams import (
    ALL32,
    MIXED,
    fetch_box,
    fetch_node,
    is_better,
    is_stale,
    set_inverse,
    without_lowest,
    write_hit,
    write_miss,
)

# So many rays are tested against the root one behind the other: what none of them decides yet the
# processor need not guess.
ABREAST = 8
STACK = DEEPEST_WIDE + LOOSE_NODES
_CHILD = np.int64(0xFFFFFFFF)


@inlined
def push_root(snapshot, mask, lanes, nearest, stack):
    """Put on an empty stack what is met of the root, as `push_children`, and loose nodes; return
    the top.
    """
    if mask != ALL32:
        lanes = np.uint32(lanes & seen16(snapshot.masks, 0, mask))
    top = push_children(snapshot, np.int64(0), lanes, nearest, stack, 0)
    return push_loose(snapshot, stack, top)


@inlined
def push_loose(snapshot, stack, top):
    """Put the nodes that every ray visits on the stack; return the new top."""
    for loose in range(snapshot.loose):
        stack[top] = snapshot.size + loose
        top += 1
    return top


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


@inlined
def child_of(entry):
    """Node, or ~slot of a leaf."""
    return np.int64(np.int32(entry & _CHILD))


# From so many nodes on rays take turns. Among 100,000 boxes, 9,500 nodes, that saves 0.12 to 0.2
# of the time, among 40,000 boxes 0.05; among 20,000, 2,200 nodes, it costs as much as it saves,
# and among 1,000 a tenth more.
FAR_NODES = 3000
# Each of them has a share of the stack, which is enough for so many levels of nodes.
SHARE = STACK // ABREAST
DEEPEST_IN_TURNS = (SHARE - LOOSE_NODES - WIDTH) // (WIDTH - 1)


@inlined
def take_turns(snapshot):
    """Whether few rays through a snapshot do."""
    return snapshot.size >= FAR_NODES and snapshot.depth <= DEEPEST_IN_TURNS


@inlined
def cast_in_turns(snapshot, tree, rays, group, seen, stack, hits):
    """Answer the rays of a group, (rows, places of their records, how many); seen = (records, what
    they meet of the root, and where, see `stream16`). Returns how many took exact arithmetic.
    """
    (rows, places, left), (records, met, nearest) = group, seen
    each = stack_array((ABREAST, RAY_ROWS, 3), np.float64)
    order, tops = stack_array(ABREAST, np.int64), stack_array(ABREAST, np.int64)
    ready, exact, turn = stack_array(ABREAST, np.bool_), np.int64(0), np.int64(0)
    for i in range(left):
        order[i], ready[i], each[i, EXACT, 0] = i, False, 0.0
        mask, own = of_row(rays.masks, rows[i]), stack[i * SHARE : (i + 1) * SHARE]
        top = push_root(snapshot, mask, met[i], nearest[i], own)
        tops[i] = ask_ahead(snapshot, tree, records[i], own, top)
    while left > 0:
        turn = turn if turn < left else np.int64(0)
        i = order[turn]
        if tops[i] > 0:
            own = stack[i * SHARE : (i + 1) * SHARE]
            room = each[i], records, own, nearest[i : i + 1]
            top = visit(snapshot, tree, rays, rows[i], places[i : i + 1], tops[i], room, ready)
            tops[i] = ask_ahead(snapshot, tree, records[i], own, top)
        if tops[i] > 0:
            turn += 1
            continue
        left -= 1
        order[turn] = order[left]
        if records[i].slot != NONE:
            hit = np.int64(records[i].slot), records[i].best_t, np.int64(records[i].axis)
            write_hit(tree, each[i], rays, rows[i], hit, hits)
        exact += np.int64(each[i, EXACT, 0])
    return exact


@inlined
def ask_ahead(snapshot, tree, record, stack, top):
    """Drop what is farther than the best hit, and ask for the memory of what a ray is to visit
    next; return the top of its stack.
    """
    limit = bits_of(record.limit)
    while top > 0 and stack[top - 1] >> 32 > limit:
        top -= 1
    if top > 0:
        node = child_of(stack[top - 1])
        if node >= 0:
            fetch_node(snapshot, node)
        else:
            fetch_box(tree, ~node)
    return top


@inlined
def visit(snapshot, tree, rays, row, place, top, room, ready):
    """Visit the node or leaf on top of a ray's stack; return the new top. The best hit is in the
    ray's record; whether `ray` is written, in `ready`.
    """
    ray, records, stack, nearest = room
    record, mask, node = records[place[0]], of_row(rays.masks, row), child_of(stack[top - 1])
    top -= 1
    if node >= 0:
        met, octant = stack_array(1, np.uint32), np.uint64(record.octant)
        lanes = stream16(snapshot.planes, node, octant, records, place, met, nearest)
        if mask != ALL32:
            lanes = np.uint32(lanes & seen16(snapshot.masks, node * WIDTH, mask))
        return push_children(snapshot, node, lanes, nearest[0], stack, top)
    slot = ~node
    if snapshot.loose > 0 and is_stale(tree, slot, mask, record.slot):
        return top
    if not ready[place[0]]:
        set_inverse(ray, rays.origins[row], rays.directions[row])
        ready[place[0]] = True
    best, t_max = (np.int64(record.slot), record.best_t, np.int64(record.axis)), rays.t_max
    first, t, axis = is_better(tree, ray, of_row(t_max, row), rays.skip_inside, slot, best)
    if first:
        record.slot, record.best_t, record.axis = slot, t, axis
        record.limit = limit32(t, record.unit)
        if rays.mode == ANY:
            return np.int64(0)
    return top


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
            hit = cast_through(
                snapshot, tree, rays, rows[i], seen, room, set_inverse, better_of_row
            )
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
def cast_through(snapshot, tree, rays, row, seen, room, prepare, better):
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
