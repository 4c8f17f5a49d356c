# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays among boxes that move: `wide.raycasting` through a snapshot that is swept (see
`sweeping`), its leaves decided by `meeting`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import inlined, lean_kernel, prefetch, stack_array
from ..entries import entry_points
from ..nodes import NONE, Tree
from ..rays.ray_hits import NO_HITS
from ..rays.raycasting import ANY, of_row
from ..rays.slab import EXACT, INSIDE, set_ray
from ..results import RayHits
from ..store.turns import REFUSED, begin_query, count_rays, end_query
from ..wide.best_hit import ASK, MEETS
from ..wide.ray_piles import MIXED_RAYS, is_scan
from ..wide.ray_streams import (
    DECIDED_EXACTLY,
    FOUND,
    OCTANTS,
    RAYS_AT_ONCE,
    RAYS_SORTED,
    TALLY,
    make_scratch,
    scratch_for,
)
from ..wide.raycasting import MIXED, traverse, visit_leaf
from .asked_then import NO_RAYS, MovingRays, RaysThen
from .meeting import box_of, course_of, fetch_box
from .rounded import may_meet, quick_decision, quick_decision_of_both
from .starting import sort_by_octant, start_group
from .stopping import as_met, distance_of, is_before, meet_box
from .sweeping import Sweep, no_sweep

UNSUITED = -3  # not a handle, nor NONE
AHEAD = 4  # so many hits before it is described, the memory of a box is asked for
WAITING, PLACES = TALLY, TALLY + 1  # behind what is tallied: how many pairs wait
# Pairs that wait at most, and the share of a group's rays: what is met is known so much later.
MOST_WAITING, LEAST_WAITING, WAITING_SHARE = 64, 8, 8

Floats = NDArray[np.float64]


class Waiting(NamedTuple):
    """`ray_streams.Scratch` for a group of rays, and pairs of a ray and a leaf that it may meet.

    Most of them part when it is looked at closely. One after the other that is a guess of the
    processor's a pair, wrong as often as not; of many together there is none.
    """

    ray: Any
    records: Any
    lists: Any
    found: Any
    met: Any
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
        way = origin, direction, at, pace
        verdict, t, face = quick_decision_of_both(
            tree, rays.moving, leaves.records, slot, way, best[1]
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
            *(tree, rays.moving, course, (slot, t, face)), (best[0], best_t, best[2])
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
        _, face = as_met(box, course, face)
        if face != INSIDE:
            hits.normals[row, face >> 1] = -1.0 if face & 1 == 0 else 1.0


@lean_kernel
def cast_rows(tree, sweep, asked, scratch, hits):
    """As `wide.raycasting.cast_rows`, but the id of a ray that is not suited is UNSUITED. Returns
    how many are not, or REFUSED.
    """
    if not begin_query(tree.state, sweep.moving.version):
        return np.int64(REFUSED)
    snapshot, at, pace = sweep.snapshot, asked.at, asked.pace
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = asked.when
    rays = MovingRays(
        *(asked.origins, asked.directions, asked.t_max, asked.masks),
        *(asked.skip_inside, asked.mode, at, pace, sweep.moving, sweep.leaves),
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
        room = Waiting(
            *(scratch.ray, scratch.records, scratch.lists, scratch.found, scratch.met),
            *(scratch.stack, pairs, snapshot.loose > 0),
        )
        group = octant, rows, alive
        traverse(snapshot, tree, group, rays, room, tally, let_wait, not_yet)
        visit_waiting(tree, rows, rays, room, tally)
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
def let_wait(tree, rays, slot, listed, scratch, tally):
    """Let rays wait that may meet a leaf, listed = (rows, places); ask for its memory."""
    rows, places = listed
    prefetch(rays.leaves.records, slot, 1)
    for place in places:
        scratch.pairs[tally[WAITING]] = slot << 32 | place
        tally[WAITING] += 1
        if tally[WAITING] == scratch.pairs.shape[0]:
            visit_waiting(tree, rows, rays, scratch, tally)
    return True


@inlined
def not_yet(tree, ray, rays, row, slot, best):
    """As `is_better` where no leaf is visited as it is met: `let_wait` has taken them all."""
    return False, best[1], best[2]


@lean_kernel
def visit_waiting(tree, rows, rays, scratch, tally):
    """See of the pairs that wait whether the leaf is the ray's best hit."""
    pairs, kept, leaves = scratch.pairs, 0, rays.leaves
    alike = rays.at.shape[0] == 1 and rays.pace.shape[0] == 1
    since, pace = rays.at[0] - leaves.start, rays.pace[0]
    for i in range(tally[WAITING]):
        pair = pairs[i]
        slot, place = pair >> 32, pair & 0xFFFFFFFF
        row, limit = rows[place], scratch.records[place].best_t
        if not alike:
            since, pace = of_row(rays.at, row) - leaves.start, of_row(rays.pace, row)
        way = rays.origins[np.uint64(row)], rays.directions[np.uint64(row)]
        near = may_meet(leaves.records, slot, *way, since, pace, limit, 0.0)
        pairs[kept] = pair
        kept += near
        if near and leaves.records[slot].loose == np.inf:
            fetch_box(tree, rays.moving, slot)
    for i in range(kept):
        group = rows, (pairs[i] & 0xFFFFFFFF,)
        visit_leaf(tree, pairs[i] >> 32, scratch.patched, group, rays, scratch, tally, is_better)
    tally[WAITING] = 0


cast_entry = entry_points(
    cast_rows, no_sweep, NO_RAYS, lambda ndim: make_scratch(0, ndim, 0), NO_HITS
)


def cast(tree: Tree, sweep: Sweep, rays: RaysThen, hits: RayHits) -> int:
    """Answer rays whose times lie in the span of a sweep, but those that are UNSUITED: how many;
    REFUSED if the tree is not what was swept, or is changed meanwhile.
    """
    count, ndim = rays.origins.shape
    scratch = scratch_for(count, ndim, sweep.snapshot.depth)
    done: int = cast_entry(ndim)(tree, sweep, rays, scratch, hits)
    return done
