# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of a message that are about other times than now."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions.ray_clouds import Floats, Hits, Rays

if TYPE_CHECKING:
    from bvh_ros.ros.world.known_times import KnownTimes
    from bvh_ros.scene import Scene

Times = NDArray[np.int64]
LONGEST = 2.0**60  # ns, as sums of these and of a stamp are no more than 64 bits


class Spans(NamedTuple):
    """When n rows begin and end, ns, and what was known when they begin."""

    at: Times
    until: Times
    which: Times
    states: list[Scene]

    def take(self, rows: NDArray[np.bool_]) -> Spans:
        """Some of the rows."""
        return Spans(self.at[rows], self.until[rows], self.which[rows], self.states)


def spans_of(
    since: Floats, durations: Floats | None, stamp: int, known: KnownTimes, now: int
) -> tuple[Spans, NDArray[np.bool_]]:
    """When rows begin, so long (s) after the stamp of their cloud, and end, and which of them
    cannot be answered.
    """
    begin = since * 1e9
    length = 0.0 * begin if durations is None else durations * 1e9
    sane = (np.abs(begin) < LONGEST) & (length < LONGEST) & (length >= 0.0)
    at, more = (np.rint(np.where(sane, c, 0.0)).astype(np.int64) for c in (begin, length))
    at += stamp
    spans, unknown = spans_between(at, at + more, known, now)
    return spans, unknown | ~sane


def spans_between(
    at: Times, until: Times, known: KnownTimes, now: int
) -> tuple[Spans, NDArray[np.bool_]]:
    """Rows that begin and end at these times, ns, and which of them cannot be answered."""
    states, which = known.states(at, now)
    good = (which >= 0) & known.within(at, until, now)
    return Spans(at, until, which, states), np.logical_not(good)


def fill(told: Any, spans: Spans, ask: Callable[[Scene, Any, Times], Any]) -> Any:
    """Fill in what ask(scene, rows, at) answers, each state's rows at once; return it."""
    for number in np.unique(spans.which).tolist():
        rows = np.flatnonzero(spans.which == number)
        found = ask(spans.states[number], rows, spans.at[rows])
        for column, part in zip(told, found, strict=True):
            column[rows] = part
    return told


def cast(rays: Rays, masks: NDArray[np.uint32], skip: bool, threads: int, spans: Spans) -> Hits:
    """First hits of rays; who takes time goes to its t_max in that time."""
    hits = Hits.unanswered(len(masks))
    for number in np.unique(spans.which).tolist():
        rows = spans.which == number
        some = rays.take(rows), masks[rows], skip, threads, spans.take(rows)
        hits = hits.put(rows, _cast(spans.states[number], *some))
    return hits


def _cast(
    scene: Scene, rays: Rays, masks: NDArray[np.uint32], skip: bool, threads: int, spans: Spans
) -> Hits:
    takes = spans.until > spans.at
    whole = np.where(takes, rays.t_max, 1.0)  # the scene's rays end at t = 1 then
    ways, limits = rays.directions * whole[:, None], np.where(takes, 1.0, rays.t_max)
    asked: Any = rays.origins, ways, limits, masks, skip, threads, rays.radii, *spans[:2]
    found = scene.raycast_many(*asked)
    hits = Hits(*found)
    return hits._replace(t=np.where(np.isfinite(hits.t), hits.t * whole, hits.t))
