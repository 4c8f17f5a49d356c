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
from ...tree.nodes import NONE
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import RAY_ROWS, set_swept_box
from ...tree.store.turns import end_query
from ..results import NO_NODE
from .casting import touch
from .legs import growth_of, look_at, see, see_standing
from .walks import nothing, walk


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
    why = begin_asking(tree, moving, moments_of(ways.pace, ways.origins.shape[0]))
    if why != 0:
        return why
    ray, tools = stack_array((RAY_ROWS, 3), np.float64), (node_handles, scratch)
    for i in range(ways.origins.shape[0]):
        thin = course_of(ray, of_row(ways.at, i), of_row(ways.pace, i), moving)
        if covers(moving, thin.at, thin.pace, of_row(ways.t_max, i)) == 0:
            why = np.int64(OUTSIDE)
            break
        set_swept_box(ray, ways.origins[i], ways.origins[i], ways.directions[i])
        found = walk(world, tree, moving, ways, i, asked, tools, thin)
        tell_first(world, tree, moving, ways, i, asked, tools, thin, found, told)
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
