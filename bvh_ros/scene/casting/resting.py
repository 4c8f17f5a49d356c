# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls at obstacles that move no farther than `max_prediction` says.

A ray sees such an obstacle go, and from some t on stand. It is asked both times, of each of them:
in a world that is refreshed often enough they are few.
"""

import numpy as np

from ...tree.rays.slab import INSIDE
from ..geometry.shapes import Floats
from ..store.obstacles import Obstacles
from ..store.places import growths, motions, seen
from ..store.registry import Slots
from .arguments import Rays
from .seen import Met, Times, meet_pairs

PAIRS = 1 << 17  # that are looked at in one go


def met(held: Obstacles, rays: Rays, radii: Floats, skip: bool, times: Times, still: Slots) -> Met:
    """Hits of these obstacles; `rays` along the tree's axes."""
    parts, step = [], max(PAIRS // len(still), 1)
    for begin in range(0, len(radii), step):
        rows = np.arange(begin, min(begin + step, len(radii)))
        pairs = np.repeat(rows, len(still)), np.tile(still, len(rows))
        parts.append(_of_pairs(held, rays, radii, skip, times, pairs))
    return Met(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _of_pairs(
    held: Obstacles,
    rays: Rays,
    radii: Floats,
    skip: bool,
    times: Times,
    pairs: tuple[Slots, Slots],
) -> Met:
    rows, slots = (column[seen(held, pairs[1], rays.masks[pairs[0]])] for column in pairs)
    velocities, references = motions(held, slots)
    some = Rays(*(column[rows] for column in rays))
    at, pace, left = times.at[rows], times.pace[rows], held.max_prediction
    grown = growths(held, slots, at, Times(at, pace).ends(some.t_max))
    balls = radii[rows] + grown
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        stop = (references + left - at) / pace
    stop = np.where(pace > 0.0, stop, np.where(references + left >= at, np.inf, 0.0))
    stop = np.clip(stop, 0.0, some.t_max)  # the t from which the obstacle stands
    since = np.minimum(at - references, left)
    going = Rays(
        some.origins - velocities * since[:, None],
        some.directions - velocities * np.where(stop > 0.0, pace, 0.0)[:, None],
        *(stop, some.masks),
    )
    first = meet_pairs(held, going, slots, balls)
    then = np.where(np.isfinite(stop), stop, 0.0)
    start = some.origins + some.directions * then[:, None]
    standing = Rays(start - velocities * left, some.directions, some.t_max - then, some.masks)
    second = meet_pairs(held, standing, slots, balls)
    early = first.hits.ts < np.inf
    late = ~early & (second.hits.ts < np.inf) & (stop < some.t_max)
    ts = np.where(early, first.hits.ts, then + second.hits.ts)
    gone = np.where(early, since + np.where(early, first.hits.ts, 0.0) * pace, left)
    points = np.where(early[:, None], first.points, second.points)
    points[:, : held.tree.ndim] += velocities * gone[:, None]
    normals = np.where(early[:, None], first.normals, second.normals)
    points += normals * grown[:, None]
    inside = early & (first.hits.features == INSIDE)
    inside |= late & (stop == 0.0) & (second.hits.features == INSIDE)
    kept = np.flatnonzero((early | late) & ~(skip & inside))
    return Met(rows, slots, ts, points, normals).take(kept)
