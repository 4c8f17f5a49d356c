# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a swept ball may touch, found through the wide snapshot of batches of rays.

A ball of radius r touches a box only where its centre is in the box grown by r, so the ray of its
centre goes through nodes that are as much larger. The first obstacles that it surely touches bound
how far it goes.
"""

import numpy as np

from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.float32x16 import seen16, stream16
from ...tree.jit.intrinsics import WIDTH, stack_array
from ...tree.nodes import NONE
from ...tree.rays.slab import INSIDE
from ...tree.wide.collapse_plan import DEEPEST_WIDE
from ...tree.wide.few_rays import push_children
from ...tree.wide.filtering import FARTHEST_ORIGIN, limit32, octant_of, start_ray
from ...tree.wide.raycasting import ALL32
from ...tree.wide.snapshot import LOOSE_NODES
from .ball_casting import SMALL, SWEEP_SLACK
from .casting import doubt_of, enter_obstacle, plain

UNSUITED = -1
PAD = 2.0**-20  # far above the rounding of a float32
_STACK = DEEPEST_WIDE + LOOSE_NODES
_CHILD = np.int64(0xFFFFFFFF)


@lean_kernel
def find_wide(world, snapshot, way, ball, asked, scratch, hits):
    """As `ball_casting.find` of the first hit: how many obstacles may be it. way = (origin,
    direction), asked = (mask, skip_inside). UNSUITED: the snapshot is not for this ball.
    """
    origin, direction = way
    mask, skip_inside = asked
    records, stack = stack_array(1, snapshot.record), stack_array(_STACK, np.int64)
    record, limits = records[0], stack_array(1, np.float32)
    reach = (ball.radius + ball.slack + doubt_of(scratch.ray, ball.radius)) * snapshot.per_length
    suited = start_ray(record, origin, direction, snapshot.center, snapshot.per_length, 1.0)
    if not (suited and reach < FARTHEST_ORIGIN):
        return np.int64(UNSUITED)
    widen(record, reach)
    limits[0], octant, top = record.limit, octant_of(direction), 1
    stack[0] = 0
    for loose in range(snapshot.loose):
        stack[top] = snapshot.size + loose
        top += 1
    count, soonest, latest = np.int64(0), np.inf, 1.0
    while top > 0:
        slot, top = next_leaf(snapshot, records, octant, mask, limits, stack, top)
        if slot == NONE or (snapshot.loose > 0 and is_known(world, slot, mask, hits, count)):
            continue
        doubt = ball.slack if plain(world.geometry, world.footprints, slot) else 0.0
        t, feature = enter_obstacle(
            world, slot, scratch.ray, ball.radius + doubt, 1.0, scratch.work
        )
        if t > latest:
            continue
        if count < hits.slots.shape[0]:
            hits.slots[count], hits.ts[count], hits.features[count] = slot, t, feature
        count += 1
        if t < soonest and ball.radius > doubt and not (skip_inside and feature == INSIDE):
            soonest = t
            late, _ = enter_obstacle(
                world, slot, scratch.ray, ball.radius - doubt, 1.0, scratch.work
            )
            latest = min(late * (1.0 + SWEEP_SLACK) + SMALL, latest)
            record.limit = limits[0] = limit32(latest, record.unit)
    return count if count > hits.slots.shape[0] else keep_until(hits, count, latest)


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
def next_leaf(snapshot, records, octant, mask, limits, stack, top):
    """(slot of the next leaf that the ray may meet before its limit, or NONE; the new top)."""
    nearest, met = stack_array(WIDTH, np.int32), stack_array(1, np.uint32)
    first = stack_array(1, np.int32)
    first[0] = 0
    while top > 0:
        top -= 1
        if stack[top] >> 32 > limits.view(np.int32)[0]:
            continue
        node = np.int64(np.int32(stack[top] & _CHILD))
        if node < 0:
            return ~node, top
        lanes = stream16(snapshot.planes, node, octant, records, first, met, nearest)
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
def keep_until(hits, count, latest):
    """Forget what is not met until then; return how many are left."""
    kept = np.int64(0)
    for j in range(count):
        if hits.ts[j] <= latest:
            hits.slots[kept], hits.ts[kept] = hits.slots[j], hits.ts[j]
            hits.features[kept] = hits.features[j]
            kept += 1
    return kept
