# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls through the tree to the true shapes.

Only scenes with other shapes than axis-aligned boxes, and balls, come here: thin rays among boxes
are the tree's own. A ball of radius r can touch an obstacle only where its centre is in the
obstacle's box grown by r, so every node is grown by r on the way.

`tree` is the tuple of arrays that the tree's own kernels take. Of `solids` (records of
`columns.GEOMETRY`, one a slot) and `prints` (of `footprint.FOOTPRINT`) one is None: numba drops a
branch that asks for what is None, so that a planar scene compiles none of the solid shapes.
"""

import numpy as np

from ..tree.compiling import kernel
from ..tree.nodes import DEEPEST, NONE, is_leaf, leaf_box
from ..tree.slab import (
    DIRECTION,
    INSIDE,
    ORIGIN,
    PAD,
    TINY,
    compare_hits,
    enters,
    prepare_ray,
    traversal_distance,
)
from .contact import contact, enter_shape
from .ray_footprint import enter_footprint, touch_footprint


@kernel
def grow(node, radius, box):
    """A node's box grown by the radius on all sides, rounded outwards."""
    for axis in range(node.lo.shape[0]):
        box[0, axis], box[1, axis] = node.lo[axis], node.hi[axis]
        if radius > 0.0:
            box[0, axis] -= radius
            box[1, axis] += radius
            box[0, axis] -= abs(box[0, axis]) * 2.0**-52
            box[1, axis] += abs(box[1, axis]) * 2.0**-52


@kernel
def push_children(nodes, node, mask, radius, ray, limit, wide, box, stack, entries, top):
    """Put the children that the ray may enter on the stack, the nearer on top."""
    bottom = top
    for child in (np.int64(nodes[node].left), np.int64(nodes[node].right)):
        if nodes[child].mask & mask != 0:
            grow(nodes[child], radius, box)
            entry = enters(box[0], box[1], ray, limit, wide)
            if entry < np.inf:
                stack[top], entries[top] = child, entry
                top += 1
    if top == bottom + 2 and entries[bottom] < entries[bottom + 1]:
        stack[bottom], stack[bottom + 1] = stack[bottom + 1], stack[bottom]
        entries[bottom], entries[bottom + 1] = entries[bottom + 1], entries[bottom]
    return top


@kernel
def plain(solids, prints, slot):
    """Whether an obstacle is an axis-aligned box."""
    if solids is not None:
        return not solids[slot].shaped
    if prints is not None:
        return not prints[slot].shaped
    return True


@kernel
def precedes(tree, solids, prints, ray, radius, slot, t, feature, other, other_t, other_feature):
    """Whether a hit comes before another; ties by handle. Between thin hits of boxes exactly."""
    nodes, tight, handles, _ = tree
    order = -1 if t < other_t else (1 if t > other_t else 0)
    if radius == 0.0 and plain(solids, prints, slot) and plain(solids, prints, other):
        lo, hi = leaf_box(nodes, tight, 2 * slot)
        other_lo, other_hi = leaf_box(nodes, tight, 2 * other)
        order = compare_hits(lo, hi, t, feature, other_lo, other_hi, other_t, other_feature, ray)
    return order < 0 or (order == 0 and handles[slot] < handles[other])


@kernel
def cast(tree, solids, prints, ray, radius, t_max, mask, skip_inside, every, hits, filled, work):
    """Append the first hit, or every hit in no order, to hits = (slots, ts, features) from `filled`.

    Return hits, grown if need be, and the new count.
    """
    nodes, tight, _, root = tree
    slots, ts, features = hits
    if root == NONE or nodes[root].mask & mask == 0:
        return slots, ts, features, filled
    begin = filled
    box = np.empty((2, ray.shape[1]))
    grow(nodes[root], radius, box)
    scale, wide = prepare_ray(ray, box[0], box[1])
    limit = traversal_distance(t_max, scale)
    stack, entries = np.empty(DEEPEST, np.int64), np.empty(DEEPEST)
    stack[0], entries[0], top = root, enters(box[0], box[1], ray, limit, wide), 1
    while top > 0:
        top -= 1
        node, entry = stack[top], entries[top]
        if entry > limit * PAD + TINY or entry == np.inf:
            continue
        if not is_leaf(node):
            top = push_children(
                nodes, node, mask, radius, ray, limit, wide, box, stack, entries, top
            )
            continue
        slot = node >> 1
        lo, hi = leaf_box(nodes, tight, node)
        t, feature = np.inf, np.int64(INSIDE)
        if solids is not None:
            t, feature = enter_shape(solids[slot], lo, hi, ray, radius, t_max, work)
        if prints is not None:
            t, feature = enter_footprint(prints[slot], lo, hi, ray, radius, t_max, work)
        if t == np.inf or (skip_inside and feature == INSIDE):
            continue
        if not every and filled > begin:
            best = slots[begin], ts[begin], features[begin]
            if not precedes(tree, solids, prints, ray, radius, slot, t, feature, *best):
                continue
            filled = begin
        if filled == slots.shape[0]:
            slots, ts, features = grown(slots), grown(ts), grown(features)
        slots[filled], ts[filled], features[filled] = slot, t, feature
        filled += 1
        if not every:
            limit = traversal_distance(t, scale)
    return slots, ts, features, filled


@kernel
def cast_rays(tree, solids, prints, origins, directions, radius, t_max, masks, skip_inside, every):
    """First hits, or every hit in no order, of many rays: (offsets, slots, ts, points, normals).

    Those of ray i stand at [offsets[i], offsets[i + 1]).
    """
    count, ndim = origins.shape
    ray, work = np.empty((3, ndim)), np.empty((5, 3))
    offsets = np.zeros(count + 1, np.int64)
    room = max(count, 16)
    slots, ts, features = np.empty(room, np.int64), np.empty(room), np.empty(room, np.int64)
    points, normals = np.zeros((room, 3)), np.zeros((room, 3))
    for i in range(count):
        ray[ORIGIN], ray[DIRECTION] = origins[i], directions[i]
        slots, ts, features, filled = cast(
            tree, solids, prints, ray, radius, t_max[i], masks[i], skip_inside, every,
            (slots, ts, features), offsets[i], work,
        )  # fmt: skip
        if slots.shape[0] > points.shape[0]:
            points, normals = widened(points, slots.shape[0]), widened(normals, slots.shape[0])
        for j in range(offsets[i], filled):
            slot, t, feature, point, normal = slots[j], ts[j], features[j], points[j], normals[j]
            lo, hi = leaf_box(tree[0], tree[1], 2 * slot)
            if solids is not None:
                contact(solids[slot], lo, hi, ray, t, feature, radius, work, point, normal)
            if prints is not None:
                touch_footprint(prints[slot], lo, hi, ray, t, feature, work, point, normal)
        offsets[i + 1] = filled
    filled = offsets[count]
    return offsets, slots[:filled], ts[:filled], points[:filled], normals[:filled]


@kernel
def widened(rows, count):
    more = np.zeros((count, 3))
    more[: rows.shape[0]] = rows
    return more


@kernel
def grown(array):
    bigger = np.empty(2 * array.shape[0], array.dtype)
    bigger[: array.shape[0]] = array
    return bigger
