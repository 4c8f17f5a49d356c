# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions that only the typed services answer: clearances and sweeps of shapes."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bvh_ros.client import messages
from bvh_ros.client.messages import BvhError
from bvh_ros.scene import ShapeKind, Shapes
from bvh_ros.scene.shapes.shape import as_shapes
from bvh_ros.tree.access import checks

Floats = NDArray[np.float64]
TRIPLES = {'points', 'normals', 'shape_points', 'obstacle_points'}
"""Fields of the answers that have three numbers a row."""


class Clearances(NamedTuple):
    """How far n shapes are from the nearest obstacle."""

    obstacles: NDArray[np.uint32]
    """(n,) node handles; FREE where there is none, UNANSWERED where the row has no answer."""
    distances: Floats
    """(n,) m: 0 where they touch, or minus the depth; inf where there is none; NaN: no answer."""
    shape_points: Floats
    """(n, 3) the closest point of the shape, m."""
    obstacle_points: Floats
    """(n, 3) the closest point of the obstacle, m."""


class Sweeps(NamedTuple):
    """The first obstacles that n moving shapes touch."""

    obstacles: NDArray[np.uint32]
    """(n,) node handles; FREE where the way is free, UNANSWERED where the row has no answer."""
    t: Floats
    """(n,) of the contact, from the start (0) to the goal (1); inf: free; NaN: no answer."""
    free_until: Floats
    """(n,) up to there it is certain that nothing is touched."""
    points: Floats
    """(n, 3) the obstacle's closest point then, m."""
    normals: Floats
    """(n, 3) from there to the shape; zero where they overlap at the start."""


class Typed(NamedTuple):
    """A request to a typed service."""

    kind: type
    """Of the service."""
    query: str
    """Its name, below that of the node."""
    request: Any
    read: Callable[[Any], Any]
    """From a response to the answers; BvhError if there is none."""
    work: float
    """Seconds that an answer takes, at most."""


def clearances(
    shapes: Shapes,
    max_distance: ArrayLike,
    mask: ArrayLike,
    signed: bool,
    at: ArrayLike | None,
    frame_id: str,
) -> Typed:
    """Return a question about n shapes; ValueError where an argument does not fit."""
    kind, given = _service('Clearance'), as_shapes(shapes)
    request, count = _about(kind, given, mask, frame_id), len(given.kind)
    request.max_distances = _doubles(messages.numbers_of('max_distance', max_distance, count))
    request.signed_distances = checks.flag('signed', signed)
    _set_times(request, messages.times_of('at', at, count), None)
    return Typed(kind, 'query/clearance', request, _reader(Clearances, count), 1e-4 * count)


def sweeps(
    shapes: Shapes,
    goal_positions: ArrayLike,
    goal_orientations: ArrayLike | None,
    tolerance: ArrayLike,
    mask: ArrayLike,
    resolution: float,
    at: ArrayLike | None,
    until: ArrayLike | None,
    frame_id: str,
) -> Typed:
    """Return a question about n sweeps; ValueError where an argument does not fit."""
    kind, given = _service('Sweep'), as_shapes(shapes)
    request, count = _about(kind, given, mask, frame_id), len(given.kind)
    request.goal_positions = _doubles(messages.places_of('goal_positions', goal_positions, count))
    if goal_orientations is not None:
        turns = messages.turns_of(goal_orientations, count, 'goal_orientations')
        request.goal_orientations = _doubles(turns)
    request.tolerances = _doubles(messages.numbers_of('tolerance', tolerance, count))
    request.resolution = checks.one('resolution', resolution)
    _set_times(request, *messages.spans_of(at, until, count))
    return Typed(kind, 'query/sweep', request, _reader(Sweeps, count), 1e-3 * count)


def _service(name: str) -> Any:
    try:
        return getattr(import_module('bvh_msgs.srv'), name)
    except (ImportError, AttributeError):  # or it is a folder of sources
        raise BvhError('this needs the package bvh_msgs, here and where the node runs') from None


def _about(kind: Any, shapes: Shapes, mask: ArrayLike, frame_id: str) -> Any:
    """Begin a request to a service: what both have in common."""
    if (shapes.kind >= ShapeKind.MESH).any():
        raise ValueError('shapes must be boxes, spheres, cylinders or capsules')
    request = kind.Request(with_names=False)
    request.header.frame_id = messages.frame(frame_id)
    request.kinds = array('B', shapes.kind.tobytes())
    request.sizes, request.positions = _doubles(shapes.size), _doubles(shapes.position)
    request.orientations = _doubles(shapes.orientation)
    request.masks = array('I', checks.masks(mask, len(shapes.kind)).tobytes())
    return request


def _set_times(
    request: Any, begin: NDArray[np.int64] | None, end: NDArray[np.int64] | None
) -> None:
    """Write times (n,) in ns as seconds after the first of them, to keep their nanoseconds."""
    if begin is None or not len(begin):
        return
    first = int(begin.min())
    if not 0 < first <= messages.LAST_STAMP:
        raise ValueError(f'at must be above 0 and below 2^31 s, not {first} ns')
    request.header.stamp.sec, request.header.stamp.nanosec = divmod(first, 1_000_000_000)
    request.departures = _doubles((begin - first) / 1e9)
    if end is not None:
        request.durations = _doubles((end - begin) / 1e9)


def _doubles(values: Floats) -> array[float]:
    return array('d', np.ascontiguousarray(values).tobytes())


def _reader(answer: Any, count: int) -> Callable[[Any], Any]:
    """Return what reads the answers to `count` rows from a response."""

    def read(response: Any) -> Any:
        failed = np.array(response.statuses, np.uint8) != response.OK
        if response.status != response.OK and failed.all():
            raise BvhError(response.message)
        columns = [np.array(getattr(response, name)) for name in answer._fields]
        widths = [3 if name in TRIPLES else 1 for name in answer._fields]
        pairs = [*zip(columns, widths, strict=True)]
        if any(len(column) != count * width for column, width in pairs):
            raise BvhError(f'the reply cannot be read: it does not have {count} rows')
        return answer(*(c.reshape(count, 3) if width == 3 else c for c, width in pairs))

    return read
