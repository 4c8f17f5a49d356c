# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ways past obstacles that move, nearest first, through the tree's nodes."""

from typing import Any, NamedTuple

import numpy as np

from ...tree.jit.compiling import inlined
from ...tree.jit.intrinsics import stack_array
from ...tree.jit.moving_sides import FRONTS
from ...tree.motion.bounds import covers, set_fronts
from ...tree.motion.casting import descend
from ...tree.nodes import DEEPEST, NONE
from ...tree.rays.raycasting import of_row
from ...tree.rays.slab import PAD, TINY
from .casting import no_hit
from .frame import COORDINATES, FRAME_SLACK
from .legs import look_at


class Ways(NamedTuple):
    """n rays, or balls that go along them."""

    origins: Any
    directions: Any
    t_max: Any
    """One for all, or (n,), as all that follows."""
    masks: Any
    radii: Any
    at: Any
    """s; empty, as `pace`, if `swept_ways.first_swept` is told when."""
    pace: Any
    """How many seconds a unit of t takes."""
    grown: Any
    """What no obstacle has grown by more, m."""


def ball_reach(radius: Any, largest: Any) -> Any:
    """By how much a ray may pass the box of an obstacle that its ball touches; `largest` of the
    coordinates of its origin.
    """
    return radius * (1.0 + FRAME_SLACK) + (FRAME_SLACK + COORDINATES) * largest


_ball_reach = inlined(ball_reach)


@inlined
def reach_of(ways, i):
    """The same of a row, and of what has grown."""
    largest = 0.0
    for axis in range(ways.origins.shape[1]):
        largest = max(largest, abs(ways.origins[i, axis]))
    return _ball_reach(of_row(ways.radii, i), largest) + of_row(ways.grown, i)


@inlined
def nothing():
    """What `look_at` has found at first."""
    return no_hit(), no_hit(), False


@inlined
def walk(world, tree, moving, ways, i, asked, tools, thin):
    """The first hits of a way, as of `look_at`: through the tree's nodes."""
    at, pace, t_max, mask = thin.at, thin.pace, of_row(ways.t_max, i), of_row(ways.masks, i)
    nodes, fronts = moving.nodes, stack_array(FRONTS, np.float64)
    _set_way(fronts, moving, ways, i, reach_of(ways, i))
    found = nothing()
    stack, entries = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64)
    stack[0], entries[0], top = world.root, 0.0, (0 if world.root == NONE else 1)
    bounded, limit = covers(moving, at, pace, t_max) > 0, t_max
    while top > 0:
        top -= 1
        if entries[top] > limit * PAD + TINY or nodes[stack[top]].mask & mask == 0:
            continue
        waiting = stack, entries, top
        node, top = descend(nodes, fronts, bounded, (at - moving.start, pace, limit), waiting)
        if node == NONE or nodes[node].mask & mask == 0:
            continue
        slot = np.int64(node >> 1)
        found = look_at(world, tree, moving, ways, i, asked, tools, thin, slot, found)
        limit = min(limit, found[0].t, found[1].t)
    return found


@inlined
def _set_way(fronts, moving, ways, i, more):
    """`set_fronts` of what goes along a way, by so much larger."""
    corners = stack_array((2, 3), np.float64)
    for axis in range(ways.origins.shape[1]):
        corners[0, axis] = ways.origins[i, axis] - more
        corners[1, axis] = ways.origins[i, axis] + more
    set_fronts(fronts, moving, corners[0], corners[1], ways.directions[i])
