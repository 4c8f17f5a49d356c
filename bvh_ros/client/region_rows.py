# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of questions to several nodes: where each row's answer can lie."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bvh_ros.client import volumes
from bvh_ros.client.batch import earliest, since, times, with_times
from bvh_ros.client.coverage import Box, Floats, grown, ways
from bvh_ros.ros.conversions import query_clouds
from bvh_ros.ros.conversions.query_clouds import Boxes, Near, Points, Question, Touched
from bvh_ros.ros.conversions.ray_clouds import Hits, Rays, rays_cloud


class Rows(NamedTuple):
    """Questions of one kind."""

    topic: str
    answer: type[Hits | Near | Touched]
    bad: NDArray[np.bool_]
    """(n,) rows that nobody can answer."""
    most: Floats
    """(n,) no obstacle is looked for beyond this distance."""
    around: Callable[[Floats], Box]
    """Bounds of all places that are as near as some distances (n,): who knows what touches them
    knows whether there is anything so near.
    """
    begin: int | None
    """ns: the earliest time of the rows; None: now."""
    message: Callable[[NDArray[np.int64], int], Any]
    """Asks some of the rows, in a message with this stamp, ns."""


def of_rays(rays: Rays, at: ArrayLike | None, until: ArrayLike | None) -> Rows:
    """Rays, and balls that go along them; a distance is a t."""
    radii = np.zeros(1) if rays.radii is None else rays.radii

    def timed(stamp: int) -> Rays:
        return rays if at is None and until is None else with_times(rays, at, until, stamp)

    def message(some: NDArray[np.int64], stamp: int) -> Any:
        return rays_cloud(timed(stamp).take(some))

    def around(t: Floats) -> Box:
        return ways(rays.origins, rays.directions, t, radii)

    timed(0)  # what are no times is refused at once
    begin = earliest(at, len(rays.t_max))
    return Rows('rays', Hits, rays.fault()[0], rays.t_max, around, begin, message)


def of_points(asked: Points, at: ArrayLike | None) -> Rows:
    """Points whose nearest obstacles are asked for."""

    def around(distances: Floats) -> Box:
        return grown((asked.places, asked.places), distances)

    bad = query_clouds.fault(asked, 0)[0]
    begin = earliest(at, len(asked.places))
    return Rows('points', Near, bad, asked.reaches, around, begin, _cloud_of(asked, at))


def of_boxes(asked: Boxes, at: ArrayLike | None) -> Rows:
    """Boxes; whatever touches one lies around all of it."""
    count, half = len(asked.places), asked.sizes * 0.5
    with np.errstate(over='ignore', invalid='ignore'):
        ball = np.nextafter(np.linalg.norm(half, axis=1), np.inf)[:, None]
        half = np.where((asked.turns[:, :3] != 0.0).any(axis=1)[:, None], ball, half)
        box = grown(grown((asked.places, asked.places), half), asked.tolerances)
    bad = query_clouds.fault(asked, 0)[0]
    return Rows(
        *('boxes', Touched, bad, np.zeros(count), lambda _: box),
        *(earliest(at, count), _cloud_of(asked, at)),
    )


def of_poses(
    places: Floats, turns: Floats, footprint: Sequence[float], at: ArrayLike | None
) -> Rows:
    """Poses of a footprint: edge lengths of a box, or the radius of a ball."""
    when = None if at is None else times('at', at, len(places))
    half = footprint[0] if len(footprint) == 1 else float(np.linalg.norm(footprint)) * 0.5
    reach = np.nextafter(half, np.inf)
    bad = np.logical_not(np.isfinite(np.hstack((places, turns))).all(axis=1))

    def around(distances: Floats) -> Box:
        return grown(grown((places, places), reach), np.maximum(distances, 0.0))

    def message(some: NDArray[np.int64], _: int) -> Any:
        return volumes.path(places[some], turns[some], None if when is None else when[some])

    return Rows('paths', Near, bad, np.full(len(places), np.inf), around, None, message)


def _cloud_of(asked: Question, at: ArrayLike | None) -> Callable[[NDArray[np.int64], int], Any]:
    when = None if at is None else times('at', at, len(asked.places))

    def message(some: NDArray[np.int64], stamp: int) -> Any:
        rows = query_clouds.take(asked, some)
        if when is not None:
            rows = rows._replace(since=since(when[some], stamp, len(some)))
        return volumes.cloud(rows)

    return message
