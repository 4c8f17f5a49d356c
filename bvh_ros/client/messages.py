# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers and arrays to messages of questions, and replies to answers."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from numpy.typing import ArrayLike, DTypeLike, NDArray

from bvh_ros.ros.conversions import nanoseconds, query_clouds
from bvh_ros.ros.conversions.plans import ERROR, set_pose
from bvh_ros.ros.conversions.query_clouds import Boxes, Points, Rays
from bvh_ros.ros.conversions.rotations import IDENTITY as UPRIGHT
from bvh_ros.scene import ShapeKind, Shapes
from bvh_ros.scene.shapes.shape import as_shapes
from bvh_ros.tree.access import checks, whole_ns

COMPILING = 'compiling: '  # begins the reason of a node that will answer soon
LAST_STAMP = 2**31 * 10**9 - 1  # ns
LARGEST = float(np.finfo(np.float32).max)

Vector = tuple[float, float, float]
Floats = NDArray[np.float64]


class BvhError(RuntimeError):
    """The node could not answer; the text is the node's reason."""


class BvhTimeoutError(BvhError):
    """No answer came in time."""


class NoRowAnsweredError(BvhError):
    """The node answered no row of a batch; a cloud of answers has no room for the reason."""


class Hit(NamedTuple):
    """One obstacle in an answer.

    A reply has no field for how far along the segment it is. For a thin ray that is the distance
    from the start to `point`; for a ball the rows of `raycast_many` have their `t`.
    """

    name: str
    point: Vector  # on the obstacle, in the node's frame, m
    normal: Vector  # outward, unit length; +x where the node has no direction to give
    stamp: int  # last update of the obstacle, ns; with `until`, the time of contact


def request(
    start: Sequence[float],
    goal: Sequence[float],
    tolerance: float,
    frame_id: str,
    orientation: Sequence[float] = UPRIGHT,
    *,
    at: float | None = None,
    until: float | None = None,
) -> GetPlan.Request:
    """Return a request of one question; `at` and `until` are the stamps of start and goal.
    ValueError if an argument has the wrong form.
    """
    made = GetPlan.Request(tolerance=tolerance)
    turn = checks.vector('orientation', orientation, 4)
    checks.rotations('orientation', turn[None])
    for stamped, where, orientation, name, time in (
        (made.start, start, turn.tolist(), 'at', at),
        (made.goal, goal, UPRIGHT, 'until', until),
    ):
        set_pose(stamped, frame(frame_id), _time(name, time), where, orientation)
    return made


def place(name: str, given: Sequence[float]) -> list[float]:
    """Return 3 coordinates; z is 0 if left out."""
    found: list[float] = checks.vector(name, given, 3, planar=True).tolist()
    return found


def length(name: str, given: float) -> float:
    """Return a number that a request can hold, in float32."""
    number = checks.one(name, given)
    if LARGEST < abs(number) < np.inf:
        raise ValueError(f'{name} must be at most {LARGEST:g} m, not {number:g}')
    return number


def frame(frame_id: str) -> str:
    """Return the name of a frame; ValueError if it is none."""
    if not isinstance(frame_id, str):
        raise ValueError(f'frame_id must be a string, not {checks.shown_short(frame_id)}')
    return frame_id


def stamp(given: int | None) -> int | None:
    """Return the stamp of a cloud, ns; ValueError if it is none."""
    return None if given is None else checks.whole('stamp', given, 0, LAST_STAMP)


def handles(obstacles: Iterable[int]) -> NDArray[np.int64]:
    """Return the handles of obstacles; ValueError if they are no integers."""
    try:
        return np.fromiter(obstacles, np.int64)
    except Exception as error:  # whatever an object of another library raises
        raise ValueError(f'obstacles must be integers: {error}') from None


def _time(name: str, stamp: float | None) -> int:
    """Return a time in ns; 0 is none."""
    if stamp is None:
        return 0
    if isinstance(stamp, (float, np.floating)):
        stamp = int(whole_ns(name, np.asarray(stamp), stamp))
    if not checks.is_integer(stamp):
        shown = checks.shown_short(stamp)
        raise ValueError(f'{name} must be an int (ns) or a float (s), not {shown}')
    if not 0 < stamp <= LAST_STAMP:
        raise ValueError(f'{name} must be above 0 and below 2^31 s, not {stamp} ns')
    return int(stamp)


def hits(reply: GetPlan.Response) -> list[Hit]:
    """Return the hits of a reply, in its order; BvhError with the reason if it is an error."""
    found = [_hit(stamped) for stamped in reply.plan.poses]
    if found and found[0].name.startswith(ERROR):
        raise BvhError(found[0].name[len(ERROR) :])
    return found


def first_hit(reply: GetPlan.Response) -> Hit | None:
    """Return the first hit of a reply, or None; BvhError with the reason if it is an error."""
    found = hits(reply)
    return found[0] if found else None


def _hit(stamped: PoseStamped) -> Hit:
    at, turn, stamp = stamped.pose.position, stamped.pose.orientation, stamped.header.stamp
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    return Hit(
        stamped.header.frame_id,
        (at.x, at.y, at.z),
        # The node sends the normal as the rotation of +x.
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)),
        nanoseconds(stamp),
    )


class Poses(NamedTuple):
    """Poses of a footprint."""

    places: Floats
    """(n, 3) m."""
    turns: Floats
    """(n, 4) quaternions."""


class Batch(NamedTuple):
    """Questions of one kind, a row each."""

    kind: str
    """Of `node.KINDS`."""
    questions: Rays | Points | Boxes | Poses
    begin: int | None
    """ns: the earliest time of the rows, where a stamp can be near it; None: now."""
    message: Callable[[int, Any], Any]
    """Return a message with a stamp (ns) of the rows of an index."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.questions[0])


def rays(
    origins: ArrayLike,
    directions: ArrayLike,
    t_max: ArrayLike,
    mask: ArrayLike,
    radius: ArrayLike | None,
    at: ArrayLike | None,
    until: ArrayLike | None,
) -> Batch:
    """Return n rays, or balls along them; ValueError where an argument does not fit."""
    starts, along = checks.both(checks.RAY_ARGUMENTS, origins, directions, 3, planar=True)
    count = len(starts)
    narrow = all(getattr(each, 'dtype', None) == np.float32 for each in (origins, directions))
    given = Rays(
        starts,
        along,
        numbers_of('t_max', t_max, count),
        checks.masks(mask, count),
        np.dtype(np.float32 if narrow else np.float64),
        None if radius is None else numbers_of('radius', radius, count),
    )
    times, ends = spans_of(at, until, count)
    if times is not None and ends is not None:
        moves = ends > times
        if (moves & np.isinf(given.t_max)).any():
            raise ValueError('t_max must end a ray that takes time')
        t_max = np.where(moves, given.t_max, 0.0)
        given = given._replace(durations=np.where(moves, (ends - times) / 1e9 * t_max, 0.0))
    return _cloud_batch('rays', given, times, given.real)


def points(
    places: ArrayLike, max_distance: ArrayLike, mask: ArrayLike, at: ArrayLike | None
) -> Batch:
    """Return n points; ValueError where an argument does not fit."""
    where = places_of('points', places)
    count = len(where)
    reaches = numbers_of('max_distance', max_distance, count)
    return _cloud_batch(
        'points', Points(where, reaches, checks.masks(mask, count)), times_of('at', at, count)
    )


def boxes(
    centers: ArrayLike,
    sizes: ArrayLike,
    orientations: ArrayLike | None,
    tolerance: ArrayLike,
    mask: ArrayLike,
    at: ArrayLike | None,
) -> Batch:
    """Return n boxes; ValueError where an argument does not fit."""
    where = places_of('centers', centers)
    count = len(where)
    given = Boxes(
        where,
        np.broadcast_to(checks.edge_lengths('sizes', sizes, count, planar=True), (count, 3)),
        turns_of(orientations, count),
        numbers_of('tolerance', tolerance, count),
        checks.masks(mask, count),
    )
    return _cloud_batch('boxes', given, times_of('at', at, count))


def _cloud_batch(
    kind: str, given: Any, times: NDArray[np.int64] | None, real: DTypeLike = np.float64
) -> Batch:
    def message(stamp: int, some: Any) -> Any:
        timed = given
        if times is not None:  # in s after the stamp of their cloud
            timed = given._replace(since=(times - stamp) / 1e9)
        return query_clouds.questions_cloud(query_clouds.take(timed, some), real)

    begin = -1 if times is None or not len(times) else int(times.min())
    return Batch(kind, given, begin if 0 <= begin <= LAST_STAMP else None, message)


def poses(
    positions: ArrayLike,
    orientations: ArrayLike | None,
    at: ArrayLike | None,
    *,
    between: bool = False,
) -> Batch:
    """Return n poses, or the sweeps `between` them; ValueError where an argument does not fit."""
    places = places_of('positions', positions)
    given = Poses(places, turns_of(orientations, len(places)))
    times = times_of('at', 0 if at is None else at, len(places))
    if times is None or (len(times) and not 0 <= times.min() <= times.max() <= LAST_STAMP):
        raise ValueError('at must be what a stamp can hold')

    def message(_: int, some: Any) -> Path:
        made = Path()
        columns = (given.places[some], given.turns[some], times[some])
        for place, turn, stamp in zip(*(column.tolist() for column in columns), strict=True):
            made.poses.append(PoseStamped())
            set_pose(made.poses[-1], '', stamp, place, turn)
        return made

    return Batch('path sweeps' if between else 'paths', given, None, message)


def spans_of(
    at: ArrayLike | None, until: ArrayLike | None, count: int
) -> tuple[NDArray[np.int64] | None, NDArray[np.int64] | None]:
    """Return when n rows begin and end, ns; ValueError if one ends before it begins."""
    begin, end = times_of('at', at, count), times_of('until', until, count)
    if end is not None:
        if begin is None:
            raise ValueError('until needs at')
        if (end < begin).any():
            row = int(np.argmax(end < begin))
            raise ValueError(f'until must not be before at: row {row} is')
    return begin, end


def times_of(name: str, given: ArrayLike | None, count: int) -> NDArray[np.int64] | None:
    """Return times (n,) in ns, from one for all rows or one a row; None: now."""
    if given is None:
        return None
    try:
        values = np.asarray(given)
    except Exception as error:  # whatever an object of another library raises
        raise ValueError(f'{name} must be ints (ns) or floats (s): {error}') from None
    if values.dtype.kind == 'f' and values.size and values.shape in ((), (count,)):
        values = whole_ns(name, values, given)
    if values.dtype.kind != 'i':
        raise ValueError(f'{name} must be ints (ns) or floats (s), not {values.dtype}')
    if values.shape not in ((), (count,)):
        raise ValueError(f'{name} must be one number or have the shape ({count},)')
    return np.broadcast_to(values, (count,)).astype(np.int64)


def turns_of(given: ArrayLike | None, count: int, name: str = 'orientations') -> Floats:
    """Return quaternions (n, 4), from one for all rows or one a row; None: along the axes."""
    turns = UPRIGHT if given is None else given
    rows = np.broadcast_to(checks.rows_or_one(name, turns, 4, count), (count, 4))
    finite = np.isfinite(rows).all(axis=1, keepdims=True)  # the node answers other rows, not these
    checks.rotations(name, np.where(finite, rows, UPRIGHT))
    return rows


def places_of(name: str, given: ArrayLike, count: int | None = None) -> Floats:
    """Return places (n, 3), of two coordinates or three; with a count, from one for all rows or
    one a row.
    """
    if count is None:
        return checks.rows(name, given, 3, None, planar=True)
    return np.broadcast_to(checks.rows_or_one(name, given, 3, count, planar=True), (count, 3))


def numbers_of(name: str, given: ArrayLike, count: int) -> Floats:
    """Return numbers (n,), from one for all rows or one a row."""
    found: Any = given
    if not isinstance(given, np.ndarray) or given.shape in ((), (count,)):
        found = checks.floats(name, given)
    if found.shape not in ((), (count,)):
        raise ValueError(f'{name} must be one number or have shape ({count},), not {found.shape}')
    return np.broadcast_to(found, (count,))


# ---- Questions that only the typed services answer: clearances and sweeps of shapes


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
    request.max_distances = _doubles(numbers_of('max_distance', max_distance, count))
    request.signed_distances = checks.flag('signed', signed)
    _set_times(request, times_of('at', at, count), None)
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
    request.goal_positions = _doubles(places_of('goal_positions', goal_positions, count))
    if goal_orientations is not None:
        turns = turns_of(goal_orientations, count, 'goal_orientations')
        request.goal_orientations = _doubles(turns)
    request.tolerances = _doubles(numbers_of('tolerance', tolerance, count))
    request.resolution = checks.one('resolution', resolution)
    _set_times(request, *spans_of(at, until, count))
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
    request.header.frame_id = frame(frame_id)
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
    if not 0 < first <= LAST_STAMP:
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
