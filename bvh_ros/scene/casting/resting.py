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
from ...tree.nodes import NONE, ROOT
from ..geometry.shapes import Floats
from ..store.obstacles import Obstacles
from ..store.places import motions, movers, rest, seen
from ..store.registry import Slots
from .arguments import Hits, Rays, call, new_scratch, world_of
from .first_moving import First, each_then
from .legs import Still
from .seen import Met, Times
from .walks import Ways

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


def still_of(held: Obstacles) -> Still:
    """Who ever does, for kernels."""
    there = rest(held)
    root, first = there.tree.state.item(ROOT), movers(held).first_end
    return Still(held.max_prediction, there.nodes, root, there.slots, first)


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
    count, columns, tree = len(rows), held.columns, held.tree
    some, still = Rays(*(column[rows] for column in rays)), still_of(held)
    ways = Ways(*some, radii[rows], times.at[rows], times.pace[rows], np.zeros(1))
    hits = Hits(np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64))
    told = First(hits, np.empty(count, np.uint32), np.empty((count, 3)), np.empty((count, 3)))
    tools, view = (columns.node_handle, new_scratch(tree.ndim)), tree.view()
    assert tree.motion is not None
    world, moving = world_of(tree, columns), tree.motion.known(view, 0.0, 0.0)
    given = view.tree, moving, still, ways, slots, (skip, held.uncertainty), tools, told
    call(each_then, world, *given)
    kept = np.flatnonzero(hits.slots != NONE)
    return Met(rows, slots, hits.ts, told.points, told.normals).take(kept)
