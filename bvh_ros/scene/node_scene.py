# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scene of a node: other callers need none of this."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.access import checks
from .inspection import Inspection
from .scene import Scene, method_of
from .shapes.shape import Floats, Shapes
from .slicing import SlicedUpdates
from .store import Obstacles
from .timed_queries import TimedQueries
from .updates import Removals, Updates


class NodeScene(Scene):
    """A scene that is changed in slices, prepared before queries, and drawn."""

    def _begin(self, store: Obstacles, updates: Updates) -> None:
        super()._begin(store, updates)
        self._slices = SlicedUpdates(store, self._updates)

    in_slices = method_of('_slices', SlicedUpdates.in_slices)
    is_long = method_of('_slices', SlicedUpdates.is_long)
    rest = method_of('_updates', Updates.rest)
    find = method_of('_removals', Removals.find)
    discard = method_of('_removals', Removals.discard)
    discard_in_slices = method_of('_removals', Removals.discard_in_slices)
    has_expired = method_of('_removals', Removals.has_expired)

    # Another thread may call these while nothing changes the scene.

    def prepare_rays(self, count: int) -> None:
        """Prepare what a batch of `count` rays needs, as the batch itself would do. It takes
        0.5 us an obstacle.
        """
        tree = self._store.tree
        rays = 2 * checks.whole('count', count, 0)  # the batch looks at the tree again
        tree.snapshot_for(rays, tree.view())

    prepare_times = method_of('_timed', TimedQueries.prepare)
    is_prepared = method_of('_timed', TimedQueries.is_prepared)
    refit = method_of('_timed', TimedQueries.refit)

    def collisions_many(
        self, shapes: Shapes, mask: int, threads: int, at: ArrayLike | None = None
    ) -> tuple[NDArray[np.uint32], Floats, Floats, Floats]:
        """`clearance_many` with signed distances; 0 where two touch and no depth is known."""
        found: Any = self._clear_many(shapes, np.inf, mask, True, threads, at)
        _, distances, points, other_points, handles = found
        distances[np.isneginf(distances)] = 0.0
        return handles, distances, points, other_points

    # ---- what there is

    newcomers = method_of('_inspection', Inspection.newcomers)
    names_still_there = method_of('_inspection', Inspection.names_still_there)
    shapes_of = method_of('_inspection', Inspection.shapes_of)
    handles_of = method_of('_inspection', Inspection.handles_of)
    own_box = method_of('_inspection', Inspection.own_box)
    triangles_met = method_of('_inspection', Inspection.triangles_met)
    tree_levels = method_of('_inspection', Inspection.tree_levels)
    figures = method_of('_inspection', Inspection.figures)
    validate_in_turns = method_of('_inspection', Inspection.validate_in_turns)

    @property
    def any_shaped(self) -> bool:
        """Whether anything is more than an axis-aligned box, and needs a narrow phase."""
        return self._store.columns.shaped > 0

    @property
    def population(self) -> tuple[int, int]:
        """Another one after each time that obstacles came or went."""
        # A new obstacle gets a new node handle; while none comes, the number can only fall.
        return self._store.next_node_handle, len(self)
