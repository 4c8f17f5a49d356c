# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far obstacles are, by their true shapes."""

import numpy as np
from numpy.typing import ArrayLike

from ..tree import checks
from ..tree.nodes import ALL
from . import nearness
from .queries import SceneQueries
from .results import SceneHit


class DistanceQueries(SceneQueries):
    """Queries of a scene for distances."""

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
        found = nearness.nearest(
            self._tree,
            self._columns,
            where,
            checks.whole('k', k, 1),
            checks.limit('max_distance', max_distance),
            mask,
        )
        if self.planar:
            found.points[:, 2] = where[2]
        slots, distances = found.slots.tolist(), found.distances.tolist()
        rows = zip(slots, distances, found.points, found.normals, strict=True)
        return [self._hit(*row) for row in rows]
