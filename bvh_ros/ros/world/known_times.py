# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The times that a node can be asked about: from its newest data on, so far as it may predict.

A node of which no source predicts has none of this: the stamps of its requests say nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bvh_ros.ros.conversions.times import nanoseconds

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bvh_ros.scene import Scene

NOTHING = 'nothing has been told yet that could be predicted'


class Span(NamedTuple):
    """Times in ns; None is now, the world as last told."""

    at: int | None = None
    until: int | None = None  # None: the world is frozen at that time


NOW = Span()


class KnownTimes:
    """Says which times are known.

    Parameters
    ----------
    scene : Scene
    max_prediction : float
        So long (s) after the newest data.
    """

    def __init__(self, scene: Scene, max_prediction: float) -> None:
        self._scene = scene
        self._ahead = round(max_prediction * 1e9)

    def require(self, span: Span, now: int) -> Span:
        """Return the span.

        Raises
        ------
        ValueError
            If one of its times is not known; `now` (ns on the node's clock).
        """
        if span.at is None:
            return span
        first, last = self._ends(now)
        stop = span.at if span.until is None else span.until
        if span.at < first:
            ago = (first - span.at) / 1e9
            raise ValueError(f'the time asked for is {ago:.9g} s before the newest data (history)')
        if stop > last:
            ahead = (stop - last) / 1e9 + self._ahead / 1e9
            raise ValueError(
                f'the time asked for is {ahead:.9g} s after the newest data, '
                f'more than max_prediction ({self._ahead / 1e9:g} s)'
            )
        return span

    def known(
        self, at: NDArray[np.int64], until: NDArray[np.int64], now: int
    ) -> NDArray[np.bool_]:
        """Which rows (n,) ask about known times, ns."""
        first, last = self._ends(now)
        return np.asarray((at >= first) & (until <= last))

    def _ends(self, now: int) -> tuple[int, int]:
        """First and last time that is known, ns."""
        newest = min(self._scene.newest, now)  # no data are newer than now, whatever they say
        if not self._scene.newest:
            raise ValueError(NOTHING)
        return newest, newest + self._ahead


def span_of(request: Any, *, moves: bool) -> Span:
    """Return the times that a nav_msgs/srv/GetPlan request is about.

    Parameters
    ----------
    request : nav_msgs.srv.GetPlan.Request
    moves : bool
        Whether it asks about a way, and not about a place.

    Raises
    ------
    ValueError
        If its stamps make no sense.
    """
    start = nanoseconds(request.start.header.stamp)
    goal = nanoseconds(request.goal.header.stamp)
    if not goal:
        return Span(start or None)
    if not start:
        raise ValueError('goal has a stamp, and start has none: when it is left is not known')
    if goal < start:
        raise ValueError(f'goal is stamped {(start - goal) / 1e9:.9g} s before start')
    if moves:
        return Span(start, goal)
    if goal != start:
        raise ValueError('start and goal have different stamps, but one time is asked for')
    return Span(start)
