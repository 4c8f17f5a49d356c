# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far obstacles are, by their true shapes."""

import numpy as np
from numpy.typing import ArrayLike

from ..tree import checks
from ..tree.nodes import ALL
from .distance import clearance, nearness
from .results import Clearance, SceneHit
from .store.obstacles import Obstacles


class DistanceQueries:
    """How far things are. Any number of threads may ask while none changes the scene."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._nearness = nearness.Nearness(held.tree, held.columns)

    def nearest(
        self, point: ArrayLike, k: int = 1, max_distance: float = np.inf, mask: int = ALL
    ) -> list[SceneHit]:
        """Return the up to k obstacles nearest to a point, nearest first, ties by handle.

        Parameters
        ----------
        point : array_like, shape (3,)
            m; z is ignored in a planar scene.
        k : int
            How many at most.
        max_distance : float
            Farther ones are left out, m; may be inf.
        mask : int
            Only obstacles with ``categories & mask != 0`` are seen.

        Returns
        -------
        list of SceneHit
            `point` is the obstacle's point closest to the given one, `t` the distance between the
            two (m), `normal` leads from the obstacle's point to the given one; zero if that lies
            in the obstacle.

        Raises
        ------
        ValueError
            If an argument is NaN, negative (`max_distance`), less than 1 (`k`) or of the wrong
            shape.
        """
        where = checks.point('point', point, 3)
        found, rows = self._nearness.find(
            where,
            checks.whole('k', k, 1),
            checks.limit('max_distance', max_distance),
            checks.mask(mask),
        )
        return self._held.hits(found, rows)

    def clearance(self, name: str) -> Clearance | None:
        """Return how far an obstacle is from the nearest other one, ties by handle; None if there
        is no other.

        Both by their true shapes; in a planar scene seen from above, the points at the height of
        the obstacle's centre. Two shapes that are no farther apart than their positions are
        rounded touch, see `narrow_phase`. KeyError if there is no obstacle of this name.
        """
        slot = self._held.slot(name)
        tree, columns, slots = self._held.tree, self._held.columns, [slot]
        if self._held.columns.shadows:  # it may stand at two places, see slicing.py
            handles = self._held.columns.node_handle
            slots = np.flatnonzero(handles == handles[slot]).tolist()
        every = [clearance.nearest_other(tree, columns, place) for place in slots]
        found = min(
            (one for one in every if one is not None),
            key=lambda one: (one.distance, self._held.columns.node_handle[one.slot]),
            default=None,
        )
        if found is None:
            return None
        return Clearance(
            found.distance,
            self._held.registry.name(found.slot),
            int(self._held.columns.node_handle[found.slot]),
            *found.points,
        )
