# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One obstacle that moves, as a ray or ball meets it: while it goes, and where it comes to rest,
from then on. Axis-aligned boxes are decided exactly; others are seen as if they stood.
"""

import numpy as np

from ...tree.jit.compiling import inlined
from ...tree.jit.intrinsics import prefetch, stack_array
from ...tree.motion.meeting import box_of, moves
from ...tree.motion.stopping import is_before, meet_box
from ...tree.motion.sums import elapsed
from ...tree.moving import LARGEST
from ...tree.nodes import NONE
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import INSIDE, set_ray
from .casting import Best, enter_obstacle, plain

HALF_A_NANOSECOND = 0.5e-9  # scenes tell whole ones, and less apart are but rounded otherwise
NEAR = 2.0**-40  # of the t at which time is up: what is computed is not off by as much


@inlined
def radius_of(ways, i, box, rate):
    """Of the ball of a way, with what an obstacle has grown at most."""
    at, pace, t_max = of_row(ways.at, i), of_row(ways.pace, i), of_row(ways.t_max, i)
    return of_row(ways.radii, i) + growth_of(box, rate, at, pace, t_max)


@inlined
def look_at(world, tree, moving, ways, i, asked, tools, thin, slot, found):
    """The first hits of a way, found = (box, other, whether that stood), after one more obstacle
    is looked at; asked = (skip inside, m/s by which obstacles that move grow).
    """
    (box, other, stood), (node_handles, scratch), t_max = found, tools, of_row(ways.t_max, i)
    (skip, rate), there = asked, box_of(tree, moving, slot)
    radius = radius_of(ways, i, there, rate)
    if radius == 0.0 and plain(world.geometry, world.footprints, slot):
        hit, t, face = meet_box(there, thin, t_max)
        if hit and not (skip and face == INSIDE):
            was = box.slot, box.t, box.feature
            if was[0] == NONE or is_before(tree, moving, thin, (slot, t, face), was):
                box = Best(slot, t, face)
    else:
        t, feature, stands = _enter(world, ways, i, there, radius, skip, scratch, thin, slot)
        nearer = t < other.t
        if t < np.inf and t == other.t:
            nearer = node_handles[slot] < node_handles[other.slot]
        if nearer:
            other, stood = Best(slot, t, np.int64(feature)), stands
    return box, other, stood


@inlined
def _enter(world, ways, i, box, radius, skip, scratch, thin, slot):
    """Where a way meets an obstacle first: (t, inf if nowhere, feature, whether it stood)."""
    t, feature, t_max, left = np.inf, np.int64(INSIDE), of_row(ways.t_max, i), thin.left
    until, stands = _time_left(box, thin), False
    if until >= 0.0:
        see(ways, i, box, thin.nanoseconds, scratch.ray)
        end = min(t_max, until * (1.0 + NEAR))
        t, feature = enter_obstacle(world, slot, scratch.ray, radius, end, scratch.work)
    inside = t < np.inf and feature == INSIDE
    if until < np.inf and not (inside or t < until * (1.0 - NEAR)):
        see_standing(ways, i, box, left, scratch.ray)
        later, where = enter_obstacle(world, slot, scratch.ray, radius, t_max, scratch.work)
        stands = later < t
        if until >= 0.0:
            stands &= where != INSIDE and later >= until * (1.0 - NEAR)
        if stands:
            t, feature = later, where
            inside = where == INSIDE
    return np.inf if skip and inside else t, feature, stands


@inlined
def _time_left(box, course):
    """The t at which an obstacle comes to rest; negative if it stands from the start, at the very
    nanosecond, too; inf if it does not meanwhile.
    """
    if course.left == np.inf or not moves(box):
        return np.inf
    time = course.left - elapsed(course.at, box[3], course.nanoseconds)[0]
    if time < HALF_A_NANOSECOND:
        return -1.0
    return time / course.pace if course.pace > 0.0 else np.inf


@inlined
def growth_of(box, rate, at, pace, t_max):
    """By how much an obstacle has grown at most on the way, as `places.growths`."""
    reference, end = box[3], (at + pace * t_max if pace > 0.0 else at)
    if rate == 0.0 or not moves(box):
        return 0.0
    return min(rate * max(abs(at - reference), abs(end - reference)), LARGEST)


@inlined
def see(ways, i, box, nanoseconds, ray):
    """Write the ray as an obstacle sees it that moves."""
    _, _, velocity, reference = box
    seen, ndim = stack_array((2, 3), np.float64), ways.origins.shape[1]
    since, _ = elapsed(of_row(ways.at, i), reference, nanoseconds)
    for axis in range(ndim):
        seen[0, axis] = ways.origins[i, axis] - velocity[axis] * since
        seen[1, axis] = ways.directions[i, axis] - velocity[axis] * of_row(ways.pace, i)
    set_ray(ray, seen[0, :ndim], seen[1, :ndim])


@inlined
def see_standing(ways, i, box, left, ray):
    """The same of one that has come to rest."""
    seen, ndim = stack_array(3, np.float64), ways.origins.shape[1]
    for axis in range(ndim):
        seen[axis] = ways.origins[i, axis] - box[2][axis] * left
    set_ray(ray, seen[:ndim], ways.directions[i])


@inlined
def fetch(tree, moving, geometry, footprints, slot):
    """Ask for the memory of what `look_at` reads of most obstacles."""
    prefetch(moving.kept, slot, 1)
    prefetch(tree.handles, slot, 1)
    if geometry is not None:
        prefetch(geometry[0], slot, 2)
    if footprints is not None:
        prefetch(footprints[0], slot, 2)
