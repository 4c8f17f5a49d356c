# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One obstacle that moves, as a ray or ball meets it: while it goes, and where somebody comes to
rest, from then on. Axis-aligned boxes are decided exactly; others are seen as if they stood.
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.jit.compiling import inlined
from ...tree.jit.intrinsics import stack_array
from ...tree.motion.meeting import box_of, is_before, meet, moves
from ...tree.motion.stopping import STOPPED, is_sooner, meet_going, meet_standing
from ...tree.moving import LARGEST
from ...tree.nodes import NONE
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import INSIDE, set_ray
from .casting import Best, enter_obstacle, plain

NEAR = 2.0**-40  # of the t at which time is up: what is computed is not off by as much


class Still(NamedTuple):
    """Who comes to rest, see `places.Rest`."""

    left: Any
    """Obstacles go on for so long, s."""
    nodes: Any
    """Bounds of a tree of where they come to rest."""
    root: Any
    slots: Any
    first_end: Any
    """When the first of them does, s."""


@inlined
def radius_of(ways, i, box, rate):
    """Of the ball of a way, with what an obstacle has grown at most."""
    at, pace, t_max = of_row(ways.at, i), of_row(ways.pace, i), of_row(ways.t_max, i)
    return of_row(ways.radii, i) + growth_of(box, rate, at, pace, t_max)


@inlined
def look_at(world, tree, moving, still, ways, i, asked, tools, thin, slot, found):
    """The first hits of a way, found = (box, other), after one more obstacle is looked at while it
    goes; asked = (skip inside, m/s by which obstacles that move grow), `still` None if nobody
    comes to rest.
    """
    (box, other), (node_handles, scratch), t_max = found, tools, of_row(ways.t_max, i)
    (skip, rate), there = asked, box_of(tree, moving, slot)
    radius = radius_of(ways, i, there, rate)
    if radius == 0.0 and plain(world.geometry, world.footprints, slot):
        if still is not None and moves(there):
            hit, t, face = meet_going(there, thin, t_max, there[3] + still.left)
        else:
            hit, t, face = meet(there, thin, t_max)
        if hit and not (skip and face == INSIDE):
            was = box.slot, box.t, box.feature
            if was[0] == NONE or is_before(tree, moving, thin, (slot, t, face), was):
                box = Best(slot, t, face)
    else:
        if still is not None and moves(there):
            until = time_left(there, still.left, thin)
            if until < 0.0:
                return box, other
            t_max = min(t_max, until * (1.0 + NEAR))
        see(ways, i, there, scratch.ray)
        t, feature = enter_obstacle(world, slot, scratch.ray, radius, t_max, scratch.work)
        if t < np.inf and not (skip and feature == INSIDE):
            other = _nearer(node_handles, slot, t, feature, other)
    return box, other


@inlined
def look_at_standing(world, tree, moving, still, ways, i, asked, tools, thin, slot, found):
    """The same from when it has come to rest on; found = (box, other, whether that stood)."""
    (box, other, stood), (node_handles, scratch), (skip, rate) = found, tools, asked
    there, t_max = box_of(tree, moving, slot), of_row(ways.t_max, i)
    radius, until = radius_of(ways, i, there, rate), time_left(there, still.left, thin)
    if radius == 0.0 and plain(world.geometry, world.footprints, slot):
        end = there[3] + still.left
        hit, t, face = meet_standing(there, thin, t_max, end)
        if hit and skip:
            first, _, where = meet_going(there, thin, 0.0, end)
            hit = face != INSIDE + STOPPED and not (first and where == INSIDE)
        if hit and is_sooner(
            *(tree, moving, thin, still.left, (slot, t, face)), (box.slot, box.t, box.feature)
        ):
            box = Best(slot, t, face)
    elif until < 0.0 or thin.pace > 0.0:
        see_standing(ways, i, there, still.left, scratch.ray)
        t, feature = enter_obstacle(world, slot, scratch.ray, radius, t_max, scratch.work)
        hit, inside = t < np.inf, feature == INSIDE
        if until >= 0.0:
            hit &= not inside and t >= until * (1.0 - NEAR)
        if hit and skip and until >= 0.0:
            see(ways, i, there, scratch.ray)
            first, where = enter_obstacle(world, slot, scratch.ray, radius, 0.0, scratch.work)
            inside = first < np.inf and where == INSIDE
        if hit and not (skip and inside):
            best = _nearer(node_handles, slot, t, feature, other)
            stood |= best.t < other.t or best.slot != other.slot
            other = best
    return box, other, stood


@inlined
def _nearer(node_handles, slot, t, feature, other):
    nearer = t < other.t
    if t == other.t:
        nearer = node_handles[slot] < node_handles[other.slot]
    return Best(slot, t, np.int64(feature)) if nearer else other


@inlined
def time_left(box, left, course):
    """`time_until` an obstacle comes to rest."""
    return time_until(box[3] + left, course)


@inlined
def time_until(end, course):
    """The t at which it is so late; negative if it was before, inf if it never is meanwhile."""
    if end < course.at:
        return -1.0
    return (end - course.at) / course.pace if course.pace > 0.0 else np.inf


@inlined
def growth_of(box, rate, at, pace, t_max):
    """By how much an obstacle has grown at most on the way, as `places.growths`."""
    reference, end = box[3], (at + pace * t_max if pace > 0.0 else at)
    if rate == 0.0 or not moves(box):
        return 0.0
    return min(rate * max(abs(at - reference), abs(end - reference)), LARGEST)


@inlined
def see(ways, i, box, ray):
    """Write the ray as an obstacle sees it that moves."""
    _, _, velocity, reference = box
    seen = stack_array((2, 3), np.float64)
    ndim, since = ways.origins.shape[1], of_row(ways.at, i) - reference
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
def see_as_met(ways, i, box, left, stood, then, ray):
    """The same of one that stood, if it did; return how long it has gone, else `then`."""
    if stood:
        see_standing(ways, i, box, left, ray)
        return left
    return then
