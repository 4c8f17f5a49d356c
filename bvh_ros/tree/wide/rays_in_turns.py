# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Few rays, as in `few_rays`, through a snapshot that does not fit into a processor core's own
caches: while the memory that one of them is to visit is on its way, the others take their turns.
"""

import numpy as np

from ..compiler import WIDTH, bits_of, inlined, stack_array
from ..nodes import NONE
from ..rays.raycasting import ANY, of_row
from ..rays.slab import EXACT, RAY_ROWS
from ..simd.float32x16 import seen16, stream16
from .best_hit import is_better
from .filtering import limit32
from .ray_stacks import ABREAST, STACK, child_of, push_children, push_root
from .raycasting import ALL32, fetch_box, fetch_node, is_stale, set_inverse, write_hit
from .snapshot import LOOSE_NODES

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
