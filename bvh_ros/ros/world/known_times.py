# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The times that queries may be about, and what was known at each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions import nanoseconds
from bvh_ros.ros.texts import seconds

if TYPE_CHECKING:
    from bvh_ros.ros.parameters import Settings
    from bvh_ros.ros.sources.source import Source
    from bvh_ros.ros.world.large_changes import LargeChanges
    from bvh_ros.scene import NodeScene

COPIED_AT_ONCE = 10_000  # obstacles, some 5 ms


# The times that a query may name: as much of the past as the node keeps, and then so far as it may
# predict.
#
# A node that does neither has none of this: the stamps of its requests say nothing.

NOTHING = 'nothing has been told yet that could be predicted'


class Span(NamedTuple):
    """Times in ns; None is now, the world as last reported."""

    at: int | None = None
    until: int | None = None  # None: the world is frozen at that time


NOW = Span()


class KnownTimes:
    """Says which times are known.

    Parameters
    ----------
    changes : LargeChanges
        Has the scene.
    max_prediction : float
        So long (s) after the newest data.
    history : float
        So long (s) before the newest data.
    """

    def __init__(self, changes: LargeChanges, max_prediction: float, history: float) -> None:
        self._changes = changes
        self._states: list[tuple[int, NodeScene]] = []
        """What was known, and since when, ns; ascending."""
        self._expired_at = 0  # ns
        self._ahead, self._length = round(max_prediction * 1e9), round(history * 1e9)

    def note(self, source: Source, now: int) -> Iterator[None]:
        """Keep the scene as it is after a message of a source that came at `now` (ns on the node's
        clock); forget what is too old. Pause while a large scene is copied.
        """
        scene = self._changes.visible
        if not self._length or scene.interrupted:
            return
        if len(scene) < COPIED_AT_ONCE:
            copy = scene.copy()
        else:
            copy = yield from self._changes.read(source, scene.copy)
        stamp = min(copy.newest, now)  # no data are newer than now, whatever they say
        if self._states and self._states[-1][0] >= stamp:
            stamp = self._states.pop()[0]
        self._states.append((stamp, copy))
        # The last one before the time that is kept says what was known at its beginning.
        before = [k for k, (one, _) in enumerate(self._states) if one <= stamp - self._length]
        del self._states[: max(before, default=0)]

    def note_expiry(self, now: int) -> None:
        """Obstacles were removed at `now` (ns on the node's clock), by no message."""
        self._expired_at = now

    def forget(self) -> None:
        """Forget the past."""
        self._states.clear()
        self._expired_at = 0

    def stamps(self) -> NDArray[np.int64]:
        """Since when something was known that is kept, ns; ascending."""
        return np.array([stamp for stamp, _ in self._states], np.int64)

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
            late = seconds(first - span.at + self._length)
            raise ValueError(
                f'the requested time is {late} s before the newest data, '
                f'more than history ({seconds(self._length)} s)'
            )
        self.state(span.at, now)
        if stop > last:
            early = seconds(stop - last + self._ahead)
            raise ValueError(
                f'the requested time is {early} s after the newest data, '
                f'more than max_prediction ({seconds(self._ahead)} s)'
            )
        return span

    def states(self, at: NDArray[np.int64], now: int) -> tuple[list[NodeScene], NDArray[np.int64]]:
        """What was known at some time, and which of these at the times (n,); -1: not any more."""
        which = np.searchsorted(self.stamps(), at, 'right') - 1
        began = self._newest(now)
        if self._states:  # before, there was what has expired since
            began = max(began, self._expired_at)
        which[at >= began] = len(self._states)
        return [*(scene for _, scene in self._states), self._changes.visible], which

    def state(self, at: int, now: int) -> NodeScene:
        """What was known at a time; ValueError if it is not any more."""
        states, (which,) = self.states(np.array([at]), now)
        if which < 0:
            raise ValueError('what was known at the requested time is not kept any more')
        return states[which]

    def within(
        self, at: NDArray[np.int64], until: NDArray[np.int64], now: int
    ) -> NDArray[np.bool_]:
        """Which rows (n,) are about times that may be known, ns."""
        first, last = self._ends(now)
        return np.asarray((at >= first) & (until <= last))

    def _newest(self, now: int) -> int:
        # No data are newer than now, whatever they say.
        return min(self._changes.visible.newest, now)

    def _ends(self, now: int) -> tuple[int, int]:
        """First and last time that may be known, ns."""
        if not self._changes.visible.newest:
            raise ValueError(NOTHING)
        newest = self._newest(now)
        return newest - self._length, newest + self._ahead


def known_times(
    changes: LargeChanges, sources: Sequence[Source], settings: Settings
) -> KnownTimes | None:
    """Return the times that there are besides now; None if there are none."""
    if not (settings.predicts or settings.history):
        return None
    times = KnownTimes(changes, settings.max_prediction, settings.history)
    for source in sources:
        source.on_applied = times.note
        source.together = False  # each message is a time of its own
    return times


def span_of(request: Any, *, moves: bool) -> Span:
    """Return the times that a nav_msgs/srv/GetPlan request is about.

    Parameters
    ----------
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
        raise ValueError(f'goal is stamped {seconds(start - goal)} s before start')
    if moves:
        return Span(start, goal)
    if goal != start:
        raise ValueError('start and goal have different stamps, but this query takes one time')
    return Span(start)
