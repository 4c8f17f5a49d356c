# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays among boxes that move: `wide.raycasting` through a snapshot that is swept (see
`sweeping`), its leaves decided by `meeting`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..entries import entry_points
from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import prefetch, stack_array
from ..nodes import NONE, View
from ..rays.ray_hits import NO_HITS
from ..rays.raycasting import ANY, CLOSEST, of_row
from ..rays.slab import EXACT, INSIDE, PAD, TINY, set_ray
from ..results import RayHits
from ..store.turns import REFUSED, accepted, begin_query, count_rays, end_query
from ..wide.best_hit import ASK, MEETS, MISSES
from ..wide.ray_streams import RAYS_AT_ONCE, RAYS_SORTED, make_scratch, scratch_for, sort_by_octant
from ..wide.raycasting import DECIDED_EXACTLY, FOUND, OCTANTS, TALLY, start_group, traverse
from ..wide.snapshot import Snapshot, no_snapshot
from .casting import no_motion
from .meeting import Course, Moving, box_of, distance_of, is_before, meet
from .sweeping import Leaves, leaf_dtype

# Slower than this boxes and rays have no common ways in numbers; and how far t of a hit may be
# from that of the same box's record.
SLOWEST, NEAR = 1e-290, 2.0**-16
UNSUITED = -3  # not a handle, nor NONE

Floats = NDArray[np.float64]


class MovingRays(NamedTuple):
    """Rays as of `rays.raycasting.Rays`, and when they start."""

    origins: Floats
    directions: Floats
    t_max: Floats
    masks: NDArray[np.uint32]
    skip_inside: bool
    mode: int
    at: Floats
    pace: Floats
    """One for all, or a row."""
    moving: Moving
    leaves: Leaves


@inlined
def quick_decision(leaf, origin, direction, since, pace, limit):
    """Decide where rounding cannot matter: (verdict, t, face), as `wide.best_hit.quick_decision`.
    `since` the start of the span.

    MEETS: surely met, and before `limit`, at `face`; t is not before that, nor later by more than
    NEAR of it.
    """
    entry, leave, surely, loose = 0.0, limit, limit * (1.0 - NEAR), np.float64(leaf.loose)
    entered_by, others_by, face = 0.0, 0.0, INSIDE
    for axis in range(origin.shape[0]):
        velocity = np.float64(leaf.velocity[axis])
        way, rate = velocity * since, direction[axis] - velocity * pace
        below, above = leaf.lo[axis] - origin[axis] + way, leaf.hi[axis] - origin[axis] + way
        if abs(rate) < SLOWEST:
            if rate == 0.0 and (below > 0.0 or above < 0.0):
                return MISSES, limit, INSIDE
            if not (rate == 0.0 and below < -loose and above > loose):
                surely = -1.0
            continue
        inverse = 1.0 / rate
        at_lo, at_hi, later = below * inverse, above * inverse, abs(loose * inverse)
        near, far = (at_lo, at_hi) if inverse > 0.0 else (at_hi, at_lo)
        leave, surely = min(leave, far), min(surely, far - later)
        if near > entry:
            others_by, entry, entered_by = max(others_by, entered_by), near, near + later
            face = 2 * axis + (inverse < 0.0)
        else:
            others_by = max(others_by, near + later)
    if entry > leave * PAD + TINY:
        return MISSES, limit, INSIDE
    clear = others_by * PAD < entry and entered_by * PAD < surely
    if clear and entered_by < entry * (1.0 + 0.5 * NEAR):
        return MEETS, entered_by, face
    return ASK, limit, INSIDE


@inlined
def may_meet(leaf, origin, direction, since, pace, limit, more):
    """Whether a course may meet a leaf before `limit` whose box is larger by `more` on all sides;
    as `quick_decision`, where it does not say MISSES.
    """
    entry, leave = 0.0, limit
    for axis in range(origin.shape[0]):
        velocity = np.float64(leaf.velocity[axis])
        way, rate = velocity * since, direction[axis] - velocity * pace
        below = leaf.lo[axis] - origin[axis] + way - more
        above = leaf.hi[axis] - origin[axis] + way + more
        if abs(rate) < SLOWEST:
            if rate == 0.0 and (below > 0.0 or above < 0.0):
                return False
            continue
        inverse = 1.0 / rate
        near, far = below * inverse, above * inverse
        entry, leave = max(entry, min(near, far)), min(leave, max(near, far))
    return entry <= leave * PAD + TINY


@inlined
def is_better(tree, ray, rays, row, slot, best):
    """As `wide.best_hit.is_better`, with faces of `meet` for axes."""
    origin, direction = rays.origins[row], rays.directions[row]
    at, pace = of_row(rays.at, row), of_row(rays.pace, row)
    ray[EXACT, 0] = 0.0
    verdict, t, face = quick_decision(
        *(rays.leaves.records[slot], origin, direction), at - rays.leaves.start, pace, best[1]
    )
    if verdict != ASK:
        return verdict == MEETS, t, np.int64(face)
    set_ray(ray, origin, direction)
    return _is_better(tree, Course(ray, at, pace), rays, row, slot, best)


@lean_kernel
def _is_better(tree, course, rays, row, slot, best):
    """The exact decision."""
    hit, t, face = meet(box_of(tree, rays.moving, slot), course, of_row(rays.t_max, row))
    better = hit and not (rays.skip_inside and face == INSIDE)
    if better and best[0] != NONE:
        best_t = distance_of(box_of(tree, rays.moving, best[0]), course, best[2])
        better = is_before(
            *(tree, rays.moving, course, (slot, t, face)), (best[0], best_t, best[2])
        )
    return better, t, face


@inlined
def write_hit(tree, ray, rays, row, hit, hits):
    """As `wide.raycasting.write_hit`."""
    slot, _, face = hit
    hits.ids[row] = tree.handles[slot]
    if rays.mode != ANY:
        course = Course(ray, of_row(rays.at, row), of_row(rays.pace, row))
        hits.t[row] = distance_of(box_of(tree, rays.moving, slot), course, face)
        if face != INSIDE:
            hits.normals[row, face >> 1] = -1.0 if face & 1 == 0 else 1.0


@lean_kernel
def cast_rows(tree, version, snapshot, rays, scratch, hits):
    """As `wide.raycasting.cast_rows`, but the id of a ray that is not suited is UNSUITED."""
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    tally, ends = stack_array(TALLY, np.int64), stack_array(OCTANTS, np.int64)
    tally[DECIDED_EXACTLY] = 0
    hits.ids[:], hits.t[:], hits.normals[:] = NONE, np.inf, 0.0
    count = rays.origins.shape[0]
    for first in range(0, count, RAYS_SORTED):
        batch, begin = scratch.rows[: min(count - first, RAYS_SORTED)], 0
        sort_by_octant(rays.directions, first, scratch.octants, batch, ends)
        for octant in range(OCTANTS):
            while begin < ends[octant]:
                rows = batch[begin : min(ends[octant], begin + RAYS_AT_ONCE)]
                _cast_group(snapshot, tree, octant, rows, rays, scratch, tally, hits)
                begin += rows.shape[0]
    count_rays(tree.state, count, tally[DECIDED_EXACTLY])
    end_query(tree.state)
    return tally[DECIDED_EXACTLY]


@inlined
def _cast_group(snapshot, tree, octant, rows, rays, scratch, tally, hits):
    """Answer rays of one octant that go together."""
    alive = start_group(snapshot, rays, rows, scratch)
    for place in scratch.lists[alive : rows.shape[0]]:
        hits.ids[rows[place]] = UNSUITED
    tally[FOUND] = 0
    if alive > 0:
        group = octant, rows, scratch.lists[:alive]
        traverse(snapshot, tree, group, rays, scratch, tally, fetch_leaf, is_better)
    for i in scratch.found[: tally[FOUND]]:
        best, row = scratch.records[i], rows[i]
        set_ray(scratch.ray, rays.origins[row], rays.directions[row])
        hit = np.int64(best.slot), best.best_t, np.int64(best.axis)
        write_hit(tree, scratch.ray, rays, row, hit, hits)


@inlined
def fetch_leaf(tree, rays, slot):
    """Ask for the memory of a leaf."""
    prefetch(rays.leaves.records, slot, 1)


NO_LEAVES = {ndim: Leaves(np.empty(0, leaf_dtype(ndim)), 0.0) for ndim in (2, 3)}


def _no_rays(ndim: int) -> MovingRays:
    row, rows = np.empty(0), np.empty((0, 3))
    asked = row, np.empty(0, np.uint32), False, CLOSEST
    return MovingRays(rows, rows, *asked, row, row, no_motion(ndim), NO_LEAVES[ndim])


cast_entry = entry_points(
    cast_rows, 0, no_snapshot, _no_rays, lambda ndim: make_scratch(0, ndim, 0), NO_HITS
)


def cast(view: View, snapshot: Snapshot, rays: MovingRays, hits: RayHits) -> None:
    """Answer rays whose times lie in the span of a snapshot, but those that are UNSUITED;
    RuntimeError if the tree is changed meanwhile.
    """
    count, ndim = rays.origins.shape
    scratch = scratch_for(count, ndim, snapshot.depth)
    accepted(cast_entry(ndim)(*view, snapshot, rays, scratch, hits))
