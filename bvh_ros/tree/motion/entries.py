# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept boxes among boxes that move. Arguments are those of the tree's methods of the
same names.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import checks
from ..batch.streams import RAYS_AT_ONCE
from ..checks import INT64
from ..compiler import inlined, lean_kernel, stack_array
from ..nodes import EXACT_RAYS, NONE, RAYS, ROOT, Tree, entry_points
from ..query.ray import (
    ANY,
    CLOSEST,
    EVERY,
    Found,
    RayOptions,
    cast,
    more_room,
    of_row,
    room_for_hits,
    room_for_rays,
    rows_of,
    sort_hits,
)
from ..query.slab import DIRECTION, EXACT, INSIDE, ORIGIN, RAY_ROWS, UPPER, set_swept_box
from ..results import RayHits
from ..simd.moving_sides import FRONTS
from ..store.turns import NOT_FINITE, accepted, count_rays, end_query, in_threads
from .bounds import OUTSIDE, begin_asking, covers, enter_node, moments_of, no_motion, set_fronts
from .exact_contact import box_of, course_of, elapsed, is_before, meet_box, phase_at_hit
from .state import Motion, both_times, span_of, times_of
from .sweep import AS_ARRAYS, NO_TIMES, UNSUITED, TimedRays, cast_swept, few_entry

Floats = NDArray[np.float64]


class Casts(NamedTuple):
    """n rays or swept boxes, at times."""

    lo: Floats
    """Shape (n, ndim), as hi and the directions; a ray has both at its origin."""
    hi: Floats
    directions: Floats
    t_max: Floats
    """A distance a row, or one for all, as of the masks and times."""
    masks: NDArray[np.uint32]
    at: Floats
    pace: Floats
    skip_inside: bool
    mode: int


class Places(NamedTuple):
    """Where hits are, shape (m, ndim) each."""

    points: Floats
    normals: Floats


class PathAt(NamedTuple):
    """A ray, or a swept box, among boxes that move."""

    tree: Tree
    moving: Any
    """`Moving`"""
    course: Any
    """`Course`"""
    mask: np.uint32
    bounded: bool
    """Whether the bounds of nodes hold for all times of the course."""
    ahead: float
    """From the start of their span to that of the course, s."""
    fronts: Floats
    """What the sides of a node are compared with, see `moving_sides`."""


@inlined
def path_at(tree, moving, course, t_max, mask, fronts):
    """The path of a course up to t_max; `fronts` are as of `set_fronts`. What the bounds do not
    hold for visits all boxes.
    """
    bounded = covers(moving, course.at, course.pace, t_max) > 0
    return PathAt(tree, moving, course, mask, bounded, course.at - moving.start, fronts)


@inlined
def enter_bounds(nodes, node, path, limit):
    """`enter_node` of a node that the mask of a `PathAt` selects."""
    if nodes[node].mask & path.mask == 0:
        return np.inf
    if not path.bounded:
        return 0.0
    return enter_node(nodes, node, path.fronts, path.ahead, path.course.pace, limit)


@inlined
def _decide(path, slot, t_max):
    return meet_box(box_of(path.tree, path.moving, slot), path.course, t_max)


@inlined
def _precedes(path, hit, other):
    return is_before(path.tree, path.moving, path.course, hit, other)


@inlined
def sort_hits_at(tree, moving, course, found, count):
    """`sort_hits` of the first hits of a course, so many."""
    path = PathAt(tree, moving, course, np.uint32(0), False, 0.0, course.ray[ORIGIN])
    sort_hits(path, found, 0, count, _precedes)


@lean_kernel
def raycast_at(tree, moving, course, options, found, filled):
    """`query.ray.cast` one ray, or swept box, among boxes that move; instead of axes, faces of
    `meet_box`.
    """
    ray, fronts = course.ray, stack_array(FRONTS, np.float64)
    set_fronts(fronts, moving, ray[ORIGIN], ray[UPPER], ray[DIRECTION])
    path = path_at(tree, moving, course, options.t_max, options.mask, fronts)
    return cast(
        moving.nodes,
        tree.state[ROOT],
        path,
        0,
        options,
        found,
        filled,
        enter_bounds,
        _decide,
        _precedes,
    )


class EveryHit(NamedTuple):
    """Hits of n rows, those of row i at [offsets[i], offsets[i + 1]) of the others."""

    offsets: NDArray[np.int64]
    ids: NDArray[np.int64]
    found: Found
    places: Places


@inlined
def is_sound(lo, hi, direction, times):
    """Whether it is a box that goes somewhere at some time."""
    at, pace = times
    sound = np.isfinite(at) and np.isfinite(pace)
    for k in range(lo.shape[0]):
        sound &= np.isfinite(lo[k]) & np.isfinite(hi[k]) & np.isfinite(direction[k])
        sound &= lo[k] <= hi[k]
    return sound


@inlined
def locate(box, course, t, face, point, normal):
    """Write where and how a course meets a box, each of shape (ndim,): of all points that then
    touch the closest to the centre of what is swept, in the box as it is then, on the face met.
    """
    lo, hi, velocity, reference = box
    phase, face = phase_at_hit(box, course, face)
    since = elapsed(phase.at, reference, phase.nanoseconds)[0]
    if phase.pace != 0.0:
        since += t * phase.pace
    for k in range(lo.shape[0]):
        low, high = course.ray[ORIGIN, k], course.ray[UPPER, k]
        normal[k], point[k] = 0.0, low * 0.5 + high * 0.5
        if face == INSIDE and low == high:
            continue
        shift = velocity[k] * since
        if face != INSIDE and k == face >> 1:
            point[k], normal[k] = (lo[k] + shift, -1.0) if face & 1 == 0 else (hi[k] + shift, 1.0)
        else:
            if course.ray[DIRECTION, k] != 0.0 and t > 0.0:
                point[k] += t * course.ray[DIRECTION, k]
            point[k] = min(max(point[k], lo[k] + shift), hi[k] + shift)


@lean_kernel
def cast_one(tree, moving, swept, options, times, place):
    """One ray or box, swept = (lo, hi, direction), options as a plain `RayOptions`, times = (at,
    pace): (handle, t), and for CLOSEST its point and normal in `place`. Instead of a handle: NONE,
    NOT_FINITE if the input is not, REFUSED if the tree is of another version, or OUTSIDE.
    """
    (lo, hi, direction), (at, pace), state = swept, times, tree.state
    options = RayOptions(options[0], options[1], options[2], options[3])
    if not is_sound(lo, hi, direction, times):
        return NOT_FINITE, np.inf
    if covers(moving, at, pace, options.t_max) == 0:
        return OUTSIDE, np.inf
    why = begin_asking(tree, moving, 1 if pace == 0.0 else 0)
    if why != 0:
        return why, np.inf
    course = course_of(stack_array((RAY_ROWS, 3), np.float64), at, pace, moving)
    set_swept_box(course.ray, lo, hi, direction)
    slots, faces = stack_array(1, np.int64), stack_array(1, np.int64)
    ts = stack_array(1, np.float64)
    handle, t = np.int64(NONE), np.inf
    if raycast_at(tree, moving, course, options, Found(slots, ts, faces), 0) > 0:
        handle, t = tree.handles[slots[0]], ts[0]
        if options.mode == CLOSEST:
            locate(box_of(tree, moving, slots[0]), course, t, faces[0], place[0], place[1])
    state[RAYS] += 1
    state[EXACT_RAYS] += np.int64(course.ray[EXACT, 0])
    end_query(state)
    return handle, t


@lean_kernel
def cast_rows(tree, moving, casts, offsets, found, first):
    """Rays or boxes from row `first` on, hits of row i at [offsets[i], offsets[i + 1]) of `found`,
    in no order.

    Returns (rows done, room wanted): fewer than there are where there is no room for the hits of
    the next one; negative if it is NOT_FINITE, OUTSIDE or REFUSED.
    """
    why = begin_asking(tree, moving, moments_of(casts.pace, casts.lo.shape[0] - first))
    if why != 0:
        return why, np.int64(0)
    ray = stack_array((RAY_ROWS, 3), np.float64)
    done, exact, end, refused = np.int64(first), np.int64(0), np.int64(0), np.int64(0)
    while done < casts.lo.shape[0]:
        lo, hi, direction = casts.lo[done], casts.hi[done], casts.directions[done]
        course = course_of(ray, of_row(casts.at, done), of_row(casts.pace, done), moving)
        t_max, mask = of_row(casts.t_max, done), of_row(casts.masks, done)
        if not is_sound(lo, hi, direction, (course.at, course.pace)):
            refused = np.int64(NOT_FINITE)
        elif covers(moving, course.at, course.pace, t_max) == 0:
            refused = np.int64(OUTSIDE)
        if refused != 0:
            break
        set_swept_box(ray, lo, hi, direction)
        options = RayOptions(t_max, mask, casts.skip_inside, casts.mode)
        end = raycast_at(tree, moving, course, options, found, offsets[done])
        if end > found.slots.shape[0]:
            break
        exact += np.int64(ray[EXACT, 0])
        done += 1
        offsets[done] = end
    count_rays(tree.state, done - first, exact)
    end_query(tree.state)
    return (done if refused == 0 else refused), np.int64(end)


@lean_kernel
def describe_rows(tree, moving, casts, offsets, found, places):
    """Bring the hits of each row, sorted by computed distance, into the order of the exact one,
    see `sort_hits`. Points and normals go to `places`.
    """
    ts, faces = found.ts, found.axes
    ray = stack_array((RAY_ROWS, 3), np.float64)
    for i in range(casts.lo.shape[0]):
        set_swept_box(ray, casts.lo[i], casts.hi[i], casts.directions[i])
        course = course_of(ray, of_row(casts.at, i), of_row(casts.pace, i), moving)
        start, end = offsets[i], offsets[i + 1]
        hits = Found(found.slots[start:end], ts[start:end], faces[start:end])
        sort_hits_at(tree, moving, course, hits, end - start)
        for j in range(offsets[i], offsets[i + 1]):
            box = box_of(tree, moving, found.slots[j])
            locate(box, course, ts[j], faces[j], places.points[j], places.normals[j])


_IDS, _ROW, _ROWS = np.empty(0, np.int64), np.empty(0), np.empty((0, 3))
_CASTS = Casts(*(_ROWS,) * 3, _ROW, np.empty(0, np.uint32), _ROW, _ROW, False, CLOSEST)
_FOUND: Any = Found(_IDS, _ROW, _IDS)
one_entry = entry_points(
    *(cast_one, no_motion, (_ROW,) * 3), *((0.0, np.uint32(0), False, CLOSEST), (0.0, 0.0), _ROWS)
)
rows_entry = entry_points(cast_rows, no_motion, _CASTS, _IDS, _FOUND, 0)
describe_entry = entry_points(describe_rows, no_motion, _CASTS, _IDS, _FOUND, Places(_ROWS, _ROWS))


FEW_HITS = 64  # are sorted as they are described, one by one

Ids = NDArray[np.int64]


class MotionRays(Motion):
    """Queries of rays and swept boxes at times."""

    def cast(
        self,
        tree: Any,
        swept: tuple[Floats, Floats, Floats],
        options: tuple[float, np.uint32, bool, int],
        times: tuple[Any, Any],
        place: Floats,
    ) -> tuple[int, float]:
        """`cast_one` of lo, hi, direction: (handle, or NONE or NOT_FINITE, t)."""
        at, pace = times
        if not (type(at) is type(pace) is float):
            times = at, pace = checks.moment('at', at), checks.moment('pace', pace)
        given = swept, options, times, place
        handle, t = self.ask_path(tree, one_entry(tree._ndim), given, at, pace, options[0])
        if handle == NOT_FINITE:
            checks.moments('at', at, None)
            checks.moments('pace', pace, None)
        return handle, t

    def ask_path(
        self, tree: Any, kernel: Any, given: tuple[Any, ...], at: float, pace: float, t_max: float
    ) -> tuple[int, float]:
        """What a kernel of one path returns, with bounds that hold for its times: (handle, t), or
        NONE or NOT_FINITE for a handle.
        """
        moving = self.moving if pace else self.bounds
        handle, t = kernel(tree._settled().tree, moving, *given)
        while handle < NONE and handle != NOT_FINITE:
            moving = self.others(tree, moving, handle, span_of(at, pace, t_max), pace == 0.0)
            handle, t = kernel(tree._settled().tree, moving, *given)
        return handle, t

    def every_ray(self, tree: Any, rays: tuple[Any, ...], times: tuple[Any, Any]) -> EveryHit:
        """`every` hit of rays = (origins, directions, t_max, mask, skip_inside)."""
        origins, directions, t_max, mask, skip_inside = rays
        count, skip = len(origins), checks.flag('skip_inside', skip_inside)
        limits = checks.limits_or_one('t_max', t_max, count)
        rows = limits, checks.masks_or_one(mask, count), *both_times(times, count)
        return self.every(tree, Casts(origins, origins, directions, *rows, skip, EVERY))

    def every(self, tree: Any, casts: Casts) -> EveryHit:
        """All hits of rays or boxes, nearest first, or the first of each."""
        count, ndim, begun = len(casts.lo), tree.ndim, tree._view()
        offsets, done = np.zeros(count + 1, np.int64), 0
        found = room_for_hits(count if casts.mode != EVERY else 64)
        kernel = rows_entry(ndim)
        spans = functools.partial(times_of, casts.at, casts.pace, casts.t_max)
        while done < count:

            def call(arrays: Any, moving: Any, first: int = done, room: Any = found) -> Any:
                return kernel(arrays, moving, casts, offsets, room, first)

            done, wanted = self.ask(tree, spans, call, not casts.pace.any())
            if done < count:
                found = more_room(found, wanted)
        total = offsets.item(-1)
        found = Found(found.slots[:total], found.ts[:total], found.axes[:total])
        if casts.mode == EVERY and total > FEW_HITS:  # else there is one a row, or they are sorted
            rows = np.repeat(np.arange(count), np.diff(offsets))
            order = np.lexsort((begun.tree.handles[found.slots], found.ts, rows))
            found = Found(found.slots[order], found.ts[order], found.axes[order])
        places = Places(np.empty((total, ndim)), np.empty((total, ndim)))
        if casts.mode != ANY:
            kernel = describe_entry(ndim)
            kernel(begun.tree, self.moving, casts, offsets, found, places)
        handles = begun.tree.handles[found.slots]
        tree._check_unchanged(begun)
        return EveryHit(offsets, handles, found, places)

    def first_many(
        self,
        tree: Any,
        rays: tuple[Floats, Floats, Floats, Any],
        skip: bool,
        mode: int,
        times: tuple[Any, Any],
        threads: int,
    ) -> RayHits:
        """`raycast_many` of rays = (origins, directions, t_max, masks), and `occluded_many`, of
        which the ids tell it.
        """
        count, ndim, (at, pace) = len(rays[0]), tree._ndim, times
        if threads == 1 and type(at) is type(pace) is float and not tree._storage.heirs:
            # What is ready is looked for before anything is made: of few rays, that is most.
            hits = self._few_at_one_time(tree, rays, skip, mode, times)
            if hits is not None:
                return hits
        when = checks.times('at', at, count), checks.times('pace', pace, count)
        span, every = times_of(*when, rays[2])
        if not every:
            when = both_times(times, count)
        query = TimedRays(*rays, skip, mode, *when, AS_ARRAYS)
        if threads == 1 and every and count and not tree._storage.heirs:
            hits = self._ready(tree, query, *span)
            if hits is not None:
                return hits
        view, hits = tree._view(), room_for_rays(count, ndim, mode)
        sweep = self.swept_for(tree, view, count, span) if every and count else None
        if sweep is None:
            _check_finite(query)

        def work(start: int, stop: int) -> int:
            part, into = query, hits
            if stop - start < count:
                part, into = (rows_of(rows, count, slice(start, stop)) for rows in (query, hits))
            if sweep is not None:
                return accepted(cast_swept(view.tree, sweep, part, into))
            self._by_nodes(tree, part, into)
            return 0

        if any(in_threads(work, count, threads, 1 if sweep is None else 2 * RAYS_AT_ONCE)):
            self._answer_unsuited(tree, query, hits)
        return hits

    def _few_at_one_time(
        self,
        tree: Any,
        rays: tuple[Floats, Floats, Floats, Any],
        skip: bool,
        mode: int,
        when: tuple[float, float],
    ) -> Any:
        """Hits of rays that all go at the same time, through what is swept already; None where
        nothing is.
        """
        count, ndim, (at, pace), t_max = len(rays[0]), tree._ndim, when, rays[2]
        sweep = self.few_sweep(count)
        if sweep is None:
            if not len(t_max):
                return None
            limit = t_max.item() if len(t_max) == 1 else t_max.max().item()
            last = at if pace == 0.0 else at + limit * pace
            query = TimedRays(*rays, skip, mode, NO_TIMES, NO_TIMES, when)
            return self._ready(tree, query, at, last)
        if mode != CLOSEST:
            hits = room_for_rays(count, ndim, mode)
        else:  # as RayHits(...), which would take one more call of a function of Python's
            parts = np.empty(count, INT64), np.empty(count), np.empty((count, ndim))
            hits = tuple.__new__(RayHits, parts)
        done = few_entry(ndim)(tree._storage.tree, sweep, rays, skip, mode, when, hits)
        if done > 0:
            query = TimedRays(*rays, skip, mode, NO_TIMES, NO_TIMES, when)
            self._answer_unsuited(tree, query, hits)
        return hits if done >= 0 else None

    def _ready(self, tree: Any, query: TimedRays, first: float, last: float) -> Any:
        """Hits of rays from a time to another, through what is swept already; None where nothing
        is.
        """
        count, arrays = len(query.origins), tree._storage.tree
        sweep = self.ready_sweep(arrays, count, first, last)
        if sweep is None:
            return None
        hits = room_for_rays(count, tree._ndim, query.mode)
        done = cast_swept(arrays, sweep, query, hits)
        if done > 0:
            self._answer_unsuited(tree, query, hits)
        return hits if done >= 0 else None

    def _answer_unsuited(self, tree: Any, rays: TimedRays, hits: Any) -> None:
        """Answer those rays that are UNSUITED."""
        if not len(rays.at):
            rays = rays._replace(at=np.array(rays.when[:1]), pace=np.array(rays.when[1:]))
        count, others = len(rays.origins), np.flatnonzero(hits.ids == UNSUITED)
        _check_finite(rays)
        some = rows_of(hits, count, others)
        self._by_nodes(tree, rows_of(rays, count, others), some)
        for column, part in zip(hits, some, strict=True):
            column[others[: len(part)]] = part

    def _by_nodes(self, tree: Any, rays: TimedRays, hits: Any) -> None:
        """Answer rays by the tree's own nodes."""
        if len(rays.origins) == 1:  # with a third of the Python
            swept = *rays.origins, *rays.origins, *rays.directions
            options = rays.t_max.item(), rays.masks[0], rays.skip_inside, rays.mode
            times, place = (rays.at.item(), rays.pace.item()), np.empty((2, tree._ndim))
            hits.ids[0], t = self.cast(tree, swept, options, times, place)
            if rays.mode == CLOSEST:
                hits.t[0], hits.normals[0] = t, place[1] if hits.ids[0] >= 0 else 0.0
            return
        casts = Casts(rays.origins, *rays[:4], *rays[6:8], rays.skip_inside, rays.mode)
        every = self.every(tree, casts)
        rows = np.flatnonzero(np.diff(every.offsets))
        hits.ids[:] = NONE
        hits.ids[rows] = every.ids
        if rays.mode == CLOSEST:
            hits.t[:], hits.normals[:] = np.inf, 0.0
            hits.t[rows], hits.normals[rows] = every.found.ts, every.places.normals


def _check_finite(rays: TimedRays) -> None:
    checks.finite('origins', rays.origins)
    checks.finite('directions', rays.directions)
