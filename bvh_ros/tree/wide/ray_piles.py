# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Piles of rays that go through the wide snapshot together, see `ray_streams`: those of an octant,
or of few rays all.

Rays are read once, in their order. A pile that is full is cast and begun again: so its records are
in the processor core's own cache, and so is, for the most part, what is written for its rays.
"""

import numpy as np

from ..compiler import inlined, stack_array
from ..nodes import NONE
from ..rays.ray_hits import raycast_row
from ..rays.raycasting import ANY, Found, of_row
from ..simd.float64x4 import look_ahead
from .filtering import CORNERS, fill_whole, start_ray
from .ray_streams import BAD, DECIDED_EXACTLY, RAYS_AT_ONCE

# How many rays of an octant go together, and one more for so many nodes: of few rays the records
# stay in the nearest cache, among many nodes many rays share what comes from memory. A scan's fly
# side by side.
RAYS_PILED, NODES_A_RAY = 512, 2
# Up to so many rays, and so many more a node, go together whatever their octants: lists that are
# eight times as long make up for planes that are loaded for each ray; but not of rays of a scan.
MIXED_RAYS, MIXED_A_NODE = 2 * RAYS_AT_ONCE, 4


@inlined
def pile_size(snapshot, origins):
    """How many rays a pile is, and whether they are of all octants."""
    count, size = origins.shape[0], snapshot.size
    if count == 0 or is_scan(origins):
        return min(count, RAYS_PILED), False
    if count <= min(MIXED_RAYS, RAYS_PILED + MIXED_A_NODE * size):
        return min(count, RAYS_AT_ONCE), True
    return min(count, RAYS_PILED + size // NODES_A_RAY, RAYS_AT_ONCE), False


@inlined
def is_scan(origins):
    """Whether rays seem to come from one place."""
    same, last = True, origins.shape[0] - 1
    for axis in range(origins.shape[1]):
        first = origins[0, axis]
        same &= first == origins[last // 2, axis] and first == origins[last, axis]
    return same


@inlined
def start_rays(snapshot, tree, rays, row, piles, ray, tally, hits):
    """Put the rays from `row` on that may meet anything on the pile of their octant, or all on one
    pile, and answer those that are not suited, until a pile is full; return the row behind them,
    and which pile. A pile is `together` records, and as many `rows`.
    """
    records, rows, piled, together, mixed = piles
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    found = Found(slots, stack_array(1, np.float64), axes)
    whole = stack_array(CORNERS, np.float64)
    fill_whole(tree, whole)
    while row < rays.origins.shape[0]:
        origin, direction = rays.origins[row], rays.directions[row]
        write_miss(rays, row, hits)
        away, octant = look_ahead(records[0], origin, direction, whole)
        row += 1
        if away:
            continue
        pile = np.int64(0) if mixed else octant
        place, t_max = pile * together + piled[pile], of_row(rays.t_max, row - 1)
        center, per_length = snapshot.center, snapshot.per_length
        if start_ray(records[place], origin, direction, center, per_length, t_max):
            rows[place] = row - 1
            piled[pile] += 1
            if piled[pile] == together:
                return row, pile
        else:
            done = raycast_row(tree, ray, rays, row - 1, found, hits)
            tally[BAD] = min(tally[BAD], done)
            tally[DECIDED_EXACTLY] += done
    return row, np.int64(0)


@inlined
def write_miss(rays, row, hits):
    """Write that a ray hits nothing."""
    hits.ids[row] = NONE
    if rays.mode != ANY:
        hits.t[row] = np.inf
        for axis in range(hits.normals.shape[1]):
            hits.normals[row, axis] = 0.0
