# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls through the tree to the true shapes.

Only scenes with other shapes than axis-aligned boxes, and balls (from `exact_ball`), come here:
thin rays among boxes are the tree's own. A ball of radius r can touch an obstacle only where its
centre is in the obstacle's box grown by r, so every node is grown by r on the way.
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    INSIDE,
    NONE,
    ORIGIN,
    PAD,
    TINY,
    DynamicBVH,
    compare_hits,
    intersect_node,
    is_leaf,
    leaf_box,
    prepare_ray,
    set_ray,
    traversal_distance,
)
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..geometry.lengths import LARGE, SMALL
from ..geometry.rim import ROUND
from ..store.columns import Columns
from .arguments import Asked, Ball, Found, Hits, Rays, call, new_scratch, world_of
from .contact import contact, enter_shape
from .footprint import enter_footprint, touch_footprint
from .shapes import COORDINATES, FRAME_SLACK, RayAndBox, enter_rounded_boxes, point_along, time_of

EARLY, AT, LATE = range(3)  # of a ball that is larger, itself, smaller, see `exact_ball`


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
    return FRAME_SLACK * radius + (FRAME_SLACK + COORDINATES) * largest


@lean_kernel
def push_children(nodes, node, mask, radius, limit, wide, scratch, top):
    """Put the children that the ray may enter on the stack, the nearer on top."""
    box, stack, entries, bottom = scratch.box, scratch.stack, scratch.entries, top
    for child in (np.int64(nodes[node].left), np.int64(nodes[node].right)):
        if nodes[child].mask & mask != 0:
            grow(nodes[child], radius, box)
            entry = intersect_node(box[0], box[1], scratch.ray, limit, wide)
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


class Best(NamedTuple):
    """The first hit so far; slot NONE without any."""

    slot: Any
    t: Any
    feature: Any


@inlined
def no_hit():
    return Best(np.int64(NONE), np.inf, np.int64(INSIDE))


@lean_kernel
def precedes(world, ray, radius, one, another):
    """Whether a hit comes before another, each a `Best`; ties by handle.

    Between thin hits of axis-aligned boxes as real arithmetic says.
    """
    slot, t, feature = one
    other, other_t, other_feature = another
    if slot == NONE or other == NONE:
        return slot != NONE
    order = -1 if t < other_t else (1 if t > other_t else 0)
    if radius == 0.0 and (
        plain(world.geometry, world.footprints, slot)
        and plain(world.geometry, world.footprints, other)
    ):
        lo, hi = leaf_box(world.nodes, world.tight, 2 * slot)
        other_lo, other_hi = leaf_box(world.nodes, world.tight, 2 * other)
        order = compare_hits(
            ray, lo, hi, (t, feature), other_lo, other_hi, (other_t, other_feature)
        )
    return order < 0 or (order == 0 and world.handles[slot] < world.handles[other])


@inlined
def with_one_more(world, ray, radius, hit, box, other):
    """The first hits so far, of axis-aligned boxes and of other shapes, after one more. Each kind
    by itself: exactly, a box may be before another though its t is not, with a shape between.
    """
    hit = Best(*hit)
    if plain(world.geometry, world.footprints, hit.slot):
        return (hit if precedes(world, ray, radius, hit, box) else box), other
    return box, (hit if precedes(world, ray, radius, hit, other) else other)


@inlined
def first_of(world, ray, radius, box, other):
    return box if precedes(world, ray, radius, box, other) else other


@lean_kernel
def enter_obstacle(world, slot, ray, radius, t_max, work):
    """(t, feature) at which a ray, or a ball swept along it, meets an obstacle; t inf if never."""
    lo, hi = leaf_box(world.nodes, world.tight, 2 * slot)
    return enter_any(
        world.geometry, world.footprints, slot, RayAndBox(ray, lo, hi), radius, t_max, work
    )


class Course(NamedTuple):
    """A ball's way, where no length needs a scale, see `shapes`: the same for all boxes."""

    unit: Any
    """(3,)"""
    pace: Any
    simple: Any
    """Whether it is so."""


@lean_kernel
def course_of(world, ray, radius, unit):
    """The `Course` of a ray; `unit` is filled in."""
    largest, here = radius, world.nodes[world.root]
    for axis in range(ray.shape[1]):
        largest = max(largest, abs(ray[ORIGIN, axis]), abs(here.lo[axis]), abs(here.hi[axis]))
    pace = point_along(ray, 1.0, unit[: ray.shape[1]])
    return Course(unit, pace, radius > SMALL and largest < LARGE)


@lean_kernel
def enter_thrice(world, slot, ray, course, ball, work, found):
    """When a ball that is larger by its slack, the ball itself and a smaller one meet an obstacle
    up to t = 1, to the rows EARLY, AT and LATE of `found`, (ts, features). Only axis-aligned boxes
    tell them apart.
    """
    ts, features = found
    is_plain = plain(world.geometry, world.footprints, slot)
    slack = ball.slack if is_plain else 0.0
    radii = stack_array(3, np.float64)
    radii[EARLY], radii[AT], radii[LATE] = ball.radius + slack, ball.radius, ball.radius - slack
    if is_plain and world.geometry is not None and course.simple:
        lo, hi = leaf_box(world.nodes, world.tight, 2 * slot)
        enter_rounded_boxes(ray[ORIGIN], course.unit, lo, hi, radii, course.pace, found)
        for i in range(3):
            ts[i] = time_of(ts[i], course.pace, 1.0)
        return
    for i in range(3):
        ts[i], features[i] = np.inf, np.int64(ROUND)
        if i > 0 and not is_plain:
            ts[i], features[i] = ts[0], features[0]
        elif radii[i] > 0.0:
            ts[i], features[i] = enter_obstacle(world, slot, ray, radii[i], 1.0, work)


@lean_kernel
def enter_any(geometry, footprints, slot, met, radius, t_max, work):
    t, feature = np.inf, np.int64(INSIDE)
    if geometry is not None:
        t, feature = enter_shape(geometry[0][slot], geometry[1], met, radius, t_max, work)
    if footprints is not None:
        t, feature = enter_footprint(footprints[0][slot], footprints[1], met, radius, t_max, work)
    return t, feature


@lean_kernel
def cast(world, ball, asked, scratch, hits, filled):
    """Write the first hit, or every hit in no order, into hits from `filled` on. Return where the
    next would go: beyond the arrays' end, hits are counted, not written.
    """
    nodes, root, ray, bounds = world.nodes, world.root, scratch.ray, scratch.box
    stack, entries = scratch.stack, scratch.entries
    if root == NONE or nodes[root].mask & asked.mask == 0:
        return filled
    box, other = no_hit(), no_hit()
    grown = ball.radius + max(ball.slack, 0.0) + doubt_of(ray, ball.radius)
    grow(nodes[root], grown, bounds)
    scale, wide = prepare_ray(ray, bounds[0], bounds[1])
    limit = traversal_distance(min(asked.t_max, asked.latest), scale)
    stack[0], entries[0], top = root, intersect_node(bounds[0], bounds[1], ray, limit, wide), 1
    while top > 0:
        top -= 1
        node, entry = stack[top], entries[top]
        if entry > limit * PAD + TINY or entry == np.inf:
            continue
        if not is_leaf(node):
            top = push_children(nodes, node, asked.mask, grown, limit, wide, scratch, top)
            continue
        slot, radius = node >> 1, ball.radius
        if plain(world.geometry, world.footprints, slot):
            radius += ball.slack
        t, feature = enter_obstacle(world, slot, ray, radius, asked.t_max, scratch.work)
        if t == np.inf or (asked.skip_inside and feature == INSIDE):
            continue
        hit = slot, t, np.int64(feature)
        if asked.every:
            filled = write(hit, hits, filled)
            continue
        box, other = with_one_more(world, ray, ball.radius, hit, box, other)
        limit = traversal_distance(min(box.t, other.t), scale)
    first = first_of(world, ray, ball.radius, box, other)
    return filled if first.slot == NONE else write(first, hits, filled)


@inlined
def write(hit, hits, place):
    """Write a hit, if there is room; return where the next would go."""
    if place < hits.slots.shape[0]:
        hits.slots[place], hits.ts[place], hits.features[place] = hit
    return place + 1


@lean_kernel
def touch(world, scratch, radius, hits, j, point, normal):
    """Fill in where hit j meets its obstacle, and the outward normal there."""
    slot, hit = hits.slots[j], (hits.ts[j], hits.features[j])
    lo, hi = leaf_box(world.nodes, world.tight, 2 * slot)
    met, out = RayAndBox(scratch.ray, lo, hi), (point, normal)
    touch_any(world.geometry, world.footprints, slot, met, hit, radius, scratch.work, out)


@lean_kernel
def touch_any(geometry, footprints, slot, met, hit, radius, work, out):
    point, normal = out
    if geometry is not None:
        contact(geometry[0][slot], geometry[1], met, hit, radius, work, point, normal)
    if footprints is not None:
        touch_footprint(footprints[0][slot], footprints[1], met, hit, radius, work, point, normal)


@lean_kernel
def cast_rays(world, rays, skip_inside, every, scratch, found):
    """First hits, or every hit in no order, of many rays, as far as there is room; return how many
    there are.
    """
    offsets, room, point = found.offsets, found.hits.slots.shape[0], Ball(0.0, 0.0)
    offsets[0] = 0
    for i in range(rays.origins.shape[0]):
        set_ray(scratch.ray, rays.origins[i], rays.directions[i])
        asked = Asked(rays.t_max[i], rays.t_max[i], rays.masks[i], skip_inside, every)
        filled = cast(world, point, asked, scratch, found.hits, offsets[i])
        for j in range(offsets[i], min(filled, room)):
            touch(world, scratch, 0.0, found.hits, j, found.points[j], found.normals[j])
        offsets[i + 1] = filled
    return offsets[-1]


def cast_all(
    tree: DynamicBVH, columns: Columns, rays: Rays, skip_inside: bool, every: bool
) -> Found:
    """`cast_rays` with room for what it finds."""
    world, scratch = world_of(tree, columns), new_scratch(tree.ndim)
    count = len(rays.origins)
    offsets, total, room = np.empty(count + 1, np.int64), max(count, 16), 0
    while total > room:
        room = total
        hits = Hits(np.empty(room, np.int64), np.empty(room), np.empty(room, np.int64))
        found = Found(offsets, hits, np.zeros((room, 3)), np.zeros((room, 3)))
        total = call(cast_rays, world, rays, skip_inside, every, scratch, found)
    hits = Hits(*(column[:total] for column in hits))
    return Found(offsets, hits, found.points[:total], found.normals[:total])
