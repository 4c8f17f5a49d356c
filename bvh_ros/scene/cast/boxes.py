# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Thin rays among axis-aligned boxes: the tree's own kernels answer them.

A ray here has three coordinates in a planar scene too, and so has what it meets. The kernels look
at as many as the tree has axes and leave the others as they are: a planar ray costs a copy no
more than a solid one.
"""

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...tree import checks
from ...tree.access import (
    CLOSEST,
    EVERY,
    INSIDE,
    INT64,
    IS_CHANGED,
    NO_HITS,
    NO_RAYS,
    NOT_FINITE,
    REFUSED,
    UINT32,
    OpenTree,
    RayHits,
    accepted,
    answer_rays,
    cast_few,
    empty_tree,
    entry_points,
    every_hit,
    locate,
    no_snapshot,
    raycast_one,
    slot_of,
)
from ...tree.access import Rays as TreeRays
from ...tree.compiler import entry_point, inlined, lean_kernel, stack_array
from ..results import NO_NODE, CastHits, require_few
from ..shapes.shape import Floats, along_axes
from .arguments import UNIT_T_MAX, BoxHit, Rays, directions_entry, fill_directions, too_long

RAYS_ON_STACK = 1024  # rays whose hits lie on the stack of a kernel
# So many rays go one by one, whatever they are: of lists a second kernel tells points and normals.
FEW = 200
_NO_IDS = np.empty(0, np.int64)


def first(
    tree: OpenTree, start: Floats, goal: Floats, mask: np.uint32, skip_inside: bool
) -> BoxHit | None:
    """The first box from `start` to `goal`, shape (3,) each."""
    place = np.empty((2, 3))
    given = start, goal, mask, skip_inside, place
    slot, t = _first_entry(tree.ndim)(tree.view().tree, *given)
    if slot == NOT_FINITE:
        raise too_long(start, goal)
    if slot == REFUSED:
        raise RuntimeError(IS_CHANGED)
    return None if slot < 0 else (slot, t, place[0], place[1])


def segment(
    start: ArrayLike, goal: ArrayLike, radius: float, planar: bool
) -> tuple[tuple[Floats, Floats], Floats, float]:
    """Check the ends and the radius of a segment: (its ends, direction, radius)."""
    radius = checks.limit('radius', radius)
    if math.isinf(radius):
        raise ValueError('radius must be finite')
    origin = checks.vector('start', start, 3, planar)
    end = checks.vector('goal', goal, 3, planar)
    # Three numbers: Python's own arithmetic takes a fifth of the time of numpy's.
    (x, y, z), (u, v, w) = origin.tolist(), end.tolist()
    direction = u - x, v - y, w - z
    if not all(map(math.isfinite, direction)):
        raise too_long(origin, end)
    return (origin, end), np.array(direction), radius


@inlined
def segment_between(start, goal, direction, place):
    """Write the direction between two points, and the first point to `place`, with no normal;
    return whether all is finite.
    """
    finite = True
    for axis in range(3):
        direction[axis] = goal[axis] - start[axis]
        finite &= math.isfinite(direction[axis])  # so both ends are
        place[0, axis], place[1, axis] = start[axis], 0.0
    return finite


@lean_kernel
def first_between(tree, start, goal, mask, skip_inside, place):
    """The first box from `start` to `goal`: (slot, t), and its point and normal as the rows of
    `place`; instead of a slot NONE, NOT_FINITE or REFUSED.
    """
    direction = stack_array(3, np.float64)
    if not segment_between(start, goal, direction, place):
        return np.int64(NOT_FINITE), np.inf
    query = 1.0, mask, skip_inside, CLOSEST
    handle, t = raycast_one(tree, start, direction, *query, place)
    return (slot_of(handle) if handle >= 0 else handle), t


def every(
    tree: OpenTree,
    origin: Floats,
    direction: Floats,
    mask: np.uint32,
    skip_inside: bool,
    most: int | None = None,
) -> Iterator[BoxHit]:
    """All boxes from `origin` to `origin + direction`, nearest first, ties by handle;
    TooManyHitsError if there are more than `most`.
    """
    view = tree.view()
    query = UNIT_T_MAX, np.array([mask]), skip_inside, EVERY, True
    rays = origin[None, : tree.ndim], direction[None, : tree.ndim], *query
    _, end, found = every_hit(view, rays, False)
    tree.check_unchanged(view)
    require_few(end, most)
    nodes, tight = view.tree.nodes, view.tree.tight
    places = np.zeros((end, 2, 3))
    places[:, 0, 2] = origin[2]
    hits = zip(*(column[:end].tolist() for column in found), places, strict=True)
    for slot, t, axis, place in hits:
        locate(nodes, tight, origin, direction, slot, t, axis, place)
        yield slot, t, place[0], place[1]


def first_hits(
    tree: OpenTree, node_handles: NDArray[np.int64], rays: Rays, threads: int
) -> CastHits | None:
    """First hits of n thin rays; None if a ray is not finite. Few go through the snapshot in one
    kernel, with as little Python as can be.
    """
    ndim, count, view = tree.ndim, len(rays.origins), None
    # As TreeRays(...) and so on, which would take more calls of functions of Python's.
    few = tuple.__new__(TreeRays, (*rays[:4], rays.skip_inside, CLOSEST, True))
    parts = np.empty(count, UINT32), np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    hits = tuple.__new__(CastHits, parts)
    if threads == 1 and (count <= FEW or tree.few_rays(few)):
        ids = _NO_IDS if count <= RAYS_ON_STACK else np.empty(count, INT64)
        flat = None if ndim == 3 else np.empty((3, count, ndim))
        given, done = (few, rays.to_goals, node_handles, ids, flat, hits), REFUSED
        ready = tree.ready_snapshot()
        if ready is not None:
            done = few_entry(ndim)(*ready[0], ready[1], *given)
        if done == REFUSED:
            view = tree.view()
            snapshot = tree.snapshot_for(count, view)
            if snapshot is not None:
                done, view = few_entry(ndim)(*view, snapshot, *given), None
        if view is None:
            if done == NOT_FINITE:
                return None
            accepted(done)
            return hits
    origins, directions = rays[:2]
    if rays.to_goals:
        directions = np.empty((count, 3))
        if directions_entry()(*rays[:2], directions) >= 0:
            return None
    elif ndim == 2 and max(map(checks.first_not_finite, (origins, directions))) >= 0:
        return None  # of others the tree's kernel looks
    axes = along_axes(origins, ndim), along_axes(directions, ndim)
    query = *axes, rays.t_max, rays.masks, rays.skip_inside, CLOSEST, threads == 1
    if view is None:
        found = tree.first_hits(query, threads)
    else:
        found = RayHits(np.empty(count, INT64), np.empty(count), np.empty((count, ndim)))
        done = answer_rays(*view, None, TreeRays(*query), found)
        if done == NOT_FINITE:
            return None
        accepted(done)
    hits = hits._replace(t=found.t)
    rows = origins, directions, found, hits
    _describe_entry(ndim)((view or tree.view()).tree, node_handles, *rows)
    return hits


@lean_kernel
def describe(tree, node_handles, origins, directions, found, hits):
    """Fill in `CastHits` from the `RayHits` found. Their normals may be the same memory, and so
    may directions and points.
    """
    place = stack_array((2, 3), np.float64)
    for i in range(origins.shape[0]):
        axis = np.int64(INSIDE)
        for k in range(3):
            normal = found.normals[i, k] if k < found.normals.shape[1] else 0.0
            hits.normals[i, k] = normal
            if normal != 0.0:
                axis = np.int64(k)
        if found.ids[i] < 0:
            hits.handles[i] = NO_NODE
            for k in range(3):
                hits.points[i, k] = np.nan
            continue
        slot, origin, direction = slot_of(found.ids[i]), origins[i], directions[i]
        place[0, 2] = origin[2]
        locate(tree.nodes, tree.tight, origin, direction, slot, found.t[i], axis, place)
        hits.handles[i] = node_handles[slot]
        for k in range(3):
            hits.points[i, k] = place[0, k]


@lean_kernel
def cast_and_describe(tree, version, snapshot, rays, to_goals, node_handles, ids, flat, hits):
    """First hits of rays in one call; returns as `cast_few`. `to_goals`: the directions are
    the goals of the rays. Scratch: `ids` for the hits of more than RAYS_ON_STACK rays, `flat`
    (3, n, 2), or None in three dimensions, for rays and normals as a planar tree has them.
    """
    directions = rays.directions
    if to_goals:
        directions = hits.points
        if fill_directions(rays.origins, rays.directions, directions) >= 0:
            return np.int64(NOT_FINITE)
    starts, paths, normals = rays.origins, directions, hits.normals
    if flat is not None:
        if not flatten(starts, paths, flat):
            return np.int64(NOT_FINITE)
        starts, paths, normals = flat[0], flat[1], flat[2]
    query = starts, paths, rays.t_max, rays.masks, rays.skip_inside, rays.mode, rays.counted
    if ids.shape[0] == 0:
        ids = stack_array(RAYS_ON_STACK, np.int64)[: rays.origins.shape[0]]
    found = RayHits(ids, hits.t, normals)
    done = cast_few(tree, version, snapshot, query, found)
    if done >= 0:
        describe(tree, node_handles, rays.origins, directions, found, hits)
    return done


@inlined
def flatten(starts, paths, flat):
    """Copy the axes of a planar tree; return whether all numbers are finite."""
    finite = True
    for i in range(starts.shape[0]):
        for axis in range(3):
            finite &= math.isfinite(starts[i, axis]) and math.isfinite(paths[i, axis])
        for axis in range(2):
            flat[0, i, axis], flat[1, i, axis] = starts[i, axis], paths[i, axis]
    return finite


@functools.cache
def few_entry(ndim: int) -> Callable[..., Any]:
    """The machine code of `cast_and_describe`."""
    flat = None if ndim == 3 else np.empty((3, 0, ndim))
    query = NO_RAYS, False, _NO_IDS, _NO_IDS, flat, _HITS
    return entry_point(cast_and_describe, empty_tree(ndim), 0, no_snapshot(ndim), *query)


_POINT = np.empty(3)
_ROWS = np.empty((0, 3))
_HITS = CastHits(np.empty(0, np.uint32), np.empty(0), _ROWS, _ROWS)
_describe_entry = entry_points(describe, np.empty(0, np.int64), _ROWS, _ROWS, NO_HITS, _HITS)
_first_entry = entry_points(first_between, _POINT, _POINT, np.uint32(0), False, np.empty((2, 3)))
