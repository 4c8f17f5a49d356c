# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The questions a scene answers.

Each checks its input, asks the tree or a kernel, and names what was found.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree import checks
from ..tree.dynamic_bvh import DynamicBVH
from ..tree.nodes import ALL
from .casting import ball_casting, box_casting, casting
from .distance import overlaps
from .geometry.query_shape import QueryShape, box_query, shape_query
from .geometry.shapes import Floats, Shapes, along_axes
from .results import NO_NODE, SceneHit, require_few
from .store.columns import Columns
from .store.registry import Registry, Slots

Masks = NDArray[np.uint32]


class SceneQueries:
    """Queries of a scene. Any number of threads may ask while none changes it."""

    planar: bool
    _tree: DynamicBVH
    _columns: Columns
    _registry: Registry
    _any_shaped: bool

    # ---- rays

    def raycast(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        radius: float = 0.0,
        mask: int = ALL,
        skip_inside: bool = False,
    ) -> SceneHit | None:
        """Return the first obstacle on the way from start to goal.

        Parameters
        ----------
        start, goal : array_like, shape (3,)
            Ends of the segment, m. If they are equal, the point (the ball) at `start` is asked
            for.
        radius : float
            Of a ball swept along the segment, m; 0 is a thin ray.
        mask : int
            Only obstacles with ``categories & mask != 0`` are seen.
        skip_inside : bool
            Ignore obstacles that the point or ball touches at the start.

        Returns
        -------
        SceneHit or None
            `t` is where the ray's point or the ball's centre is between start (0) and goal (1).
            `point` lies on the obstacle, `normal` leads from there to the ball's centre. An
            obstacle that contains the start is met at ``t = 0`` with a zero normal; the normal is
            zero as well where the ball's centre is no farther from the obstacle than rounding.
            Among axis-aligned boxes it is decided exactly whether a ray or a ball touches, and
            which obstacle is first; other shapes touch too where that cannot be told apart, see
            `frame`. Ties go to the smaller handle.

        Raises
        ------
        ValueError
            If an argument is NaN, infinite, negative (`radius`) or of the wrong shape.
        """
        origin, direction, radius = self._segment(start, goal, radius)
        if radius == 0.0 and not self._any_shaped:
            hit = box_casting.first(
                self._tree, origin, direction, checks.mask(mask), bool(skip_inside)
            )
            return None if hit is None else self._hit(*hit)
        hits = self._cast_one(origin, direction, radius, mask, skip_inside, False)
        return hits[0] if hits else None

    def raycast_all(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        radius: float = 0.0,
        mask: int = ALL,
        skip_inside: bool = False,
        most: int | None = None,
    ) -> list[SceneHit]:
        """Return all obstacles on the way, nearest first, ties by handle.

        Arguments as `raycast`. TooManyHitsError, a ValueError, if there are more than `most`: an
        answer is never cut short. For a ball that counts what it may touch, before the last digit
        is looked at.
        """
        origin, direction, radius = self._segment(start, goal, radius)
        if radius == 0.0 and not self._any_shaped:
            hits = box_casting.every(
                self._tree, origin, direction, checks.mask(mask), bool(skip_inside), most
            )
            return self._each_once([self._hit(*hit) for hit in hits])
        return self._each_once(
            self._cast_one(origin, direction, radius, mask, skip_inside, True, most)
        )

    def raycast_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
    ) -> tuple[NDArray[np.uint32], Floats, Floats, Floats]:
        """First obstacles on n thin rays ``origin + t * direction``, ``0 <= t <= t_max``.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
        t_max, mask : one for all rays, or array_like of shape (n,)

        Returns
        -------
        handles : (n,) uint32
            Node handles, NO_NODE (0xFFFFFFFF) where nothing is hit.
        t : (n,)
            In units of the directions; inf where nothing is hit.
        points, normals : (n, 3)
            NaN and zero where nothing is hit.
        """
        starts = checks.points('origins', origins, 3)
        ways = checks.points('directions', directions, 3, len(starts))
        reaches, masks = (
            checks.limits('t_max', t_max, len(starts)),
            checks.masks(mask, len(starts)),
        )
        rays = starts, ways, reaches, masks
        if not self._any_shaped:
            handles = self._columns.node_handle
            return box_casting.first_of_many(self._tree, handles, rays, bool(skip_inside))
        return self._first_of_many(*rays, skip_inside)

    def _first_of_many(
        self, starts: Floats, ways: Floats, t_max: Floats, masks: Masks, skip_inside: bool
    ) -> tuple[NDArray[np.uint32], Floats, Floats, Floats]:
        """The same against the true shapes."""
        found = self._cast(starts, ways, t_max, masks, skip_inside, False)
        offsets, slots, ts, points, normals = found
        count, rows = len(starts), np.flatnonzero(np.diff(offsets))
        handles, distances = np.full(count, NO_NODE, np.uint32), np.full(count, np.inf)
        places, outwards = np.full((count, 3), np.nan), np.zeros((count, 3))
        handles[rows], distances[rows] = self._columns.node_handle[slots], ts
        places[rows], outwards[rows] = points, normals
        if self.planar:
            places[rows, 2] = starts[rows, 2]
        return handles, distances, places, outwards

    def _segment(
        self, start: ArrayLike, goal: ArrayLike, radius: float
    ) -> tuple[Floats, Floats, float]:
        radius = checks.limit('radius', radius)
        if math.isinf(radius):
            raise ValueError('radius must be finite')
        origin, end = checks.floats('start', start), checks.floats('goal', goal)
        if origin.shape == end.shape == (3,):
            # Three numbers: Python's own arithmetic takes a fifth of the time of numpy's.
            way = [b - a for a, b in zip(origin.tolist(), end.tolist(), strict=True)]
            if all(map(math.isfinite, way)):  # so both ends are
                return origin, np.array(way), radius
        checks.point('start', origin, 3)
        checks.point('goal', end, 3)
        raise ValueError('the segment from start to goal is longer than the largest double')

    def _cast(
        self,
        starts: Floats,
        ways: Floats,
        t_max: Floats,
        masks: Masks,
        skip_inside: bool,
        every: bool,
    ) -> tuple[Slots, Slots, Floats, Floats, Floats]:
        """Offsets, slots, t, points and normals of thin rays against the true shapes."""
        ndim = self._tree.ndim
        rays = along_axes(starts, ndim), along_axes(ways, ndim), t_max, masks
        return casting.cast_all(self._tree, self._columns, rays, bool(skip_inside), every)

    def _cast_one(
        self,
        origin: Floats,
        way: Floats,
        radius: float,
        mask: int,
        skip_inside: bool,
        every: bool,
        most: int | None = None,
    ) -> list[SceneHit]:
        seen = checks.mask(mask)
        if radius > 0.0:
            slots, ts, points, normals = ball_casting.cast_ball(
                *(self._tree, self._columns, origin, way, radius, seen, bool(skip_inside), every),
                most,
            )
        else:
            masks = checks.masks(seen, 1)
            found = self._cast(origin[None], way[None], np.ones(1), masks, skip_inside, every)
            _, slots, ts, points, normals = found
            require_few(len(slots), most)
            order = np.lexsort((self._columns.node_handle[slots], ts))
            slots, ts, points, normals = slots[order], ts[order], points[order], normals[order]
        if self.planar:
            points[:, 2] = origin[2]
        hits = zip(slots.tolist(), ts.tolist(), points, normals, strict=True)
        return [self._hit(*hit) for hit in hits]

    # ---- boxes

    def overlap(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        orientation: ArrayLike = (0.0, 0.0, 0.0, 0.0),
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
        query = box_query(start, goal, orientation, tolerance, self.planar)
        return self._touching(query, mask, most)

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
        return self._touching(shape_query(shape, tolerance, self.planar), mask)

    def overlap_pairs(self, mask: int = ALL) -> list[tuple[str, str]]:
        """Return the names of all obstacles that touch each other.

        Each pair once, the older obstacle first; sorted by handle. `mask`: only obstacles with
        ``categories & mask != 0`` are seen.
        """
        pairs = overlaps.find_pairs(self._tree, self._columns, mask)
        if self._columns.shadows:
            pairs = overlaps.each_once(self._columns, pairs)
        return [
            (self._registry.name(one), self._registry.name(two)) for one, two in pairs.tolist()
        ]

    def _touching(self, query: QueryShape, mask: int, most: int | None = None) -> list[SceneHit]:
        if query.aligned and not self._any_shaped:
            found = overlaps.find_boxes(self._tree, query, checks.mask(mask), most)
        else:
            found = overlaps.find(self._tree, self._columns, query, checks.mask(mask), most)
        slots, distances, points, normals = found
        order = np.lexsort((self._columns.node_handle[slots], distances))
        return self._each_once(
            [self._hit(int(slots[i]), float(distances[i]), points[i], normals[i]) for i in order]
        )

    def _each_once(self, hits: list[SceneHit]) -> list[SceneHit]:
        """Of hits of one obstacle at two places, see slicing.py, the first."""
        if not self._columns.shadows:
            return hits
        first: dict[int, SceneHit] = {}
        for hit in hits:
            first.setdefault(hit.handle, hit)
        return list(first.values())

    def _hit(self, slot: int, t: float, point: Floats, normal: Floats) -> SceneHit:
        columns = self._columns
        return SceneHit(
            self._registry.name(slot),
            int(columns.node_handle[slot]),
            t,
            point,
            normal,
            int(columns.stamp[slot]),
        )
