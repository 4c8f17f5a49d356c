# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a shape meets that goes from one pose to another, and turns on the way.

What these queries need is imported with the first of them.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.access import ALL, EVERYTHING, checks
from .distance.query import query_rows
from .overlap_queries import turns_of
from .results import NO_NODE, SceneHit, ShapeSweeps
from .shapes.shape import Floats, Shapes, as_one_shape, unchecked_shapes
from .store import Obstacles
from .timed_queries import TimedQueries

if TYPE_CHECKING:
    from .distance.moving_sweeps import TimedShapeSweeper
    from .distance.sweeps import ShapeSweeper

UNTURNED = np.array([[0.0, 0.0, 0.0, 1.0]])
WANTED = {'first': False, 'any': True}


class SweepQueries:
    """Sweeps of shapes that turn. Any number of threads may ask while none changes the scene."""

    _store: Obstacles
    _timed: TimedQueries
    _sweeper: 'ShapeSweeper | None' = None
    _timed_sweeper: 'TimedShapeSweeper | None' = None

    def sweep_shape(
        self,
        shape: Shapes,
        goal_position: ArrayLike,
        goal_orientation: ArrayLike | None = None,
        tolerance: float = 0.0,
        mask: int = ALL,
        resolution: float = 1e-4,
        at: float | None = None,
        until: float | None = None,
    ) -> SceneHit | None:
        """Return the first obstacle that a shape touches on its way to another pose.

        Its position goes along a straight line, and it turns about one axis at constant rate, by
        half a turn at most (slerp); exactly half a turn goes as the signs of the quaternions say.

        Parameters
        ----------
        shape : Shapes
            One row, in the pose from which it starts.
        goal_position : array_like, shape (3,), or (2,) in a planar scene
            m.
        goal_orientation : array_like, shape (4,), optional
            A quaternion x, y, z, w. None: it does not turn.
        tolerance : float
            The shape is grown by so much all round, m.
        mask : int
            Only obstacles with ``categories & mask != 0`` are seen.
        resolution : float
            m, more than 0. Before it touches an obstacle, a shape is at some time nearer to it
            than any resolution. What is not certain to be farther away counts as contact; so does
            what cannot be decided in doubles, some 1e-13 of the largest length.
        at, until : time, optional
            As in `raycast`.

        Returns
        -------
        SceneHit or None
            `t` is where it is between start (0) and goal (1) when it touches the obstacle, or is
            nearer than the resolution: before that it is **certain** that it touches nothing. None
            is as certain. `point` is the obstacle's closest point then, `normal` leads from there
            to the shape; zero if they overlap at the start. Ties go to the smaller handle.

        Raises
        ------
        ValueError
            If the shape is not one legal row, or another argument is NaN, infinite or of the wrong
            shape, `tolerance` negative, or `resolution` not above 0.

        Notes
        -----
        Conservative advancement (Mirtich 1996; Zhang, Lee and Kim 2006) on certified distances.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        given = as_one_shape(shape, self._store.planar)
        checks.finite('the position of shape', given.position)
        goal = checks.point('goal_position', goal_position, 3, self._store.planar)[None]
        turns = goal_turns = given.orientation
        if goal_orientation is not None:
            goal_turns = checks.point('goal_orientation', goal_orientation, 4)[None]
            checks.rotations('goal_orientation', goal_turns)
        grown = np.array([checks.limit('tolerance', tolerance)])
        masks = EVERYTHING if mask is ALL else np.array([checks.mask(mask)])
        poses = given.position, turns, goal, goal_turns
        options = grown, masks, resolution
        (slot,), found = self._find(given, poses, options, (at, until), False, 1)
        if found.handles[0] == NO_NODE:
            return None
        return self._store.hit(int(slot), found.t.item(0), found.points[0], found.normals[0])

    def sweep_shape_many(
        self,
        shape: Shapes,
        positions: ArrayLike,
        orientations: ArrayLike | None,
        goal_positions: ArrayLike,
        goal_orientations: ArrayLike | None = None,
        tolerance: ArrayLike = 0.0,
        mask: ArrayLike = ALL,
        resolution: float = 1e-4,
        at: ArrayLike | None = None,
        until: ArrayLike | None = None,
        want: str = 'first',
        threads: int = 1,
    ) -> ShapeSweeps | NDArray[np.bool_]:
        """Return the first obstacles on n ways of one shape; a row is what `sweep_shape` says.

        Parameters
        ----------
        shape : Shapes
            One row. Its poses are those given here, not its own.
        positions, goal_positions : array_like, shape (n, 3), or (n, 2) in a planar scene
            m. One of them may be one row: the same for all.
        orientations : array_like, shape (n, 4), or (4,) for all, or None
            Quaternions x, y, z, w. None: that of the shape.
        goal_orientations : array_like, shape (n, 4), or (4,) for all, optional
            None: those of the start.
        tolerance, mask, at, until : one for all, or (n,)
            As in `sweep_shape`.
        resolution : float
            As in `sweep_shape`.
        want : str
            'first', or 'any': whether there is a contact, at whatever t.
        threads : int
            The ways are shared among so many threads; the answer does not depend on it.

        Returns
        -------
        ShapeSweeps, or (n,) bool with 'any'

        Raises
        ------
        ValueError
            As `sweep_shape`; the message names the first bad row.
        """
        if self._store.change.unfinished:
            self._store.change.require_none()
        wanted = WANTED.get(want) if isinstance(want, str) else None
        if wanted is None:
            raise ValueError(f'want must be first or any, not {checks.shown_short(want)}')
        given = as_one_shape(shape, self._store.planar)
        names = 'positions', 'goal_positions'
        ends = names, positions, goal_positions, 3, self._store.planar
        starts, goals = checks.points_of_both(*ends)
        count = len(starts)
        turns = given.orientation if orientations is None else turns_of(orientations, count)
        goal_turns = turns
        if goal_orientations is not None:
            goal_turns = turns_of(goal_orientations, count, 'goal_orientations')
        grown = checks.lengths_or_one('tolerance', tolerance, count)
        masks = EVERYTHING if mask is ALL else checks.masks_or_one(mask, count)
        poses, threads = (starts, turns, goals, goal_turns), checks.whole('threads', threads, 1)
        options = grown, masks, resolution
        _, found = self._find(given, poses, options, (at, until), wanted, threads)
        return found.t < np.inf if wanted else found

    def _find(
        self,
        given: Shapes,
        poses: tuple[Floats, Floats, Floats, Floats],
        options: tuple[Floats, Any, float],
        span: tuple[Any, Any],
        enough: bool,
        threads: int,
    ) -> tuple[NDArray[np.int64], ShapeSweeps]:
        """Check what both have in common, and ask the kernel; also the slots of the obstacles."""
        from .distance.sweeps import Rows, ShapeSweeper

        (starts, turns, goals, goal_turns), (grown, masks, resolution) = poses, options
        resolution, count = checks.limit('resolution', resolution), len(starts)
        if not 0.0 < resolution < math.inf:
            raise ValueError(f'resolution must be finite and above 0, not {resolution:g}')
        if np.isinf(grown).any():
            raise ValueError('tolerance must be finite')
        with np.errstate(over='ignore'):
            long = ~np.isfinite(goals - starts).all(axis=1)
        if long.any():
            raise ValueError(f'the way of row {int(long.argmax())} is longer than a double')
        kind, _, _, size, mesh = given
        shape = unchecked_shapes(kind, np.zeros((1, 3)), UNTURNED, size, mesh)
        legal, hulls = query_rows(shape, 0.0, ALL, False)
        body = legal.records, legal.bounds[0]
        when = self._timed.spans(*span, count)
        start, pace = (None, None) if when is None else when
        rows = Rows(*body, starts, goals, turns, goal_turns, grown, masks, resolution, pace)
        if when is None:
            if self._sweeper is None:
                self._sweeper = ShapeSweeper(self._store)
            return self._sweeper.sweep(rows, hulls, enough, threads, None)
        if self._timed_sweeper is None:
            from .distance.moving_sweeps import TimedShapeSweeper

            self._timed_sweeper = TimedShapeSweeper(self._store)
        return self._timed_sweeper.sweep(rows, hulls, enough, threads, start)
