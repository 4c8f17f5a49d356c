# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a swept ball may touch, found through the wide snapshot of batches of rays.

A ball of radius r touches a box only where its centre is in the box grown by r, so the ray of its
centre goes through nodes that are as much larger. The first obstacles that it surely touches bound
how far it goes.
"""

import numpy as np

from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import inlined
from ...tree.jit.float32x16 import seen16, stream16
from ...tree.jit.intrinsics import WIDTH, stack_array
from ...tree.nodes import NONE, View
from ...tree.rays.slab import INSIDE
from ...tree.wide.filtering import FARTHEST_ORIGIN, limit32, octant_of, start_ray
from ...tree.wide.ray_stacks import STACK, child_of, push_children, push_loose
from ...tree.wide.raycasting import ALL32
from ...tree.wide.snapshot import Snapshot, no_snapshot
from .ball_casting import SMALL, SWEEP_SLACK
from .casting import EARLY, LATE, Course, course_of, doubt_of, enter_thrice

UNSUITED = -1
PAD = 2.0**-20  # far above the rounding of a float32


def tree_and_snapshot(tree: DynamicBVH, count: int) -> tuple[View, Snapshot]:
    """For batches that cannot do with `ready_snapshot`."""
    view = tree.view()
    return view, tree.snapshot_for(count, view) or no_snapshot(tree.ndim)


@inlined
def find_wide(world, snapshot, way, ball, asked, room):
    """As `ball_casting.find` and `bracket` of the first hit: how many obstacles may be it. way =
    (origin, direction), asked = (mask, skip_inside), room as of `sweeping.sweep_balls`. UNSUITED:
    the snapshot is not for this ball.
    """
    (origin, direction), (mask, skip_inside) = way, asked
    scratch, hits, times, features = room
    records, stack = stack_array(1, snapshot.record), stack_array(STACK, np.int64)
    record, limits = records[0], stack_array(1, np.float32)
    reach = (ball.radius + ball.slack + doubt_of(scratch.ray, ball.radius)) * snapshot.per_length
    suited = start_ray(record, origin, direction, snapshot.center, snapshot.per_length, 1.0)
    if not (suited and reach < FARTHEST_ORIGIN):
        return np.int64(UNSUITED)
    widen(record, reach)
    limits[0], octant, top = record.limit, octant_of(direction), put_roots(snapshot, stack)
    count, soonest, latest = np.int64(0), np.inf, 1.0
    ts, course = stack_array(3, np.float64), Course(stack_array(3, np.float64), -1.0, False)
    found = ts, stack_array(3, np.int64)
    while top > 0:
        slot, top = next_leaf(snapshot, records, octant, mask, limits, stack, top)
        if slot == NONE or (snapshot.loose > 0 and is_known(world, slot, mask, hits, count)):
            continue
        if course.pace < 0.0:  # many balls meet no leaf
            course = course_of(world, scratch.ray, ball.radius, course.unit)
        enter_thrice(world, slot, scratch.ray, course, ball, scratch.work, found)
        if ts[EARLY] > latest:
            continue
        if count < hits.slots.shape[0]:
            hits.slots[count] = slot
            for i in range(3):
                times[i, count], features[i, count] = ts[i], found[1][i]
        count += 1
        if ts[EARLY] < soonest and not (skip_inside and found[1][EARLY] == INSIDE):
            soonest = ts[EARLY]
            latest = min(ts[LATE] * (1.0 + SWEEP_SLACK) + SMALL, latest)
            record.limit = limits[0] = limit32(latest, record.unit)
    if count > hits.slots.shape[0]:
        return count
    return keep_until(hits.slots, (times, features), count, latest)


@inlined
def widen(record, reach):
    """Let a ray meet boxes as if they were larger by `reach`, in the snapshot's units. Numbers
    that may be as large as reach * slope are rounded once more here, so there is a pad of more
    than that.
    """
    for axis in range(record.slope.shape[0]):
        slope, shift = (
            abs(np.float64(record.slope[axis])),
            abs(np.float64(record.near_shift[axis])),
        )
        more = slope * (reach * (1.0 + PAD) + PAD) + shift * PAD
        record.near_shift[axis] = np.float32(record.near_shift[axis] - more)
        record.far_shift[axis] = np.float32(record.far_shift[axis] + more)


@inlined
def put_roots(snapshot, stack):
    """Put the nodes that every ray visits on the stack; return its top."""
    stack[0] = 0
    return push_loose(snapshot, stack, 1)


@inlined
def next_leaf(snapshot, records, octant, mask, limits, stack, top):
    """(slot of the next leaf that the ray may meet before its limit, or NONE; the new top)."""
    nearest, met = stack_array(WIDTH, np.int32), stack_array(1, np.uint32)
    first = stack_array(1, np.int32)
    first[0] = 0
    while top > 0:
        top -= 1
        if stack[top] >> 32 > limits.view(np.int32)[0]:
            continue
        node = child_of(stack[top])
        if node < 0:
            return ~node, top
        lanes = stream16(snapshot.planes, node, np.uint64(octant), records, first, met, nearest)
        if mask != ALL32:
            lanes = np.uint32(lanes & seen16(snapshot.masks, node * WIDTH, mask))
        top = push_children(snapshot, node, lanes, nearest, stack, top)
    return np.int64(NONE), top


@inlined
def is_known(world, slot, mask, hits, count):
    """Whether a leaf of a snapshot that was patched is to be left out: what it was is removed or
    has another mask now, or it is met twice.
    """
    known = world.nodes[2 * slot].mask & mask == 0
    for j in range(min(count, hits.slots.shape[0])):
        known = known or hits.slots[j] == slot
    return known


@inlined
def keep_until(slots, brackets, count, latest):
    """Forget what is not met until then; return how many are left."""
    kept, (times, features) = np.int64(0), brackets
    for j in range(count):
        if times[EARLY, j] <= latest:
            slots[kept] = slots[j]
            for i in range(3):
                times[i, kept], features[i, kept] = times[i, j], features[i, j]
            kept += 1
    return kept
