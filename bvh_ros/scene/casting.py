# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls through the tree to the true shapes.

Only scenes with other shapes than axis-aligned boxes, and balls, come here: thin rays among boxes are the tree's own.
A ball of radius r can touch an obstacle only where its centre is in the obstacle's box grown by r, so the nodes are grown by r.
"""

import numpy as np

from ..tree.compiling import kernel
from ..tree.nodes import NONE, is_leaf, leaf_box
from ..tree.overlapping import grown
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
def precedes(
    nodes, tight, handles, shapes, slot, t, feature, other, other_t, other_feature, radius, ray
):
    """Whether a hit comes before another: exactly between thin hits of axis-aligned boxes, else by t; ties by handle."""
    order = -1 if t < other_t else (1 if t > other_t else 0)
    if radius == 0.0 and not shapes[slot].shaped and not shapes[other].shaped:
        lo, hi = leaf_box(nodes, tight, 2 * slot)
        other_lo, other_hi = leaf_box(nodes, tight, 2 * other)
        order = compare_hits(lo, hi, t, feature, other_lo, other_hi, other_t, other_feature, ray)
    return order < 0 or (order == 0 and handles[slot] < handles[other])


@kernel
def cast(
    nodes,
    heights,
    tight,
    handles,
    root,
    shapes,
    ray,
    radius,
    t_max,
    mask,
    skip_inside,
    every,
    hits,
    ts,
    features,
    filled,
):
    """Append the first hit, or every hit in no order, to (hits, ts, features) from `filled` on; return the arrays and the count."""
    if root == NONE or nodes[root].mask & mask == 0:
        return hits, ts, features, filled
    begin = filled
    box, local, corners = np.empty((2, ray.shape[1])), np.empty((2, 3)), np.empty((2, 3))
    grow(nodes[root], radius, box)
    scale, wide = prepare_ray(ray, box[0], box[1])
    limit = traversal_distance(t_max, scale)
    stack, entries = (
        np.empty(np.int64(heights[root]) + 2, np.int64),
        np.empty(np.int64(heights[root]) + 2),
    )
    stack[0], entries[0], top = root, enters(box[0], box[1], ray, limit, wide), 1
    while top > 0:
        top -= 1
        node = stack[top]
        if entries[top] > limit * PAD + TINY or entries[top] == np.inf:
            continue
        if not is_leaf(node):
            top = push_children(
                nodes, node, mask, radius, ray, limit, wide, box, stack, entries, top
            )
            continue
        slot = node >> 1
        lo, hi = leaf_box(nodes, tight, node)
        t, feature = enter_shape(shapes[slot], lo, hi, ray, radius, t_max, local, corners)
        if t == np.inf or (skip_inside and feature == INSIDE):
            continue
        if not every and filled > begin:
            if not precedes(
                nodes,
                tight,
                handles,
                shapes,
                slot,
                t,
                feature,
                hits[begin],
                ts[begin],
                features[begin],
                radius,
                ray,
            ):
                continue
            filled = begin
        if filled == hits.shape[0]:
            hits, ts, features = grown(hits), grown(ts), grown(features)
        hits[filled], ts[filled], features[filled] = slot, t, feature
        filled += 1
        if not every:
            limit = traversal_distance(t, scale)
    return hits, ts, features, filled


@kernel
def push_children(nodes, node, mask, radius, ray, limit, wide, box, stack, entries, top):
    """Put the children that the ray may enter on the stack, the nearer on top."""
    for child in (np.int64(nodes[node].right), np.int64(nodes[node].left)):
        if nodes[child].mask & mask == 0:
            continue
        grow(nodes[child], radius, box)
        entry = enters(box[0], box[1], ray, limit, wide)
        if entry < np.inf:
            stack[top], entries[top] = child, entry
            top += 1
    if top > 1 and entries[top - 2] < entries[top - 1] and nodes[stack[top - 2]].parent == node:
        stack[top - 2], stack[top - 1] = stack[top - 1], stack[top - 2]
        entries[top - 2], entries[top - 1] = entries[top - 1], entries[top - 2]
    return top


@kernel
def cast_rows(
    nodes,
    heights,
    tight,
    handles,
    root,
    shapes,
    origins,
    directions,
    radius,
    t_max,
    masks,
    skip_inside,
    found,
):
    """First hits of many rays: fill (slots, ts, points, normals); slot NONE and t inf where nothing is hit."""
    slots, ts, points, normals = found
    features = np.empty(slots.shape[0], np.int64)
    ray, local, corners = np.empty((3, origins.shape[1])), np.empty((2, 3)), np.empty((2, 3))
    for i in range(slots.shape[0]):
        for axis in range(origins.shape[1]):
            ray[ORIGIN, axis], ray[DIRECTION, axis] = origins[i, axis], directions[i, axis]
        filled = cast(
            nodes,
            heights,
            tight,
            handles,
            root,
            shapes,
            ray,
            radius,
            t_max[i],
            masks[i],
            skip_inside,
            False,
            slots,
            ts,
            features,
            i,
        )[3]
        if filled == i:
            slots[i], ts[i] = NONE, np.inf
            continue
        lo, hi = leaf_box(nodes, tight, 2 * slots[i])
        contact(
            shapes[slots[i]],
            lo,
            hi,
            ray,
            ts[i],
            features[i],
            radius,
            local,
            corners,
            points[i],
            normals[i],
        )


@kernel
def cast_every(
    nodes,
    heights,
    tight,
    handles,
    root,
    shapes,
    origin,
    direction,
    radius,
    t_max,
    mask,
    skip_inside,
):
    """All hits of one ray, in no order: (slots, ts, points, normals)."""
    ray, local, corners = np.empty((3, origin.shape[0])), np.empty((2, 3)), np.empty((2, 3))
    ray[ORIGIN], ray[DIRECTION] = origin, direction
    slots, ts, features, filled = cast(
        nodes,
        heights,
        tight,
        handles,
        root,
        shapes,
        ray,
        radius,
        t_max,
        mask,
        skip_inside,
        True,
        np.empty(16, np.int64),
        np.empty(16),
        np.empty(16, np.int64),
        0,
    )
    points, normals = np.empty((filled, 3)), np.empty((filled, 3))
    for i in range(filled):
        lo, hi = leaf_box(nodes, tight, 2 * slots[i])
        contact(
            shapes[slots[i]],
            lo,
            hi,
            ray,
            ts[i],
            features[i],
            radius,
            local,
            corners,
            points[i],
            normals[i],
        )
    return slots[:filled], ts[:filled], points, normals
