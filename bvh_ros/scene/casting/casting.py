# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls through the tree to the true shapes.

Only scenes with other shapes than axis-aligned boxes, and balls (from `ball_casting`), come here:
thin rays among boxes are the tree's own. A ball of radius r can touch an obstacle only where its
centre is in the obstacle's box grown by r, so every node is grown by r on the way.

`tree` is the tuple of arrays that the tree's own kernels take. Of `geometry` (a pair: records of
`columns.GEOMETRY`, one a slot, and the `mesh_store.Hulls`, or None) and `footprints` (the same
with records of `footprint.FOOTPRINT`) one is None: numba drops a branch that asks for what is
None, so that a planar scene compiles none of the solid shapes, and a scene without meshes nothing
of theirs.
"""

import numpy as np
from numpy.typing import NDArray

from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import lean_kernel
from ...tree.nodes import DEEPEST, NONE, is_leaf, leaf_box
from ...tree.rays.slab import (
    INSIDE,
    ORIGIN,
    PAD,
    RAY_ROWS,
    TINY,
    compare_hits,
    intersect_node,
    prepare_ray,
    set_ray,
    traversal_distance,
)
from ..geometry.shapes import Floats
from ..store.columns import Columns
from ..store.registry import Slots
from .contact import contact, enter_shape
from .frame import COORDINATES, SLACK
from .ray_footprint import enter_footprint, touch_footprint


@lean_kernel
def grow(node, radius, box):
    """A node's box grown by the radius on all sides, rounded outwards."""
    for axis in range(node.lo.shape[0]):
        box[0, axis], box[1, axis] = node.lo[axis], node.hi[axis]
        if radius > 0.0:
            box[0, axis] -= radius
            box[1, axis] += radius
            box[0, axis] -= abs(box[0, axis]) * 2.0**-52
            box[1, axis] += abs(box[1, axis]) * 2.0**-52


@lean_kernel
def doubt_of(ray, radius):
    """By how much a ray may pass a shape's box and yet touch the shape, within its frame's slack:
    the ray's own share. That of the shape is in its box.
    """
    largest = 0.0
    for axis in range(ray.shape[1]):
        largest = max(largest, abs(ray[ORIGIN, axis]))
    return SLACK * radius + (SLACK + COORDINATES) * largest


@lean_kernel
def push_children(nodes, node, mask, radius, limit, wide, scratch, top):
    """Put the children that the ray may enter on the stack, the nearer on top."""
    ray, box, _, stack, entries = scratch
    bottom = top
    for child in (np.int64(nodes[node].left), np.int64(nodes[node].right)):
        if nodes[child].mask & mask != 0:
            grow(nodes[child], radius, box)
            entry = intersect_node(box[0], box[1], ray, limit, wide)
            if entry < np.inf:
                stack[top], entries[top] = child, entry
                top += 1
    if top == bottom + 2 and entries[bottom] < entries[bottom + 1]:
        stack[bottom], stack[bottom + 1] = stack[bottom + 1], stack[bottom]
        entries[bottom], entries[bottom + 1] = entries[bottom + 1], entries[bottom]
    return top


@lean_kernel
def plain(geometry, footprints, slot):
    """Whether an obstacle is an axis-aligned box."""
    if geometry is not None:
        return not geometry[0][slot].shaped
    if footprints is not None:
        return not footprints[0][slot].shaped
    return True


@lean_kernel
def precedes(tree, geometry, footprints, ray, radius, one, another):
    """Whether a hit (slot, t, feature) comes before another; ties by handle.

    Between thin hits of axis-aligned boxes as real arithmetic says.
    """
    nodes, tight, handles, _ = tree
    slot, t, feature = one
    other, other_t, other_feature = another
    order = -1 if t < other_t else (1 if t > other_t else 0)
    if radius == 0.0 and plain(geometry, footprints, slot) and plain(geometry, footprints, other):
        lo, hi = leaf_box(nodes, tight, 2 * slot)
        other_lo, other_hi = leaf_box(nodes, tight, 2 * other)
        order = compare_hits(
            ray, lo, hi, (t, feature), other_lo, other_hi, (other_t, other_feature)
        )
    return order < 0 or (order == 0 and handles[slot] < handles[other])


@lean_kernel
def enter_obstacle(tree, geometry, footprints, slot, ray, radius, t_max, work):
    """(t, feature) at which a ray, or a ball swept along it, meets an obstacle; t inf if never."""
    lo, hi = leaf_box(tree[0], tree[1], 2 * slot)
    t, feature = np.inf, np.int64(INSIDE)
    if geometry is not None:
        t, feature = enter_shape(geometry[0][slot], geometry[1], lo, hi, ray, radius, t_max, work)
    if footprints is not None:
        t, feature = enter_footprint(
            footprints[0][slot], footprints[1], lo, hi, ray, radius, t_max, work
        )
    return t, feature


@lean_kernel
def cast(
    tree,
    geometry,
    footprints,
    radius,
    slack,
    t_max,
    latest,
    mask,
    skip_inside,
    every,
    scratch,
    hits,
    filled,
):
    """Write the first hit, or every hit in no order, into hits from `filled` on; none is left out
    that is not after `latest`.

    hits = (slots, ts, features). Return where the next would go: beyond the arrays' end, hits are
    counted, not written. For axis-aligned boxes the ball is larger by `slack`.
    """
    nodes, _, _, root = tree
    ray, box, work, stack, entries = scratch
    slots, ts, features = hits
    if root == NONE or nodes[root].mask & mask == 0:
        return filled
    begin = filled
    grown = radius + max(slack, 0.0) + doubt_of(ray, radius)
    grow(nodes[root], grown, box)
    scale, wide = prepare_ray(ray, box[0], box[1])
    limit = traversal_distance(min(t_max, latest), scale)
    stack[0], entries[0], top = root, intersect_node(box[0], box[1], ray, limit, wide), 1
    while top > 0:
        top -= 1
        node, entry = stack[top], entries[top]
        if entry > limit * PAD + TINY or entry == np.inf:
            continue
        if not is_leaf(node):
            top = push_children(nodes, node, mask, grown, limit, wide, scratch, top)
            continue
        slot = node >> 1
        ball = radius + slack if plain(geometry, footprints, slot) else radius
        t, feature = enter_obstacle(tree, geometry, footprints, slot, ray, ball, t_max, work)
        if t == np.inf or (skip_inside and feature == INSIDE):
            continue
        if not every and filled > begin:
            best = slots[begin], ts[begin], features[begin]
            if not precedes(tree, geometry, footprints, ray, radius, (slot, t, feature), best):
                continue
            filled = begin
        if filled < slots.shape[0]:
            slots[filled], ts[filled], features[filled] = slot, t, feature
        filled += 1
        if not every:
            limit = traversal_distance(t, scale)
    return filled


@lean_kernel
def touch(tree, geometry, footprints, ray, radius, hits, j, work, point, normal):
    """Fill in where hit j meets its obstacle, and the outward normal there."""
    slots, ts, features = hits
    slot, t, feature = slots[j], ts[j], features[j]
    lo, hi = leaf_box(tree[0], tree[1], 2 * slot)
    if geometry is not None:
        records, hulls = geometry
        contact(records[slot], hulls, lo, hi, ray, t, feature, radius, work, point, normal)
    if footprints is not None:
        records, hulls = footprints
        touch_footprint(records[slot], hulls, lo, hi, ray, t, feature, radius, work, point, normal)


@lean_kernel
def cast_rays(tree, geometry, footprints, rays, skip_inside, every, scratch, found):
    """First hits, or every hit in no order, of many rays; return how many there are.

    rays = (origins, directions, t_max, masks); found = (offsets, slots, ts, features, points,
    normals): what ray i hits goes to [offsets[i], offsets[i + 1]), as far as there is room.
    """
    origins, directions, t_max, masks = rays
    offsets, slots, ts, features, points, normals = found
    ray, work, hits = scratch[0], scratch[2], (slots, ts, features)
    offsets[0] = 0
    for i in range(origins.shape[0]):
        set_ray(ray, origins[i], directions[i])
        filled = cast(
            tree, geometry, footprints, 0.0, 0.0, t_max[i], t_max[i], masks[i], skip_inside, every,
            scratch, hits, offsets[i],
        )  # fmt: skip
        for j in range(offsets[i], min(filled, slots.shape[0])):
            touch(tree, geometry, footprints, ray, 0.0, hits, j, work, points[j], normals[j])
        offsets[i + 1] = filled
    return offsets[-1]


def cast_all(
    tree: DynamicBVH,
    columns: Columns,
    rays: tuple[Floats, Floats, Floats, NDArray[np.uint32]],
    skip_inside: bool,
    every: bool,
) -> tuple[Slots, Slots, Floats, Floats, Floats]:
    """`cast_rays` with room for what it finds: offsets, slots, t, points and normals."""
    geometry, footprints = columns.geometry_arrays(), columns.footprint_arrays()
    count, ndim = rays[0].shape
    scratch = (
        np.empty((RAY_ROWS, ndim)), np.empty((2, ndim)), np.empty((5, 3)),
        np.empty(DEEPEST, np.int64), np.empty(DEEPEST),
    )  # fmt: skip
    offsets, total, room = np.empty(count + 1, np.int64), max(count, 16), 0
    while total > room:
        room = total
        slots, ts, features = np.empty(room, np.int64), np.empty(room), np.empty(room, np.int64)
        points, normals = np.zeros((room, 3)), np.zeros((room, 3))
        found = (offsets, slots, ts, features, points, normals)
        total = cast_rays(
            tree.arrays(), geometry, footprints, rays, skip_inside, every, scratch, found
        )
    return offsets, slots[:total], ts[:total], points[:total], normals[:total]
