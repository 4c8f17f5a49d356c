# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls as single obstacles that move see them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.jit.compiling import lean_kernel
from ...tree.rays.slab import set_ray
from ..geometry.shapes import Floats
from ..store.obstacles import Obstacles
from ..store.registry import Slots
from .arguments import Found, Hits, Rays, call, new_scratch, world_of
from .casting import enter_obstacle, touch


class Met(NamedTuple):
    """Hits, by ray and in the order in which they are met."""

    rows: Slots
    slots: Slots
    ts: Floats
    points: Floats
    """Shape (m, 3)."""
    normals: Floats

    def take(self, which: NDArray[np.int64]) -> 'Met':
        """Some of them."""
        columns: Any = (column[which] for column in self)
        return Met(*columns)


class Times(NamedTuple):
    """When rays start, s, and how many seconds pass a unit of t; shape (n,) each."""

    at: Floats
    pace: Floats

    def ends(self, t_max: Floats) -> Floats:
        """When rays end, s; inf where they never do."""
        with np.errstate(over='ignore', invalid='ignore'):
            return np.where(self.pace > 0.0, self.at + self.pace * t_max, self.at)

    def last(self, t_max: Floats) -> float:
        """When the last ray ends."""
        return float(self.ends(t_max).max(initial=-np.inf))


@lean_kernel
def meet_each(world, rays, slots, radii, scratch, found):
    """Ray i, or a ball of radii[i] that goes along it, against the obstacle at slots[i]; t is inf
    where it is missed.
    """
    hits = found.hits
    for i in range(slots.shape[0]):
        set_ray(scratch.ray, rays.origins[i], rays.directions[i])
        t_max, work = rays.t_max[i], scratch.work
        t, feature = enter_obstacle(world, slots[i], scratch.ray, radii[i], t_max, work)
        hits.slots[i], hits.ts[i], hits.features[i] = slots[i], t, feature
        if t < np.inf:
            touch(world, scratch, radii[i], hits, i, found.points[i], found.normals[i])


def meet_pairs(held: Obstacles, seen: Rays, slots: Slots, radii: Floats) -> Found:
    """What `meet_each` finds."""
    count = len(slots)
    hits = Hits(np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64))
    found = Found(np.zeros(1, np.int64), hits, np.zeros((count, 3)), np.zeros((count, 3)))
    scratch = new_scratch(held.tree.ndim)
    call(meet_each, world_of(held.tree, held.columns), seen, slots, radii, scratch, found)
    return found


def grow(found: Met, grown: Floats, centres: Floats) -> None:
    """Move points (m, 3) from obstacles to what has grown about them by so much, (m,); centres
    (m, ndim) are where rays, or balls, begin. One that begins within what has grown meets it
    there, without a normal.
    """
    points, normals = found.points, found.normals
    points += normals * grown[:, None]
    out = np.zeros(len(points))
    for axis in range(centres.shape[1]):  # in the order of `first_moving`
        out += (centres[:, axis] - points[:, axis]) * normals[:, axis]
    within = np.flatnonzero((grown > 0.0) & (found.ts == 0.0) & (out <= 0.0))
    points[within, : centres.shape[1]] = centres[within]
    normals[within] = 0.0
