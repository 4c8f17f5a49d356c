# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first obstacle that a ray, or ball, meets among those that move: one walk through the tree,
nearest first. `moving` says what is met, and how; nobody may come to rest meanwhile.
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.motion.bounds import covers
from ...tree.motion.casting import OUTSIDE, descend, locate
from ...tree.motion.meeting import Course, box_of, is_before, meet
from ...tree.nodes import DEEPEST, NONE
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import INSIDE, PAD, RAY_FLOATS, RAY_ROWS, TINY, set_ray, set_swept_box
from ...tree.store.turns import REFUSED, begin_query, end_query
from .casting import enter_obstacle, plain, touch


class Ways(NamedTuple):
    """n rays, or balls that go along them."""

    origins: Any
    directions: Any
    t_max: Any
    masks: Any
    radii: Any
    at: Any
    """s, as how many seconds a unit of t takes."""
    pace: Any
    more: Any
    """By how much a ray may pass an obstacle's box, and yet touch what has grown in it."""


class First(NamedTuple):
    """What they meet."""

    hits: Any
    """`Hits`, (n,); NONE where the way is free."""
    points: Any
    normals: Any
    """(n, 3)"""


class Best(NamedTuple):
    """The first hit so far of axis-aligned boxes by thin rays, decided exactly, and of others."""

    slot: Any
    t: Any
    face: Any


@lean_kernel
def first_rows(world, tree, moving, ways, asked, node_handles, scratch, told):
    """Fill in a row for each way; asked = (skip inside, m/s by which obstacles that move grow).
    Returns 0; or OUTSIDE or REFUSED.
    """
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    why = np.int64(0)
    for i in range(ways.origins.shape[0]):
        t_max, at, pace = of_row(ways.t_max, i), ways.at[i], ways.pace[i]
        if covers(moving, at, pace, t_max) == 0:
            why = np.int64(OUTSIDE)
            break
        _first(world, tree, moving, ways, i, asked, (node_handles, scratch), told)
    end_query(tree.state)
    return why


@lean_kernel
def _first(world, tree, moving, ways, i, asked, tools, told):
    """Walk through the tree, and fill in a row."""
    at, pace, t_max, mask = ways.at[i], ways.pace[i], ways.t_max[i], ways.masks[i]
    (node_handles, scratch), nodes, ndim = tools, moving.nodes, ways.origins.shape[1]
    corners, more = stack_array(6, np.float64).reshape(2, 3), ways.more[i]
    for axis in range(ndim):
        corners[0, axis] = ways.origins[i, axis] - more
        corners[1, axis] = ways.origins[i, axis] + more
    wide = Course(stack_array(RAY_FLOATS, np.float64).reshape(RAY_ROWS, 3), at, pace)
    thin = Course(stack_array(RAY_FLOATS, np.float64).reshape(RAY_ROWS, 3), at, pace)
    set_swept_box(wide.ray, corners[0, :ndim], corners[1, :ndim], ways.directions[i])
    set_swept_box(thin.ray, ways.origins[i], ways.origins[i], ways.directions[i])
    box = Best(np.int64(NONE), np.inf, np.int64(INSIDE))
    other = Best(np.int64(NONE), np.inf, np.int64(INSIDE))
    stack, entries = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64)
    stack[0], entries[0], top = world.root, 0.0, (0 if world.root == NONE else 1)
    bounded, limit = covers(moving, at, pace, t_max) > 0, t_max
    while top > 0:
        top -= 1
        if entries[top] > limit * PAD + TINY or nodes[stack[top]].mask & mask == 0:
            continue
        waiting = stack, entries, top
        node, top = descend(nodes, wide, bounded, at - moving.start, limit, waiting)
        if node == NONE or nodes[node].mask & mask == 0:
            continue
        slot = np.int64(node >> 1)
        grown = growth_of(box_of(tree, moving, slot), asked[1], at, pace, t_max)
        if ways.radii[i] + grown == 0.0 and plain(world.geometry, world.footprints, slot):
            hit, t, face = meet(box_of(tree, moving, slot), thin, t_max)
            if hit and not (asked[0] and face == INSIDE):
                was = box.slot, box.t, box.face
                if was[0] == NONE or is_before(tree, moving, thin, (slot, t, face), was):
                    box = Best(slot, t, face)
        else:
            see(ways, i, box_of(tree, moving, slot), scratch.ray)
            radius = ways.radii[i] + grown
            t, feature = enter_obstacle(world, slot, scratch.ray, radius, t_max, scratch.work)
            if t < np.inf and not (asked[0] and feature == INSIDE):
                nearer = t < other.t
                if t == other.t:
                    nearer = node_handles[slot] < node_handles[other.slot]
                if nearer:
                    other = Best(slot, t, np.int64(feature))
        limit = min(limit, box.t, other.t)
    by_box = other.slot == NONE or box.t < other.t
    if box.slot != NONE and box.t == other.t:
        by_box = node_handles[box.slot] < node_handles[other.slot]
    if box.slot == NONE or not by_box:
        _tell(world, tree, moving, ways, i, asked, (scratch, other), told)
        return
    told.hits.slots[i], told.hits.ts[i], told.hits.features[i] = box.slot, box.t, box.face
    point, normal = told.points[i, :ndim], told.normals[i, :ndim]
    locate(box_of(tree, moving, box.slot), thin, box.t, box.face, point, normal)


@inlined
def growth_of(box, rate, at, pace, t_max):
    """By how much an obstacle has grown at most on the way, as `places.growths`."""
    _, _, velocity, reference = box
    moves, end = False, (at + pace * t_max if pace > 0.0 else at)
    for axis in range(velocity.shape[0]):
        moves |= velocity[axis] != 0.0
    if rate == 0.0 or not moves:
        return 0.0
    return rate * max(abs(at - reference), abs(end - reference))


@inlined
def see(ways, i, box, ray):
    """Write the ray as an obstacle sees it that moves."""
    _, _, velocity, reference = box
    seen = stack_array(6, np.float64).reshape(2, 3)
    ndim, since = ways.origins.shape[1], ways.at[i] - reference
    for axis in range(ndim):
        seen[0, axis] = ways.origins[i, axis] - velocity[axis] * since
        seen[1, axis] = ways.directions[i, axis] - velocity[axis] * ways.pace[i]
    set_ray(ray, seen[0, :ndim], seen[1, :ndim])


@lean_kernel
def _tell(world, tree, moving, ways, i, asked, found, told):
    """Fill in a row: the obstacle, and where it is met."""
    scratch, best = found
    hits, point, normal = told.hits, told.points[i], told.normals[i]
    hits.slots[i], hits.ts[i], hits.features[i] = best.slot, best.t, best.face
    if best.slot == NONE:
        return
    box = box_of(tree, moving, best.slot)
    grown = growth_of(box, asked[1], ways.at[i], ways.pace[i], ways.t_max[i])
    see(ways, i, box, scratch.ray)
    touch(world, scratch, ways.radii[i] + grown, hits, i, point, normal)
    then = ways.at[i] - box[3] + best.t * ways.pace[i]
    for axis in range(box[2].shape[0]):
        point[axis] += box[2][axis] * then
    for axis in range(3):
        point[axis] += normal[axis] * grown
