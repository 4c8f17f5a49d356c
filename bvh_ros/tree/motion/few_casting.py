# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Few rays among boxes that move: as `wide.few_rays`, one after the other, through what is swept,
where all of them go at the same time.
"""

import numpy as np

from ..compiler import WIDTH, inlined, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import NONE
from ..rays.ray_hits import NO_HITS
from ..rays.raycasting import CLOSEST
from ..rays.slab import EXACT, RAY_ROWS, set_ray
from ..simd.float32x16 import stream16
from ..store.turns import REFUSED, begin_query, count_rays, end_query
from ..wide.few_rays import cast_one
from ..wide.ray_piles import write_miss
from ..wide.ray_stacks import ABREAST, STACK
from ..wide.raycasting import MIXED
from .asked_then import AS_ARRAYS, MovingRays
from .starting import start_seen
from .sweeping import no_sweep
from .wide_casting import UNSUITED, is_better, write_hit

# Smaller batches go ray by ray: of segments of 5 m that takes 0.87 times as long as in lists for
# 48, 0.92 times for 72, 1.0 to 1.1 times for 96.
FEW = 72


@lean_kernel
def cast_few(tree, sweep, asked, skip_inside, mode, when, hits):
    """As `wide_casting.cast_rows`, of rays asked = (origins, directions, t_max, masks) that share
    their times, when = (at, pace); REFUSED, too, where those do not lie within the span that was
    swept.
    """
    (origins, directions, t_max, masks), (at, pace), moving = asked, when, sweep.moving
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
    unsuited = _cast_all(sweep.snapshot, tree, rays, hits)
    end_query(tree.state)
    return unsuited


@inlined
def _cast_all(snapshot, tree, rays, hits):
    """Answer all that are suited; return how many are not."""
    ray, stack = stack_array((RAY_ROWS, 3), np.float64), stack_array(STACK, np.int64)
    records, rows = stack_array(ABREAST, snapshot.record), stack_array(ABREAST, np.int64)
    places, met = stack_array(ABREAST, np.int32), stack_array(ABREAST, np.uint32)
    nearest = stack_array((ABREAST, WIDTH), np.int32)
    count, row = rays.origins.shape[0], np.int64(0)
    exact, unsuited = np.int64(0), np.int64(0)
    while row < count:
        alive = np.int64(0)
        while row < count and alive < ABREAST:
            rows[alive], places[alive] = row, alive
            write_miss(rays, row, hits)
            if start_seen(records[alive], snapshot, rays.leaves, rays, row):
                alive += 1
            else:
                hits.ids[row] = UNSUITED
                unsuited += 1
            row += 1
        if alive == 0:
            continue
        stream16(snapshot.planes, 0, MIXED, records, places[:alive], met, nearest)
        for i in range(alive):
            ray[EXACT, 0] = 0.0
            seen = places[i : i + 1], met[i], nearest[i : i + 1]
            room = ray, records, stack
            hit = cast_one(snapshot, tree, rays, rows[i], seen, room, as_it_is, is_better)
            exact += np.int64(ray[EXACT, 0])
            if hit[0] != NONE:
                set_ray(ray, rays.origins[rows[i]], rays.directions[rows[i]])
                write_hit(tree, ray, rays, rows[i], hit, hits)
    count_rays(tree.state, count, exact)
    return unsuited


@inlined
def as_it_is(ray, origin, direction):
    """Leave the ray: `is_better` writes it where it needs it."""


_ROW, _ROWS = np.empty(0), np.empty((0, 3))
NO_FEW = _ROWS, _ROWS, _ROW, np.empty(0, np.uint32)
few_entry = entry_points(cast_few, no_sweep, NO_FEW, False, CLOSEST, AS_ARRAYS, NO_HITS)
