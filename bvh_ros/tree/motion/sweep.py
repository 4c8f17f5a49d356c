# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A wide snapshot of all places where boxes are within a span of time, and rays through it.

Nodes and children are those of the snapshot of boxes at rest; the planes of each leaf bound it
from the start of the span to its stop, those of an inner node its children. It only prunes, so it
serves every ray whose times lie within the span; the shorter that is, the better.

Where boxes move together, places are in the frame of their mean velocity, the drift. In that frame
nodes stay as small as at rest, and rays are transformed into it, see `start_in_drift_frame`.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..batch.single import cast_abreast
from ..batch.snapshot import (
    BLURRED,
    LARGEST_SCENE,
    SMALLEST_SCENE,
    Snapshot,
    blurred_entry,
    no_snapshot,
    octant_of,
    on_cache_lines,
    outwards,
    start_ray,
    write_planes,
)
from ..batch.streams import (
    ASK,
    DECIDED_EXACTLY,
    FOUND,
    MEETS,
    MIXED,
    MIXED_RAYS,
    OCTANTS,
    RAYS_AT_ONCE,
    RAYS_SORTED,
    TALLY,
    defer_leaves,
    fetch_nothing,
    is_scan,
    make_scratch,
    scratch_for,
    traverse,
    visit_leaf,
    visit_nothing,
)
from ..compiler import CACHE_LINE, WIDTH, inlined, lean_kernel, prefetch, stack_array
from ..nodes import NONE, Tree, aligned_empty, entry_points
from ..query.ray import ANY, CLOSEST, NO_HITS, Hit, of_row
from ..query.slab import EXACT, INSIDE, set_ray
from ..results import RayHits
from ..store.turns import REFUSED, accepted, begin_query, count_rays, end_query
from .bounds import LEAST, WIDER, no_motion
from .exact_contact import (
    A_NANOSECOND,
    FASTEST,
    LATER,
    LEAST_32,
    Moving,
    box_of,
    course_of,
    distance_of,
    fetch_box,
    is_before,
    may_meet,
    meet_box,
    moves,
    phase_at_hit,
    quick_decision,
    quick_decision_of_both,
)

MARGIN, WIDER_32 = 2.0**-38, 2.0**-22


@functools.cache
def leaf_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a leaf, by slot."""
    wide, narrow = (np.float64, (ndim,)), (np.float32, (ndim,))
    return np.dtype(
        {
            'names': ['lo', 'hi', 'velocity', 'loose'],
            'formats': [wide, wide, narrow, np.float32],
            'offsets': [0, 8 * ndim, 16 * ndim, 20 * ndim],
            'itemsize': CACHE_LINE,
        }
    )


class Leaves(NamedTuple):
    """What a rounded test needs."""

    records: NDArray[Any]
    """Of `leaf_dtype`; behind them one more, whose `lo` is the drift: at that velocity the planes
    of the snapshot go on; `loose` is 0 if there is none. (An argument more takes 0.2 us.)
    """
    start: float
    """When boxes are where they say, s, and planes, too."""


@inlined
def swept_side(box, axis, moving, drift):
    """The bounds of a box on an axis over the span, in the drift frame, surely wide enough."""
    least, most, more = _displacements(box, axis, moving, drift[axis])
    return box[0][axis] + least - more, box[1][axis] + most + more


@inlined
def _displacements(box, axis, moving, drift):
    """How far a box moves in the span relative to the drift: the least, the most, and the error of
    its place.
    """
    lo, hi, velocity, reference = box
    speed, end, length = velocity[axis], reference + moving.left, moving.stop - moving.start
    first = speed * (min(moving.start, end) - reference)
    # Its place is linear in time until it stops, and from then on.
    displacement = speed * (min(moving.stop, end) - reference)
    bent = displacement - drift * min(max(end - moving.start, 0.0), length)
    last = displacement - drift * length
    extent, times = abs(lo[axis]) + abs(hi[axis]), abs(moving.start) + abs(moving.stop)
    extent += abs(speed) * (times + abs(reference)) + abs(drift) * times
    return min(first, bent, last), max(first, bent, last), extent * WIDER + LEAST


@inlined
def speed_of(box, axis, moving):
    """Of a box that may stop, on the average over the span."""
    end = box[3] + moving.left
    if end < moving.stop:
        passed = max(end - moving.start, 0.0)
        return box[2][axis] * (passed / (moving.stop - moving.start)) if passed > 0.0 else 0.0
    return box[2][axis]


@inlined
def may_stop(box, moving):
    """Whether a box is going at the start of the span and may stop before a course is over whose
    last time, as it is rounded, is in the span.
    """
    soon = (abs(moving.start) + abs(moving.stop)) * LATER + A_NANOSECOND
    return moving.start <= box[3] + moving.left < moving.stop + soon and moves(box)


@inlined
def set_leaf(leaf, box, axis, moving, per_length):
    """Write an axis of a leaf's record.

    It is wider by MARGIN of the scene. That is more than all that `rounded.quick_decision`
    loses: with its origin within 2**10 scenes and within the span, a ray goes no further than that
    along an axis, relative to a box, nor does that go further than `sweeping.FARTHEST_DRIFT`
    and a scene.
    """
    speed = speed_of(box, axis, moving)
    speed = np.float32(speed if abs(speed) < FASTEST else 0.0)
    least, most, more = _displacements(box, axis, moving, np.float64(speed))
    margin = MARGIN / per_length
    more += margin
    leaf.velocity[axis] = speed
    leaf.lo[axis] = box[0][axis] + least - more
    leaf.hi[axis] = box[1][axis] + most + more
    loose = most - least + 2.0 * more + margin
    leaf.loose = max(leaf.loose, np.float32(loose * (1.0 + WIDER_32)) + LEAST_32)


USELESS = -2  # why there is no such snapshot
# Boxes move together if on the average they sweep so many times what they sweep in the drift
# frame.
TOGETHER = 2.0
# No snapshot sees boxes go along for more than so many of its units: then rays begin too far away.
FARTHEST_DRIFT = 2.0**9


class Sweep(NamedTuple):
    """A snapshot that is swept over a span of time."""

    snapshot: Snapshot
    moving: Moving
    """The motion from which it was made."""
    leaves: Leaves

    @property
    def nbytes(self) -> int:
        """Memory that is not that of the snapshot at rest."""
        return self.snapshot.planes.nbytes + self.leaves.records.nbytes


def no_sweep(ndim: int) -> Sweep:
    """Empty arrays of the right types."""
    leaves = Leaves(np.empty(0, leaf_dtype(ndim)), 0.0)
    return Sweep(no_snapshot(ndim), no_motion(ndim), leaves)


@inlined
def _leaf_of(tree, snapshot, lane):
    """Slot of the leaf that a lane holds, negative if it holds none or one that is gone."""
    slot = ~np.int64(snapshot.children[lane])
    holds = snapshot.masks[lane] != 0 and slot >= 0 and tree.nodes[2 * slot].mask != 0
    return slot if holds else np.int64(-1)


@inlined
def _half_area(sides):
    """Of a box, or of a rectangle half its perimeter."""
    if sides.shape[0] == 2:
        return sides[0] + sides[1]
    return sides[0] * sides[1] + sides[1] * sides[2] + sides[2] * sides[0]


@inlined
def _set_frame(tree, moving, snapshot, frame, drift, mean):
    """Write the centre of all that is swept in the drift frame, units in which it lies within
    [-1, 1], and the mean velocity; return (whether there are such units, as in
    `batch.snapshot.take_snapshot`, whether boxes move together).
    """
    ndim, half, farthest, count = frame.shape[0] - 1, 0.0, 0.0, 0
    length = moving.stop - moving.start
    low, high = stack_array(3, np.float64), stack_array(3, np.float64)
    low[:], high[:], mean[:] = np.inf, -np.inf, 0.0
    # What a box sweeps on the average, and what it sweeps in the frame of the mean velocity.
    swept, apart = stack_array(3, np.float64), stack_array(3, np.float64)
    swept[:] = apart[:] = 0.0
    for lane in range((snapshot.size + snapshot.loose) * WIDTH):
        slot = _leaf_of(tree, snapshot, lane)
        if slot >= 0:
            box = box_of(tree, moving, slot)
            count += 1
            for axis in range(ndim):
                lo, hi = swept_side(box, axis, moving, drift)
                side, speed = box[1][axis] - box[0][axis], speed_of(box, axis, moving)
                mean[axis] += (speed - mean[axis]) / count
                swept[axis] += side + abs(speed) * length
                apart[axis] += side + abs(speed - mean[axis]) * length
                # Written such that what is not a number makes the scene too large.
                low[axis] = low[axis] if low[axis] <= lo else lo
                high[axis] = high[axis] if high[axis] >= hi else hi
    for axis in range(ndim):
        frame[axis] = low[axis] * 0.5 + high[axis] * 0.5
        half = max(half, high[axis] * 0.5 - low[axis] * 0.5)
        far = max(abs(low[axis]), abs(high[axis]))
        farthest = farthest if farthest >= far else far
    if not (SMALLEST_SCENE < half < LARGEST_SCENE and farthest < LARGEST_SCENE):
        return False, False
    frame[ndim] = math.ldexp(1.0, -math.frexp(half)[1])
    return True, TOGETHER * _half_area(apart[:ndim]) < _half_area(swept[:ndim])


@inlined
def _choose_frame(tree, moving, snapshot, frame, last):
    """`_set_frame` and the drift, in the last record: none, or the mean velocity if boxes go
    together. Returns whether a snapshot can be made so.
    """
    mean, farthest, drift = stack_array(3, np.float64), 0.0, last.lo
    drift[:] = 0.0
    for _ in range(2):
        fits, together = _set_frame(tree, moving, snapshot, frame, drift, mean)
        if not (fits and together):
            break
        for axis in range(drift.shape[0]):
            drift[axis], farthest = mean[axis], max(farthest, abs(mean[axis]))
    last.loose = np.float32(farthest != 0.0)
    shift = farthest * (moving.stop - moving.start) * frame[drift.shape[0]]
    return fits and shift <= FARTHEST_DRIFT


@inlined
def _sweep_leaf(box, lane, moving, frame, drift, planes, leaf):
    """Write the planes and the record of a leaf."""
    # No rounded test decides whether a box that may stop still moves when a ray meets it.
    ndim, leaf.loose = frame.shape[0] - 1, np.float32(np.inf if may_stop(box, moving) else 0.0)
    for axis in range(ndim):
        lo, hi = swept_side(box, axis, moving, drift)
        set_leaf(leaf, box, axis, moving, frame[ndim])
        write_planes(planes, lane, axis, ndim, outwards(lo, hi, frame[axis], frame[ndim]))


@inlined
def _lane_area(planes, lane, ndim, per_length):
    """Half area of what a lane holds."""
    place, sides = lane // WIDTH * (2 * ndim * WIDTH) + lane % WIDTH, stack_array(3, np.float64)
    for axis in range(ndim):
        upper, lower = planes[place + (axis + ndim) * WIDTH], planes[place + axis * WIDTH]
        sides[axis] = (np.float64(upper) - np.float64(lower)) / per_length
    return _half_area(sides[:ndim])


@inlined
def _unite_child(planes, lane, child, ndim):
    """Write the planes of a lane that holds a wide node."""
    for axis in range(ndim):
        lower = (child * 2 * ndim + axis) * WIDTH
        upper = lower + ndim * WIDTH
        lo, hi = np.float32(np.inf), np.float32(-np.inf)
        for k in range(WIDTH):
            lo, hi = min(lo, planes[lower + k]), max(hi, planes[upper + k])
        write_planes(planes, lane, axis, ndim, (lo, hi))


@lean_kernel
def sweep(tree, moving, snapshot, planes, leaves, frame, areas):
    """Fill `planes`, as those of a snapshot of the tree at rest, and `leaves`, the records of
    `Leaves`, for the span of `moving`, and `frame`, (ndim + 1,): its centre, and its units per
    length; `areas`, (2,): the half area of all wide nodes in the snapshot, and now. Returns 0;
    USELESS if it would be; REFUSED if the tree is of another version than `moving`.
    """
    if not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    ndim, drift, areas[:] = frame.shape[0] - 1, leaves[-1].lo, 0.0
    useful = _choose_frame(tree, moving, snapshot, frame, leaves[-1])
    if useful:
        # From the last to the first: children have greater numbers than their parents.
        for lane in range((snapshot.size + snapshot.loose) * WIDTH - 1, -1, -1):
            slot, child = _leaf_of(tree, snapshot, lane), np.int64(snapshot.children[lane])
            if slot >= 0:
                box = box_of(tree, moving, slot)
                _sweep_leaf(box, lane, moving, frame, drift, planes, leaves[slot])
            elif child >= 0:
                _unite_child(planes, lane, child, ndim)
                areas[0] += _lane_area(snapshot.planes, lane, ndim, snapshot.per_length)
                areas[1] += _lane_area(planes, lane, ndim, frame[ndim])
            else:
                for axis in range(ndim):
                    empty = np.float32(np.inf), np.float32(-np.inf)
                    write_planes(planes, lane, axis, ndim, empty)
    end_query(tree.state)
    return np.int64(0 if useful else USELESS)


_PLANES, _NUMBERS = np.empty(0, np.float32), np.empty(0)
_entry = entry_points(
    *(sweep, no_motion, no_snapshot, _PLANES),
    *(lambda ndim: np.empty(0, leaf_dtype(ndim)), _NUMBERS, _NUMBERS),
)


def swept(tree: Tree, moving: Moving, snapshot: Snapshot) -> tuple[Sweep | None, float]:
    """A snapshot for the span of `moving`, made of that of the tree at rest, and how many times as
    large its nodes are; None where it would prune too little; RuntimeError if the tree is of
    another version than `moving`.
    """
    ndim = len(snapshot.center)
    planes, frame, areas = on_cache_lines(len(snapshot.planes)), np.empty(ndim + 1), np.empty(2)
    records = aligned_empty(len(tree.handles) + 1, leaf_dtype(ndim))
    done = _entry(ndim)(tree, moving, snapshot, planes, records, frame, areas)
    if done == USELESS:
        return None, 1.0
    accepted(done)
    center, per_length = frame[:ndim], float(frame[ndim])
    if accepted(blurred_entry(ndim)(tree, moving.version, BLURRED / per_length)):
        return None, 1.0
    snapshot = snapshot._replace(planes=planes, center=center, per_length=per_length)
    grown = areas.item(1) / areas.item(0) if areas.item(0) > 0.0 else 1.0
    return Sweep(snapshot, moving, Leaves(records, moving.start)), grown


Floats = NDArray[np.float64]
NO_TIMES, AS_ARRAYS = np.empty(0), (0.0, 0.0)


class TimedRays(NamedTuple):
    """Rays as of `rays.raycasting.Rays`, and when they start."""

    origins: Floats
    directions: Floats
    t_max: Floats
    masks: NDArray[np.uint32]
    skip_inside: bool
    mode: int
    at: Floats
    """One for all, or a row, as `pace`; NO_TIMES if `when` tells both."""
    pace: Floats
    when: tuple[float, float]
    """For all rays: of few, to make arrays takes as long as some of them."""


def split_times(when: tuple[Any, Any]) -> tuple[Floats, Floats, tuple[float, float]]:
    """`at`, `pace` and `when` of `TimedRays`, of what may be two numbers for all or two arrays."""
    return (NO_TIMES, NO_TIMES, when) if type(when[0]) is float else (*when, AS_ARRAYS)


class MovingRays(NamedTuple):
    """`TimedRays` and the parts of a `Sweep` that each ray needs."""

    origins: Any
    directions: Any
    t_max: Any
    masks: Any
    skip_inside: Any
    mode: Any
    at: Any
    pace: Any
    moving: Any
    leaves: Any


_ROW, _ROWS = np.empty(0), np.empty((0, 3))
NO_RAYS = TimedRays(
    *(_ROWS, _ROWS, _ROW, np.empty(0, np.uint32), False, CLOSEST), *(NO_TIMES, NO_TIMES, AS_ARRAYS)
)


# A ray that moves with the drift keeps 2**-50 of its direction: it must not be zero.
ALMOST_ONE = 1.0 - 2.0**-50


@inlined
def start_in_drift_frame(record, snapshot, leaves, rays, row):
    """`filtering.start_ray` of one of `rays`, MovingRays or what has as much to say; whether it is
    suited to the snapshot of a `sweeping.Sweep`, whose leaves these are.
    """
    origin, direction, t_max = rays.origins[row], rays.directions[row], of_row(rays.t_max, row)
    units, drift = (snapshot.center, snapshot.per_length), leaves.records[-1].lo
    if leaves.records[-1].loose == 0.0:
        return start_ray(record, origin, direction, *units, t_max)
    origin = origin, drift, of_row(rays.at, row) - leaves.start
    direction = direction, drift, of_row(rays.pace, row) * ALMOST_ONE
    return start_ray(record, origin, direction, *units, t_max)


@inlined
def start_group(snapshot, rays, rows, scratch):
    """Fill the records of the rays of `rows` and list them, those that are suited first; return
    how many are.
    """
    alive, last = 0, rows.shape[0]
    for i in range(rows.shape[0]):
        suited = start_in_drift_frame(scratch.records[i], snapshot, rays.leaves, rays, rows[i])
        last -= not suited
        scratch.lists[alive if suited else last] = i
        alive += suited
    return alive


@lean_kernel
def sort_by_octant(rays, start, octants, rows, ends):
    """Fill `rows` with the numbers from `start` on, octant by octant of the rays' directions;
    those of octant k end before ends[k]. `octants` is scratch.
    """
    ends[:], drift = 0, rays.leaves.records[-1].lo
    for i in range(rows.shape[0]):
        direction = rays.directions[start + i]
        octant, pace = octant_of(direction), of_row(rays.pace, start + i) * ALMOST_ONE
        if rays.leaves.records[-1].loose != 0.0:
            octant = 0
            for axis in range(direction.shape[0]):
                shift = direction[axis] - (drift[axis] * pace + 0.0)
                octant |= (math.copysign(1.0, shift) < 0.0) << axis
        octants[i] = octant
        ends[octants[i]] += 1
    before = 0
    for octant in range(ends.shape[0]):
        before, ends[octant] = before + ends[octant], before
    for i in range(rows.shape[0]):
        rows[ends[octants[i]]] = start + i
        ends[octants[i]] += 1


UNSUITED = -3  # not a handle, nor NONE
AHEAD = 4  # the memory of a box is prefetched so many hits before its hit is described
WAITING, PLACES = TALLY, TALLY + 1  # behind what is tallied: how many pairs wait
# Pairs that wait at most, and the share of a group's rays: what is met is known so much later.
MOST_WAITING, LEAST_WAITING, WAITING_SHARE = 64, 8, 8


class DeferringScratch(NamedTuple):
    """`ray_streams.Scratch` for a group of rays, and pairs of a ray and a leaf that it may meet.

    Most of them part when it is looked at closely. One after the other that is a guess of the
    processor's a pair, wrong as often as not; of many together there is none.
    """

    ray: Any
    records: Any
    lists: Any
    found: Any
    hit_lanes: Any
    stack: Any
    pairs: NDArray[np.int64]
    """Slot of the leaf, and in the lower half the ray's place; as many as wait at most."""
    patched: bool
    """Whether a leaf may be in the snapshot twice, see `wide.raycasting.is_stale`."""


@inlined
def is_better(tree, ray, rays, row, slot, best):
    """As `wide.best_hit.is_better`, with faces of `meet_box` for axes."""
    origin, direction = rays.origins[row], rays.directions[row]
    at, pace = of_row(rays.at, row), of_row(rays.pace, row)
    ray[EXACT, 0] = 0.0
    leaves = rays.leaves
    if leaves.records[slot].loose == np.inf:
        path = origin, direction, at, pace
        verdict, t, face = quick_decision_of_both(
            tree, rays.moving, leaves.records, slot, path, best[1]
        )
    else:
        since = at - leaves.start
        verdict, t, face = quick_decision(
            leaves.records, slot, origin, direction, since, pace, best[1]
        )
    if verdict != ASK:
        return verdict == MEETS and not (rays.skip_inside and face == INSIDE), t, np.int64(face)
    set_ray(ray, origin, direction)
    course = course_of(ray, at, pace, rays.moving)
    return _is_better(tree, course, rays, row, slot, best)


@lean_kernel
def _is_better(tree, course, rays, row, slot, best):
    """The exact decision."""
    hit, t, face = meet_box(box_of(tree, rays.moving, slot), course, of_row(rays.t_max, row))
    better = hit and not (rays.skip_inside and face == INSIDE)
    if better and best[0] != NONE:
        best_t = distance_of(box_of(tree, rays.moving, best[0]), course, best[2])
        better = is_before(
            tree, rays.moving, course, Hit(slot, t, face), Hit(best[0], best_t, best[2])
        )
    return better, t, face


@inlined
def write_hit(tree, ray, rays, row, hit, hits):
    """As `wide.raycasting.write_hit`."""
    slot, _, face = hit
    hits.ids[row] = tree.handles[slot]
    if rays.mode != ANY:
        course = course_of(ray, of_row(rays.at, row), of_row(rays.pace, row), rays.moving)
        box = box_of(tree, rays.moving, slot)
        hits.t[row] = distance_of(box, course, face)
        _, face = phase_at_hit(box, course, face)
        if face != INSIDE:
            hits.normals[row, face >> 1] = -1.0 if face & 1 == 0 else 1.0


@lean_kernel
def cast_rows(tree, sweep, query, scratch, hits):
    """As `batch.streams.cast_rows`, but the id of a ray that is not suited is UNSUITED. Returns
    how many are not, or REFUSED.
    """
    if not begin_query(tree.state, sweep.moving.version):
        return np.int64(REFUSED)
    snapshot, at, pace = sweep.snapshot, query.at, query.pace
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = query.when
    rays = MovingRays(
        *(query.origins, query.directions, query.t_max, query.masks),
        *(query.skip_inside, query.mode, at, pace, sweep.moving, sweep.leaves),
    )
    tally, ends = stack_array(PLACES, np.int64), stack_array(OCTANTS, np.int64)
    tally[DECIDED_EXACTLY] = tally[WAITING] = 0
    hits.ids[:], hits.t[:], hits.normals[:] = NONE, np.inf, 0.0
    count, unsuited = rays.origins.shape[0], np.int64(0)
    mixed = 0 < count <= MIXED_RAYS and not is_scan(rays.origins)
    for first in range(0, count, RAYS_SORTED):
        batch, begin = scratch.rows[: min(count - first, RAYS_SORTED)], 0
        if mixed:
            ends[:] = count
            for row in range(count):
                batch[row] = row
        else:
            sort_by_octant(rays, first, scratch.octants, batch, ends)
        for octant in range(OCTANTS):
            while begin < ends[octant]:
                rows = batch[begin : min(ends[octant], begin + RAYS_AT_ONCE)]
                which = MIXED if mixed else octant
                unsuited += _cast_group(snapshot, tree, which, rows, rays, scratch, tally, hits)
                begin += rows.shape[0]
    count_rays(tree.state, count, tally[DECIDED_EXACTLY])
    end_query(tree.state)
    return unsuited


@inlined
def _cast_group(snapshot, tree, octant, rows, rays, scratch, tally, hits):
    """Answer rays of one octant that go together; return how many are not suited."""
    alive = start_group(snapshot, rays, rows, scratch)
    for place in scratch.lists[alive : rows.shape[0]]:
        hits.ids[rows[place]] = UNSUITED
    tally[FOUND] = 0
    if alive > 0:
        most = min(max(LEAST_WAITING, alive // WAITING_SHARE), MOST_WAITING)
        pairs = stack_array(MOST_WAITING, np.int64)[:most]
        room = DeferringScratch(
            *(scratch.ray, scratch.records, scratch.lists, scratch.found, scratch.hit_lanes),
            *(scratch.stack, pairs, snapshot.loose > 0),
        )
        group = octant, rows, alive
        traverse(
            snapshot, tree, group, rays, room, tally, take_leaves, fetch_nothing, visit_nothing
        )
        flush_deferred(tree, rows, rays, room, tally)
    found = scratch.found[: tally[FOUND]]
    for place in range(found.shape[0]):
        if place + AHEAD < found.shape[0]:
            fetch_box(tree, rays.moving, np.int64(scratch.records[found[place + AHEAD]].slot))
        i = found[place]
        best, row = scratch.records[i], rows[i]
        set_ray(scratch.ray, rays.origins[row], rays.directions[row])
        hit = np.int64(best.slot), best.best_t, np.int64(best.axis)
        write_hit(tree, scratch.ray, rays, row, hit, hits)
    return rows.shape[0] - alive


@inlined
def take_leaves(snapshot, tree, node, listed, rays, scratch, tally, hit_lanes):
    return defer_leaves(snapshot, tree, node, listed, rays, scratch, tally, hit_lanes, defer_leaf)


@inlined
def defer_leaf(tree, rays, slot, rows, place, scratch, tally):
    """Let a ray wait that may meet a leaf; prefetch its memory."""
    prefetch(rays.leaves.records, slot, 1)
    scratch.pairs[tally[WAITING]] = slot << 32 | np.int64(place)
    tally[WAITING] += 1
    if tally[WAITING] == scratch.pairs.shape[0]:
        flush_deferred(tree, rows, rays, scratch, tally)


@lean_kernel
def flush_deferred(tree, rows, rays, scratch, tally):
    """See of the pairs that wait whether the leaf is the ray's best hit."""
    pairs, remaining, leaves = scratch.pairs, 0, rays.leaves
    alike = rays.at.shape[0] == 1 and rays.pace.shape[0] == 1
    since, pace = rays.at[0] - leaves.start, rays.pace[0]
    for i in range(tally[WAITING]):
        pair = pairs[i]
        slot, place = pair >> 32, pair & 0xFFFFFFFF
        row, limit = rows[place], scratch.records[place].best_t
        if not alike:
            since, pace = of_row(rays.at, row) - leaves.start, of_row(rays.pace, row)
        path = rays.origins[np.uint64(row)], rays.directions[np.uint64(row)]
        near = may_meet(leaves.records, slot, *path, since, pace, limit, 0.0)
        pairs[remaining] = pair
        remaining += near
        if near and leaves.records[slot].loose == np.inf:
            fetch_box(tree, rays.moving, slot)
    for i in range(remaining):
        group = rows, (pairs[i] & 0xFFFFFFFF,)
        visit_leaf(tree, pairs[i] >> 32, scratch.patched, group, rays, scratch, tally, is_better)
    tally[WAITING] = 0


cast_entry = entry_points(
    cast_rows, no_sweep, NO_RAYS, lambda ndim: make_scratch(0, ndim, 0), NO_HITS
)


def cast_swept(tree: Tree, sweep: Sweep, rays: TimedRays, hits: RayHits) -> int:
    """Answer rays whose times lie in the span of a sweep, but those that are UNSUITED: how many;
    REFUSED if the tree is not what was swept, or is changed meanwhile.
    """
    count, ndim = rays.origins.shape
    scratch = scratch_for(count, ndim, sweep.snapshot.depth)
    done: int = cast_entry(ndim)(tree, sweep, rays, scratch, hits)
    return done


# Smaller batches go ray by ray: of segments of 5 m that takes 0.87 times as long as in lists for
# 48, 0.92 times for 72, 1.0 to 1.1 times for 96.
FEW = 72


@lean_kernel
def cast_few(tree, sweep, query, skip_inside, mode, when, hits):
    """`cast_rows` of rays = (origins, directions, t_max, masks) that share their times, when =
    (at, pace); REFUSED, too, where those do not lie within the span that was swept.
    """
    (origins, directions, t_max, masks), (at, pace), moving = query, when, sweep.moving
    within = moving.start <= at <= moving.stop
    for row in range(t_max.shape[0]):
        last = at if pace == 0.0 else at + t_max[row] * pace
        within = within and moving.start <= last <= moving.stop
    if not within or not begin_query(tree.state, moving.version):
        return np.int64(REFUSED)
    ats, paces = stack_array(1, np.float64), stack_array(1, np.float64)
    ats[0], paces[0] = at, pace
    rays = MovingRays(
        *(origins, directions, t_max, masks, skip_inside, mode),
        *(ats, paces, moving, sweep.leaves),
    )
    exact, unsuited = cast_abreast(
        sweep.snapshot, tree, rays, _start, 0, hits, leave_ray, is_better, _set_and_write_hit
    )
    count_rays(tree.state, origins.shape[0], exact)
    end_query(tree.state)
    return unsuited


@inlined
def _start(snapshot, tree, rays, row, record, state, hits):
    """`start` of `cast_abreast`; it counts the rays that are UNSUITED."""
    suited = start_in_drift_frame(record, snapshot, rays.leaves, rays, row)
    if not suited:
        hits.ids[row] = UNSUITED
    return suited, np.int64(not suited)


@inlined
def _set_and_write_hit(tree, ray, rays, row, hit, hits):
    set_ray(ray, rays.origins[row], rays.directions[row])
    write_hit(tree, ray, rays, row, hit, hits)
    return False


@inlined
def leave_ray(ray, origin, direction):
    """Leave the ray: `is_better` writes it where it needs it."""


NO_FEW = _ROWS, _ROWS, _ROW, np.empty(0, np.uint32)
few_entry = entry_points(cast_few, no_sweep, NO_FEW, False, CLOSEST, AS_ARRAYS, NO_HITS)
