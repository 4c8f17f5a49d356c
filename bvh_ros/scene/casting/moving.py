# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls at a time, or while it passes, among obstacles that have velocities.

Seen from an obstacle that moves on a straight line, a ray is another ray. So the tree says whose
boxes may be met, and each of these obstacles is asked by the ray that it sees. Among axis-aligned
boxes thin rays are decided by the tree alone, as real arithmetic does.

Who grows, see `store.places`, is met by a ball that is as much larger, as he has grown at the end
of its way: too early rather than too late.
"""

import functools
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...tree.checks import INT64, NOTHING, UINT32
from ...tree.motion.asked_then import AS_ARRAYS, told_once
from ...tree.motion.casting import Casts
from ...tree.motion.spans import times_of
from ...tree.motion.sweeping import Sweep
from ...tree.motion.wide_casting import UNSUITED
from ...tree.moving import LARGEST
from ...tree.nodes import NONE
from ...tree.rays.ray_batches import rows_of
from ...tree.rays.raycasting import EVERY
from ...tree.store.turns import accepted
from ..geometry.shapes import Floats, along_axes
from ..results import NO_NODE, CastHits
from ..store.obstacles import Obstacles
from ..store.places import growths, most_growth
from .arguments import Hits, Rays, call, code_for, new_scratch, world_of
from .first_moving import First, each_then, first_rows
from .seen import Met, Times
from .swept_ways import AT_HAND, first_swept, kept, lists_for
from .walks import Ways, ball_reach

_NO_ROOM = np.empty((0, 3))
PAIRS = 1 << 17  # that are looked at in one go


def cast_then(held: Obstacles, rays: Rays, radii: Floats, skip: bool, times: Times) -> Met:
    """All that rays, or balls, meet; `rays` as Scene.raycast_many has them."""
    ndim, count = held.tree.ndim, len(rays.origins)
    require_ends(held, rays)
    flat = rays._replace(
        origins=along_axes(rays.origins, ndim), directions=along_axes(rays.directions, ndim)
    )
    thin = radii == 0.0
    parts = [_plain(held, flat, np.flatnonzero(thin), skip, times)]
    if held.columns.shaped or held.uncertainty or not thin.all():
        parts.append(_shaped(held, flat, radii, skip, times))
    columns: Any = zip(*parts, strict=True)
    met = Met(*(np.concatenate(column) for column in columns))
    if ndim == 2:
        met.points[:, 2] = rays.origins[met.rows, 2]
    handles = held.columns.node_handle[met.slots]
    order = np.lexsort((handles, met.ts, met.rows))
    first = len(parts[0].rows)
    _keep_exact_order(order, first)
    return met.take(order) if count else met


def first_then(
    held: Obstacles, sweep: Sweep | None, rays: Rays, radii: Floats, skip: bool, times: Times
) -> First:
    """First hits of rays, or balls, their columns one for all or (n,); as of `cast_then`. `sweep`:
    what `sweep_for` says, of these and more rays.
    """
    tree, columns, count = held.tree, held.columns, len(rays.origins)
    ndim, grown = tree.ndim, NOTHING
    if held.uncertainty:
        require_ends(held, rays)
        grown = np.atleast_1d(most_growth(held, times.at, times.ends(rays.t_max)))
    flat = along_axes(rays.origins, ndim), along_axes(rays.directions, ndim)
    ways = *flat, rays.t_max, rays.masks, radii, *times, grown
    marks, places = np.empty((2, count), INT64), (np.empty((count, 3)), np.empty((count, 3)))
    hits = Hits(marks[0], np.empty(count), marks[1])
    told = First(hits, np.empty(count, UINT32), *places)
    asked, handles = (skip, held.uncertainty), columns.node_handle
    motion = _motion_of(held)
    if sweep is None:
        world, given = (
            world_of(tree, columns),
            (Ways(*ways), asked, handles, new_scratch(ndim), told),
        )
        spans = partial(times_of, times.at, times.pace, rays.t_max)
        moments = not times.pace.any()

        def ask(*arrays: Any) -> Any:
            return call(first_rows, world, *arrays, *given)

        motion.ask(tree, spans, ask, moments)
    else:
        view, shapes = tree.view(), columns.shapes
        now = sweep._replace(moving=motion.known(view, 0.0, 0.0))
        found = marks, hits.ts, told.handles, *places
        tools = handles, lists_for(sweep.snapshot.depth)
        every = shapes, view.tree, now, ways, asked, tools, found, AS_ARRAYS, _NO_ROOM
        if accepted(code_for(first_swept, shapes, every)(*every)):
            _tell_others(held, (rays, radii, skip, times), told)
    if tree.ndim == 2:
        met = told.handles != NO_NODE
        told.points[met, 2] = rays.origins[met, 2]
    return told


def few_then(
    held: Obstacles,
    sweep: Sweep,
    rays: tuple[Any, ...],
    radii: Floats,
    skip: bool,
    when: tuple[Any, Any],
    to_goals: bool,
) -> CastHits | None:
    """`first_then` in a solid scene through what is swept already, with as little Python as can
    be; else as `moving_boxes.few_first`.
    """
    tree: Any = held.tree
    count, columns = len(rays[0]), held.columns
    at, pace, when = told_once(when)
    ways = *rays, radii, at, pace, NOTHING
    marks, room = kept.marks, kept.ways if to_goals else _NO_ROOM
    if count > AT_HAND:
        marks, room = np.empty((2, count), INT64), np.empty((count if to_goals else 0, 3))
    ts, points, normals = np.empty(count), np.empty((count, 3)), np.empty((count, 3))
    handles = np.empty(count, UINT32)
    told = marks, ts, handles, points, normals
    tools = columns.node_handle, lists_for(sweep.snapshot.depth)
    asked, shapes = (skip, held.uncertainty), columns.shapes
    every = shapes, tree._storage.tree, sweep, ways, asked, tools, told, when, room
    if code_for(first_swept, shapes, every)(*every) != 0:
        return None
    return tuple.__new__(CastHits, (handles, ts, points, normals))


def sweep_for(held: Obstacles, rays: Rays, times: Times) -> Sweep | None:
    """What is swept for the rays of a batch, if that pays."""
    span, every = times_of(*times, rays.t_max)
    if not every or not len(rays.origins):
        return None
    tree = held.tree
    found: Sweep | None = _motion_of(held).swept_for(tree, tree.view(), len(rays.origins), span)
    return found


def _tell_others(held: Obstacles, asked: tuple[Any, ...], told: First) -> None:
    """Fill in the rows of ways that are not for a sweep; asked = what `first_then` is told."""
    (rays, radii, skip, times), count = asked, len(told.handles)
    others = np.flatnonzero(told.hits.slots == UNSUITED)
    some, when = rows_of(rays, count, others), rows_of(times, count, others)
    balls = radii[others] if len(radii) == count else radii
    found = first_then(held, None, some, balls, skip, when)
    for column, part in zip((*told.hits, *told[1:]), (*found.hits, *found[1:]), strict=True):
        column[others] = part


def require_ends(held: Obstacles, rays: Rays) -> None:
    """ValueError if a ray has no end, where obstacles grow."""
    if held.uncertainty and np.isinf(rays.t_max).any():
        row = np.flatnonzero(np.isinf(rays.t_max))[0]
        raise ValueError(f't_max must end the way where obstacles grow: row {row} has none')


def reaches(held: Obstacles, rays: Rays, radii: Floats, times: Times) -> Floats:
    """By how much rays may pass boxes of obstacles that their balls touch, (n,)."""
    axes = np.abs(rays.origins[:, : held.tree.ndim]).T
    largest = functools.reduce(np.maximum, axes)  # `max` of short rows takes ten times as long
    growth = most_growth(held, times.at, times.ends(rays.t_max))
    return np.asarray(ball_reach(radii, largest) + growth)


def _motion_of(held: Obstacles) -> Any:
    return held.tree.motion


def _keep_exact_order(order: NDArray[np.int64], first: int) -> None:
    """The first so many hits are in exact order, which their t, as doubles, may not tell: they
    keep it in the places that are theirs.
    """
    order[order < first] = np.arange(first)


def _plain(held: Obstacles, rays: Rays, rows: NDArray[np.int64], skip: bool, times: Times) -> Met:
    """Thin rays of these rows against axis-aligned boxes, decided exactly."""
    some = Rays(*(np.ascontiguousarray(column[rows]) for column in rays))
    asked = some.t_max, some.masks, times.at[rows], times.pace[rows], skip, EVERY
    casts = Casts(some.origins, some.origins, some.directions, *asked)
    offsets, handles, found, places = _motion_of(held).every(held.tree, casts)
    slots = held.tree.slots(handles)
    of = np.repeat(rows, np.diff(offsets))
    ends = times.ends(rays.t_max)
    grown = growths(held, slots, times.at[of], ends[of])
    plain = np.flatnonzero(~held.columns.geometry['shaped'][slots] & (grown == 0.0))
    points, normals = (np.zeros((len(slots), 3)) for _ in range(2))
    points[:, : held.tree.ndim], normals[:, : held.tree.ndim] = places
    return Met(of, slots, found.ts, points, normals).take(plain)


def _casts(held: Obstacles, rays: Rays, radii: Floats, times: Times) -> Casts:
    """What rays may meet: every box that balls touch with what has grown in it."""
    more = reaches(held, rays, radii, times)[:, None]
    with np.errstate(over='ignore'):  # as far as there are doubles
        low, high = rays.origins - more, rays.origins + more
    ways = np.maximum(low, -LARGEST), np.minimum(high, LARGEST), rays.directions, rays.t_max
    return Casts(*ways, rays.masks, *times, False, EVERY)


def _shaped(held: Obstacles, rays: Rays, radii: Floats, skip: bool, times: Times) -> Met:
    """Balls against all obstacles, thin rays against those that are no axis-aligned boxes."""
    ends, casts = times.ends(rays.t_max), _casts(held, rays, radii, times)
    offsets, handles, _, _ = _motion_of(held).every(held.tree, casts)
    slots, rows = held.tree.slots(handles), np.repeat(np.arange(len(radii)), np.diff(offsets))
    grown = growths(held, slots, times.at[rows], ends[rows])
    wanted = held.columns.geometry['shaped'][slots] | (radii[rows] + grown > 0.0)
    slots, rows, parts = slots[wanted], rows[wanted], []
    for begin in range(0, max(len(rows), 1), PAIRS):
        some = slice(begin, begin + PAIRS)
        parts.append(_of_pairs(held, rays, radii, skip, times, rows[some], slots[some]))
    columns: Any = zip(*parts, strict=True)
    return Met(*(np.concatenate(column) for column in columns))


def _of_pairs(
    held: Obstacles,
    rays: Rays,
    radii: Floats,
    skip: bool,
    times: Times,
    rows: NDArray[np.int64],
    slots: NDArray[np.int64],
) -> Met:
    """Rays, or balls, of some rows, each against one obstacle."""
    count, columns, tree = len(rows), held.columns, held.tree
    some = Rays(*(column[rows] for column in rays))
    ways = Ways(*some, radii[rows], times.at[rows], times.pace[rows], np.zeros(1))
    hits = Hits(np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64))
    told = First(hits, np.empty(count, UINT32), np.empty((count, 3)), np.empty((count, 3)))
    tools, view = (columns.node_handle, new_scratch(tree.ndim)), tree.view()
    known = _motion_of(held).known(view, 0.0, 0.0)
    given = view.tree, known, ways, slots, (skip, held.uncertainty), tools, told
    call(each_then, world_of(tree, columns), *given)
    met = np.flatnonzero(hits.slots != NONE)
    return Met(rows, slots, hits.ts, told.points, told.normals).take(met)
