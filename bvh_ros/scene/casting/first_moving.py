# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first obstacle that a ray, or ball, meets among those that move: `walks` says whom it may
meet, `legs` how one is met.
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.motion.bounds import OUTSIDE, begin_asking, covers, moments_of
from ...tree.motion.casting import locate
from ...tree.motion.meeting import box_of, course_of
from ...tree.motion.sums import elapsed
from ...tree.motion.wide_casting import UNSUITED
from ...tree.nodes import NONE, ROOT
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import RAY_ROWS, set_swept_box
from ...tree.store.turns import REFUSED, begin_query, count_rays, end_query
from ..results import NO_NODE
from .arguments import CastWorld, Hits, fill_ways
from .casting import touch
from .legs import growth_of, look_at, see, see_standing
from .walks import Ways, nothing, walk, walk_wide


class First(NamedTuple):
    """What they meet."""

    hits: Any
    """`Hits`, (n,); NONE where the way is free."""
    handles: Any
    """(n,) uint32; NO_NODE where the way is free."""
    points: Any
    normals: Any
    """(n, 3)"""


@lean_kernel
def first_rows(world, tree, moving, ways, asked, node_handles, scratch, told):
    """Fill in a row for each way; asked as of `legs.look_at`. Returns 0; or OUTSIDE or REFUSED."""
    return _rows(world, tree, moving, None, ways, asked, (node_handles, scratch), told)


@lean_kernel
def first_swept(shapes, tree, sweep, ways, asked, tools, told, when, room):
    """`first_rows` through a `tree.motion.sweeping.Sweep`: ways that are not for it become
    UNSUITED. Returns how many; 1 if one is not finite. shapes as of `Columns.shapes`, ways what a
    `Ways` holds, tools = (node_handles, scratch), told = (slots and features, (2, n) or more, ts,
    handles, points, normals), when = (at, pace) of all if the ways tell no times. With `room`,
    (n, 3) or more, what is called directions are the goals of the ways, which are written there.
    """
    origins, directions, t_max, masks, radii, at, pace, grown = ways
    marks, ts, handles, points, normals = told
    found = First(Hits(marks[0], ts, marks[1]), handles, points, normals)
    if room.shape[0] > 0 and fill_ways(origins, directions, room) >= 0:
        return np.int64(1)
    directions = room if room.shape[0] > 0 else directions
    if at.shape[0] == 0:
        at, pace = stack_array(1, np.float64), stack_array(1, np.float64)
        at[0], pace[0] = when
    every = Ways(origins, directions, t_max, masks, radii, at, pace, grown)
    world = CastWorld(tree.nodes, tree.tight, tree.handles, tree.state[ROOT], *shapes)
    return _rows(world, tree, sweep.moving, sweep, every, asked, tools, found)


@lean_kernel
def _rows(world, tree, moving, sweep, ways, asked, tools, told):
    why, suited = np.int64(0), True
    if sweep is None:
        why = begin_asking(tree, moving, moments_of(ways.pace, ways.origins.shape[0]))
    elif not begin_query(tree.state, moving.version):
        why = np.int64(REFUSED)
    if why != 0:
        return why
    ray = stack_array((RAY_ROWS, 3), np.float64)
    for i in range(ways.origins.shape[0]):
        thin = course_of(ray, of_row(ways.at, i), of_row(ways.pace, i), moving)
        set_swept_box(ray, ways.origins[i], ways.origins[i], ways.directions[i])
        if sweep is None:
            if covers(moving, thin.at, thin.pace, of_row(ways.t_max, i)) == 0:
                why = np.int64(OUTSIDE)
                break
            found = walk(world, tree, moving, ways, i, asked, tools, thin)
        else:
            suited, found = walk_wide(world, tree, moving, sweep, ways, i, asked, tools, thin)
        if suited:
            tell_first(world, tree, moving, ways, i, asked, tools, thin, found, told)
        else:
            told.hits.slots[i] = UNSUITED
            why += 1
    if sweep is not None:
        count_rays(tree.state, ways.origins.shape[0], 0)
    end_query(tree.state)
    return why


@lean_kernel
def each_then(world, tree, moving, ways, slots, asked, tools, told):
    """Fill in a row for each way and the obstacle of `slots` that it may meet."""
    ray = stack_array((RAY_ROWS, 3), np.float64)
    for i in range(slots.shape[0]):
        thin = course_of(ray, of_row(ways.at, i), of_row(ways.pace, i), moving)
        set_swept_box(ray, ways.origins[i], ways.origins[i], ways.directions[i])
        slot = slots[i]
        found = look_at(world, tree, moving, ways, i, asked, tools, thin, slot, nothing())
        tell_first(world, tree, moving, ways, i, asked, tools, thin, found, told)


@inlined
def tell_first(world, tree, moving, ways, i, asked, tools, thin, found, told):
    """Write which of two hits is the first, found = (box, other, whether that stood), and where it
    is.
    """
    (box, other, stood), (node_handles, scratch), ndim = found, tools, ways.origins.shape[1]
    by_box = other.slot == NONE or box.t < other.t
    if box.slot != NONE and box.t == other.t:
        by_box = node_handles[box.slot] < node_handles[other.slot]
    if box.slot == NONE or not by_box:
        place = write_first(other, i, node_handles, told)
        if other.slot != NONE:
            met = scratch, other, stood
            _tell(world, tree, moving, ways, i, asked, met, told, place)
    else:
        place = write_first(box, i, node_handles, told)
        there, (point, normal) = box_of(tree, moving, box.slot), place
        locate(there, thin, box.t, box.feature, point[:ndim], normal[:ndim])


@inlined
def write_first(best, i, node_handles, told):
    """Fill in what is met in a row, NONE if nothing is; where that is, (point, normal), is still
    to be told.
    """
    hits, point, normal = told.hits, told.points[i], told.normals[i]
    hits.slots[i], hits.ts[i], hits.features[i] = best.slot, best.t, best.feature
    met = best.slot != NONE
    told.handles[i] = node_handles[best.slot] if met else NO_NODE
    for axis in range(3):
        point[axis], normal[axis] = 0.0 if met else np.nan, 0.0
    return point, normal


@lean_kernel
def _tell(world, tree, moving, ways, i, asked, found, told, place):
    """Write where an obstacle is met."""
    (scratch, best, stood), (point, normal), hits = found, place, told.hits
    at, pace = of_row(ways.at, i), of_row(ways.pace, i)
    box = box_of(tree, moving, best.slot)
    grown = growth_of(box, asked[1], at, pace, of_row(ways.t_max, i))
    then = elapsed(at, box[3], moving.nanoseconds)[0] + best.t * pace
    see(ways, i, box, moving.nanoseconds, scratch.ray)
    if stood:
        see_standing(ways, i, box, moving.left, scratch.ray)
        then = moving.left
    touch(world, scratch, of_row(ways.radii, i) + grown, hits, i, point, normal)
    for axis in range(box[2].shape[0]):
        point[axis] += box[2][axis] * then
    for axis in range(3):
        point[axis] += normal[axis] * grown
    if grown > 0.0 and best.t == 0.0:
        leave_surface(ways.origins[i], point, normal)


@lean_kernel
def leave_surface(centre, point, normal):
    """As `seen.grow`: who begins within what has grown meets it there, without a normal."""
    out = 0.0
    for axis in range(centre.shape[0]):
        out += (centre[axis] - point[axis]) * normal[axis]
    if out <= 0.0:
        for axis in range(centre.shape[0]):
            point[axis], normal[axis] = centre[axis], 0.0
