# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How rays begin their ways through what is swept, where who drifts along sees them: from an
origin that he leaves behind, and so much slower. Only what prunes sees them so, and t is the same.

What is rounded here is a 2**-49 of how far the drift goes in the span, at most
`sweeping.FARTHEST_DRIFT` of the scene, less than what `filtering` has to spare, 2**-23 of the
scene; and a 2**-52 of where its centre is, and of how far the drift goes in as long as from time
zero: boxes are widened by a 2**-48 of both, see `sweeping`.
"""

import math

from ..compiler import inlined, lean_kernel
from ..rays.raycasting import of_row
from ..wide.filtering import octant_of, start_ray

# Who goes along with the drift still goes somewhere, a 2**-50 of his way: a ray must.
ALMOST_ONE = 1.0 - 2.0**-50


@inlined
def start_seen(record, snapshot, leaves, rays, row):
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
        suited = start_seen(scratch.records[i], snapshot, rays.leaves, rays, rows[i])
        last -= not suited
        scratch.lists[alive if suited else last] = i
        alive += suited
    return alive


@lean_kernel
def sort_by_octant(rays, start, octants, rows, ends):
    """Fill `rows` with the numbers from `start` on, octant by octant of where rays are seen to go;
    those of octant k end before ends[k]. `octants` is scratch.
    """
    ends[:], drift = 0, rays.leaves.records[-1].lo
    for i in range(rows.shape[0]):
        direction = rays.directions[start + i]
        octant, pace = octant_of(direction), of_row(rays.pace, start + i) * ALMOST_ONE
        if rays.leaves.records[-1].loose != 0.0:
            octant = 0
            for axis in range(direction.shape[0]):
                way = direction[axis] - (drift[axis] * pace + 0.0)
                octant |= (math.copysign(1.0, way) < 0.0) << axis
        octants[i] = octant
        ends[octants[i]] += 1
    before = 0
    for octant in range(ends.shape[0]):
        before, ends[octant] = before + ends[octant], before
    for i in range(rows.shape[0]):
        rows[ends[octants[i]]] = start + i
        ends[octants[i]] += 1
