# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls at obstacles that move no farther than `max_prediction` says.

A ray sees such an obstacle go, and from some t on stand. Whom it may meet on either way the tree
says, and that of where obstacles come to rest; each of these is asked both times.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...tree.motion.casting import Casts
from ...tree.rays.slab import INSIDE
from ..geometry.shapes import Floats
from ..store.obstacles import Obstacles
from ..store.places import growths, motions, rest, seen
from ..store.registry import Slots
from .arguments import Rays
from .seen import Met, Times, grow, meet_pairs

PAIRS = 1 << 17  # that are looked at in one go


def met(
    held: Obstacles,
    rays: Rays,
    radii: Floats,
    skip: bool,
    times: Times,
    still: Slots,
    casts: Casts,
) -> Met:
    """Hits of these obstacles; `rays` along the tree's axes, and what they may meet, `casts`."""
    there, number = rest(held), np.full(len(held.columns.node_handle), -1)
    number[still] = np.arange(len(still))
    going, standing = _boxes(held.tree, casts), _boxes(there.tree, casts)
    rows = np.concatenate((going[0], standing[0]))
    which = number[np.concatenate((going[1], there.slots[standing[1]]))]
    rows, which = rows[which >= 0], which[which >= 0]
    stops = comes_to_rest(held, still[which], times.ends(rays.t_max)[rows])
    pairs = np.unique(rows[stops] * len(still) + which[stops])
    parts = []
    for begin in range(0, max(len(pairs), 1), PAIRS):
        some = np.divmod(pairs[begin : begin + PAIRS], len(still))
        parts.append(_of_pairs(held, rays, radii, skip, times, (some[0], still[some[1]])))
    return Met(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def comes_to_rest(held: Obstacles, slots: Slots, last: Floats) -> NDArray[np.bool_]:
    """Who of these obstacles does so before some times (m,), s. A ray that sees none of it end is
    the tree's own affair, whoever is asked about in the same batch.
    """
    velocities, references = motions(held, slots)
    stops: NDArray[np.bool_] = velocities.any(axis=1) & (references + held.max_prediction < last)
    return stops


def _boxes(tree: Any, casts: Casts) -> tuple[NDArray[np.int64], Slots]:
    """Rows, and slots of boxes that they meet."""
    offsets, handles, _, _ = tree.motion.every(tree, casts)
    return np.repeat(np.arange(len(casts.lo)), np.diff(offsets)), tree.slots(handles)


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
    inside = early & (first.hits.features == INSIDE)
    inside |= late & (stop == 0.0) & (second.hits.features == INSIDE)
    kept = np.flatnonzero((early | late) & ~(skip & inside))
    all_met = Met(rows, slots, ts, points, normals)
    grow(all_met, grown, some.origins)
    return all_met.take(kept)
