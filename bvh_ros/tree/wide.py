# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A read-only snapshot of the tree for batches of rays: nodes of eight children, whose boxes are tested with one vector operation.

The snapshot is a filter and decides nothing. Its boxes are float32 in units in which the scene fits into [-1, 1], rounded outwards;
the distance of a plane is fma(plane, 1 / d, -o / d). With e = 2**-24, the rounding of 1 / d, of o / d and of the result make an
error of at most |1 / d| (1 + |o|) 2 e (1 + 4 e), so every entry is lowered and every exit raised by PAD32 |1 / d| (1 + |o|), twice
that. (Ize 2013 bounds (plane - o) * (1 / d); the fused form needs the term with |o|.) The directions are scaled to a largest
component of 1, and smaller ones than 2**-40 are taken for 2**-40: such an axis' exit then is beyond 2**17 at least, further than
anything that a ray from within 2**10 scene sizes can meet. Other rays take the binary tree.

What passes is decided in float64 by `slab`, as everywhere.
"""

import math

import numpy as np

from .area import area_scale, node_area
from .compiling import inlined, kernel, lean_kernel
from .nodes import ALL, DEEPEST, NONE, is_leaf, leaf_box
from .slab import (
    DIRECTION,
    INSIDE,
    INVERSE,
    ORIGIN,
    PAD,
    TINY,
    compare_hits,
    meets,
    near_plane,
    plane_distance,
)
from .overlapping import grown
from .machine import LANES, slab8, stack_array, trailing_zeros

PAD32 = 2.0**-22
FARTHEST_ORIGIN = 2.0**10
STEEPEST = 2.0**40
DEEPEST_WIDE = DEEPEST * (LANES - 1) + 1
ALL32 = np.uint32(ALL)
MISSES, MEETS, ASK = range(3)


@kernel
def post_order(nodes, root):
    """Inner nodes below and with `root`, parents before children: read it backwards for children first."""
    order, stack = np.empty(64, np.int64), stack_array(DEEPEST, np.int64)
    stack[0], top, count = root, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        if is_leaf(node):
            continue
        if count == order.shape[0]:
            order = grown(order, count + 1)
        order[count] = node
        count += 1
        stack[top], stack[top + 1] = nodes[node].left, nodes[node].right
        top += 2
    return order[:count]


@kernel
def plan_collapse(nodes, root, least, shares):
    """Least total area of wide nodes, by dynamic programming (Ylitie et al. 2017, section 3.1).

    least[k, j - 1]: of the subtree of inner node 2 k + 1 when it may take up to j lanes of the wide node above.
    shares[k, j - 1]: how many of those lanes its left child gets; 0 if it takes one lane, as a wide node of its own.
    """
    scale = area_scale(nodes, root, root)
    order = post_order(nodes, root)
    for place in range(order.shape[0] - 1, -1, -1):
        node = order[place]
        left, right = np.int64(nodes[node].left), np.int64(nodes[node].right)
        here, share = least[node >> 1], shares[node >> 1]
        for lanes in range(2, LANES + 1):
            best, best_share = np.float32(np.inf), 0
            for given in range(1, lanes):
                cost = np.float32(0.0)
                if not is_leaf(left):
                    cost += least[left >> 1, given - 1]
                if not is_leaf(right):
                    cost += least[right >> 1, lanes - given - 1]
                if cost < best:
                    best, best_share = cost, given
            here[lanes - 1], share[lanes - 1] = best, best_share
        here[0], share[0] = np.float32(node_area(nodes, node, scale)) + here[LANES - 1], 0
        for lanes in range(2, LANES + 1):
            if here[lanes - 2] <= here[lanes - 1]:
                here[lanes - 1], share[lanes - 1] = here[lanes - 2], share[lanes - 2]


@lean_kernel
def _gather(nodes, shares, node, members):
    """The descendants that share the lanes of the wide node made of inner node `node`; return how many."""
    members[0], members[1] = nodes[node].left, nodes[node].right
    lanes = stack_array(LANES, np.int64)
    lanes[0] = shares[node >> 1, LANES - 1]
    lanes[1] = LANES - lanes[0]
    count, i = 2, 0
    while i < count:
        member = members[i]
        given = 0 if is_leaf(member) else shares[member >> 1, lanes[i] - 1]
        if given == 0:
            i += 1
            continue
        members[i], members[count] = nodes[member].left, nodes[member].right
        lanes[count] = lanes[i] - given
        lanes[i] = given
        count += 1
    return count


@inlined
def _down32(x):
    return np.nextafter(np.float32(x), np.float32(-np.inf))


@inlined
def _up32(x):
    return np.nextafter(np.float32(x), np.float32(np.inf))


@kernel
def collapse(nodes, root, shares, center, per_length, planes, kids, masks):
    """Fill planes, kids (a wide node, or ~slot of a leaf) and masks, eight a node; return how many wide nodes there are.

    Node by node in the order of breadth, so that the top, which every ray visits, lies together.
    """
    ndim = nodes[root].lo.shape[0]
    stride = 2 * ndim * LANES
    members = np.empty(LANES, np.int64)
    queue = np.empty(planes.shape[0] // stride, np.int64)
    queue[0], made, at = root, 1, 0
    while at < made:
        node = queue[at]
        members[0], size = node, 1
        if not is_leaf(node):
            size = _gather(nodes, shares, node, members)
        for lane in range(LANES):
            place = at * stride + lane
            here = nodes[members[lane if lane < size else 0]]
            visible = lane < size and here.mask != 0
            for axis in range(ndim):
                lo, hi = np.float32(np.inf), np.float32(-np.inf)
                if visible:
                    lo = _down32((here.lo[axis] - center[axis]) * per_length)
                    hi = _up32((here.hi[axis] - center[axis]) * per_length)
                planes[place + axis * LANES] = lo
                planes[place + (axis + ndim) * LANES] = hi
            place = at * LANES + lane
            masks[place], kids[place] = 0, -1
            if visible:
                masks[place] = here.mask
                if is_leaf(members[lane]):
                    kids[place] = ~np.int32(members[lane] >> 1)
                else:
                    kids[place] = made
                    queue[made] = members[lane]
                    made += 1
        at += 1
    return made


@inlined
def quick_decision(lo, hi, ray, best_t):
    """Decide where rounding cannot matter: (verdict, t, axis).

    MISSES: surely not met, or surely after best_t. MEETS: surely met, before best_t, and entered last through `axis`. ASK: `meets`
    must tell. t has an error of three roundings. Distances from the ray neither overflow nor have an infinite inverse here.
    """
    entry, second, leave = 0.0, 0.0, best_t
    entered = INSIDE
    for axis in range(lo.shape[0]):
        inverse = ray[INVERSE, axis]
        at_lo = (lo[axis] - ray[ORIGIN, axis]) * inverse
        at_hi = (hi[axis] - ray[ORIGIN, axis]) * inverse
        near, far = (at_lo, at_hi) if inverse > 0.0 else (at_hi, at_lo)
        if near > entry:
            entry, second, entered = near, entry, axis
        elif near > second:
            second = near
        leave = far if far < leave else leave
    if entry > leave * PAD + TINY:
        return MISSES, entry, entered
    if entry * PAD + TINY < leave and second * PAD + TINY < entry:
        return MEETS, entry, entered
    return ASK, entry, entered


@inlined
def fill_ray(ray, center, per_length, ndim):
    """Write inverses; return (suited, largest component of the direction)."""
    largest, farthest, smallest = 0.0, 0.0, np.inf
    for axis in range(ndim):
        direction = abs(ray[DIRECTION, axis])
        largest = max(largest, direction)
        smallest = min(smallest, direction if direction > 0.0 else np.inf)
        farthest = max(farthest, abs(ray[ORIGIN, axis] - center[axis]) * per_length)
        ray[INVERSE, axis] = 1.0 / ray[DIRECTION, axis]
    suited = 1e-200 < largest < 1e200 and smallest > 1e-290 and farthest < FARTHEST_ORIGIN
    return suited, largest


@inlined
def axis_constants(ray, axis, center, per_length, largest, ndim):
    """For `slab8`: near and far plane offsets, inverse, near shift, far shift of one axis, with the largest direction made 1."""
    inverse = ray[INVERSE, axis] * largest
    slope = min(abs(inverse), STEEPEST)
    origin = (ray[ORIGIN, axis] - center[axis]) * per_length
    pad = PAD32 * slope * (1.0 + abs(origin))
    slope = math.copysign(slope, inverse)
    near = axis * LANES if slope > 0.0 else (axis + ndim) * LANES
    far = (2 * axis + ndim) * LANES - near
    shift = -origin * slope
    return near, far, np.float32(slope), np.float32(shift - pad), np.float32(shift + pad)


@inlined
def limit32(t, unit):
    """A distance in the snapshot's units, surely not less than t."""
    return np.float32(t * unit) * np.float32(1.0 + PAD32) + np.float32(1e-30)


@inlined
def cast(
    planes, kids, wide_masks, center, per_length, nodes, tight, handles, ray, largest, t_max, mask, skip_inside, any_hit, stack, stack_entry, entries
):
    """First hit of one ray (or any): (slot, axis); slot NONE where there is none."""
    ndim = ray.shape[1]
    stride = 2 * ndim * LANES
    near_x, far_x, inverse_x, in_x, out_x = axis_constants(ray, 0, center, per_length, largest, ndim)
    near_y, far_y, inverse_y, in_y, out_y = axis_constants(ray, 1, center, per_length, largest, ndim)
    near_z, far_z, inverse_z, in_z, out_z = axis_constants(ray, ndim - 1, center, per_length, largest, ndim)
    unit = largest * per_length  # t times this is the distance in the snapshot's units
    best, best_t, best_axis = np.int64(NONE), t_max, np.int64(INSIDE)
    limit = limit32(t_max, unit)
    stack[0], stack_entry[0], top = 0, 0.0, 1
    while top > 0:
        top -= 1
        if stack_entry[top] > limit:
            continue
        child = stack[top]
        if child < 0:
            slot = np.int64(~child)
            lo, hi = leaf_box(nodes, tight, 2 * slot)
            verdict, t, axis = quick_decision(lo, hi, ray, best_t)
            if verdict == MISSES:
                continue
            if verdict == ASK:
                met, t, axis = meets(lo, hi, ray, t_max)
                if not met or (skip_inside and axis == INSIDE):
                    continue
                if best != NONE:
                    best_lo, best_hi = leaf_box(nodes, tight, 2 * best)
                    order = compare_hits(lo, hi, t, axis, best_lo, best_hi, best_t, best_axis, ray)
                    if order > 0 or (order == 0 and handles[slot] > handles[best]):
                        continue
            best, best_t, best_axis = slot, t, axis
            limit = limit32(t, unit)
            if any_hit:
                break
            continue
        base = np.int64(child)
        if ndim == 2:
            hits = slab8(
                planes, base * stride, (near_x, near_y), (far_x, far_y), (inverse_x, inverse_y), (in_x, in_y), (out_x, out_y),
                limit, entries,
            )
        else:
            hits = slab8(
                planes, base * stride, (near_x, near_y, near_z), (far_x, far_y, far_z), (inverse_x, inverse_y, inverse_z),
                (in_x, in_y, in_z), (out_x, out_y, out_z), limit, entries,
            )
        floor = top
        while hits != np.uint32(0):
            lane = np.int64(trailing_zeros(hits))
            hits = np.uint32(hits & np.uint32(hits - np.uint32(1)))
            if mask != ALL32 and wide_masks[base * LANES + lane] & mask == 0:
                continue
            entry = entries[lane]
            place = top
            while place > floor and stack_entry[place - 1] < entry:
                stack_entry[place], stack[place] = stack_entry[place - 1], stack[place - 1]
                place -= 1
            stack_entry[place], stack[place] = entry, kids[base * LANES + lane]
            top += 1
    return best, best_axis


@kernel
def cast_rows(
    planes, kids, wide_masks, center, per_length, nodes, tight, handles, origins, directions, t_max, masks, skip_inside,
    any_hit, order, start, stop, slots, ts, axes, left_over,
):
    """Cast the rays order[start:stop]; rays not suited are marked in `left_over`."""
    ndim = origins.shape[1]
    ray = np.empty((3, ndim))
    stack, stack_entry = stack_array(DEEPEST_WIDE, np.int32), stack_array(DEEPEST_WIDE, np.float32)
    entries = stack_array(LANES, np.float32)
    for j in range(start, stop):
        i = order[j]
        for axis in range(ndim):
            ray[ORIGIN, axis], ray[DIRECTION, axis] = origins[i, axis], directions[i, axis]
        suited, largest = fill_ray(ray, center, per_length, ndim)
        left_over[i] = not suited
        if not suited:
            continue
        slot, axis = cast(
            planes, kids, wide_masks, center, per_length, nodes, tight, handles, ray, largest, t_max[i], masks[i], skip_inside,
            any_hit, stack, stack_entry, entries,
        )
        slots[i], axes[i], ts[i] = slot, axis, np.inf
        if slot != NONE:
            lo, hi = leaf_box(nodes, tight, 2 * slot)
            ts[i] = 0.0
            if axis != INSIDE:
                ts[i] = plane_distance(near_plane(lo, hi, ray, axis), ray[ORIGIN, axis], ray[DIRECTION, axis])
