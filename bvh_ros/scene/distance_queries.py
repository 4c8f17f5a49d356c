# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far obstacles are, by their true shapes."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.access import ALL, IS_CHANGED, NONE, checks
from .distance.batch import Near, Neighbours, Points, Signed
from .distance.distances import MANY, NO_ORDER, Distances
from .distance.query import NO_GIVEN, given_rows, query_rows
from .results import NO_NODE, Clearance, Clearances, NearestObstacles, SceneHit
from .shapes.shape import GEOMETRY, Floats, Shapes, as_shapes
from .store import Obstacles
from .timed_queries import TimedQueries


class DistanceQueries:
    """How far things are. Any number of threads may ask while none changes the scene."""

    _store: Obstacles
    _timed: TimedQueries
    _distances: Distances

    def nearest(
        self,
        point: ArrayLike,
        k: int = 1,
        max_distance: float = np.inf,
        mask: int = ALL,
        signed: bool = False,
        at: float | None = None,
    ) -> list[SceneHit]:
        """Return the up to k obstacles nearest to a point, nearest first, ties by handle.

        Parameters
        ----------
        point : array_like, shape (3,)
            m. In a planar scene z is ignored, and may be left out.
        k : int
            How many at most.
        max_distance : float
            Farther ones are left out, m; may be inf.
        mask : int
            Only obstacles with ``categories & mask != 0`` are seen.
        signed : bool
            Within an obstacle the distance is minus the depth, the point the closest one of its
            surface, and the normal leads out there. So the first is that in which the given point
            lies deepest.
        at : time, optional
            An int in ns, or a float in s: the world is asked for as it is then, with obstacles
            that have velocities where they are at that time. None: it is as last told.

        Returns
        -------
        list of SceneHit
            `point` is the obstacle's point closest to the given one, `t` the distance between the
            two (m), `normal` leads from the obstacle's point to the given one; zero if that lies
            in the obstacle, and `signed` is false, or on the surface of a mesh that is not convex.

        Raises
        ------
        ValueError
            If an argument is NaN, negative (`max_distance`), less than 1 (`k`) or of the wrong
            shape; if `signed`, in a planar scene, and the point lies in a mesh that is not convex:
            its depth there is not known.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        where = checks.point('point', point, 3, self._store.planar)
        limits = checks.limit('max_distance', max_distance), checks.mask(mask)
        many = checks.whole('k', k, 1)
        distances, second = self._distances, None
        if self._timed.time_matters(at, None, 1):
            distances, second = self._timed.distances(), self._timed.second(at)
        hits = distances.find_nearest(where, many, limits, sign_of(signed), second)
        if signed and hits:
            self._require_depths(np.array([hits[0].t]), np.array([hits[0].handle]))
        return hits

    def clearance(
        self, name: str, signed: bool = False, at: float | None = None
    ) -> Clearance | None:
        """Return how far an obstacle is from the nearest other one, ties by handle; None if there
        is no other.

        Where they touch it is 0; if `signed`, minus the penetration depth: the least distance by
        which either has to move until they only just touch, which is along the way from `point` to
        `other_point`, both on the surfaces then. So the nearest is that which is met deepest.

        Both by their true shapes; in a planar scene seen from above, the points at the height of
        the obstacle's centre. Two shapes that are no farther apart than their positions are
        rounded touch, see `narrow_phase`. `at` (ns): both where they are at that time. KeyError if
        there is no obstacle of this name. For shapes that are no obstacles see `clearance_many`.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        slot = self._store.slot(name)
        distances, times = self._distances, None
        if self._timed.time_matters(at, None, 1):
            distances, times = self._timed.distances(), self._timed.seconds(at, 1)
        slots, handles = [slot], self._store.columns.node_handle
        if self._store.columns.shadows:  # it may stand at two places, see slicing.py
            slots = np.flatnonzero(handles == handles[slot]).tolist()
        sign: Signed = sign_of(signed)
        every = [self._other(distances, place, sign, times) for place in slots]
        found = min(every, key=lambda one: (one.distances.item(0), handles[one.slots[0]]))
        if found.slots[0] == NONE:
            return None
        self._require_depths(found.distances, found.handles)
        return Clearance(
            found.distances.item(0),
            self._store.registry.name(found.slots[0]),
            int(handles[found.slots[0]]),
            found.points[0],
            found.other_points[0],
        )

    def _other(self, distances: Distances, slot: int, signed: Signed, at: Any) -> Neighbours:
        """What is nearest to the obstacle of a slot."""
        options, hulls = (checks.FOREVER, slot, signed), self._store.columns.hulls
        room = np.empty(1, GEOMETRY), np.zeros((1, 2, 3))  # a kernel fills them in
        rows = *room, checks.NOTHING, checks.EVERYTHING, NO_GIVEN
        found = distances.clearances(rows, 1, hulls, options, 1, at)
        assert found is not None
        return found

    def nearest_many(
        self,
        points: ArrayLike,
        k: int = 1,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        signed: bool = False,
        threads: int = 1,
        at: ArrayLike | None = None,
    ) -> NearestObstacles:
        """Return the obstacles nearest to each of n points; a row is what `nearest` says.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            m. In a planar scene z is ignored, and may be left out.
        k : int
            How many of each at most.
        max_distance, mask, at : one for all points, or array_like of shape (n,)
            As in `nearest`.
        signed : bool
            As in `nearest`: within an obstacle the distance is minus the depth.
        threads : int
            The points are shared among so many threads; the answer does not depend on it.

        Returns
        -------
        NearestObstacles
            handles and distances (n, k), and points (n, k, 3).

        Raises
        ------
        ValueError
            As `nearest`; the message names the first bad row.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        where, many = checks.rows('points', points, 3, None, self._store.planar), k
        if type(k) is not int or k != 1:
            many = checks.capacity('k', k)
        count = len(where)
        if count >= MANY:
            checks.finite('points', where)  # else a kernel looks
        reaches = checks.limits_or_one('max_distance', max_distance, count)
        masks = checks.masks_or_one(mask, count)
        # As Points(...), which would take one more call of a function of Python's.
        order = NO_ORDER if count < MANY else self._distances.order_of(where)
        options = tuple.__new__(Points, (where, reaches, masks, order, None))
        sign: Signed = sign_of(signed)
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        times = None if at is None else self._timed.seconds(at, count)
        distances, most = self._distances, many
        if times is not None:
            distances = self._timed.distances()
            most = 1 if many == 1 else min(many, max(len(self._store.tree), 1))
        near = distances.nearest(options, most, sign, threads, times)
        if near is None:
            checks.finite('points', where)
            raise RuntimeError(IS_CHANGED)
        if signed:
            self._require_depths(near.distances[:, 0], near.handles[:, 0])
        columns = near if near[0].shape[1] == many else _padded(near, many)
        # As NearestObstacles(...), which would take one more call of a function of Python's.
        return tuple.__new__(NearestObstacles, columns)

    def clearance_many(
        self,
        shapes: Shapes,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        signed: bool = False,
        threads: int = 1,
        at: ArrayLike | None = None,
    ) -> Clearances:
        """Return how far each of n shapes is from the nearest obstacle, ties by handle.

        A row is what `clearance` says of an obstacle of this shape; the shapes themselves are no
        obstacles.

        Parameters
        ----------
        shapes : Shapes
            n rows.
        max_distance, mask : one for all shapes, or array_like of shape (n,)
            Obstacles that are farther away (m), or are not seen, are left out.
        at : one for all shapes, or array_like of shape (n,), optional
            As in `nearest`.
        signed : bool
            As in `clearance`: where they touch the distance is minus the depth.
        threads : int
            The shapes are shared among so many threads; the answer does not depend on it.

        Returns
        -------
        Clearances
            handles and distances (n,), points and other_points (n, 3).

        Raises
        ------
        ValueError
            If a row is no legal shape, or another argument is NaN, negative or of the wrong shape;
            if `signed`, and two shapes touch of which one has a mesh that is not convex: only that
            of a ball and a solid is known then, and in a planar scene none.
        """
        found = self._clear_many(shapes, max_distance, mask, signed, threads, at)
        if signed:
            self._require_depths(found.distances, found.handles)
        _, distances, points, other_points, handles = found
        # As Clearances(...), which would take one more call of a function of Python's.
        return tuple.__new__(Clearances, (handles, distances, points, other_points))

    def _clear_many(
        self,
        shapes: Shapes,
        max_distance: ArrayLike,
        mask: ArrayLike,
        signed: bool,
        threads: int,
        at: ArrayLike | None,
    ) -> Neighbours:
        """The same; where they touch and no depth is known, the distance is -inf."""
        if self._store.change.unfinished:
            self._store.change.require_none()
        given = as_shapes(shapes, self._store.planar)
        count = len(given.kind)
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        reaches = checks.FOREVER
        if max_distance is not np.inf:
            reaches = checks.limits_or_one('max_distance', max_distance, count)
        options, found = (reaches, NONE, sign_of(signed)), None
        distances, times = self._distances, None
        if at is not None:
            times = self._timed.seconds(at, count)
            distances = distances if times is None else self._timed.distances()
        if given.mesh is None:
            rows = given_rows(given[:4], 0.0, mask)
            found = distances.clearances(rows, count, None, options, threads, times)
        if found is None:
            legal, hulls = query_rows(given, 0.0, mask, self._store.planar)
            found = distances.clearances(tuple(legal), count, hulls, options, threads, times)
        assert found is not None
        return found

    def _require_depths(self, distances: Floats, handles: NDArray[Any]) -> None:
        """ValueError that names an obstacle for which there is no signed distance."""
        bad = np.flatnonzero(np.isneginf(distances))
        if not len(bad):
            return
        columns = self._store.columns
        slot = np.flatnonzero(columns.node_handle == handles[bad[0]])[0]
        why = (
            'where a shape touches an open mesh, or where another shape than a ball touches '
            'a solid that is not convex'
        )
        if self._store.planar:
            why = 'in a planar scene where something touches a mesh that is not convex'
        name = self._store.registry.name(slot)
        raise ValueError(f'there is no signed distance {why}: row {bad[0]}, obstacle {name}')


def sign_of(signed: bool) -> Signed:
    """The same for kernels."""
    # False is the most common: a call of `checks.flag` takes 2 % of one of a row.
    return None if signed is False or not checks.flag('signed', signed) else True


def _padded(near: Near, k: int) -> tuple[NDArray[np.uint32], Floats, Floats]:
    """The columns with k places a row."""
    more = ((0, 0), (0, k - near.handles.shape[1]))
    return (
        np.pad(near.handles, more, constant_values=NO_NODE),
        np.pad(near.distances, more, constant_values=np.inf),
        np.pad(near.points, (*more, (0, 0)), constant_values=np.nan),
    )
