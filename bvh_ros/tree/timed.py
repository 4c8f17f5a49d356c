# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes that move by themselves. A tree without any neither imports nor compiles `motion`."""

import math
from typing import TYPE_CHECKING, Any, Optional

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .nodes import View
from .store.arrays import Arrays, Floats, Ids

if TYPE_CHECKING:
    from .motion.queries import MotionQueries

NOW = 0.0  # the default of times


class Timed(Arrays):
    """A tree whose boxes may have velocities."""

    _motion: Optional['MotionQueries']

    def set_velocities(
        self, handles: ArrayLike, velocities: ArrayLike, reference: ArrayLike = 0.0
    ) -> None:
        """Let boxes move: at time s each is displaced by ``velocity * (s - reference)`` from its
        stored place.

        From then on `raycast`, `raycast_all`, `occluded`, `overlap`, `nearest`, their batches, and
        `boxcast` see the world as it is `at` a time, 0 by default; None is the stored places.
        With `pace`, time goes by along rays and sweeps. All of them decide exactly. All other
        methods (`boxes`, `overlap_pairs`, ...) are about the stored places. A new box has no
        velocity. A box that is moved keeps its velocity and reference until it gets others.

        Parameters
        ----------
        handles : array_like of int, shape (n,)
        velocities : array_like, shape (n, ndim)
            m/s; zero is at rest.
        reference : one time, or array_like of shape (n,)
            When the boxes are at their stored places: a float in s, or an int in ns.

        Raises
        ------
        KeyError
            If a handle names no box; then nothing is changed.
        ValueError
            If a handle is given twice, a number is not finite or the shapes do not fit; or if the
            tree is mapped from a file.

        Examples
        --------
        >>> from bvh_ros import DynamicBVH
        >>> tree = DynamicBVH(ndim=2)
        >>> car = tree.insert([10, -1], [14, 1])
        >>> tree.set_velocities([car], [[-5, 0]])
        >>> tree.raycast([0, 0], [1, 0]).t, tree.raycast([0, 0], [1, 0], at=1.0).t
        (10.0, 5.0)
        >>> tree.raycast([0, 0], [3, 0], pace=1.0).t  # at 3 m/s it is met after 1.25 s
        1.25
        """
        view = self._view()
        slots = checks.slots_of(view.tree.handles, handles)
        rows = checks.points('velocities', velocities, self.ndim, len(slots))
        times = checks.moments('reference', reference, len(slots))
        if self._motion is None:
            from .motion.queries import MotionQueries

            self._motion = MotionQueries(self.ndim, self._tree_of_boxes)
        motion, named = self._motion, view.tree.handles[slots]
        self._check_unchanged(view)
        self._change(motion.write, view.version, named, rows, times)

    def _count_nanoseconds(self, left: float = math.inf) -> None:
        """Let times, and paces, mean the whole nanoseconds nearest to them: of these all is
        decided, exactly, up to 2**51 ns (26 days) from time 0. Few of them are doubles of seconds.
        Boxes go on for `left` (s) after their reference, and then stand. For a tree without
        velocities.
        """
        if self._motion is None:
            from .motion.queries import MotionQueries

            self._motion = MotionQueries(self.ndim, self._tree_of_boxes, True, left)

    def velocities(self, handles: ArrayLike) -> tuple[Floats, Floats]:
        """(velocities, references) of boxes, shape (n, ndim) and (n,); zero where a box has none.
        KeyError if a handle names no box.
        """
        view = self._view()
        slots = checks.slots_of(view.tree.handles, handles, once=False)
        result = np.zeros((len(slots), self.ndim)), np.zeros(len(slots))
        if self._motion is not None:
            result = self._motion.velocities_of(view.tree.handles, slots)
        self._check_unchanged(view)
        return result

    @staticmethod
    def _tree_of_boxes(lo: Floats, hi: Floats, masks: Any) -> View:
        """Build a tree of other boxes, shape (n, ndim); `motion` builds one for a time."""
        raise NotImplementedError

    def _packed_velocities(self, handles: Ids) -> dict[str, Any]:
        """What a file holds of them, by name, of a tree with these handles by slot; nothing where
        no box ever had one.
        """
        return {} if self._motion is None else self._motion.packed(handles)

    def _motion_at(
        self, at: Any, pace: Any = NOW, count: int | None = None
    ) -> Optional['MotionQueries']:
        """The motion, if any box moves and `at` is not None; else None. The times, of one query or
        `count`, are checked in any case.
        """
        if at is None:
            if pace is not NOW:
                raise ValueError('pace needs at, which is None')
            return None
        if self._motion is None and not at is pace is NOW:
            checks.moments('at', at, count)
            checks.moments('pace', pace, count)
        return self._motion
