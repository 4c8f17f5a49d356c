# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Few rays through the wide snapshot, one after the other.

Lists of rays save wrong branch predictions, see `streams`. For some tens of rays, or some hundreds
far apart, no list is long enough for that, and it takes longer to make them.
"""

from typing import Any, NamedTuple

import numpy as np

from ..compiler import WIDTH, bits_of, inlined, lean_kernel, stack_array, trailing_zeros
from ..nodes import NONE, entry_points
from ..query.ray import ANY, NO_HITS, NO_RAYS, Found, Rays, of_row, raycast_row
from ..query.slab import EXACT, INSIDE, RAY_ROWS
from ..simd.float32x16 import above16, near16, seen16, stream16
from ..simd.float64x4 import look_ahead
from ..store.turns import REFUSED, count_rays, end_query
from .snapshot import (
    CORNERS,
    DEEPEST_WIDE,
    FARTHEST_ORIGIN,
    LOOSE_NODES,
    WIDER,
    begin_batch,
    fill_whole,
    limit32,
    no_snapshot,
    outwards,
    start_ray,
)
from .streams import (
    ALL32,
    MIXED,
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


@inlined
def next_child(snapshot, query, limit_of, mask, stack, top, meet):
    """The next leaf that a query may reach: (slot or NONE, top). What waits on the stack beyond
    limit_of(query), float32, is left out; meet(snapshot, query, node, nearest) is the bit mask of
    the children that are met, and writes where.
    """
    nearest = stack_array(WIDTH, np.int32)
    while top > 0:
        top -= 1
        if stack[top] >> 32 > bits_of(limit_of(query)):
            continue
        node = child_of(stack[top])
        if node < 0:
            return ~node, top
        lanes = meet(snapshot, query, node, nearest)
        if mask != ALL32:
            lanes = np.uint32(lanes & seen16(snapshot.masks, node * WIDTH, mask))
        top = push_children(snapshot, node, lanes, nearest, stack, top)
    return np.int64(NONE), top


@inlined
def leaf_within(entry, limit):
    """The slot of a leaf that was taken from the stack, if it is within a limit, float32; else
    NONE.
    """
    return ~child_of(entry) if entry >> 32 <= bits_of(limit) else np.int64(NONE)


@inlined
def next_wide_leaf(snapshot, records, place, mask, stack, top):
    """The next leaf that a ray may meet within the limit of its record, the one at place[0]:
    (slot or NONE, top).
    """
    return next_line_leaf(snapshot, (records, place), 0, mask, stack, top, _meet_ray)


@inlined
def next_line_leaf(snapshot, ray, line, mask, stack, top, meet):
    """`next_wide_leaf` of a ray = (records, place); `meet` is as of `next_child`, where the query
    is (ray, line), and begins with `meet_ray`.
    """
    return next_child(snapshot, (ray, line), _limit_of_ray, mask, stack, top, meet)


@inlined
def _limit_of_ray(query):
    (records, place), _ = query
    return records[place[0]].limit


@inlined
def meet_ray(snapshot, ray, node, nearest):
    """Bit mask of the children whose boxes a ray meets."""
    (records, place), hit_lanes = ray, stack_array(1, np.uint32)
    octant = np.uint64(records[place[0]].octant)
    return stream16(snapshot.planes, node, octant, records, place, hit_lanes, nearest)


@inlined
def _meet_ray(snapshot, query, node, nearest):
    return meet_ray(snapshot, query[0], node, nearest)


class Surroundings(NamedTuple):
    """Where `next_near_leaf` looks."""

    box: Any
    """(6,) float32: the lower and upper sides of a box, in the snapshot's units."""
    limit: Any
    """(1,) float32: the largest squared distance."""
    plane: Any
    """(4,) float32: see `set_plane32`."""
    extent: Any
    """Of the shape in the box, where `meet` reads it."""


@inlined
def surround(snapshot, low, high, box):
    """Fill in the `box` of `Surroundings`; return whether it is near enough for float32."""
    suited = snapshot.size > 0
    for axis in range(3):
        center, unit = snapshot.center[axis], snapshot.per_length
        box[axis], box[3 + axis] = outwards(low[axis], high[axis], center, unit)
        suited &= abs(box[axis]) < FARTHEST_ORIGIN and abs(box[3 + axis]) < FARTHEST_ORIGIN
    return suited


@inlined
def square32(square, unit):
    """A squared distance in the snapshot's units, surely not less, and finite."""
    within = np.float32(min(square * unit * unit, LARGEST32))
    return within * np.float32(1.0 + WIDER) + np.float32(1e-30)


@inlined
def next_near_leaf(snapshot, around, stack, top, meet):
    """The next leaf whose box is within a squared distance of a box: (slot or NONE, top).

    meet(snapshot, around, node, nearest) begins with `meet_boxes`. It may leave out more children,
    and lower the limit.
    """
    return next_child(snapshot, around, _limit_around, ALL32, stack, top, meet)


@inlined
def _limit_around(around):
    return around.limit[0]


@inlined
def meet_boxes(snapshot, around, node, nearest):
    """Bit mask of the children whose boxes are near enough; `nearest` becomes the bits of their
    squared distances.
    """
    lanes = near16(snapshot.planes, node, around.box, around.limit[0], nearest)
    if around.plane[3] > -np.inf:
        lanes &= above16(snapshot.planes, node, around.plane)
    return lanes


@inlined
def no_plane32(plane):
    """Fill in a plane that everything reaches."""
    plane[0] = plane[1] = plane[2] = 0.0
    plane[3] = -np.inf


@inlined
def set_plane32(snapshot, normal, place, plane):
    """Fill in a plane, (4,) float32, that boxes surely reach, in the snapshot's units, if anything
    in them is at `place` or farther along a unit vector.
    """
    level = place
    for axis in range(3):
        level -= normal[axis] * snapshot.center[axis]
        plane[axis] = normal[axis]
    level *= snapshot.per_length
    plane[3] = level - WIDER * (1.0 + abs(level))


LARGEST32 = 1e38


@inlined
def cast_abreast(snapshot, tree, rays, start, state, hits, prepare, better, write):
    """Answer few rays one by one, ABREAST of them through the root: (how many took exact
    arithmetic, the sum of what `start` returned; it is negative where `start` refused a ray).

    start(snapshot, tree, rays, row, record, state, hits) fills the record of a ray, or answers it:
    (whether the record is filled, a number to be summed up). `prepare` and `better` are as of
    `cast_through`. write(tree, ray, rays, row, hit, hits) writes the answer of a ray that hits;
    it returns whether that took exact arithmetic.
    """
    ray, stack = stack_array((RAY_ROWS, 3), np.float64), stack_array(STACK, np.int64)
    records, rows = stack_array(ABREAST, snapshot.record), stack_array(ABREAST, np.int64)
    places, hit_lanes = stack_array(ABREAST, np.int32), stack_array(ABREAST, np.uint32)
    nearest, total = stack_array((ABREAST, WIDTH), np.int32), np.int64(0)
    count, row, exact = rays.origins.shape[0], np.int64(0), np.int64(0)
    while row < count and total >= 0:
        alive = np.int64(0)
        while row < count and alive < ABREAST and total >= 0:
            rows[alive], places[alive] = row, alive
            write_miss(rays, row, hits)
            filled, number = start(snapshot, tree, rays, row, records[alive], state, hits)
            total = number if number < 0 else total + number
            alive += filled
            row += 1
        if alive == 0 or total < 0:
            continue
        stream16(snapshot.planes, 0, MIXED, records, places[:alive], hit_lanes, nearest)
        for i in range(alive):
            ray[EXACT, 0] = 0.0
            at_root = places[i : i + 1], hit_lanes[i], nearest[i : i + 1]
            room = ray, records, stack
            hit = cast_through(snapshot, tree, rays, rows[i], at_root, room, prepare, better)
            took_exact = ray[EXACT, 0] != 0.0
            if hit[0] != NONE:
                took_exact |= write(tree, ray, rays, rows[i], hit, hits)
            exact += took_exact
    return exact, total


class AtRest(NamedTuple):
    """What `start_or_answer` needs."""

    whole: Any
    """The box around all boxes, see `fill_whole`."""
    ray: Any
    """Scratch, as `found`."""
    found: Found


@lean_kernel
def cast_few(tree, version, snapshot, given, hits):
    """As `streams.cast_rows`, given = a plain tuple of the fields of `Rays`. REFUSED, too, where a
    snapshot that nothing was added to is not of the tree as it is.
    """
    if not begin_batch(tree, version, snapshot):
        return np.int64(REFUSED)
    ray, whole = stack_array((RAY_ROWS, 3), np.float64), stack_array(CORNERS, np.float64)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    rays, found = Rays(*given), Found(slots, stack_array(1, np.float64), axes)
    fill_whole(tree, whole)
    state = AtRest(whole, ray, found)
    exact, more = cast_abreast(
        snapshot, tree, rays, start_or_answer, state, hits, set_inverse, better_of_row, write_hit
    )
    exact = more if more < 0 else exact + more
    if rays.counted and exact >= 0:
        count_rays(tree.state, rays.origins.shape[0], exact)
    end_query(tree.state)
    return exact


@inlined
def start_or_answer(snapshot, tree, rays, row, record, state, hits):
    """Fill the record of a ray that may meet anything; answer one that is not suited to the
    snapshot by the nodes of the tree: (whether it is filled, whether it took exact arithmetic, or
    NOT_FINITE).
    """
    origin, direction, t_max = rays.origins[row], rays.directions[row], of_row(rays.t_max, row)
    away, _ = look_ahead(record, origin, direction, state.whole)
    if away:
        return False, np.int64(0)
    if start_ray(record, origin, direction, snapshot.center, snapshot.per_length, t_max):
        return True, np.int64(0)
    return False, raycast_row(tree, state.ray, rays, row, state.found, hits)


@inlined
def better_of_row(tree, ray, rays, row, slot, best):
    """`best_hit.is_better` of a row."""
    return is_better(tree, ray, of_row(rays.t_max, row), rays.skip_inside, slot, best)


@inlined
def cast_through(snapshot, tree, rays, row, at_root, room, prepare, better):
    """Best hit of a ray, or any: (slot, about t, axis); at_root = (its place, the children of the
    root that it meets, where), see `stream16`; room = (ray, records, stack), and `prepare` is
    called to write the ray before `better` may read it.
    """
    (place, lanes, nearest), (ray, records, stack) = at_root, room
    record, mask, t_max = records[place[0]], of_row(rays.masks, row), of_row(rays.t_max, row)
    best, best_t, best_axis = np.int64(NONE), t_max, np.int64(INSIDE)
    patched, ready = snapshot.loose > 0, False
    top = push_root(snapshot, mask, lanes, nearest[0], stack)
    while top > 0:
        slot, top = next_wide_leaf(snapshot, records, place, mask, stack, top)
        if slot == NONE or (patched and is_stale(tree, slot, mask, best)):
            continue
        if not ready:  # many rays meet no leaf
            prepare(ray, rays.origins[row], rays.directions[row])
            ready = True
        before = best, best_t, best_axis
        first, t, axis = better(tree, ray, rays, row, slot, before)
        if first:
            best, best_t, best_axis = slot, t, np.int64(axis)
            record.limit = limit32(t, record.unit)
            if rays.mode == ANY:
                break
    return best, best_t, best_axis


few_entry = entry_points(cast_few, 0, no_snapshot, tuple(NO_RAYS), NO_HITS)
