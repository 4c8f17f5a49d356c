# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances among obstacles that move, at a time a row: the kernels, and how they are
called. Scenes without velocities need none of this.
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    CHANGES,
    INT64,
    NONE,
    NOTHING,
    PointQueries,
    Tree,
    View,
    are_dense,
    end_query,
    of_row,
)
from ...tree.compiler import inlined, lean_kernel, prefetch, stack_array
from ...tree.motion.access import (
    OUTSIDE,
    Bounded,
    at_least,
    begin_asking,
    box_of,
    covers,
    elapsed,
    fetch_box,
    moves,
    near_at,
    nearest_bounds,
    overlap_at,
    times_of,
)
from ..shapes.footprint import FOOTPRINT
from ..shapes.hull import Hulls
from ..shapes.shape import GEOMETRY, Floats, along_axes
from ..store import WIDER, movers
from .batch import (
    COUNT,
    Points,
    Signed,
    answer_clearances,
    answer_nearest,
    answer_overlaps,
    look_at_shape,
    room_for,
)
from .distances import OVERLAPS, Distances, Scratch, bodies_of
from .narrow_phase import length, near
from .penetration import signed_distance_in_obstacle
from .query import (
    LARGEST,
    NO_GIVEN,
    ROUNDED,
    QueryShape,
    Touch,
    find_touching,
    found_in,
    grow,
    look_at,
)

# ---- Overlaps and distances among obstacles that move, at a time a row.
#
# The tree gives the boxes at the time, as real arithmetic has them. `pose_at` then writes each
# obstacle where it stands, and the rest is as for obstacles at rest.


class QueryTimes(NamedTuple):
    """The times of rows, and how obstacles change."""

    bodies: Any
    """`Bodies`, as stored."""
    at: Any
    """s, one for all or (n,)"""
    growth: float
    """Those that move grow at this rate all round, m/s, before and after their stamps."""
    earliest: float
    latest: float
    """The first and the last of their stamps, s."""


class World(NamedTuple):
    """Obstacles that move, for kernels."""

    tree: Any
    moving: Any
    """`Moving`"""
    times: QueryTimes
    spare: Any
    """`Bodies` with one shape: an obstacle where it stands."""
    grown: float
    """By how much the shape of a clearance has grown."""
    before: Any
    """What packets found of the rows before, `Bounded`, or None."""


@inlined
def most_growth(then, at):
    """By how much any obstacle may have grown."""
    if then.growth == 0.0:
        return 0.0
    return then.growth * max(at - then.earliest, then.latest - at, 0.0) * WIDER


@inlined
def displacement(velocity, since, left):
    """How far an obstacle has gone along an axis; since = `elapsed`."""
    return min(max(velocity * min(since[0], left), -LARGEST), LARGEST)


@inlined
def pose_at(world, slot, at):
    """Write an obstacle to `spare` where it stands at a time; return by how much it has grown."""
    tree, moving, times, spare, _, _ = world
    box = box_of(tree, moving, slot)
    _, _, velocity, reference = box
    displaced, shape = stack_array(3, np.float64), spare.shapes[0]
    since = elapsed(at, reference, moving.nanoseconds)
    spare.shapes[0] = times.bodies.shapes[slot]
    for axis in range(velocity.shape[0]):
        displaced[axis] = displacement(velocity[axis], since, moving.left)
        shape.position[axis] += displaced[axis]
    footprint_at(times.bodies.footprints, spare.footprints, slot, displaced)
    return times.growth * abs(since[0]) if moves(box) else 0.0


@inlined
def footprint_at(footprints, spare, slot, displaced):
    """Write the same of a planar scene."""
    if footprints is not None:
        spare[0] = footprints[slot]
        for axis in range(2):
            spare[0].centre[axis] += displaced[axis]


@inlined
def is_exact(world, shape, at):
    """Whether nothing but the boxes counts between an aligned box and others."""
    return not shape.shaped and most_growth(world.times, at) == 0.0


@inlined
def _candidates(world, row, query, mask, found):
    at, ndim = of_row(world.times.at, row), world.moving.velocities[0].velocity.shape[0]
    if covers(world.moving, at, 0.0, 0.0) == 0:
        return np.int64(OUTSIDE)
    grown = stack_array((2, 3), np.float64)
    more = query.tolerance + most_growth(world.times, at)
    grow(QueryShape(query.record, query.bounds, False, more, 0.0), grown)
    low, high = grown[0, :ndim], grown[1, :ndim]
    return overlap_at(world.tree, world.moving, at, low, high, mask, found.slots, 0)


@inlined
def _touch(world, row, query, slot):
    at, bodies, solid = of_row(world.times.at, row), world.times.bodies, query.record[0]
    if query.tolerance == 0.0 and is_exact(world, solid, at) and not bodies.shapes[slot].shaped:
        return Touch(True, True, False, False, 0.0)
    growth, shape = pose_at(world, slot, at), world.spare.shapes[0]
    reach, planar = query.tolerance + growth, bodies.footprints is not None
    touches, digits = near(shape, bodies.hulls, solid, bodies.query_hulls, reach, planar)
    return Touch(touches, True, True, digits, growth)


@inlined
def _lie(world, row, query, slot, touched, found, place):
    if not touched.compared:  # else it is there already
        pose_at(world, slot, of_row(world.times.at, row))
    look_at(world.spare, 0, query.record[0].position, found, place)
    apply_growth(found, place, touched.growth, None)


@inlined
def _answer_one(world, row, query, mask, enough, node_handles, found):
    return find_touching(
        world, row, query, mask, enough, node_handles, found, _candidates, _touch, _lie
    )


@lean_kernel
def overlap_rows_at(tree, moving, times, node_handles, memory, rows, place, options, answers):
    """`answer_overlaps` at times, and the version of the tree; OUTSIDE instead of rows if bounds
    do not hold for one, REFUSED if the tree is changed.
    """
    why = begin_asking(tree, moving, place[1] - place[0])
    if why != 0:
        return why, np.int64(0), 0, 0, 0, np.int64(0)
    world, found = World(tree, moving, times, memory[1], 0.0, None), found_in(memory[0])
    done = answer_overlaps(
        world, False, rows, place, options, node_handles, found, answers, _answer_one
    )
    version = tree.state[CHANGES]
    end_query(tree.state)
    return (*done, version)


@inlined
def apply_growth(found, row, growth, signed):
    """How an obstacle lies to the centre after it has grown."""
    if growth == 0.0:
        return
    distance = found.distances[row]
    left, displaced = distance - growth, growth
    if signed is None:
        left, displaced = max(left, 0.0), min(growth, distance)
    for axis in range(3):
        found.points[row, axis] += displaced * found.normals[row, axis]
        if signed is None and left == 0.0:
            found.normals[row, axis] = 0.0
    found.distances[row] = left


# ---- What is nearest to points and shapes among obstacles that move, at a time a row.

# Room for boxes that are as near as the last one that is wanted: those that a shape touches.
PLACES = 4


@inlined
def _nearest_bounds(tree, near_by, before, row, slots, gaps):
    """`nearest_bounds`, from what packets found of this row if they found as many."""
    if before is None:
        return nearest_bounds(tree, near_by, slots, gaps)
    if before.slots.shape[1] != slots.shape[0]:
        return nearest_bounds(tree, near_by, slots, gaps)
    for i in range(before.counts[row]):
        slots[i] = before.slots[row, i]
    return before.counts[row], before.left_out[row]


@inlined
def _neighbours(world, row, low, high, wanted, reach, mask, found):
    tree, moving, times, _, grown, before = world
    at, places = of_row(times.at, row), wanted
    if covers(moving, at, 0.0, 0.0) == 0:
        return np.int64(OUTSIDE), False, 0.0
    more = most_growth(times, at) + grown
    near_by = near_at(moving, at, low, high, wanted, reach + more, mask)
    if before is None:
        places = max(wanted, PLACES)
    slots, gaps = found.slots[:places], found.bounds[:places]
    count, left_out = _nearest_bounds(tree, near_by, before, row, slots, gaps)
    for slot in slots[:count]:  # what `pose_at` reads
        prefetch(times.bodies.shapes, slot, 2)
        fetch_box(tree, moving, slot)
    return np.int64(count), count >= wanted, at_least(left_out) - more


@inlined
def _lie_to_point(world, row, slot, point, signed, found, place):
    growth = pose_at(world, slot, of_row(world.times.at, row))
    look_at(world.spare, 0, point, found, place)
    if signed is not None:
        signed_distance_in_obstacle(world.spare, 0, point, found, place)
    apply_growth(found, place, growth, signed)


@lean_kernel
def nearest_rows_at(tree, moving, times, node_handles, memory, points, place, options, near):
    """`answer_nearest` at times, as `overlap_rows_at`."""
    why = begin_asking(tree, moving, place[1] - place[0])
    if why != 0:
        return why, np.int64(0), np.int64(0), np.int64(0)
    world, found = World(tree, moving, times, memory[1], 0.0, points.before), found_in(memory[0])
    done = answer_nearest(
        world, points, place, options, node_handles, found, near, False, _neighbours, _lie_to_point
    )
    version = tree.state[CHANGES]
    end_query(tree.state)
    return (*done, version)


@inlined
def _look(world, row, one, slot, reach, signed, node_handles, results):
    at, least = of_row(world.times.at, row), max(results.distances[row], 0.0)
    exact = least < np.inf and world.grown == 0.0 and is_exact(world, one, at)
    if exact and _is_farther(world, one, slot, at, least):
        return
    growths = world.grown, pose_at(world, slot, at)
    look_at_shape(world.spare, 0, one, growths, slot, reach, signed, node_handles, results, row)


@inlined
def _is_farther(world, one, slot, at, least):
    """Whether two aligned boxes are farther apart than this at a time: as `pose_at` and `box_gap`
    have it, without a copy or points. For others False.
    """
    other, gaps = world.times.bodies.shapes[slot], stack_array(3, np.float64)
    if other.shaped:
        return False
    _, _, velocity, reference = box_of(world.tree, world.moving, slot)
    since = elapsed(at, reference, world.moving.nanoseconds)
    for axis in range(velocity.shape[0]):
        displaced = displacement(velocity[axis], since, world.moving.left)
        position, half = other.position[axis] + displaced, other.half[axis]
        low = max(one.position[axis] - one.half[axis], position - half)
        high = min(one.position[axis] + one.half[axis], position + half)
        gaps[axis] = max(low - high, 0.0)
    return length(gaps[: velocity.shape[0]]) > least


@inlined
def _put_itself(world, rows, slot):
    """Write an obstacle to the only row, where it stands at the time; return by how much it has
    grown.
    """
    records, bounds, _, _, _ = rows
    lo, hi, velocity, reference = box_of(world.tree, world.moving, slot)
    at = world.times.at[0]
    since = elapsed(at, reference, world.moving.nanoseconds)
    for axis in range(lo.shape[0]):
        displaced = displacement(velocity[axis], since, world.moving.left)
        bounds[0, 0, axis], bounds[0, 1, axis] = lo[axis] + displaced, hi[axis] + displaced
    grown = pose_at(world, slot, at)
    records[0] = world.spare.shapes[0]
    return grown


@lean_kernel
def clearance_rows_at(tree, moving, times, node_handles, memory, rows, place, options, results):
    """`answer_clearances` at times, as `overlap_rows_at`."""
    why = begin_asking(tree, moving, place[1] - place[0])
    if why != 0:
        return why, np.int64(0), np.int64(0)
    world, grown, itself = World(tree, moving, times, memory[1], 0.0, None), 0.0, options[1]
    if itself != NONE:
        grown = _put_itself(world, rows, itself)
    world, found = World(tree, moving, times, memory[1], grown, None), found_in(memory[0])
    done = answer_clearances(
        world, rows, place, options, node_handles, found, results, False, _neighbours, _look
    )
    version = tree.state[CHANGES]
    end_query(tree.state)
    return (*done, version)


# ---- How the kernels are called.

MOST = 16  # boxes that packets look for


class CachedArguments(NamedTuple):
    """Arguments of kernels while the world has one version and these arrays."""

    version: int
    bodies: Any
    times: QueryTimes
    memory: tuple[Any, Any]
    """Where kernels write what they find, and `Bodies` with one shape."""


class TimedScratch(Scratch):
    """The same for queries at times."""

    def __init__(self) -> None:
        self.at, self.answers = np.empty(1), room_for(1, COUNT)
        super().__init__()

    def make_room(self, count: int) -> None:
        self.cached: CachedArguments | None = None
        self.shape, self.footprint = np.empty(1, GEOMETRY), np.empty(1, FOOTPRINT)
        super().make_room(count)


class TimedDistances(Distances):
    """Overlaps and distances in one scene, among obstacles as they are at times."""

    kernels: tuple[Any, ...] = overlap_rows_at, nearest_rows_at, clearance_rows_at
    scratch = TimedScratch
    moments = True
    """Whether each row is at one time."""

    def _find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, at: Any
    ) -> tuple[Scratch, list[int]]:
        scratch: Any = self._take()
        columns, done = self._columns, 0
        scratch.limits[0], scratch.masks[0] = query.tolerance, mask
        rows = query.record, query.bounds[None], scratch.limits, scratch.masks, NO_GIVEN
        batch = OVERLAPS, rows, (COUNT, 0), scratch.answers, hulls, True, at
        while not done:
            view = self._tree.latest()
            done, wanted, _, compared, more, _ = self._ask(view, scratch, batch, 0, 1)
            if compared:
                columns.pairs_compared += compared
                columns.pairs_in_more_digits += more
            if not done:
                scratch.have_room(wanted)
        count, found = scratch.answers[1].item(0), scratch.found
        if columns.footprint is not None:
            found.points[:count, 2] = query.height
        return scratch, found.order[:count].tolist() if count else []

    def _look_ahead(self, points: Points, k: int, signed: Signed, at: Any) -> tuple[Points, Any]:
        """Of a batch that is dense enough; `nearest_rows_at` finds the rest, and all where
        obstacles grow.
        """
        columns, tree, count = self._columns, self._tree, len(points[0])
        more = columns.shaped > 0 or columns.shadows > 0 or signed is not None
        wanted, motion = min(k + more, len(tree) + 1), tree.motion
        dense = wanted <= MOST and are_dense(count, len(tree)) and not self._store.uncertainty
        if not dense or motion is None:
            return points, None
        where, limits = along_axes(points.points, tree.ndim), points.reaches
        limits = np.maximum(limits * ROUNDED, limits)
        slots, counts = np.empty((count, wanted), INT64), np.empty(count, INT64)
        packets = Bounded(slots, counts, np.empty(count))

        def begin(start: int, stop: int) -> None:
            order = points.order[start:stop]
            near_by = PointQueries(where, wanted, limits, points.masks, order)
            motion.bound_many(tree, at, near_by, packets)

        return points._replace(before=packets), begin

    # ---- kernels

    def _ask(self, view: View, scratch: Any, batch: Any, start: int, stop: int) -> Any:
        question, rows, options, results, hulls, _, at = batch
        times, memory = self._arguments(scratch, view[0], at, hulls)
        motion = self._tree._motion
        if motion is None:
            raise RuntimeError('no obstacle of this scene has a velocity')
        place, handles = (start, stop), self._columns.node_handle
        given = times, handles, memory, rows, place, options, results
        code = self._codes.get((question, type(times[0][2])))
        if code is None:
            code = self._compile(question, type(times[0][2]), view[0], motion.moving, *given)
        done = code(view[0], motion.bounds if self.moments else motion.moving, *given)
        return done if done[0] >= 0 else self._ask_again(code, given)

    def _ask_again(self, code: Any, given: tuple[Any, ...]) -> Any:
        """Call it with bounds that hold for these times."""
        tree: Any = self._tree
        spans = partial(times_of, given[0].at, *self._spans(given[3]))
        return tree.motion.ask(tree, spans, lambda *now: code(*now, *given), self.moments)

    def _spans(self, rows: Any) -> tuple[Floats, Floats]:
        """How many seconds a unit of t takes, and where t ends, one for all or (n,)."""
        return NOTHING, NOTHING

    def _arguments(
        self, scratch: TimedScratch, tree: Tree, at: Any, hulls: Hulls | None
    ) -> tuple[QueryTimes, tuple[Any, Any]]:
        """The times for a kernel, and the part of `scratch` that it writes to."""
        cached, version, bodies = scratch.cached, tree[4].item(CHANGES), self._columns.bodies
        if cached is not None and hulls is None and cached[0] == version and cached[1] is bodies:
            _, _, times, memory = cached
        else:
            store, known = self._store, bodies_of(self._columns, hulls)
            ends = movers(store)[1:] if store.uncertainty else (0.0, 0.0)
            times = QueryTimes(known, scratch.at, store.uncertainty, *ends)
            flat = None if known.footprints is None else scratch.footprint
            memory = scratch.memory, known._replace(shapes=scratch.shape, footprints=flat)
            scratch.cached = None
            if hulls is None:
                scratch.cached = CachedArguments(version, bodies, times, memory)
        if type(at) is float:
            scratch.at[0] = at
            return times, memory
        return tuple.__new__(QueryTimes, (times[0], at, *times[2:])), memory
