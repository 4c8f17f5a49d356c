# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What touches a box or another shape in a scene, and what touches each other."""

from numpy.typing import ArrayLike

from ..tree import checks
from ..tree.nodes import ALL
from .distance import overlaps
from .distance.query_shape import NO_TURN, box_query, shape_query
from .geometry.shapes import Shapes
from .results import SceneHit
from .store.obstacles import Obstacles


class OverlapQueries:
    """What touches. Any number of threads may ask while none changes the scene."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held
        self._overlaps = overlaps.Overlaps(held.tree, held.columns)

    def overlap(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        orientation: ArrayLike = NO_TURN,
        tolerance: float = 0.0,
        mask: int = ALL,
        most: int | None = None,
    ) -> list[SceneHit]:
        """Return all obstacles that touch a box, nearest to its centre first, ties by handle.

        Parameters
        ----------
        start, goal : array_like, shape (3,)
            Opposite corners of the box, m. If they are equal it is a point, with `tolerance` a
            ball.
        orientation : array_like, shape (4,)
            Quaternion x, y, z, w of the box's axes; zero is the identity.
        tolerance : float
            The box is grown by this all round, with rounded corners: obstacles at most so far from
            it count, m.
        mask : int
            Only obstacles with ``categories & mask != 0`` are seen.
        most : int, optional
            More than so many are refused: an answer is never cut short.

        Returns
        -------
        list of SceneHit
            `point` is the obstacle's point closest to the box's centre, `t` the distance between
            the two (m), `normal` leads from the point to the centre; zero if the centre lies in
            the obstacle.

        Raises
        ------
        ValueError
            If an argument is NaN, infinite, negative (`tolerance`) or of the wrong shape, or (as
            TooManyHitsError) there are more hits than `most`.
        """
        query = box_query(start, goal, orientation, tolerance, self._held.planar)
        found, rows = self._overlaps.find(query, None, checks.mask(mask), most)
        return self._held.each_once(self._held.hits(found, rows))

    def overlap_shape(
        self, shape: Shapes, tolerance: float = 0.0, mask: int = ALL
    ) -> list[SceneHit]:
        """Return all obstacles that touch a shape of any kind; otherwise as `overlap`.

        Parameters
        ----------
        shape : Shapes
            One row. A planar scene sees it from above too.
        tolerance, mask
            As in `overlap`.
        """
        query, hulls = shape_query(shape, tolerance, self._held.planar)
        found, rows = self._overlaps.find(query, hulls, checks.mask(mask), None)
        return self._held.each_once(self._held.hits(found, rows))

    def overlap_pairs(self, mask: int = ALL) -> list[tuple[str, str]]:
        """Return the names of all obstacles that touch each other.

        Each pair once, the older obstacle first; sorted by handle. `mask`: only obstacles with
        ``categories & mask != 0`` are seen.
        """
        pairs = overlaps.find_pairs(self._held.tree, self._held.columns, mask)
        if self._held.columns.shadows:
            pairs = overlaps.each_once(self._held.columns, pairs)
        return [
            (self._held.registry.name(one), self._held.registry.name(two))
            for one, two in pairs.tolist()
        ]
