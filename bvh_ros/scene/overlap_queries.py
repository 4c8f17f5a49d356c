# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What touches a box or another shape in a scene, and what touches each other."""

from typing import Any

from numpy.typing import ArrayLike

from ..tree.access import ALL, checks
from .distance import batch
from .distance.batch import WANTED
from .distance.distances import Distances
from .distance.query import (
    BOXES,
    UNTURNED,
    QueryShape,
    box_query,
    given_rows,
    query_rows,
    shape_query,
)
from .results import SceneHit
from .shapes.shape import Floats, Shapes, as_one_shape, unchecked_shapes
from .store import Obstacles
from .timed_queries import TimedQueries


def turns_of(orientations: ArrayLike, count: int, name: str = 'orientations') -> Floats:
    """Quaternions of all rows, or one for all, as (n, 4) or (1, 4)."""
    turns = checks.rows_or_one(name, orientations, 4, count)
    checks.rotations(name, turns)
    return turns


def _turns_given(orientations: ArrayLike, count: int) -> Floats:
    """`turns_of`, but several rows are checked where a kernel has found a fault in any."""
    turns = checks.rows_or_one('orientations', orientations, 4, count)
    if len(turns) == 1:
        checks.rotations('orientations', turns)
    return turns


class OverlapQueries:
    """What touches. Any number of threads may ask while none changes the scene."""

    _store: Obstacles
    _timed: TimedQueries
    _distances: Distances

    def overlap(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        orientation: ArrayLike | None = None,
        tolerance: float = 0.0,
        mask: int = ALL,
        most: int | None = None,
        at: float | None = None,
    ) -> list[SceneHit]:
        """Return all obstacles that touch a box, nearest to its centre first, ties by handle.

        Parameters
        ----------
        start, goal : array_like, shape (3,), or (2,) in a planar scene
            Opposite corners of the box, m. If they are equal it is a point, with `tolerance` a
            ball.
        orientation : array_like, shape (4,), optional
            Quaternion x, y, z, w of the box's axes.
        tolerance : float
            The box is grown by this all round, with rounded corners: obstacles at most so far from
            it count, m.
        mask : int
            Only obstacles with ``categories & mask != 0`` are seen.
        most : int, optional
            More than so many are refused: an answer is never cut short.
        at : time, optional
            An int in ns, or a float in s: the world as it is then: obstacles with
            velocities are where they are at that time. None: as last reported.

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
        if self._store.change.unfinished:
            self._store.change.require_none()
        planar = self._store.planar
        if planar:
            start, goal = checks.with_z('start', start), checks.with_z('goal', goal)
        query = box_query(start, goal, orientation, tolerance, planar)
        limit = checks.whole_or_none('most', most, 0)
        return self._overlap(query, None, mask, limit, at)

    def _overlap(
        self, query: QueryShape, hulls: Any, mask: int, most: int | None, at: Any
    ) -> list[SceneHit]:
        """What a query touches."""
        distances, second = self._distances, None
        if self._timed.time_matters(at, None, 1):
            distances, second = self._timed.distances(), self._timed.second(at)
        return distances.find(query, hulls, checks.mask(mask), most, second)

    def overlap_shape(
        self, shape: Shapes, tolerance: float = 0.0, mask: int = ALL, at: float | None = None
    ) -> list[SceneHit]:
        """Return all obstacles that touch a shape of any kind; otherwise as `overlap`.

        Parameters
        ----------
        shape : Shapes
            One row. A planar scene sees it from above too.
        tolerance, mask, at
            As in `overlap`.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        query, hulls = shape_query(shape, tolerance, self._store.planar)
        return self._overlap(query, hulls, mask, None, at)

    def overlap_many(
        self,
        centers: ArrayLike,
        sizes: ArrayLike,
        orientations: ArrayLike | None = None,
        tolerance: ArrayLike = 0.0,
        mask: ArrayLike = ALL,
        want: str = 'any',
        threads: int = 1,
        at: ArrayLike | None = None,
    ) -> Any:
        """Return what touches each of n boxes; a row is what `overlap_shape` says of a box.

        Parameters
        ----------
        centers : array_like, shape (n, 3), or (n, 2) in a planar scene
            m.
        sizes : array_like, shape (n, 3), or one row for all, or a number
            Edge lengths, m; in a planar scene two are enough. One number is that of cubes. A box
            without any is a point, with `tolerance` a ball.
        orientations : array_like, shape (n, 4), or (4,) for all, optional
            Quaternions x, y, z, w of the boxes' axes.
        tolerance, mask, at : one for all boxes, or array_like of shape (n,)
            As in `overlap`.
        want : {'any', 'count', 'first', 'all', 'hits'}
            What is returned of each box.
        threads : int
            The boxes are shared among so many threads; the answer does not depend on it.

        Returns
        -------
        (n,) bool, with 'any'
            Whether anything touches the box.
        (n,) int64, with 'count'
            How many obstacles do.
        (n,) uint32, with 'first'
            Node handle of the first of `overlap`; NO_NODE (0xFFFFFFFF) without any.
        (offsets, handles), with 'all'
            Node handles of those that touch box i are ``handles[offsets[i]:offsets[i + 1]]``, in
            the order of `overlap`; int64 of shape (n + 1,), and uint32.
        BoxHits, with 'hits'
            How many there are, the first, its closest point, and how far that is.

        Raises
        ------
        ValueError
            As `overlap`; the message names the first bad row. If `want` is none of these.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        places = checks.rows('centers', centers, 3, None, self._store.planar)
        turns, count = UNTURNED, len(places)
        edges = checks.edge_lengths('sizes', sizes, count, self._store.planar)
        if orientations is not None:
            turns = _turns_given(orientations, count)
        given = BOXES, places, turns, edges
        names = 'centers', 'sizes', 'orientations'
        return self._answer(given, None, names, (tolerance, mask, threads, at), want)

    def overlap_shape_many(
        self,
        shape: Shapes,
        positions: ArrayLike,
        orientations: ArrayLike | None = None,
        tolerance: ArrayLike = 0.0,
        mask: ArrayLike = ALL,
        want: str = 'any',
        threads: int = 1,
        at: ArrayLike | None = None,
    ) -> Any:
        """Return what touches one shape at n poses; a row is what `overlap_shape` says of it.

        Parameters
        ----------
        shape : Shapes
            One row. Its poses are those given here, not its own.
        positions : array_like, shape (n, 3), or (n, 2) in a planar scene
            m.
        orientations : array_like, shape (n, 4), or (4,) for all, optional
            Quaternions x, y, z, w. None: that of the shape.
        tolerance, mask, want, threads, at
            As in `overlap_many`, which see for what is returned and raised.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        kinds, _, turns, sizes, mesh = as_one_shape(shape, self._store.planar)
        places = checks.rows('positions', positions, 3, None, self._store.planar)
        count = len(places)
        if orientations is not None:
            turns = _turns_given(orientations, count)
        if mesh is not None and len(turns) != count:
            turns = turns.repeat(count, axis=0)
        if mesh is not None:
            kinds, sizes, mesh = kinds.repeat(count), sizes.repeat(count, 0), mesh.repeat(count)
        names = 'positions', '', '' if orientations is None else 'orientations'
        given = kinds, places, turns, sizes
        return self._answer(given, mesh, names, (tolerance, mask, threads, at), want)

    def _answer(
        self,
        given: tuple[Any, ...],
        mesh: Any,
        names: tuple[str, ...],
        options: tuple[ArrayLike, ArrayLike, int, Any],
        want: str,
    ) -> Any:
        """What `overlap_many` returns of any shapes, as of `Shapes`; options = (tolerance, mask,
        threads, at).
        """
        wanted = WANTED.get(want) if isinstance(want, str) else None
        if wanted is None:
            shown = checks.shown_short(want)
            raise ValueError(f'want must be any, count, first, all or hits, not {shown}')
        tolerance, mask, threads, at = options
        if type(threads) is not int or threads != 1:
            threads = checks.whole('threads', threads, 1)
        distances, times, count = self._distances, None, len(given[1])
        if at is not None:
            times = self._timed.seconds(at, count)
            distances = distances if times is None else self._timed.distances()
        if mesh is None:
            rows = given_rows(given, tolerance, mask)
            answers = distances.touching(rows, count, None, wanted, threads, times)
            if answers is not None:
                return answers
        if names[2] and given[2] is not UNTURNED:
            checks.rotations(names[2], given[2])
        shapes = unchecked_shapes(given[0], given[1], given[2], given[3], mesh)
        legal, hulls = query_rows(shapes, tolerance, mask, self._store.planar, *names)
        return distances.touching(tuple(legal), count, hulls, wanted, threads, times)

    def overlap_pairs(self, mask: int = ALL) -> list[tuple[str, str]]:
        """Return the names of all obstacles that touch each other.

        Each pair once, the older obstacle first; sorted by handle. `mask`: only obstacles with
        ``categories & mask != 0`` are seen.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        pairs = batch.find_pairs(self._store.tree, self._store.columns, mask)
        if self._store.columns.shadows:
            pairs = batch.each_once(self._store.columns, pairs)
        return [
            (self._store.registry.name(one), self._store.registry.name(two))
            for one, two in pairs.tolist()
        ]
