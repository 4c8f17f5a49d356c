# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of thin rays among axis-aligned boxes that move: the tree decides, and the kernel that
asks it tells points, too.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.checks import INT64, UINT32
from ...tree.entries import entry_points
from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.motion.asked_then import AS_ARRAYS, NO_RAYS, RaysThen, told_once
from ...tree.motion.casting import locate
from ...tree.motion.few_casting import FEW, NO_FEW, cast_few
from ...tree.motion.meeting import box_of, course_of, fetch_box
from ...tree.motion.stopping import face_met
from ...tree.motion.sweeping import Sweep, no_sweep
from ...tree.motion.wide_casting import AHEAD, cast_rows
from ...tree.nodes import Tree, slot_of
from ...tree.rays.raycasting import CLOSEST, of_row
from ...tree.rays.slab import INSIDE, RAY_ROWS, set_ray
from ...tree.results import RayHits
from ...tree.wide.ray_streams import make_scratch, scratch_for
from ..geometry.shapes import Floats, along_axes
from ..results import NO_NODE, CastHits
from ..store.obstacles import Obstacles
from .arguments import Rays, fill_ways
from .box_casting import AT_ONCE
from .moving import sweep_for
from .seen import Times

_NO_IDS = np.empty(0, np.int64)
# What is called directions: those of rays, the goals of the ways, or those of rays whose hits are
# there already, to be described.
ALONG, TO_GOALS, FOUND = range(3)


class Told(NamedTuple):
    """Room for what n rays meet: a `RayHits`, and what a scene tells besides."""

    ids: NDArray[np.int64]
    """Empty for AT_ONCE rays or fewer, if nobody but the kernel is to read them."""
    t: Floats
    normals: Floats
    """Shape (n, ndim)."""
    handles: NDArray[np.uint32]
    points: Floats
    """Shape (n, 3); what is beyond the tree's axes stays as it is where a ray hits."""


def first_boxes(held: Obstacles, rays: Rays, skip: bool, times: Times, threads: int) -> CastHits:
    """First hits of rays."""
    tree: Any = held.tree
    count, ndim, motion, view = len(rays.origins), tree.ndim, tree.motion, tree.view()
    flat = along_axes(rays.origins, ndim), along_axes(rays.directions, ndim)
    asked = RaysThen(*flat, rays.t_max, rays.masks, skip, CLOSEST, *times, AS_ARRAYS)
    told = Told(
        *(np.empty(count, np.int64), np.empty(count), np.empty((count, ndim))),
        *(np.empty(count, np.uint32), np.empty((count, 3))),
    )
    told.points[:, ndim:] = rays.origins[:, ndim:]
    node_handles = held.columns.node_handle

    def cast(arrays: Tree, sweep: Sweep, some: RaysThen, into: Told) -> int:
        scratch = scratch_for(len(some.origins), ndim, sweep.snapshot.depth)
        done: int = _entry(ndim)(arrays, sweep, some, ALONG, node_handles, scratch, into)
        return done

    sweep = sweep_for(held, rays, times)
    if not motion.answer(tree, (view, sweep), asked, told, threads, cast):
        known = no_sweep(ndim)._replace(moving=motion.known(view, 0.0, 0.0))
        given = asked, FOUND, node_handles, scratch_for(0, ndim, 0), told
        _entry(ndim)(view.tree, known, *given)
        tree.check_unchanged(view)
    normals = told.normals
    if ndim == 2:
        normals = np.zeros((count, 3))
        normals[:, :2] = told.normals
    return CastHits(told.handles, told.t, told.points, normals)


def few_first(
    held: Obstacles,
    sweep: Sweep,
    rays: tuple[Any, ...],
    skip: bool,
    when: tuple[Any, Any],
    to_goals: bool,
) -> CastHits | None:
    """`first_boxes` in a tree of three dimensions through what is swept already, with as little
    Python as can be: of few rays, that is most. None where a ray is not for it. rays = (origins,
    directions, t_max, masks), when = (at, pace) of all, or arrays. `to_goals`: what is called
    directions are the goals of the ways.
    """
    tree: Any = held.tree
    count = len(rays[0])
    # As CastHits(...) and so on, which would take more calls of functions of Python's.
    handles, ts, points = np.empty(count, UINT32), np.empty(count), np.empty((count, 3))
    normals, node_handles = np.empty((count, 3)), held.columns.node_handle
    hits = tuple.__new__(CastHits, (handles, ts, points, normals))
    if count < FEW and type(when[0]) is float:
        few = rays, skip, when, to_goals, node_handles, hits
        return hits if _few_entry(3)(tree._storage.tree, sweep, *few) == 0 else None
    asked = tuple.__new__(RaysThen, (*rays, skip, CLOSEST, *told_once(when)))
    ids = _NO_IDS if count <= AT_ONCE else np.empty(count, INT64)
    told = tuple.__new__(Told, (ids, ts, normals, handles, points))
    scratch = scratch_for(count, 3, sweep.snapshot.depth)
    given = asked, int(to_goals), node_handles, scratch, told
    return hits if _entry(3)(tree._storage.tree, sweep, *given) == 0 else None


@lean_kernel
def cast_few_and_describe(tree, sweep, rays, skip_inside, when, to_goals, node_handles, hits):
    """As `cast_and_describe`, of fewer rays than FEW, see `few_casting.cast_few`."""
    (origins, directions, t_max, masks), ids = rays, stack_array(FEW, np.int64)
    if to_goals:
        directions = hits.points
        if fill_ways(origins, rays[1], directions) >= 0:
            return np.int64(1)
    told = Told(ids[: origins.shape[0]], hits.t, hits.normals, hits.handles, hits.points)
    found = RayHits(told.ids, told.t, told.normals)
    some = origins, directions, t_max, masks
    done = cast_few(tree, sweep, some, skip_inside, CLOSEST, when, found)
    if done == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = when
        asked = RaysThen(*some, skip_inside, CLOSEST, at, pace, when)
        describe(tree, sweep.moving, asked, node_handles, told)
    return done


@lean_kernel
def cast_and_describe(tree, sweep, asked, what, node_handles, scratch, told):
    """First hits of rays in one call; returns as `wide_casting.cast_rows`, 1 where a way is not
    finite.
    """
    directions, ids, done = asked.directions, told.ids, np.int64(0)
    if what == TO_GOALS:
        directions = told.points
        if fill_ways(asked.origins, asked.directions, directions) >= 0:
            return np.int64(1)
    if ids.shape[0] == 0:
        ids = stack_array(AT_ONCE, np.int64)[: asked.origins.shape[0]]
    rays = RaysThen(
        *(asked.origins, directions, asked.t_max, asked.masks, asked.skip_inside, asked.mode),
        *(asked.at, asked.pace, asked.when),
    )
    hits = Told(ids, told.t, told.normals, told.handles, told.points)
    if what != FOUND:
        done = cast_rows(tree, sweep, rays, scratch, RayHits(ids, told.t, told.normals))
    if done == 0:
        describe(tree, sweep.moving, rays, node_handles, hits)
    return done


@inlined
def describe(tree, moving, rays, node_handles, told):
    """Fill in what is told of hits; directions and points may be the same memory."""
    ray, ndim = stack_array((RAY_ROWS, 3), np.float64), told.normals.shape[1]
    at, pace = rays.at, rays.pace
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = rays.when
    count = rays.origins.shape[0]
    for i in range(count):
        if i + AHEAD < count and told.ids[i + AHEAD] >= 0:
            fetch_box(tree, moving, slot_of(told.ids[i + AHEAD]))
        point, face = told.points[i], INSIDE
        if told.ids[i] < 0:
            told.handles[i] = NO_NODE
            for k in range(3):
                point[k] = np.nan
            continue
        for k in range(ndim):
            if told.normals[i, k] != 0.0:
                face = 2 * k + (told.normals[i, k] > 0.0)
        slot = slot_of(told.ids[i])
        told.handles[i] = node_handles[slot]
        set_ray(ray, rays.origins[i], rays.directions[i])
        course = course_of(ray, of_row(at, i), of_row(pace, i), moving)
        box = box_of(tree, moving, slot)
        face = face_met(box, course, of_row(rays.t_max, i), told.t[i], np.int64(face))
        locate(box, course, told.t[i], face, point, told.normals[i])


_ROWS = np.empty((0, 3))
_TOLD = Told(_NO_IDS, np.empty(0), _ROWS, np.empty(0, np.uint32), _ROWS)
_few_entry = entry_points(
    *(cast_few_and_describe, no_sweep, NO_FEW, False, AS_ARRAYS, False),
    *(_NO_IDS, CastHits(np.empty(0, np.uint32), np.empty(0), _ROWS, _ROWS)),
)
_entry = entry_points(
    *(cast_and_describe, no_sweep, NO_RAYS, ALONG, _NO_IDS),
    *(lambda ndim: make_scratch(0, ndim, 0), _TOLD),
)
