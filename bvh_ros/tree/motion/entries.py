# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What rays and swept boxes meet in a tree whose boxes move. Arguments are those of the tree's
methods of the same names, which hand them on.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import checks, time_checks
from ..batch.streams import RAYS_AT_ONCE
from ..checks import INT64
from ..compiler import inlined, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import DEEPEST, EXACT_RAYS, NONE, RAYS, ROOT, Tree, View, is_leaf
from ..query.ray import ANY, CLOSEST, EVERY, Asked, Found, more_room, of_row, room_for_hits
from ..query.ray_queries import room_for_rays, rows_of
from ..query.slab import (
    DIRECTION,
    EXACT,
    INSIDE,
    ORIGIN,
    PAD,
    RAY_ROWS,
    TINY,
    UPPER,
    set_swept_box,
)
from ..results import RayHits
from ..simd.moving_sides import FRONTS
from ..store.turns import NOT_FINITE, accepted, count_rays, end_query
from ..store.workers import in_threads
from .bounds import OUTSIDE, begin_asking, covers, enter_node, moments_of, no_motion, set_fronts
from .exact_contact import as_met, box_of, course_of, elapsed, is_before, meet_box
from .state import Motion, both_times, span_of, times_of
from .sweep import AS_ARRAYS, NO_TIMES, UNSUITED, RaysThen, Sweep, cast_swept, few_entry

Floats = NDArray[np.float64]


class Casts(NamedTuple):
    """What is asked for."""

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


@lean_kernel
def cast(tree, moving, course, asked, found, filled):
    """Write the hits of a course, `asked` as of `Asked`, to `found` from `filled` on; return where
    the next would go. See `rays.raycasting.raycast`; instead of axes, faces of `meet_box`.

    What the bounds do not hold for visits all boxes.
    """
    nodes, root, mask = moving.nodes, tree.state[ROOT], asked.mask
    slots, ts, faces, ray = found.slots, found.ts, found.axes, course.ray
    if root == NONE:
        return filled
    bounded = covers(moving, course.at, course.pace, asked.t_max) > 0
    ahead, limit = course.at - moving.start, asked.t_max
    begin, best, fronts = filled, np.int64(NONE), stack_array(FRONTS, np.float64)
    set_fronts(fronts, moving, ray[ORIGIN], ray[UPPER], ray[DIRECTION])
    stack, entries = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64)
    stack[0], entries[0], top = root, 0.0, 1
    while top > 0:
        top -= 1
        if entries[top] > limit * PAD + TINY or nodes[stack[top]].mask & mask == 0:
            continue
        node, top = descend(
            nodes, fronts, bounded, (ahead, course.pace, limit), (stack, entries, top)
        )
        if node == NONE or nodes[node].mask & mask == 0:
            continue
        slot = np.int64(node >> 1)
        hit, t, face = meet_box(box_of(tree, moving, slot), course, asked.t_max)
        if not hit or (asked.skip_inside and face == INSIDE):
            continue
        place = filled
        if asked.mode == CLOSEST:
            if best != NONE and not is_before(
                tree, moving, course, (slot, t, face), (best, ts[begin], faces[begin])
            ):
                continue
            best, place, limit = slot, begin, t
        if place < slots.shape[0]:
            slots[place], ts[place], faces[place] = slot, t, face
        filled = place + 1
        if asked.mode == ANY:
            break
    return filled


@inlined
def descend(nodes, fronts, bounded, course, waiting):
    """Follow the nearer child from the last of the nodes that wait, (stack, entries, top), down to
    a leaf: (leaf or NONE, top). fronts and course = (ahead, pace, limit) as of `enter_node`.
    """
    stack, entries, top = waiting
    node = stack[top]
    while not is_leaf(node):
        first, second = np.int64(nodes[node].left), np.int64(nodes[node].right)
        first_entry, second_entry = 0.0, 0.0
        if bounded:
            first_entry = enter_node(nodes, first, fronts, *course)
            second_entry = enter_node(nodes, second, fronts, *course)
        if second_entry < first_entry:
            first, second = second, first
            first_entry, second_entry = second_entry, first_entry
        if first_entry == np.inf:
            return np.int64(NONE), top
        if second_entry < np.inf:
            stack[top], entries[top] = second, second_entry
            top += 1
        node = first
    return node, top


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
    seen, face = as_met(box, course, face)
    since = elapsed(seen.at, reference, seen.nanoseconds)[0]
    if seen.pace != 0.0:
        since += t * seen.pace
    for k in range(lo.shape[0]):
        low, high = course.ray[ORIGIN, k], course.ray[UPPER, k]
        normal[k], point[k] = 0.0, low * 0.5 + high * 0.5
        if face == INSIDE and low == high:
            continue
        way = velocity[k] * since
        if face != INSIDE and k == face >> 1:
            point[k], normal[k] = (lo[k] + way, -1.0) if face & 1 == 0 else (hi[k] + way, 1.0)
        else:
            if course.ray[DIRECTION, k] != 0.0 and t > 0.0:
                point[k] += t * course.ray[DIRECTION, k]
            point[k] = min(max(point[k], lo[k] + way), hi[k] + way)


@lean_kernel
def cast_one(tree, moving, swept, asked, times, place):
    """One ray or box, swept = (lo, hi, direction), asked = what an `Asked` holds, which Python
    makes slowly, times = (at, pace): (handle, t), and for CLOSEST its point and normal in `place`.
    Instead of a handle why there is none: NONE, NOT_FINITE if the input is not, REFUSED if the
    tree is of another version, or OUTSIDE.
    """
    (lo, hi, direction), (at, pace), state = swept, times, tree.state
    asked = Asked(asked[0], asked[1], asked[2], asked[3])
    if not is_sound(lo, hi, direction, times):
        return NOT_FINITE, np.inf
    if covers(moving, at, pace, asked.t_max) == 0:
        return OUTSIDE, np.inf
    why = begin_asking(tree, moving, 1 if pace == 0.0 else 0)
    if why != 0:
        return why, np.inf
    course = course_of(stack_array((RAY_ROWS, 3), np.float64), at, pace, moving)
    set_swept_box(course.ray, lo, hi, direction)
    slots, faces = stack_array(1, np.int64), stack_array(1, np.int64)
    ts = stack_array(1, np.float64)
    handle, t = np.int64(NONE), np.inf
    if cast(tree, moving, course, asked, Found(slots, ts, faces), 0) > 0:
        handle, t = tree.handles[slots[0]], ts[0]
        if asked.mode == CLOSEST:
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
        asked = Asked(t_max, mask, casts.skip_inside, casts.mode)
        end = cast(tree, moving, course, asked, found, offsets[done])
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
    then of handles; each t becomes the largest up to it. Points and normals go to `places`.
    """
    slots, ts, faces = found.slots, found.ts, found.axes
    ray = stack_array((RAY_ROWS, 3), np.float64)
    for i in range(casts.lo.shape[0]):
        set_swept_box(ray, casts.lo[i], casts.hi[i], casts.directions[i])
        course = course_of(ray, of_row(casts.at, i), of_row(casts.pace, i), moving)
        for j in range(offsets[i] + 1, offsets[i + 1]):
            hit, place = (slots[j], ts[j], faces[j]), j
            while place > offsets[i] and is_before(
                *(tree, moving, course, hit), (slots[place - 1], ts[place - 1], faces[place - 1])
            ):
                slots[place], ts[place] = slots[place - 1], ts[place - 1]
                faces[place] = faces[place - 1]
                place -= 1
            slots[place], ts[place], faces[place] = hit
        for j in range(offsets[i], offsets[i + 1]):
            if j > offsets[i]:
                ts[j] = max(ts[j], ts[j - 1])
            box = box_of(tree, moving, slots[j])
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
    """What rays and boxes meet on their ways."""

    def cast(
        self,
        tree: Any,
        swept: tuple[Floats, Floats, Floats],
        asked: tuple[float, np.uint32, bool, int],
        times: tuple[Any, Any],
        place: Floats,
    ) -> tuple[int, float]:
        """`cast_one` of lo, hi, direction: (handle, or NONE or NOT_FINITE, t)."""
        at, pace = times
        if not (type(at) is type(pace) is float):
            times = at, pace = time_checks.moment('at', at), time_checks.moment('pace', pace)
        kernel, moving = one_entry(tree._ndim), self.moving if pace else self.bounds
        handle, t = kernel(tree._settled().tree, moving, swept, asked, times, place)
        while handle < NONE and handle != NOT_FINITE:
            span = span_of(at, pace, asked[0])
            moving = self.others(tree, moving, handle, span, pace == 0.0)
            handle, t = kernel(tree._settled().tree, moving, swept, asked, times, place)
        if handle == NOT_FINITE:
            time_checks.moments('at', at, None)
            time_checks.moments('pace', pace, None)
        return handle, t

    def every_ray(
        self, tree: Any, rays: tuple[Any, ...], times: tuple[Any, Any]
    ) -> tuple[Ids, Ids, Found, Places]:
        """`every` hit of rays = (origins, directions, t_max, mask, skip_inside)."""
        origins, directions, t_max, mask, skip_inside = rays
        count, skip = len(origins), checks.flag('skip_inside', skip_inside)
        limits = checks.limits_or_one('t_max', t_max, count)
        rows = limits, checks.masks_or_one(mask, count), *both_times(times, count)
        return self.every(tree, Casts(origins, origins, directions, *rows, skip, EVERY))

    def every(self, tree: Any, casts: Casts) -> tuple[Ids, Ids, Found, Places]:
        """All hits of rays or boxes, nearest first, or the first of each: (offsets, handles, what
        was found, where).
        """
        count, ndim, begun = len(casts.lo), tree.ndim, tree.view()
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
        tree.check_unchanged(begun)
        return offsets, handles, found, places

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
            hits = self._alike(tree, rays, skip, mode, times)
            if hits is not None:
                return hits
        when = time_checks.times('at', at, count), time_checks.times('pace', pace, count)
        span, every = times_of(*when, rays[2])
        if not every:
            when = both_times(times, count)
        asked = RaysThen(*rays, skip, mode, *when, AS_ARRAYS)
        if threads == 1 and every and count and not tree._storage.heirs:
            hits = self._ready(tree, asked, *span)
            if hits is not None:
                return hits
        view, hits = tree.view(), room_for_rays(count, ndim, mode)
        sweep = self.swept_for(tree, view, count, span) if every and count else None
        self.answer(tree, (view, sweep), asked, hits, threads, cast_swept)
        return hits

    def _alike(
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
            asked = RaysThen(*rays, skip, mode, NO_TIMES, NO_TIMES, when)
            return self._ready(tree, asked, at, last)
        if mode != CLOSEST:
            hits = room_for_rays(count, ndim, mode)
        else:  # as RayHits(...), which would take one more call of a function of Python's
            parts = np.empty(count, INT64), np.empty(count), np.empty((count, ndim))
            hits = tuple.__new__(RayHits, parts)
        done = few_entry(ndim)(tree._storage.tree, sweep, rays, skip, mode, when, hits)
        if done > 0:
            asked = RaysThen(*rays, skip, mode, NO_TIMES, NO_TIMES, when)
            self._tell_unsuited(tree, asked, hits)
        return hits if done >= 0 else None

    def _ready(self, tree: Any, asked: RaysThen, first: float, last: float) -> Any:
        """Hits of rays from a time to another, through what is swept already; None where nothing
        is.
        """
        count, arrays = len(asked.origins), tree._storage.tree
        sweep = self.ready_sweep(arrays, count, first, last)
        if sweep is None:
            return None
        hits = room_for_rays(count, tree._ndim, asked.mode)
        done = cast_swept(arrays, sweep, asked, hits)
        if done > 0:
            self._tell_unsuited(tree, asked, hits)
        return hits if done >= 0 else None

    def answer(
        self,
        tree: Any,
        seen: tuple[View, Sweep | None],
        asked: RaysThen,
        hits: Any,
        threads: int,
        cast: Callable[[Tree, Sweep, RaysThen, Any], int],
    ) -> bool:
        """Fill in the first hits of rays, a `RayHits` or what has more columns. `cast` is called
        as `cast_swept` of some, where there is a sweep; whether it has told all.
        """
        count, (view, sweep) = len(asked.origins), seen
        if sweep is None:
            _check_finite(asked)

        def work(start: int, stop: int) -> int:
            part, into = asked, hits
            if stop - start < count:
                part, into = (rows_of(rows, count, slice(start, stop)) for rows in (asked, hits))
            if sweep is not None:
                return accepted(cast(view.tree, sweep, part, into))
            self._one_by_one(tree, part, into)
            return 0

        unsuited = in_threads(work, count, threads, 1 if sweep is None else 2 * RAYS_AT_ONCE)
        if any(unsuited):
            self._tell_unsuited(tree, asked, hits)
        return sweep is not None and not any(unsuited)

    def _tell_unsuited(self, tree: Any, rays: RaysThen, hits: Any) -> None:
        """Answer those rays that are UNSUITED."""
        if not len(rays.at):
            rays = rays._replace(at=np.array(rays.when[:1]), pace=np.array(rays.when[1:]))
        count, others = len(rays.origins), np.flatnonzero(hits.ids == UNSUITED)
        _check_finite(rays)
        some = rows_of(hits, count, others)
        self._one_by_one(tree, rows_of(rays, count, others), some)
        for column, part in zip(hits, some, strict=True):
            column[others[: len(part)]] = part

    def _one_by_one(self, tree: Any, rays: RaysThen, hits: Any) -> None:
        """Answer rays by the tree's own nodes."""
        if len(rays.origins) == 1:  # with a third of the Python
            swept = *rays.origins, *rays.origins, *rays.directions
            asked = rays.t_max.item(), rays.masks[0], rays.skip_inside, rays.mode
            times, place = (rays.at.item(), rays.pace.item()), np.empty((2, tree._ndim))
            hits.ids[0], t = self.cast(tree, swept, asked, times, place)
            if rays.mode == CLOSEST:
                hits.t[0], hits.normals[0] = t, place[1] if hits.ids[0] >= 0 else 0.0
            return
        casts = Casts(rays.origins, *rays[:4], *rays[6:8], rays.skip_inside, rays.mode)
        offsets, handles, found, places = self.every(tree, casts)
        rows = np.flatnonzero(np.diff(offsets))
        hits.ids[:] = NONE
        hits.ids[rows] = handles
        if rays.mode == CLOSEST:
            hits.t[:], hits.normals[:] = np.inf, 0.0
            hits.t[rows], hits.normals[rows] = found.ts, places.normals


def _check_finite(rays: RaysThen) -> None:
    checks.finite('origins', rays.origins)
    checks.finite('directions', rays.directions)
