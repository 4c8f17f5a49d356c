# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One ray, or swept ball, among obstacles that have velocities.

The answers are those of `moving.first_then`. Here arrays of one row are kept, as making them would
take longer than the question.
"""

from functools import partial
from typing import Any

import numpy as np

from ...tree.entries import entry_points
from ...tree.jit.compiling import lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.motion.casting import cast_one, no_motion
from ...tree.motion.spans import span_of, times_of
from ...tree.nodes import NONE, slot_of
from ...tree.rays.raycasting import CLOSEST
from ...tree.store.turns import NOT_FINITE
from ..geometry.shapes import Floats
from ..store.obstacles import Obstacles
from ..store.places import most_growth
from ..store.spare import Spare
from .arguments import Hits, call, new_scratch, world_of
from .box_casting import BoxHit, too_long, way_between
from .first_moving import First, first_rows
from .walks import Ways

Way = tuple[Floats, Floats, float]  # origin, direction, radius
When = tuple[float, float]  # at, pace


@lean_kernel
def first_between_then(tree, moving, start, goal, when, mask, skip_inside, place):
    """The first box from `start` to `goal`, when = (at, pace): (slot, t), and its point and normal
    as the rows of `place`; instead of a slot what `cast_one` says.
    """
    way, ndim = stack_array(3, np.float64), moving.kept[0].velocity.shape[0]
    if not way_between(start, goal, way, place):
        return np.int64(NOT_FINITE), np.inf
    swept = start[:ndim], start[:ndim], way[:ndim]
    asked = 1.0, mask, skip_inside, CLOSEST
    handle, t = cast_one(tree, moving, swept, asked, when, place)
    return (slot_of(handle) if handle >= 0 else np.int64(handle)), t


_POINT = np.empty(3)
_first_entry = entry_points(
    *(first_between_then, no_motion, _POINT, _POINT, (0.0, 0.0), np.uint32(0), False),
    np.empty((2, 3)),
)


class _Room:
    """Room for one way, see `spare`."""

    def __init__(self, ndim: int) -> None:
        self.ways = Ways(
            *(np.empty((1, ndim)), np.empty((1, ndim)), np.ones(1), np.empty(1, np.uint32)),
            *(np.empty(1), np.empty(1), np.empty(1), np.empty(1)),
        )
        self.hits = Hits(np.empty(1, np.int64), np.empty(1), np.empty(1, np.int64))
        self.handles = np.empty(1, np.uint32)
        self.scratch = new_scratch(ndim)


class OneWay:
    """Asks for one way at a time."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._tree: Any = held.tree
        self._spare = Spare(partial(_Room, held.tree.ndim))
        self._first = _first_entry(held.tree.ndim)

    def first_box(
        self, start: Floats, goal: Floats, mask: np.uint32, skip: bool, when: When
    ) -> BoxHit | None:
        """The first axis-aligned box from `start` to `goal`, shape (3,) each: the tree decides."""
        tree, place = self._tree, np.empty((2, 3))
        asked = start, goal, when, mask, skip, place
        motion, moment = tree._motion, when[1] == 0.0
        moving = motion.bounds if moment else motion.moving
        slot, t = self._first(tree._settled().tree, moving, *asked)
        while slot < NONE:
            if slot == NOT_FINITE:
                raise too_long(start, goal)
            moving = motion.others(tree, moving, slot, span_of(*when, 1.0), moment)
            slot, t = self._first(tree._settled().tree, moving, *asked)
        return None if slot == NONE else (slot, t, place[0], place[1])

    def first_shape(self, way: Way, mask: np.uint32, skip: bool, when: When) -> BoxHit | None:
        """The first obstacle of any shape."""
        held, tree, room = self._held, self._tree, self._spare.take()
        (origin, direction, radius), (at, pace) = way, when
        ways, hits, ndim = room.ways, room.hits, tree.ndim
        ways.origins[0], ways.directions[0] = origin[:ndim], direction[:ndim]
        ways.masks[0], ways.radii[0], ways.at[0], ways.pace[0] = mask, radius, at, pace
        ways.grown[0] = 0.0
        if held.uncertainty:
            ways.grown[0] = np.max(most_growth(held, ways.at, ways.at + pace))
        told = First(hits, room.handles, np.empty((1, 3)), np.empty((1, 3)))
        given = ways, (skip, held.uncertainty), held.columns.node_handle, room.scratch, told
        world, motion = world_of(tree, held.columns), tree.motion
        spans: Any = partial(times_of, ways.at, ways.pace, ways.t_max)

        def ask(*arrays: Any) -> Any:
            return call(first_rows, world, *arrays, *given)

        motion.ask(tree, spans, ask, pace == 0.0)
        if ndim == 2:
            told.points[0, 2] = origin[2]
        slot, t, point, normal = (
            hits.slots.item(0),
            hits.ts.item(0),
            told.points[0],
            told.normals[0],
        )
        self._spare.give(room)
        return None if slot == NONE else (slot, t, point, normal)
