# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Overlaps and distances at a time, among obstacles that have velocities: how `moving` is called,
and one query. Scenes without velocities need none of this.
"""

from functools import partial
from typing import Any

import numpy as np

from ...tree.access import CHANGES, COUNT, NOTHING, Tree
from ...tree.compiler import entry_point
from ...tree.motion.access import times_of
from ..geometry.shapes import Floats
from ..results import SceneHit
from ..store.mesh_store import Hulls
from ..store.obstacles import Obstacles
from ..store.places import movers
from ..store.spare import Spare
from .kept import FEW, Known, Scratch, no_rows
from .moving import Then, touch_rows
from .moving_neighbours import near_rows
from .query_rows import NO_GIVEN
from .query_shape import QueryShape
from .touching_rows import COUNT as COUNTED
from .touching_rows import Signed, bodies_of


class OneTimed:
    """One query at a time, and how kernels are called."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._spare = Spare(Scratch)
        self._entries: dict[tuple[Any, ...], Any] = {}

    def find(
        self, query: QueryShape, hulls: Hulls | None, mask: np.uint32, at: float
    ) -> list[SceneHit]:
        """What a query touches at a time, in the order of `overlaps.Overlaps.find`."""
        scratch, tree, done = self._spare.take(), self._held.tree, 0
        scratch.limits[0], scratch.masks[0] = query.tolerance, mask
        asked = query.record, query.bounds[None], scratch.limits, scratch.masks, NO_GIVEN
        while not done:
            arrays, found = tree._settled().tree, scratch.found
            then, memory = self._known(scratch, arrays, at, hulls)
            given = asked, (0, 1, COUNTED, 0), memory, scratch.answers
            done, wanted, _, compared = self._call(arrays, touch_rows, then, given, None)
            if not done:
                scratch.have_room(wanted)
        if compared:
            self._held.columns.pairs_compared += compared
        count = scratch.answers[1].item(0)
        hits = self._held.hits(found, found.order[:count].tolist()) if count else []
        self._spare.give(scratch)
        return hits

    def find_near(
        self, point: Floats, k: int, limits: tuple[float, np.uint32], signed: Signed, at: float
    ) -> list[SceneHit]:
        """What is nearest to a point at a time, in the order of `nearness.Nearness.find`."""
        scratch, held, done = self._spare.take(), self._held, 0
        scratch.point[0] = point
        reach, scratch.masks[0] = limits
        scratch.limits[0] = reach
        if k > FEW:  # not more room than for all
            k = min(k, max(len(held.tree), 1))
        if scratch.told.handles.shape[1] != k:
            scratch.told = no_rows(1, k)
        while not done:
            arrays, found = held.tree._settled().tree, scratch.found
            then, memory = self._known(scratch, arrays, at, None)
            asked = 0, 1, k, *self._among(arrays, signed)
            given = scratch.points, None, asked, memory, scratch.told
            done, wanted, count = self._call(arrays, near_rows, then, given, signed)
            if not done:
                scratch.have_room(wanted)
        distances = found.distances[:count].tolist()
        order = [row for row in found.order[:count].tolist() if distances[row] <= reach]
        if held.columns.shadows:
            handles = held.columns.node_handle[found.slots[order]]
            first = np.sort(np.unique(handles, return_index=True)[1])
            order = [order[place] for place in first]
        hits = held.hits(found, order[:k])
        self._spare.give(scratch)
        return hits

    # ---- kernels

    def _among(self, arrays: Tree, signed: Signed) -> tuple[bool, int, bool, Signed]:
        """What `near_rows` is told of all rows."""
        held, columns = self._held, self._held.columns
        shaped, twice = columns.shaped > 0, columns.shadows > 0
        some_more = shaped or twice or held.uncertainty > 0.0 or signed is not None
        return some_more, arrays[4].item(COUNT), twice, signed

    def _known(
        self, scratch: Scratch, arrays: Tree, at: Any, hulls: Hulls | None
    ) -> tuple[Then, tuple[Any, Any]]:
        """What a kernel is told of times, and what of `scratch` it writes to."""
        known, bodies, version = scratch.known, self._held.columns.bodies, arrays[4].item(CHANGES)
        if known is not None and hulls is None and known[0] == version and known[1] is bodies:
            _, _, then, memory = known
        else:
            then = self._then(scratch.at, hulls)
            memory = scratch.memory(then)
            scratch.known = Known(version, bodies, then, memory) if hulls is None else None
        if type(at) is float:
            scratch.at[0] = at
            return then, memory
        return tuple.__new__(Then, (*then[:2], at, *then[3:])), memory

    def _then(self, at: Floats, hulls: Hulls | None) -> Then:
        held = self._held
        ends = movers(held)[1:] if held.uncertainty else (0.0, 0.0)
        places = bodies_of(held.columns, hulls), held.columns.node_handle
        return Then(*places, at, held.uncertainty, *ends)

    def _call(
        self, arrays: Tree, kernel: Any, then: Then, given: tuple[Any, ...], kind: Any
    ) -> Any:
        """Call a kernel; `kind` stands, with it, for the types of what it is given."""
        tree: Any = self._held.tree
        variant, motion = (kernel, kind, then[0].hulls is not None), tree._motion
        if motion is None:
            raise RuntimeError('no obstacle of this scene has a velocity')
        entry = self._entries.get(variant)
        if entry is None:
            entry = entry_point(kernel, arrays, motion.moving, then, *given)
            self._entries[variant] = entry
        done = entry(arrays, motion.bounds, then, *given)
        return done if done[0] >= 0 else self._call_again(entry, then, given)

    def _call_again(self, entry: Any, then: Then, given: tuple[Any, ...]) -> Any:
        """Call it with bounds that hold for these times."""
        tree: Any = self._held.tree
        spans = partial(times_of, then.at, NOTHING, NOTHING)
        return tree._motion.ask(tree, spans, lambda *arrays: entry(*arrays, then, *given))
